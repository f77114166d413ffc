"""Effects that a forecast neglects, each with its size in a scene, and flags where a forecast is out of its range."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from surveysim.forecasting.mode_response import PROJECTIONS
from surveysim.forecasting.observing_conditions import Conditions
from surveysim.forecasting.pilot import Kept
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.setup import Setup
from surveysim.survey.discarded_scans import MOST_DISCARDED

LARGE = 0.1  # relative size from which on an effect is flagged
MOST_TEMPLATES = 0.25  # for each detector from which on they are flagged
MOST_UNEVEN = 0.25  # more noise, from which on coverage is flagged
_RESOLUTIONS = 3.0  # of multipole, from which on a forecast is compared
_BEAM_LEFT = 0.03  # of the power, up to where it is
_PIXEL_REACH = 0.75  # of the map pixel's Nyquist multipole
# Of the layer's noise, what forecasts lack: 20, 30, 32, 33 and 35 % of it were measured in surveys of 115 detectors in
# which it is 30, 100, 57, 27 and 46 % of the noise.
_STRIPES = 0.33
_APPROXIMATE = {"wind": "shifted along the wind", "pca": "by principal components"}  # taken as average subtraction


@dataclass(frozen=True)
class Effect:
    """An effect that a forecast neglects or only predicts.

    `size` is its size relative to the noise PSD of the scored multipoles, None where it is not known; `sentence` tells
    it; `flagged` says that the forecast may be off by more than it should be for it.
    """

    name: str
    size: float | None
    sentence: str
    flagged: bool


@dataclass(frozen=True)
class Grounds:
    """Inputs of one data set's effects: its cleaning, and its forecast of each observation.

    Of observations in the conditions `levels`: `kept` scans, `weight` (n_obs,) [1/mK^2], noise variance a sample
    `noise` and the `layer`'s part of it (n_obs, n_bin) [mK^2]. `share` (n_bin,) of bins in sigma(A)^-2; mean `hits`
    (n, n) of an observation on the scored patch.
    """

    pipeline: CleaningPipeline
    n_det: int
    levels: Conditions
    kept: Kept
    weight: np.ndarray
    noise: np.ndarray
    layer: np.ndarray
    share: np.ndarray
    hits: np.ndarray

    @property
    def layer_share(self) -> np.ndarray:
        """Share (n_obs,) of the co-added noise in the scored multipoles that is each observation's layer."""
        added = self.weight**2 * self.kept.share
        total = added @ self.noise
        parts = np.divide(self.layer * added[:, None], total, out=np.zeros_like(self.layer), where=total > 0)
        return parts @ self.share


def resolution_ell(setup: Setup) -> float:
    """Width in multipole that scans and the map's taper give a mode: 2 pi over the shorter of their lengths.

    The taper's length is that of the box with its squared sum.
    """
    score, scan = setup.scene.score, setup.scene.scan
    # A cosine's square is 3/8 on average where it falls; the taper's edges are half its fraction each.
    taper = score.size_rad * (1 - score.taper_fraction * 5 / 8)
    return 2 * np.pi / min(taper, scan.speed_rad_s * scan.duration_s)


def compared_ell(setup: Setup) -> tuple[float, float]:
    """Multipoles in which a forecast of noise PSDs is compared with a run's.

    From `_RESOLUTIONS` times `resolution_ell` on, below which the ends of scans and the map's edge rule, to where the
    beam leaves `_BEAM_LEFT` of the power, or `_PIXEL_REACH` of the map pixel's Nyquist multipole or that of the samples
    if these are lower.
    """
    scene = setup.scene
    width = scene.instrument.beam_fwhm_rad / np.sqrt(8 * np.log(2))
    beam = np.sqrt(-np.log(_BEAM_LEFT)) / width
    samples = np.pi * scene.scan.sample_rate_hz / scene.scan.speed_rad_s
    return _RESOLUTIONS * resolution_ell(setup), float(min(beam, _PIXEL_REACH * np.pi / scene.map.pixel_rad, samples))


def effects(setup: Setup, grounds: Grounds) -> tuple[Effect, ...]:
    """Effects on the forecast of one data set, in the order of the noise's way from the scans to the score."""
    return tuple(_effects(setup, grounds))


def _effects(setup: Setup, grounds: Grounds) -> Iterator[Effect]:
    if grounds.pipeline.takes_responsivities:
        yield _discarded(grounds.kept)
    if setup.scene.atmosphere is not None:
        yield _repeated_layer(setup, grounds)
        if grounds.pipeline.steps != ("none",):
            yield _stripes(grounds)
        if (name := grounds.pipeline.label) in _APPROXIMATE:
            sentence = f"Cleaning {_APPROXIMATE[name]} is taken as average subtraction: the difference is not known."
            yield Effect("cleaning", None, sentence, True)
    if templates := len(PROJECTIONS[grounds.pipeline.label]):
        yield _few_detectors(templates, grounds.n_det)
    yield _uneven_coverage(setup, grounds.hits)
    yield _weights(setup, grounds)
    yield _low_multipoles(setup, grounds.share)


def _discarded(kept: Kept) -> Effect:
    share, error = kept.discarded, kept.error
    if np.isinf(error):
        sentence = "The share of scans that cleaning discards is not known: a trial of a few would be too large."
        return Effect("discarded scans", None, sentence, True)
    if error == 0:
        sentence = f"Cleaning discarded {_percent(share)} of the scans; the noise counts on those that were kept."
    else:
        known = f"{100 * share:.1f} +- {100 * error:.1f} %"
        sentence = f"Cleaning discards {known} of the scans, by a trial of a few; the noise counts on the others."
    return Effect("discarded scans", share, sentence, share > MOST_DISCARDED)


def _repeated_layer(setup: Setup, grounds: Grounds) -> Effect:
    """The layer's noise of observations in which consecutive scans see the same air: taken as independent.

    Without cleaning all of it: a scan's trend is that of the next in any wind.
    """
    path = setup.scene.scan
    parts = grounds.layer_share
    if grounds.pipeline.steps == ("none",):
        size, where = float(parts.sum()), "Scans share trends of the layer in any wind"
    else:
        wind = np.abs(grounds.levels.motion - path.speed_rad_s).mean(axis=1)
        travel = wind * (path.duration_s + path.turnaround_s)
        slow = travel < 2 * setup.camera.radius_rad
        size = float(parts[slow].sum())
        where = f"In {_percent(slow.mean())} of the observations consecutive scans see the same part of the layer"
    sentence = f"{where}, which is taken as independent: {_percent(size)} of the noise."
    return Effect("scans that share air", size, sentence, size > LARGE)


def _stripes(grounds: Grounds) -> Effect:
    """Stripes of one and two of the raster's steps, which a layer makes that cleaning leaves."""
    layer = float(grounds.layer_share.sum())
    size = _STRIPES * layer
    sentence = (
        f"After cleaning {_percent(layer)} of the noise is the layer's, which makes stripes of one and two steps:"
        f" they are neglected, about {_percent(size)} of the noise."
    )
    return Effect("stripes", size, sentence, size > LARGE)


def _few_detectors(templates: int, n_det: int) -> Effect:
    """Share of a stream that templates take of itself: what is left of a signal differs by so much between detectors.

    Where the detectors that pass over a place differ from those that pass over another, that scatters the signal of
    low multipoles over all others.
    """
    size = templates / n_det
    sentence = (
        f"Templates ({templates} for {n_det} detectors) take {_percent(size)} of each stream's own noise, and what they"
        " leave of the signal differs by as much between detectors: the mean is taken."
    )
    return Effect("few detectors", size, sentence, size > MOST_TEMPLATES)


def _uneven_coverage(setup: Setup, hits: np.ndarray) -> Effect:
    """Excess of the noise that the mean of 1 / hits makes over one with even hits: what ties multipoles together."""
    weight, covered = setup.band.taper**2, hits > 0
    mean = np.average(hits[covered], weights=weight[covered])
    size = float(np.average(mean / hits[covered], weights=weight[covered]) - 1)
    missed = float(1 - weight[covered].sum() / weight.sum())
    sentence = f"Hits differ over the map: {_percent(size)} more noise than with even hits, taken as alike at all ell"
    sentence += f"; {_percent(missed)} of the map has none." if missed > 0 else "."
    return Effect("uneven coverage", size, sentence, size > MOST_UNEVEN or missed > LARGE)


def _weights(setup: Setup, grounds: Grounds) -> Effect:
    """Scatter of measured weights: a run corrects its effect for white maps and to first order."""
    band = setup.band
    modes = band.rings.n_modes
    measured = grounds.noise * np.sqrt(grounds.share * modes)
    scatter = np.sum(measured**2 / modes, axis=1) * 2 / np.sum(measured, axis=1) ** 2
    mean = float(np.average(scatter, weights=grounds.weight))
    size = abs(mean - band.noise_scatter) + mean**2
    sentence = (
        f"An observation's weight is measured on its own map, to {_percent(np.sqrt(mean))}: "
        f"beyond what a run corrects, {_percent(size)} of the noise."
    )
    return Effect("weights", size, sentence, size > LARGE)


def _low_multipoles(setup: Setup, share: np.ndarray) -> Effect:
    """Share of the score from multipoles where the ends of scans and the edge of the map rule."""
    low, _ = compared_ell(setup)
    size = float(share[setup.band.rings.edges_ell[:-1] < low].sum())
    sentence = (
        f"Below ell = {low:.0f} the ends of scans, the map's edge and its gaps matter, which are approximated: "
        f"{_percent(size)} of sigma(A)^-2 is from there."
    )
    return Effect("low multipoles", size, sentence, size > LARGE)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share < 0.0995 else f"{100 * share:.0f} %"
