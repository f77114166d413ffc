"""Effects that a forecast neglects, each with its size in a scene, and flags where the forecast is out of its range."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mapmaker.cleaning import TIME_FILTERS
from surveysim.forecasting.mode_response import PROJECTIONS
from surveysim.forecasting.observing_conditions import ObservingConditions
from surveysim.forecasting.pilot import KeptScans
from surveysim.forecasting.track_motions import TrackMotions
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.map_noise import weighs_itself
from surveysim.reduction.scored_region import ScoredRegion
from surveysim.reduction.setup import Setup
from surveysim.scene.scene import Scene
from surveysim.survey.discarded_scans import MOST_DISCARDED
from surveysim.timestreams.crosstalk import CrosstalkMatrix
from surveysim.timestreams.expected_losses import sampled_share

LARGE = 0.1  # relative size above which an effect is flagged
MOST_TEMPLATES = 0.25  # templates a detector above which they are flagged
MOST_LOST = 0.3  # fraction of lost samples above which they are flagged
MOST_UNEVEN = 0.25  # excess noise above which uneven coverage is flagged
MOST_TAKEN = 0.5  # weight that a solved map loses above which it is flagged
_RESOLUTIONS = 3.0  # of `resolution_ell`: lower end of compared multipoles
_BEAM_LEFT = 0.03  # power in the beam: upper end of compared multipoles
_PIXEL_REACH = 0.75  # of the map pixel's Nyquist multipole
# Fraction of the layer's noise that forecasts lack. It was 20, 30, 32, 33 and 35 % in surveys of 115 detectors in which
# the layer makes 30, 100, 57, 27 and 46 % of the noise.
_STRIPES = 0.33
_SCATTERED = 0.07  # least fraction of the mean noise of all multipoles that is scattered to each
_APPROXIMATE = {"wind": "shifted along the wind", "pca": "by principal components"}  # taken as average subtraction
_OF_CHUNKS = (
    "Filters in time are those of a chunk whose middle crosses the middle of the patch; others lose more at their ends,"
    " by about a tenth of sigma(A)."
)
_OF_BINNED = "The forecast is that of a binned map: the bright pixels that an iterative map restores are not known."


@dataclass(frozen=True)
class NeglectedEffect:
    """Effect that a forecast neglects or only predicts.

    Attributes
    ----------
    name
    size
        Size relative to the noise PSD of the scored multipoles; None where unknown.
    sentence
        Description for the reader.
    flagged
        True where the effect may make the forecast too inaccurate.
    """

    name: str
    size: float | None
    sentence: str
    flagged: bool


@dataclass(frozen=True)
class EffectInputs:
    """Forecast of one data set, from which the sizes of neglected effects follow.

    Attributes
    ----------
    pipeline, n_det
        Cleaning pipeline and number of detectors.
    conditions
        Observing conditions of the observations.
    kept
        Scans that cleaning keeps.
    weight : (n_obs,)
        Weights of the observations [1/mK^2].
    noise, layer : (n_obs, n_bin)
        Noise variance a sample, and the layer's contribution [mK^2].
    share : (n_bin,)
        Fraction of sigma(A)^-2 from each bin.
    hits : (n, n)
        Mean hits of an observation on the scored patch.
    tracks
        Velocities and curvature along the tracks of the boresight.
    taken : (n_bin,), optional
        Fraction of the weight that a solved map gives to baselines or to a measured noise model; None for binned maps.
    """

    pipeline: CleaningPipeline
    n_det: int
    conditions: ObservingConditions
    kept: KeptScans
    weight: np.ndarray
    noise: np.ndarray
    layer: np.ndarray
    share: np.ndarray
    hits: np.ndarray
    tracks: TrackMotions
    taken: np.ndarray | None = None

    @property
    def co_added(self) -> np.ndarray:
        """Noise (n_bin,) of the co-added observations, up to a factor."""
        return self.weight**2 * self.kept.share @ self.noise

    @property
    def layer_share(self) -> np.ndarray:
        """Fraction (n_obs,) of the co-added noise in the scored multipoles that comes from each observation's layer."""
        added = self.weight**2 * self.kept.share
        total = added @ self.noise
        parts = np.divide(self.layer * added[:, None], total, out=np.zeros_like(self.layer), where=total > 0)
        return parts @ self.share


def resolution_ell(scene: Scene) -> float:
    """Resolution in multipole of scans and the map's taper: 2 pi over the shorter of their lengths.

    The length of the taper is that of a box with the same sum of squares.
    """
    score, scan = scene.score, scene.scan
    # The square of a cosine edge averages to 3/8; each edge has half of the taper's fraction.
    taper = score.size_rad * (1 - score.taper_fraction * 5 / 8)
    return 2 * np.pi / min(taper, scan.speed_rad_s * scan.duration_s)


def compared_ell(scene: Scene) -> tuple[float, float]:
    """Multipoles in which a forecast noise PSD is compared with that of a run.

    Returns
    -------
    low, high
        `low` is `_RESOLUTIONS` times `resolution_ell`; at lower multipoles scan ends and the map's edge dominate.
        `high` is the lowest of three: the multipole where the beam leaves `_BEAM_LEFT` of the power, `_PIXEL_REACH` of
        the map pixel's Nyquist multipole, and the Nyquist multipole of the samples.
    """
    width = scene.instrument.beam_fwhm_rad / np.sqrt(8 * np.log(2))
    beam = np.sqrt(-np.log(_BEAM_LEFT)) / width
    samples = np.pi * scene.scan.sample_rate_hz / scene.scan.fastest_rad_s
    return _RESOLUTIONS * resolution_ell(scene), float(min(beam, _PIXEL_REACH * np.pi / scene.map.pixel_rad, samples))


def neglected_effects(setup: Setup, inputs: EffectInputs) -> tuple[NeglectedEffect, ...]:
    """Estimate the effects that the forecast of one data set neglects, in the order from scans to score."""
    return tuple(_iterate_effects(setup, inputs))


def _iterate_effects(setup: Setup, inputs: EffectInputs) -> Iterator[NeglectedEffect]:
    if inputs.pipeline.takes_responsivities:
        yield _discarded(inputs.kept)
    if inputs.taken is not None:
        yield _map_maker(setup.scene.map.maker, float(inputs.taken @ inputs.share))
    if setup.scene.map.maker == "iterative":
        yield NeglectedEffect("map-maker", None, _OF_BINNED, True)
    if setup.scene.turbulent:
        yield _repeated_layer(setup, inputs)
        if inputs.pipeline.spatial_step != "none":
            if inputs.tracks.straight:
                yield _stripes(inputs)
            yield _scattered(setup.analysis.region, inputs)
    if setup.scene.turbulent and (name := inputs.pipeline.spatial_step) in _APPROXIMATE:
        sentence = f"Cleaning {_APPROXIMATE[name]} is approximated by average subtraction, with an unknown difference."
        yield NeglectedEffect("cleaning", None, sentence, True)
    if setup.scene.crosstalk is not None and inputs.pipeline.detectors is not None:
        yield _crosstalk(setup, inputs.pipeline)
    if setup.scene.losses:
        yield _lost_samples(setup.scene, inputs)
    if templates := len(PROJECTIONS[inputs.pipeline.spatial_step]):
        yield _few_detectors(templates, inputs.n_det)
    if not inputs.tracks.straight:
        if not set(inputs.pipeline.steps).isdisjoint(TIME_FILTERS):
            yield NeglectedEffect("filters", None, _OF_CHUNKS, True)
        yield _curvature(setup.analysis.region, inputs)
    yield _uneven_coverage(setup.analysis.region, inputs.hits)
    if not weighs_itself(setup.scene.map):
        yield _weights(setup.analysis.region, inputs)
    yield _low_multipoles(setup, inputs.share)


def _discarded(kept: KeptScans) -> NeglectedEffect:
    share, error = kept.discarded, kept.error
    if np.isinf(error):
        sentence = (
            "The fraction of scans that cleaning discards is unknown: a pilot would be too large. It is taken as 0."
        )
        return NeglectedEffect("discarded scans", None, sentence, True)
    if error == 0:
        sentence = f"Cleaning discarded {_percent(share)} of the scans; the noise is that of the kept scans."
    else:
        known = f"{100 * share:.1f} +- {100 * error:.1f} %"
        sentence = f"Cleaning discards {known} of the scans, by a pilot; the noise is that of the kept scans."
    return NeglectedEffect("discarded scans", share, sentence, share > MOST_DISCARDED)


def _map_maker(maker: str, size: float) -> NeglectedEffect:
    """Fraction of the weight of the scored modes that baselines, or the modes of a measured noise model, take."""
    if maker == "destriped":
        sentence = "Baselines couple modes, which the forecast takes as independent, and"
    else:
        sentence = "The noise model is measured on the streams that it weighs: its modes"
    return NeglectedEffect("map-maker", size, f"{sentence} take {_percent(size)} of the weight.", size > MOST_TAKEN)


def _return_s(setup: Setup, tracks: TrackMotions) -> float:
    """Time after which a track comes back to the same part of the scored patch, about.

    Scans come back in the next scan, curved tracks after twice the width of the patch.
    """
    scan = setup.scene.scan
    if tracks.straight:
        return scan.duration_s + scan.turnaround_s
    return 2 * setup.scene.score.size_rad / scan.speed_rad_s


def _repeated_layer(setup: Setup, inputs: EffectInputs) -> NeglectedEffect:
    """Size of the layer's noise where the track sees the same air again, which the forecast takes as independent.

    Without cleaning it is the whole layer: the trends of consecutive scans are alike in any wind.
    """
    parts = inputs.layer_share
    if inputs.pipeline.spatial_step == "none":
        size, where = float(parts.sum()), "Scans share trends of the layer in any wind"
    else:
        travel = inputs.conditions.winds_rad_s * _return_s(setup, inputs.tracks)
        amplitude = inputs.conditions.layers
        total = amplitude.sum(axis=0)
        alike = np.sum(amplitude, axis=0, where=travel < 2 * setup.camera.radius_rad)
        slow = np.divide(alike, total, out=np.zeros_like(total), where=total > 0)
        size = float(parts @ slow)
        where = f"In {_percent(slow.mean())} of the observations consecutive scans see the same part of the layer"
    sentence = f"{where}, which the forecast takes as independent: {_percent(size)} of the noise."
    return NeglectedEffect("scans that share air", size, sentence, size > LARGE)


def _stripes(inputs: EffectInputs) -> NeglectedEffect:
    """Size of stripes with periods of one and two raster steps, which the residual layer makes."""
    layer = float(inputs.layer_share.sum())
    size = _STRIPES * layer
    sentence = (
        f"After cleaning the layer makes {_percent(layer)} of the noise; its stripes with periods of one and two raster"
        f" steps are neglected, about {_percent(size)} of the noise."
    )
    return NeglectedEffect("stripes", size, sentence, size > LARGE)


def _scattered(region: ScoredRegion, inputs: EffectInputs) -> NeglectedEffect:
    """Noise of other multipoles that uneven coverage and the trends that scans share scatter to the scored ones."""
    counts, noise = region.rings.n_modes, inputs.co_added
    mean = counts @ noise / counts.sum()
    beyond = np.divide(mean, noise, out=np.ones_like(noise), where=noise > 0) - 1
    coverage, _ = _unevenness(region, inputs.hits)
    size = max(0.0, float(max(_SCATTERED, coverage) * (beyond @ inputs.share)))
    sentence = (
        f"Uneven coverage and trends of the layer that scans share scatter noise of all multipoles to the scored ones,"
        f" about {_percent(size)} of their noise, which the forecast neglects."
    )
    return NeglectedEffect("scattered noise", size, sentence, size > LARGE)


def _curvature(region: ScoredRegion, inputs: EffectInputs) -> NeglectedEffect:
    """Fraction of the noise from parts of the track that turn by more than a radian in a wavelength of the modes."""
    ell = float(region.rings.ell @ inputs.share)
    size = float(np.mean(inputs.tracks.curvature * 2 * np.pi / ell > 1))
    sentence = (
        f"The forecast takes the track as straight over a wavelength of the scored multipoles, about ell = {ell:.0f};"
        f" {_percent(size)} of the noise is from parts that turn by more than a radian in it."
    )
    return NeglectedEffect("curved track", size, sentence, size > LARGE)


def _crosstalk(setup: Setup, pipeline: CleaningPipeline) -> NeglectedEffect:
    """Fraction of the signal's power that crosstalk adds to the largest structures, in a part of the detectors."""
    ones = np.ones((setup.camera.n_det, 1))
    seen = CrosstalkMatrix(setup.scene.crosstalk, setup.camera.readout_groups).times(ones)[pipeline.rows]
    size = float(abs(np.mean(seen) ** 2 - 1))
    sentence = (
        f"Crosstalk changes the signal's power by up to {_percent(size)}, which the forecast of a part of the detectors"
        " neglects."
    )
    return NeglectedEffect("crosstalk", size, sentence, size > LARGE)


def _lost_samples(scene: Scene, inputs: EffectInputs) -> NeglectedEffect:
    """Fraction of the samples that is lost, which the forecast takes out of the hits alone."""
    size = 1 - float(np.mean(sampled_share(scene, inputs.conditions.white + inputs.conditions.shared)))
    sentence = (
        f"{_percent(size)} of the samples are lost, which lowers the hits of the forecast; it neglects that templates"
        " are made of fewer detectors and of filled gaps."
    )
    return NeglectedEffect("lost samples", size, sentence, size > MOST_LOST)


def _few_detectors(templates: int, n_det: int) -> NeglectedEffect:
    """Fraction of a stream's own signal that templates remove, by which the transfer function differs between
    detectors.

    Where the detectors differ between places of the map, this scatters signal from low multipoles to all others.
    """
    size = templates / n_det
    sentence = (
        f"Templates ({templates} for {n_det} detectors) remove {_percent(size)} of each stream's own noise, and the"
        " transfer function differs by as much between detectors; the forecast takes the mean."
    )
    return NeglectedEffect("few detectors", size, sentence, size > MOST_TEMPLATES)


def _uneven_coverage(region: ScoredRegion, hits: np.ndarray) -> NeglectedEffect:
    """Excess of the mean of 1 / hits over that of uniform coverage, which couples multipoles."""
    size, missed = _unevenness(region, hits)
    sentence = f"Uneven coverage raises the noise by {_percent(size)}, which the forecast takes as equal at all ell"
    sentence += f"; {_percent(missed)} of the map has no hits." if missed > 0 else "."
    return NeglectedEffect("uneven coverage", size, sentence, size > MOST_UNEVEN or missed > LARGE)


def _unevenness(region: ScoredRegion, hits: np.ndarray) -> tuple[float, float]:
    """Excess of the mean of 1 / hits over that of uniform coverage, and fraction of the map without hits."""
    weight, covered = region.taper**2, hits > 0
    mean = np.average(hits[covered], weights=weight[covered])
    excess = np.average(mean / hits[covered], weights=weight[covered]) - 1
    return float(excess), float(1 - weight[covered].sum() / weight.sum())


def _weights(region: ScoredRegion, inputs: EffectInputs) -> NeglectedEffect:
    """Noise from the scatter of measured weights, beyond the first-order correction that a run makes."""
    band = region
    modes = band.rings.n_modes
    measured = inputs.noise * np.sqrt(inputs.share * modes)
    scatter = np.sum(measured**2 / modes, axis=1) * 2 / np.sum(measured, axis=1) ** 2
    mean = float(np.average(scatter, weights=inputs.weight))
    size = abs(mean - band.noise_scatter) + mean**2
    sentence = (
        f"The weight of an observation is measured on its own map, to {_percent(np.sqrt(mean))}; "
        f"beyond the correction of a run this adds {_percent(size)} to the noise."
    )
    return NeglectedEffect("weights", size, sentence, size > LARGE)


def _low_multipoles(setup: Setup, share: np.ndarray) -> NeglectedEffect:
    """Fraction of the score from multipoles at which scan ends and the map's edge dominate."""
    low, _ = compared_ell(setup.scene)
    size = float(share[setup.analysis.region.rings.edges_ell[:-1] < low].sum())
    sentence = (
        f"Below ell = {low:.0f} the ends of scans, the map's edge and its gaps matter, which are approximated; "
        f"{_percent(size)} of sigma(A)^-2 comes from there."
    )
    return NeglectedEffect("low multipoles", size, sentence, size > LARGE)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share < 0.0995 else f"{100 * share:.0f} %"
