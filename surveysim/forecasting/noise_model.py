"""Closed form of the noise in the map of one observation, for any observing conditions.

The noise variance of a sample in the multipole bin b is a sum over the components of the time-streams, which
`surveysim.forecasting.closed_forms` lists,

    N_b = n_w W_b + n_s S_b + V E_b + sum over layers of B2 sin(el)^(1 - b) L_b(v, sin el)   [mK^2],

with the levels of `ObservingConditions`: independent (n_w) and shared (n_s) white noise, variance V of the excess
noise, amplitude of the layer and its velocities v against the scan. A component with the detector correlation K and the
PSD P(f) has the coefficient, averaged over the modes k of the annulus,

    rate / 2 < p_b (a^H K a / n_det) int H(f, f') P(f') df' + (1 - p_b) (its power in the cleaned streams) >,

with the array response a and the leakage H of `surveysim.forecasting.mode_response` and the pixel window p_b: pixels
attenuate modes, and alias noise over all of them. For the layer the integral is a sum over its wavevectors alpha, at
f' = alpha.v, weighted by |a^H (r exp(2 pi i alpha.r))|^2 for responsivities r. The same a give the transfer function of
the sky. The spectrum of a layer is equation 2 of Sayers et al. (2010). All are averaged over the speeds and directions
along the track of the boresight (`surveysim.forecasting.track_motions`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mapmaker.transfer_function import pixel_window
from surveysim.forecasting.closed_forms import CLOSED_FORMS, ClosedForm, Noise, layers
from surveysim.forecasting.mode_mixing import ModeMixing, mode_mixing
from surveysim.forecasting.mode_response import PROJECTIONS, ProjectedArray, projected_array, ring_modes
from surveysim.forecasting.noise_bins import MapBins, NoiseBins, crosstalked, noise_only_bins, scan_frequencies
from surveysim.forecasting.observing_conditions import (
    ObservingConditions,
    WhiteShapes,
    independent_noise,
    noise_correlations,
    population_conditions,
    removed_modes,
    white_shapes,
)
from surveysim.forecasting.response_filters import gain_variance, stream_filters
from surveysim.forecasting.time_filters import ScanFilters, has_few_modes, pipeline_filters
from surveysim.forecasting.track_motions import track_motions
from surveysim.forecasting.turned_modes import turned_power
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.scored_region import left_signal
from surveysim.reduction.setup import Setup
from surveysim.runtime.errors import InsufficientDataError, NotForecastableError
from surveysim.runtime.once import keep_last
from surveysim.scene.scene import Scene
from surveysim.telescope.pointing_errors import smearing_variance
from surveysim.timestreams.component import present_components
from surveysim.timestreams.crosstalk import CrosstalkMatrix

_ANGLES = 3  # between array and scan that represent all observations


@dataclass(frozen=True)
class NoiseModel:
    """Noise of one data set as a function of the observing conditions.

    Attributes
    ----------
    name, pipeline
        Data set, and the cleaning pipeline that it results from.
    n_det
        Number of detectors.
    parts
        Noise of each term of the components' closed forms, as a mean over the track.
    signal_psd : (n_bin,)
        PSD that scans and cleaning leave of a flat spectrum of unit band power [sr].
    """

    name: str
    pipeline: CleaningPipeline
    n_det: int
    parts: dict[ClosedForm, Noise]
    signal_psd: np.ndarray

    def noise(self, conditions: ObservingConditions) -> np.ndarray:
        """Noise variance a sample in each bin, (n_draw, n_bin) [mK^2]."""
        return sum((part(conditions) for part in self.parts.values()), self._none(conditions))

    def layer_noise(self, conditions: ObservingConditions) -> np.ndarray:
        """Contribution of the atmosphere to `noise`, (n_draw, n_bin) [mK^2]."""
        return self.parts.get(layers, self._none)(conditions)

    def _none(self, conditions: ObservingConditions) -> np.ndarray:
        return np.zeros((len(conditions.sine), len(self.signal_psd)))


@keep_last(1)
def survey_models(setup: Setup) -> tuple[NoiseModel, ...]:
    """Noise models of the data sets, valid for all weather of the scene; raises as `noise_models`."""
    return tuple(noise_models(setup, population_conditions(setup)[0]))


def noise_models(setup: Setup, conditions: ObservingConditions) -> Iterator[NoiseModel]:
    """Build the noise model of each data set, valid within the range of some observing conditions.

    Yields
    ------
    NoiseModel

    Raises
    ------
    NotForecastableError
        Where the focal plane does not support the templates of the cleaning.
    """
    scene, region = setup.scene, setup.analysis.region
    shapes, mixing = white_shapes(setup), mode_mixing(region, scene.score)
    for pipeline in forecast_pipelines(setup):
        bins = map_bins(setup, pipeline, conditions, shapes, pipeline_filters(setup, pipeline))
        transmission = _transmission(setup, bins) * conditions.gain.mean() ** 2
        signal = left_signal(setup.analysis.beams, setup.analysis.geometry, setup.sky.geometry, region, transmission)
        n_det = len(bins[0].arrays[0].place)
        yield NoiseModel(pipeline.data_set, pipeline, n_det, _mixed(track_noise(bins), mixing), signal)
        if pipeline is setup.analysis.pipelines[0]:
            for name in scene.score.noise_only_sets:
                of_set = [noise_only_bins(item, name, scene.score.white_noise_above_hz) for item in bins]
                yield NoiseModel(name, pipeline, n_det, track_noise(of_set), signal)


def map_bins(
    setup: Setup,
    pipeline: CleaningPipeline,
    conditions: ObservingConditions,
    shapes: WhiteShapes | None,
    filters: ScanFilters | None,
) -> list[MapBins]:
    """Set up the bins of a pipeline's map, with filters in time, at each speed of the track."""
    ell, arrays = setup.analysis.region.rings.ell, _arrays(setup, pipeline, conditions)
    crosstalk = _crosstalk(setup, pipeline)
    fitted = removed_modes(setup, pipeline, arrays[0], conditions, filters)
    wave = ring_modes(ell).wave.ravel()
    alike: dict[str, Any] = {
        "scene": setup.scene,
        "layers": setup.air.layers,
        "conditions": conditions,
        "arrays": arrays,
        "correlations": noise_correlations(setup.camera, pipeline, shapes),
        "camera": setup.camera,
        "rows": pipeline.rows,
        "independent": independent_noise(shapes, pipeline),
        "filters": stream_filters(setup, pipeline),
        "gain_variance": gain_variance(setup, pipeline, conditions),
        "crosstalk": crosstalk,
        "responses": [crosstalked(array.response(wave), crosstalk).astype(np.complex64) for array in arrays],
        "pixel": pixel_window(ell, setup.analysis.geometry.pixel_rad),
    }
    tracks, of_scans = track_motions(setup), (setup.observing.scans, setup.scene.score, ell)
    frequencies = [
        scan_frequencies(
            *of_scans, speed_rad_s=speed, straight=tracks.straight, fitted_modes=fitted, time_filters=filters
        )
        for speed in tracks.speed_rad_s.tolist()
    ]
    return [MapBins(node=node, frequencies=item, **alike) for node, item in enumerate(frequencies)]


def track_noise(bins: Sequence[NoiseBins]) -> dict[ClosedForm, Noise]:
    """Noise of each term of the components that the scene has a section for, as a mean over the speeds of the track."""
    return {term: _track_mean([term(item) for item in bins]) for term in present_terms(bins[0].scene)}


def present_terms(scene: Scene) -> list[ClosedForm]:
    """Terms of the components that a scene has a section for, each once."""
    present = {item.name for item in present_components(scene)}
    return list(dict.fromkeys(term for name, terms in CLOSED_FORMS.items() if name in present for term in terms))


def _track_mean(parts: list[Noise]) -> Noise:
    def mean(conditions: ObservingConditions) -> np.ndarray:
        share = conditions.speed_share.T[..., None]
        return np.sum([weight * part(conditions) for weight, part in zip(share, parts, strict=True)], axis=0)

    return parts[0] if len(parts) == 1 else mean


def _mixed(parts: dict[ClosedForm, Noise], mixing: ModeMixing) -> dict[ClosedForm, Noise]:
    """Mix the bins of the layers by the map's taper. Noise of the detectors is about the same across the scans."""
    if layers not in parts:
        return parts
    of_layers = parts[layers]
    return parts | {layers: lambda conditions: mixing.mixed(of_layers(conditions))}


def forecast_pipelines(setup: Setup) -> tuple[CleaningPipeline, ...]:
    """Pipelines that have a forecast."""
    return tuple(item for item in setup.analysis.pipelines if is_projection(item) and has_few_modes(setup, item))


def is_projection(pipeline: CleaningPipeline) -> bool:
    """Tell whether a pipeline is (nearly) a projection that does not depend on the data, besides filters in time."""
    return pipeline.spatial_step in PROJECTIONS


def _arrays(setup: Setup, pipeline: CleaningPipeline, conditions: ObservingConditions) -> list[ProjectedArray]:
    """Set up the pipeline's detectors at a few angles to the scan, which represent all observations."""
    camera, calibration = setup.camera, setup.analysis.calibration
    plane = camera.focal_plane.subset(pipeline.rows)
    angles = np.sort(np.mod(conditions.angle, 2 * np.pi), axis=None)
    chosen = angles[((np.arange(_ANGLES) + 0.5) * len(angles) / _ANGLES).astype(int)] if len(angles) > 1 else angles
    responsivity, assumed = camera.responsivity[pipeline.rows], None
    if calibration is not None and pipeline.takes_responsivities:
        assumed = calibration[0, pipeline.rows]
    gains = {"responsivity": responsivity, "assumed": assumed, "weight": setup.analysis.weight_of(pipeline.rows)}
    try:
        return [projected_array(plane, angle, algorithm=pipeline.spatial_step, **gains) for angle in np.unique(chosen)]
    except InsufficientDataError as error:
        raise NotForecastableError(f"cleaning: {error}") from None


def _crosstalk(setup: Setup, pipeline: CleaningPipeline) -> CrosstalkMatrix | None:
    """Crosstalk between the detectors of a pipeline; None without it.

    Crosstalk from detectors that a pipeline leaves out is neglected, with that between those that it takes.
    """
    section = setup.scene.crosstalk
    if section is None or pipeline.detectors is not None:
        return None
    return CrosstalkMatrix(section, setup.camera.readout_groups)


def _transmission(setup: Setup, bins: list[MapBins]) -> np.ndarray:
    """Transfer function (n_bin,) of pointing errors, response, scans and cleaning for the co-added map.

    Amplitudes of all samples of a place are averaged before they are squared: scans along one direction keep modes that
    scans along the other lose.
    """
    modes, tracks = bins[0].frequencies.modes, track_motions(setup)
    smeared = np.exp(-smearing_variance(setup.scene.pointing_errors) / 2 * np.abs(modes.wave) ** 2)
    amplitude = [item.signal_amplitude().reshape(modes.wave.shape) * smeared for item in bins]
    return turned_power(modes, np.array(amplitude), tracks.directions, tracks.place_share)
