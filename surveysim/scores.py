"""From co-added maps to the uncertainty on a flat CMB band power, for every data set."""

from dataclasses import dataclass

import numpy as np

from mapmaker.bandpower import BandPower, ErrorBudget, flat_spectrum_psd, noise_error, score
from mapmaker.binning import weighted_mean
from mapmaker.spectrum import map_psd
from mapmaker.window import Window, beam_window, pixel_window, signal_window
from surveysim.coadds import CoAdds, n_arrays
from surveysim.setup import Setup
from surveysim.units import rj_to_cmb


@dataclass(frozen=True)
class DataSetScore:
    """One data set's result.

    `noise_psd` (n_bin,) [uK_CMB^2 sr] with `noise_psds` (K, n_bin) of the sign-flipped co-adds;
    `signal_psd` (n_bin,) [sr]; `window` of its array; `weights` (n_obs,) [1/mK^2 a sample] of the
    observations with data.
    """

    name: str
    n_det: int
    band: BandPower
    budget: ErrorBudget
    noise_psds: np.ndarray
    signal_psd: np.ndarray
    window: Window
    weights: np.ndarray

    @property
    def noise_psd(self) -> np.ndarray:
        """Mean over the sign-flipped co-adds."""
        return self.noise_psds.mean(axis=0)


@dataclass(frozen=True)
class Gain:
    """The ratio of two data sets' uncertainties, with the error of the pair."""

    ratio: float
    error: float


def score_survey(setup: Setup, coadds: CoAdds, names: tuple[str, ...] | None = None) -> dict[str, DataSetScore]:
    """Scores of the named data sets (all by default) from the observations so far.

    Raises ValueError with fewer than 2 observations with data, or before a window observation is in.
    """
    windows = [_window(setup, coadds, array) for array in range(n_arrays(setup))]
    noise = coadds.noise_mk2()
    scores = {}
    for s, name in enumerate(setup.data_sets):
        if names is None or name in names:
            masked = name.startswith("masked")
            n_det = len(setup.masked) if masked else len(setup.responsivity)
            good = np.isfinite(noise[:, s]) & (noise[:, s] > 0)
            psds = _noise_psds(setup, coadds, s)
            scores[name] = _score(setup, name, n_det, psds, windows[int(masked)], 1 / noise[good, s])
    return scores


def rescore(setup: Setup, item: DataSetScore, ell_min: float) -> DataSetScore:
    """The same data set scored from another lowest multipole."""
    low, high = setup.band.rings.edges_ell[:-1], setup.band.rings.edges_ell[1:]
    selected = (low >= ell_min) & (high <= setup.scene.score.ell_max)
    return _score(setup, item.name, item.n_det, item.noise_psds, item.window, item.weights, selected)


def gain(worse: DataSetScore, better: DataSetScore, factor: float = 1.0) -> Gain:
    """``factor * sigma(worse) / sigma(better)`` with the Monte Carlo error of the ratio.

    The two share signs, weather and window skies, so their errors are taken of the difference of their
    responses, and not in quadrature: `mapmaker.bandpower` on how sigma responds.
    """
    ratio = factor * worse.band.sigma_ukcmb2 / better.band.sigma_ukcmb2
    responses = [
        (item.noise_psds[:, used] / item.noise_psd[used]) @ item.band.weight[used]
        for item in (worse, better)
        for used in (item.band.weight > 0,)
    ]
    difference = (1 + responses[0] - responses[1])[:, None]
    noise = noise_error(difference, np.ones(1), worse.weights)
    weather = 0.0
    if len(worse.weights) == len(better.weights):
        relative = worse.weights / worse.weights.mean() - better.weights / better.weights.mean()
        weather = relative.std(ddof=1) / np.sqrt(len(relative))
    window = 0.0 if worse.window is better.window else np.hypot(worse.budget.window, better.budget.window)
    return Gain(ratio, ratio * float(np.sqrt(noise**2 + weather**2 + window**2)))


def _score(setup, name, n_det, psds, window, weights, selected=None) -> DataSetScore:
    rings = setup.band.rings
    beam = beam_window(rings.ell, setup.scene.instrument.beam_fwhm_rad)
    pixel = pixel_window(rings.ell, setup.scene.map.pixel_rad)
    signal = flat_spectrum_psd(rings.ell) * beam * pixel * window.transmission
    relative = np.divide(
        window.error, window.transmission, out=np.zeros_like(window.error), where=window.transmission > 0
    )
    selected = setup.band.selected if selected is None else selected
    band, budget = score(
        psds, signal, relative, rings.n_modes, selected, weights, rings.ell, rings.edges_ell
    )
    return DataSetScore(name, n_det, band, budget, psds, signal, window, weights)


def _noise_psds(setup: Setup, coadds: CoAdds, data_set: int) -> np.ndarray:
    """PSDs (K, n_bin) [uK_CMB^2 sr] of the sign-flipped co-adds."""
    patch = setup.band.patch
    maps = weighted_mean(coadds.flipped[:, data_set], coadds.weight[data_set][patch, patch])
    to_ukcmb = 1e3 * rj_to_cmb(setup.scene.instrument.frequency_hz)
    return _psd(setup, maps) * to_ukcmb**2


def _window(setup: Setup, coadds: CoAdds, array: int) -> Window:
    maps = weighted_mean(coadds.window[:, array], coadds.window_weight[array])
    psd = _psd(setup, maps)
    return signal_window(psd[:, 1], psd[:, 0], setup.band.rings.ell)


def _psd(setup: Setup, patches: np.ndarray) -> np.ndarray:
    band = setup.band
    return map_psd(band.pad(patches), band.padded_taper, setup.geometry.pixel_rad, band.rings)
