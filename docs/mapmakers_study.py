"""Map-makers on streams of the Lynx survey: `python docs/mapmakers_study.py` writes the tables of the page.

Noise is measured with the observations in random signs, the transfer function with skies that have no noise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy import fft

import mapmaker as mm
import surveysim
from mapmaker.destriping import measure_baseline_weight
from mapmaker.gls import GlsOptions, measure_noise, measure_scan_noise
from mapmaker.normal_equations import (
    NoiseWeight,
    NormalBlock,
    add_diagonal,
    add_right_side,
    normal_matrix,
    solve_normal,
)

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "validation" / "mapmakers.md"
N_OBS, N_SIGN, N_SKY, RATE_HZ = 12, 10, 2, 10.0
EDGES = np.array([500, 1000, 1500, 2000, 3000, 4000, 6000, 8000, 12000.0])
AVERAGE = mm.TemplateOptions(tolerance=1e-8, max_iterations=100)
OWN, OTHERS = "its own scan", "other scans"


@dataclass(frozen=True)
class Observation:
    """Raw and averaged streams (1 + n_sky, n_det, n_samp), noise first, and the scans that averaging keeps."""

    index: np.ndarray
    bounds: np.ndarray
    raw: np.ndarray
    averaged: np.ndarray
    kept: np.ndarray


@dataclass(frozen=True)
class Row:
    """Result of a maker: noise PSD and transfer of the amplitude (n_bin,), and iterations."""

    noise: np.ndarray
    transfer: np.ndarray
    iterations: int


class Study:
    """Observations and the tapered patch."""

    def __init__(self) -> None:
        scene = surveysim.load_scene(ROOT / "scenarios" / "lynx.toml")
        streams = [surveysim.simulate_observation(scene, k) for k in range(N_OBS)]
        self.plane = streams[0].focal_plane
        centre = mm.mean_direction(streams[0].ra_rad, streams[0].dec_rad)
        self.geometry = mm.covering_geometry(*centre, np.radians(20 / 3600), np.radians(36 / 60))
        n, pixel = self.geometry.n_y, self.geometry.pixel_rad
        self.taper = mm.tukey_taper(n, n, pixel, size_rad=np.radians(42 / 60), edge_fraction=0.5)
        self.rings = mm.annuli(n, n, pixel, edges_ell=EDGES, taper=self.taper)
        rng = np.random.default_rng(1)
        self.skies = np.array([_sky(n, pixel, rng) for _ in range(N_SKY)])
        self.signs = rng.choice([-1.0, 1.0], (N_SIGN, N_OBS))
        self.observations = [self._observation(item) for item in streams]

    def _observation(self, streams: mm.Timestreams) -> Observation:
        index, bounds, raw = mm.pixel_indices(self.geometry, streams), streams.scan_bounds, streams.data_mk
        signals = np.where(index >= 0, self.skies.reshape(N_SKY, -1)[:, index], 0).astype(raw.dtype)
        clean = partial(mm.clean, "average", scan_bounds=bounds, focal_plane=streams.focal_plane, options=AVERAGE)
        item, both = clean(raw), [clean(raw + signal) for signal in signals]
        averaged = np.stack([item.data_mk, *(one.data_mk - item.data_mk for one in both)])
        kept = np.logical_and.reduce([item.kept, *(one.kept for one in both)])
        return Observation(index, bounds, np.concatenate([raw[None], signals]), averaged, kept)

    def psd(self, image: np.ndarray) -> np.ndarray:
        """PSD (n_bin,) of a flat map."""
        return mm.map_psd(image.reshape(self.taper.shape), self.taper, self.geometry.pixel_rad, self.rings)

    def amplitude(self, maps: np.ndarray) -> np.ndarray:
        """Part (n_bin,) of the skies that is in maps (n_sky, n_pixel), by their cross-power."""
        pairs = [
            (self.psd(sky.ravel() + item) - self.psd(sky.ravel() - item)) / 4
            for sky, item in zip(self.skies, maps, strict=True)
        ]
        return np.sum(pairs, axis=0) / np.sum([self.psd(sky) for sky in self.skies], axis=0)

    def solve(self, blocks: list[list[NormalBlock]], streams: list[np.ndarray], *, signs: np.ndarray) -> tuple:
        """Maps of streams (1 + n_sky, ...), the first with signs (n_sign, n_obs), and the iterations."""
        n_pixel = self.taper.size
        right, weight, hits = (
            np.zeros((len(blocks), len(streams[0]), n_pixel)),
            np.zeros(n_pixel),
            np.zeros(n_pixel, int),
        )
        for of, data, out in zip(blocks, streams, right, strict=True):
            for block in of:
                add_right_side(block, data, out)
                add_diagonal(block, weight, hits)
        sums = np.concatenate([np.einsum("so,op->sp", signs, right[:, 0]), right[:, 1:].sum(axis=0)])
        apply = normal_matrix(lambda: [block for of in blocks for block in of], np.float32)
        found = solve_normal(apply, sums, weight.reshape(self.taper.shape), options=mm.SolveOptions(1e-4, 100))
        return found.sky_mk, found.iterations

    def row(self, blocks: list[list[NormalBlock]], streams: list[np.ndarray]) -> Row:
        """Noise and transfer of a maker, its N^-1 fixed."""
        maps, iterations = self.solve(blocks, streams, signs=self.signs)
        noise = np.mean([self.psd(item) for item in maps[:N_SIGN]], axis=0)
        return Row(noise, self.amplitude(maps[N_SIGN:]), iterations)


def _sky(n: int, pixel: float, rng: np.random.Generator) -> np.ndarray:
    """Draw a sky (n, n) [mK] of flat band power in the beam of lynx, 0.1 mK rms."""
    ell = mm.mode_ell(2 * n, 2 * n, pixel)
    power = mm.flat_spectrum_psd(ell) * mm.beam_window(ell, np.radians(1 / 60))
    item = fft.irfft2(fft.rfft2(rng.standard_normal((2 * n, 2 * n))) * np.sqrt(power), (2 * n, 2 * n))[:n, :n]
    return 0.1 * item / item.std()


@dataclass(frozen=True)
class Even:
    """White noise of one level: N^-1 of a binned map."""

    weight: float

    def apply(self, data_mk: np.ndarray, index: np.ndarray, scan_bounds: np.ndarray) -> np.ndarray:
        """Compute N^-1 d."""
        return data_mk * data_mk.dtype.type(self.weight)

    def white(self, scan_bounds: np.ndarray) -> np.ndarray:
        """Weights (1, n_scan)."""
        return np.full((1, len(scan_bounds)), self.weight)


def averaged(study: Study, weigh: Callable[[np.ndarray, Observation, np.ndarray], NoiseWeight]) -> Row:
    """Map of averaged streams."""
    blocks = []
    for item in study.observations:
        bounds = item.bounds[item.kept]
        blocks.append([NormalBlock(item.index, bounds, weigh(item.averaged[0], item, bounds))])
    return study.row(blocks, [item.averaged for item in study.observations])


def even(data: np.ndarray, item: Observation, bounds: np.ndarray) -> NoiseWeight:
    """Inverse variance of the kept scans."""
    return Even(1 / np.mean([data[:, start:stop].var() for start, stop in bounds]))


def baselines(data: np.ndarray, item: Observation, bounds: np.ndarray, *, seconds: float) -> NoiseWeight:
    """White noise about baselines."""
    return measure_baseline_weight(data, item.index, bounds, round(seconds * RATE_HZ))


def likelihood(study: Study, streams: list[np.ndarray], options: GlsOptions, measured: str) -> list[list[NormalBlock]]:
    """Blocks with the noise of streams (n_det, n_samp)."""
    measure = measure_noise if measured == OWN else measure_scan_noise
    return [
        [NormalBlock(item.index, item.bounds, measure(data, item.bounds, study.plane, RATE_HZ, options))]
        for item, data in zip(study.observations, streams, strict=True)
    ]


def measured_anew(study: Study, options: GlsOptions, measured: str) -> np.ndarray:
    """Transfer of the amplitude with the noise measured in streams that have the sky."""
    maps, one = [], np.ones((1, N_OBS))
    for k in range(N_SKY + 1):
        streams = [item.raw[0] + (item.raw[k] if k else 0) for item in study.observations]
        blocks = likelihood(study, streams, options, measured)
        maps.append(study.solve(blocks, [data[None] for data in streams], signs=one)[0][0])
    return study.amplitude(np.array(maps[1:]) - maps[0])


def table(study: Study, rows: dict[str, np.ndarray], first: str) -> str:
    """Format numbers (n_bin,) by name."""
    head = [first, *(f"{low:.0f}-{high:.0f}" for low, high in zip(EDGES, EDGES[1:], strict=False))]
    lines = [head, ["---", *["---:"] * (len(head) - 1)]]
    lines += [[name, *(f"{value:.2f}" for value in values)] for name, values in rows.items()]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Write the tables."""
    study, options = Study(), GlsOptions()
    raw = [item.raw for item in study.observations]
    noise = [item.raw[0] for item in study.observations]
    makers = {
        "binned": averaged(study, even),
        "destriped, 15 s": averaged(study, partial(baselines, seconds=15)),
        "destriped, 5 s": averaged(study, partial(baselines, seconds=5)),
        "destriped, 1.5 s": averaged(study, partial(baselines, seconds=1.5)),
        "maximum likelihood": study.row(likelihood(study, noise, options, OTHERS), raw),
    }
    plain = makers["binned"].noise / makers["binned"].transfer ** 2
    ratios = {f"{name} ({row.iterations})": row.noise / row.transfer**2 / plain for name, row in makers.items()}
    transfers = {name: row.transfer for name, row in makers.items()}
    loss = {}
    for cut in (2.0, 1.2):
        of_cut = GlsOptions(eigenvalue_cut=cut)
        for measured in (OWN, OTHERS):
            loss[f"cut {cut}, {measured}"] = measured_anew(study, of_cut, measured)
    tables = {
        "noise at equal signal": table(study, ratios, "l"),
        "transfer": table(study, transfers, "l"),
        "measured noise": table(study, loss, "noise of"),
    }
    text = PAGE.read_text()
    for name, item in tables.items():
        start, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
        text = text[: text.index(start) + len(start)] + item + "\n" + text[text.index(end) :]
    PAGE.write_text(text)


if __name__ == "__main__":
    main()
