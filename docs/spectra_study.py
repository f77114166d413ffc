"""Band powers of simulated skies, and null tests: `python docs/spectra_study.py` writes the tables of the page.

Every sky is drawn anew, four times as large as the map along each axis. The spectrum has the peaks and the damping tail
of the CMB, and a rise of point sources.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy import fft, stats

import mapmaker as mm

PAGE = Path(__file__).parent / "validation" / "spectra.md"
N, PIXEL, FWHM = 96, np.radians(2 / 60), np.radians(5 / 60)  # 3.2 degrees
EDGES = np.arange(300.0, 3001, 300)
TAPER = mm.tukey_taper(N, N, PIXEL, size_rad=N * PIXEL, edge_fraction=1.0)
BEAM = partial(mm.beam_window, fwhm_rad=FWHM)
NOISE_UK = np.array([15.0, 20, 25])  # of a pixel, in three splits
Spectrum = Callable[[np.ndarray], np.ndarray]


def cmb(ell: np.ndarray) -> np.ndarray:
    """l(l+1) C_l / 2 pi [uK^2] with peaks and troughs every 310 in l, damped as that of the CMB."""
    peaks = 1 + 0.5 * np.cos(2 * np.pi * (ell - 220) / 310)
    return 2500 * peaks * np.exp(-((ell / 1100) ** 1.3)) + 30 * (ell / 3000) ** 2


def skies(spectrum: Spectrum, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Gaussian skies (N, N) [uK] in beam and pixels, without end."""
    ell = mm.mode_ell(4 * N, 4 * N, PIXEL)
    power = spectrum(ell) * mm.flat_spectrum_psd(ell) * BEAM(ell) * mm.mode_pixel_window(4 * N, 4 * N, PIXEL, PIXEL)
    amplitude = np.sqrt(power) / PIXEL
    while True:
        white = rng.standard_normal((4 * N, 4 * N))
        yield fft.irfft2(fft.rfft2(white) * amplitude, (4 * N, 4 * N))[:N, :N]


def high_pass(maps: np.ndarray) -> np.ndarray:
    """Maps (..., N, N) whose rows have lost their mean and slope."""
    along = np.arange(N) - (N - 1) / 2
    slope = (maps @ along)[..., None] * along / (along @ along)
    return maps - maps.mean(axis=-1, keepdims=True) - slope


def transfer(n_sky: int, seed: int) -> np.ndarray:
    """Transfer function of `high_pass`, from skies of a flat band power."""
    flat = skies(lambda ell: np.full_like(ell, 1e3), np.random.default_rng(seed))
    whole = np.array([next(flat) for _ in range(n_sky)])
    rings = mm.annuli(N, N, PIXEL, edges_ell=EDGES, taper=TAPER)
    psds = (mm.map_psd(maps, TAPER, PIXEL, rings) for maps in (high_pass(whole), whole))
    return mm.measure_transfer_function(*psds, rings.ell).transmission


@dataclass(frozen=True)
class Recovery:
    """Band powers (n_sky, n_bin) of skies, and those expected."""

    coupling: mm.ModeCoupling
    expected: np.ndarray
    found: np.ndarray
    analytic: mm.Covariance

    @property
    def pull(self) -> np.ndarray:
        """Deviations of the mean over skies, in standard errors, (n_bin,)."""
        return (self.found.mean(axis=0) - self.expected) / self.found.std(axis=0) * np.sqrt(len(self.found))

    @property
    def error_ratio(self) -> np.ndarray:
        """Analytic errors over the scatter of the skies, (n_bin,)."""
        return self.analytic.error_uk2 / self.found.std(axis=0, ddof=1)

    def chi_squared(self, covariance: mm.Covariance) -> list[mm.ChiSquared]:
        """Chi-squared of each sky about the expected band powers."""
        return [mm.chi_squared(item - self.expected, covariance) for item in self.found]


def recovery(n_sky: int, seed: int, *, filtered: bool = False) -> Recovery:
    """Band powers of skies in three splits of different noise, filtered by `high_pass` or not."""
    rng = np.random.default_rng(seed)
    left = transfer(200, seed + 1) if filtered else None
    coupling = mm.flat_coupling(TAPER, PIXEL, edges_ell=EDGES, beam=BEAM, transfer=left)
    expected, found = coupling.windows @ cmb(coupling.window_ell), []
    for _, sky in zip(range(n_sky), skies(cmb, rng), strict=False):
        maps = sky + NOISE_UK[:, None, None] * rng.standard_normal((3, N, N))
        found.append(mm.cross_band_powers(high_pass(maps) if filtered else maps, coupling, signal_uk2=expected))
    return Recovery(coupling, expected, np.array([item.power_uk2 for item in found]), found[0].covariance)


def scan_noise(number: int, rng: np.random.Generator) -> np.ndarray:
    """Pairs of maps (number, 2, N, N) of noise that rises along the rows and towards the map's edges."""
    along = np.abs(np.fft.rfftfreq(N))
    colour = np.sqrt(1 + (0.05 / np.maximum(along, 1 / N)) ** 2)
    across = np.linspace(-1, 1, N)
    depth = 1 + 0.5 * (across[:, None] ** 2 + across**2)
    white = rng.standard_normal((number, 2, N, N)) * NOISE_UK[:2, None, None]
    return fft.irfft(fft.rfft(white) * colour, N) * depth


def null_tests(n_test: int, n_realization: int, seed: int) -> list[mm.NullTest]:
    """Null tests of splits with one sky, each with realizations of its own."""
    rng = np.random.default_rng(seed)
    coupling = mm.flat_coupling(TAPER, PIXEL, edges_ell=EDGES, beam=BEAM)
    found = []
    for _, sky in zip(range(n_test), skies(cmb, rng), strict=False):
        realized = mm.null_power(scan_noise(n_realization, rng), coupling)
        splits = mm.null_power(scan_noise(1, rng)[0] + sky, coupling)
        found.append(mm.null_test(splits, realized, coupling))
    return found


def band_powers() -> str:
    """Markdown: band powers of 100 skies, and of 1000 filtered ones."""
    whole, many, filtered = recovery(100, 1), recovery(2000, 21), recovery(1000, 11, filtered=True)
    head = "| l | input at mean l | expected | mean of 100 skies | deviation [standard errors] | analytic error [uK2] "
    head += "| over that of 2000 skies | filtered, mean over expected | error |\n" + "|---:" * 9 + "|\n"
    rows = zip(
        whole.coupling.ell,
        cmb(whole.coupling.ell),
        whole.expected,
        whole.found.mean(axis=0),
        whole.pull,
        whole.analytic.error_uk2,
        many.error_ratio,
        filtered.found.mean(axis=0) / filtered.expected,
        filtered.found.std(axis=0) / filtered.expected / np.sqrt(1000),
        strict=True,
    )
    form = "| {:.0f} | {:.1f} | {:.1f} | {:.1f} | {:+.1f} | {:.1f} | {:.2f} | {:.3f} | {:.3f} |\n"
    return head + "".join(form.format(*row) for row in rows) + "\n" + chi_squareds(whole, filtered, many)


def chi_squareds(whole: Recovery, filtered: Recovery, many: Recovery) -> str:
    """Markdown: mean chi-squared of skies and the probability that PTEs are uniform."""
    measured = mm.monte_carlo_covariance(many.found)
    text = "| skies | covariance | mean chi^2 of 9 bins | PTE below 0.05 [%] | KS probability |\n"
    text += "|---|---|---:|---:|---:|\n"
    for name, skies_, covariance in (
        ("100", whole, whole.analytic),
        ("100", whole, measured),
        ("2000", many, many.analytic),
        ("1000, filtered", filtered, filtered.analytic),
    ):
        found = skies_.chi_squared(covariance)
        kind = "2000 realizations" if covariance.n_realizations else "analytic"
        values, ptes = (np.array([getattr(item, key) for item in found]) for key in ("value", "pte"))
        share, uniform = 100 * np.mean(ptes < 0.05), uniformity(ptes)
        text += f"| {name} | {kind} | {values.mean():.2f} | {share:.1f} | {uniform:.2f} |\n"
    return text


def nulls() -> str:
    """Markdown: null tests with few and many realizations."""
    text = "| realizations | tests | mean chi^2 of 9 bins | PTE below 0.05 [%] | the same, chi^2 distribution [%] "
    text += "| KS probability |\n|---:|---:|---:|---:|---:|---:|\n"
    for n_realization, n_test in ((15, 1000), (30, 1000), (100, 200)):
        found = [item.chi_squared for item in null_tests(n_test, n_realization, n_realization)]
        values, ptes = (np.array([getattr(item, key) for item in found]) for key in ("value", "pte"))
        share, naive = 100 * np.mean(ptes < 0.05), 100 * np.mean(stats.chi2.sf(values, found[0].n_bin) < 0.05)
        text += f"| {n_realization} | {n_test} | {values.mean():.2f} | {share:.1f} | {naive:.1f} "
        text += f"| {uniformity(ptes):.2f} |\n"
    return text


def uniformity(ptes: list[float] | np.ndarray) -> float:
    """Probability of a larger Kolmogorov-Smirnov distance, if PTEs are uniform."""
    return float(stats.kstest(ptes, "uniform").pvalue)


if __name__ == "__main__":
    tables = {"band powers": band_powers(), "null tests": nulls()}
    text = PAGE.read_text(encoding="utf-8")
    for name, table in tables.items():
        begin, end = f"<!-- {name} of docs/spectra_study.py -->\n", f"<!-- end of the {name} -->\n"
        before, rest = text.split(begin)
        text = f"{before}{begin}\n{table}\n{end}{rest.split(end)[1]}"
    PAGE.write_text(text, encoding="utf-8")
