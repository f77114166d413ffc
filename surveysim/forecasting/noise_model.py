"""Closed form of the noise in the map of one observation, for any observing conditions.

The noise variance of a sample in the multipole bin b is a sum over the components of the time-streams,

    N_b = n_w W_b + n_s S_b + V E_b + B2 sin(el)^(1 - b) L_b(v, sin el)   [mK^2],

with the levels of `ObservingConditions`: independent (n_w) and shared (n_s) white noise, variance V of the excess
noise, amplitude of the layer and its velocities v against the scan. A component with the detector correlation K and the
PSD P(f) has the coefficient, averaged over the modes k of the annulus,

    rate / 2 < p_b (a^H K a / n_det) int H(f, f') P(f') df' + (1 - p_b) (its power in the cleaned streams) >,

with the array response a and the leakage H of `surveysim.forecasting.mode_response` and the pixel window p_b: pixels
attenuate modes, and alias noise over all of them. For the layer the integral is a sum over its wavevectors alpha, at
f' = alpha.v, weighted by |a^H (r exp(2 pi i alpha.r))|^2 for responsivities r. The same a give the transfer function of
the sky. The spectrum of the layer is equation 2 of Sayers et al. (2010).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mapmaker.transfer_function import pixel_window
from surveysim.forecasting.fitted_modes import FittedModes
from surveysim.forecasting.mode_response import (
    PROJECTIONS,
    LayerWaves,
    Modes,
    ProjectedArray,
    layer_gain,
    layer_stream_gain,
    layer_waves,
    matrix_power,
    projected_array,
    ring_modes,
    stream_power,
)
from surveysim.forecasting.observing_conditions import (
    NoiseCorrelations,
    ObservingConditions,
    noise_correlations,
    population_conditions,
    removed_modes,
)
from surveysim.forecasting.scan_apodization import ScanApodization, frequency_nodes, hann_window, scan_window
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.scored_region import left_signal
from surveysim.reduction.setup import Setup, prepare
from surveysim.runtime.errors import InsufficientDataError, NotForecastableError
from surveysim.scene.scene import Scene
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.low_frequency import excess_psd
from surveysim.timestreams.shared_parts import screen

PATTERNS = ("raster",)  # scan patterns with a closed form: straight scans along RA and Dec in turn
_ANGLES = 3  # between array and scan that represent all observations
_SPEEDS, _DIRECTIONS = 5, 4  # nodes of the layer's motion against the scan
_SINES = 3  # nodes in elevation
_SLOWEST = 0.02  # least relative speed of the table, in scan speeds


# Maps motions (n_draw, n_motion), complex [rad/s], and sines of elevations (n_draw,) to noise (n_draw, n_bin).
LayerNoise = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class _NoiseComponents:
    """Noise variance a sample in each bin (n_bin,) per unit level; `layer` as `LayerNoise`."""

    white: np.ndarray
    shared: np.ndarray
    excess: np.ndarray
    layer: LayerNoise


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
        Noise per unit level.
    signal_psd : (n_bin,)
        PSD that scans and cleaning leave of a flat spectrum of unit band power [sr].
    """

    name: str
    pipeline: CleaningPipeline
    n_det: int
    parts: _NoiseComponents
    signal_psd: np.ndarray

    def noise(self, conditions: ObservingConditions) -> np.ndarray:
        """Noise variance a sample in each bin, (n_draw, n_bin) [mK^2]."""
        parts = self.parts
        flat = ((conditions.white, parts.white), (conditions.shared, parts.shared), (conditions.excess, parts.excess))
        return sum(np.outer(*part) for part in flat) + self.layer_noise(conditions)

    def layer_noise(self, conditions: ObservingConditions) -> np.ndarray:
        """Contribution of the layer to `noise`, (n_draw, n_bin) [mK^2]."""
        return conditions.layer[:, None] * self.parts.layer(conditions.motion, conditions.sine)


@dataclass(frozen=True)
class _ScanFrequencies:
    """Scored modes (n_mode,) with their aliased frequencies, quadrature nodes and weights (n,), and the lines of the
    excess noise (n_line,) with their variances for unit total variance.
    """

    modes: Modes
    at_hz: np.ndarray
    window: ScanApodization
    nodes_hz: np.ndarray
    weight_hz: np.ndarray
    excess_hz: np.ndarray
    excess: np.ndarray


@lru_cache(maxsize=1)
def survey_models(scene: Scene) -> tuple[NoiseModel, ...]:
    """Noise models of a scene's data sets, valid for all weather of the scene; raises as `noise_models`."""
    return tuple(noise_models(prepare(scene), population_conditions(scene)[0]))


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
    for pipeline in filter(is_projection, setup.analysis.pipelines):
        arrays = _arrays(setup, pipeline, conditions)
        spectrum = _spectrum(setup, removed_modes(setup, pipeline, arrays[0], conditions))
        n_det = len(arrays[0].place)
        responses = [array.response(spectrum.modes.wave.ravel()) for array in arrays]
        transmission = _transmission(setup, spectrum, arrays, responses)
        signal = left_signal(
            setup.scene, setup.analysis.geometry, setup.sky.geometry, setup.analysis.region, transmission
        )
        correlations = noise_correlations(setup, pipeline)
        parts = _map_components(
            setup, conditions, spectrum, arrays=arrays, responses=responses, correlations=correlations
        )
        yield NoiseModel(pipeline.data_set, pipeline, n_det, parts, signal)
        if pipeline is setup.analysis.pipelines[0]:
            for name in setup.scene.score.noise_only_sets:
                parts = _noise_only_components(
                    setup, conditions, spectrum, arrays=arrays, correlations=correlations, name=name
                )
                yield NoiseModel(name, pipeline, n_det, parts, signal)


def is_projection(pipeline: CleaningPipeline) -> bool:
    """Tell whether a pipeline is (nearly) a projection that does not depend on the data."""
    return len(pipeline.steps) == 1 and pipeline.steps[0] in PROJECTIONS


def _spectrum(setup: Setup, fitted_modes: FittedModes) -> _ScanFrequencies:
    scene, lines = setup.scene, setup.observing.scans
    seconds = samples_per_scan(lines) / lines.sample_rate_hz
    modes = ring_modes(setup.analysis.region.rings.ell)
    rate = lines.sample_rate_hz
    at_hz = modes.wave.real.ravel() * lines.speed_rad_s / (2 * np.pi)
    at_hz -= rate * np.round(at_hz / rate)  # aliases of the sample rate
    window = scan_window(
        seconds,
        speed_rad_s=lines.speed_rad_s,
        size_rad=scene.score.size_rad,
        taper_fraction=scene.score.taper_fraction,
        fitted_modes=fitted_modes,
    )
    nodes, weight = frequency_nodes(window, max(1.1 * np.abs(at_hz).max(), 0.5 * rate))
    excess_hz, excess = np.zeros(0), np.zeros(0)
    if scene.excess:
        # Lines of streams twice as long as a scan, as in the simulation: the lowest lines dominate a steep spectrum.
        n_samp = samples_per_scan(lines)
        psd = excess_psd(scene.excess, 1.0, n_samp, 2 * n_samp, rate)[1:]
        step = rate / (2 * n_samp)
        positive = step * np.arange(1, n_samp + 1)
        excess_hz, excess = np.concatenate([-positive, positive]), np.tile(psd * step, 2)
    return _ScanFrequencies(modes, at_hz, window, nodes, weight, excess_hz, excess)


def _arrays(setup: Setup, pipeline: CleaningPipeline, conditions: ObservingConditions) -> list[ProjectedArray]:
    """Set up the pipeline's detectors at a few angles to the scan, which represent all observations."""
    plane = setup.camera.focal_plane.subset(pipeline.rows)
    angles = np.sort(np.mod(conditions.angle, 2 * np.pi))
    chosen = angles[((np.arange(_ANGLES) + 0.5) * len(angles) / _ANGLES).astype(int)] if len(angles) > 1 else angles
    responsivity, assumed = setup.camera.responsivity[pipeline.rows], None
    if setup.analysis.calibration is not None and pipeline.takes_responsivities:
        assumed = setup.analysis.calibration[0, pipeline.rows]
    try:
        return [
            projected_array(plane, angle, responsivity=responsivity, algorithm=pipeline.steps[0], assumed=assumed)
            for angle in np.unique(chosen)
        ]
    except InsufficientDataError as error:
        raise NotForecastableError(f"cleaning: {error}") from None


def _map_components(
    setup: Setup,
    conditions: ObservingConditions,
    spectrum: _ScanFrequencies,
    *,
    arrays: list[ProjectedArray],
    responses: list[np.ndarray],
    correlations: NoiseCorrelations,
) -> _NoiseComponents:
    rate, modes = setup.observing.scans.sample_rate_hz, spectrum.modes
    window, nodes = spectrum.window, spectrum.nodes_hz
    flat = window.sums(spectrum.weight_hz[None], nodes, spectrum.at_hz)
    red = window.sums(spectrum.excess[None], spectrum.excess_hz, spectrum.at_hz)
    parts, (photon, excess) = [], correlations
    for array, response in zip(arrays, responses, strict=True):
        white = matrix_power(response, None)
        shared = white if photon is None else matrix_power(response, photon)
        low = white if excess is None else matrix_power(response, excess)
        own = matrix_power(response * array.responsivity[:, None], None)
        parts.append([modes.mean(item) for item in (white * flat, shared * flat, own * red, low * red)])
    white, shared, own, low = np.mean(parts, axis=0) * rate / 2
    layer = _layer_noise(setup, conditions, spectrum, arrays=arrays, responses=responses)
    # Pixels attenuate modes, and alias the lost noise over all modes, at the white level of a stream. Templates of few
    # detectors leave much less than that in modes that are longer than the array.
    pixel = pixel_window(setup.analysis.region.rings.ell, setup.analysis.geometry.pixel_rad)
    scattered = modes.mean(flat) * rate / 2 * (1 - pixel)
    white = white * pixel + stream_power(arrays[0], None) * scattered
    shared = shared * pixel + stream_power(arrays[0], photon) * scattered
    # Excess noise is aliased across the scan, among modes of one frequency: independent noise is unchanged.
    low = own + (low - own) * pixel
    return _NoiseComponents(white, shared, low, lambda motion, sine: layer(motion, sine) * pixel)


def _layer_noise(
    setup: Setup,
    conditions: ObservingConditions,
    spectrum: _ScanFrequencies,
    *,
    arrays: list[ProjectedArray],
    responses: list[np.ndarray],
) -> LayerNoise:
    """Tabulate the noise variance a sample of a layer of unit amplitude against its motion."""
    if setup.scene.atmosphere is None:
        return _no_layer
    layer = _layer(setup, conditions, spectrum)
    gains = [layer_gain(array, response, layer) for array, response in zip(arrays, responses, strict=True)]

    def noise(motion: complex) -> list[np.ndarray]:
        along = _stream_frequencies(layer, motion)
        sums = np.mean([spectrum.window.power_sums(gain, layer.power, along, spectrum.at_hz) for gain in gains], axis=0)
        return [spectrum.modes.mean(item) * setup.observing.scans.sample_rate_hz for item in sums]

    return _interpolate_motions(setup, conditions, noise)


def _no_layer(motion: np.ndarray, sine: np.ndarray) -> np.ndarray:
    return np.zeros((len(motion), 1))


def _layer(setup: Setup, conditions: ObservingConditions, spectrum: _ScanFrequencies) -> LayerWaves:
    longest = np.abs(conditions.motion).max() * spectrum.window.duration_s
    return layer_waves(screen(setup.scene), longest, _sine_nodes(conditions).tolist())


def _sine_nodes(conditions: ObservingConditions) -> np.ndarray:
    """Choose sines of elevations that bracket those of all observations."""
    first, last = conditions.sine.min(), conditions.sine.max()
    return np.linspace(first, last * (1 + 1e-6), _SINES if last > 1.01 * first else 2)


def _stream_frequencies(layer: LayerWaves, motion: complex) -> np.ndarray:
    """Frequency [Hz] of each wavevector of the layer in the streams."""
    return (layer.alpha * np.conj(motion)).real


def _interpolate_motions(
    setup: Setup, conditions: ObservingConditions, noise: Callable[[complex], list[np.ndarray]]
) -> LayerNoise:
    """Tabulate `noise` at a few speeds, directions and elevations, and interpolate its mean over the motions of a draw.

    `noise` of a motion is (n_bin,) at each elevation of `_sine_nodes`. Mirrored directions are taken as one, because
    the array has many angles to them. Conditions outside the table take the nearest value.
    """
    from scipy.interpolate import RegularGridInterpolator

    slowest = _SLOWEST * setup.observing.scans.speed_rad_s

    def place(motion: np.ndarray, sine: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        logs = np.broadcast_to(np.log(sine)[:, None], motion.shape)
        return np.log(np.maximum(np.abs(motion), slowest)), np.abs(np.angle(motion)), logs

    speed, turn, _ = place(conditions.motion, conditions.sine)
    speeds = np.linspace(speed.min(), speed.max() + 1e-6, _SPEEDS if np.ptp(speed) > 1e-3 else 2)
    turns = np.linspace(turn.min(), turn.max() + 1e-6, _DIRECTIONS if np.ptp(turn) > 1e-3 else 2)
    table = np.array([[noise(np.exp(s + 1j * t)) for t in turns] for s in speeds])
    nodes = speeds, turns, np.log(_sine_nodes(conditions))
    logs = RegularGridInterpolator(nodes, np.log(np.maximum(table, 1e-300)))

    def between(motion: np.ndarray, sine: np.ndarray) -> np.ndarray:
        places = zip(place(motion, sine), nodes, strict=True)
        return np.exp(logs(np.stack([np.clip(item, node[0], node[-1]) for item, node in places], axis=-1))).mean(axis=1)

    return between


def _noise_only_components(
    setup: Setup,
    conditions: ObservingConditions,
    spectrum: _ScanFrequencies,
    *,
    arrays: list[ProjectedArray],
    correlations: NoiseCorrelations,
    name: str,
) -> _NoiseComponents:
    """Components of the data sets "uncorrelated" and "white", simulated from the PSDs of the cleaned streams."""
    rate = setup.observing.scans.sample_rate_hz
    seconds = spectrum.window.duration_s
    n_samp = samples_per_scan(setup.observing.scans)
    lines = np.arange(1, (n_samp - 1) // 2 + 1) / seconds
    hann, nodes = hann_window(seconds, spectrum.window.fitted_modes), spectrum.nodes_hz
    window = spectrum.window
    if name == "uncorrelated":
        # Streams periodic over a scan: lines, without a mean.
        both = np.concatenate([-lines, lines])
        through = window.at(spectrum.at_hz[:, None] - both) ** 2 / seconds
        to_modes = rate * (through[:, : len(lines)] + through[:, len(lines) :])
    else:
        high = lines > setup.scene.score.white_noise_above_hz
        flat = window.sums(spectrum.weight_hz[None], nodes, spectrum.at_hz)
        to_modes = rate * np.outer(flat, high / high.sum())

    def in_bins(psd: np.ndarray) -> np.ndarray:
        """Bins of a two-sided PSD (n_line,) of the streams."""
        return spectrum.modes.mean(to_modes @ psd)

    # The power of the cleaned streams does not depend on the array's angle.
    white, shared, low = (stream_power(arrays[0], item) for item in (None, *correlations))
    flat = in_bins(hann.sums(spectrum.weight_hz[None] / 2, nodes, lines))
    red = in_bins(hann.sums(spectrum.excess[None] / 2, spectrum.excess_hz, lines))
    layer: Callable[[np.ndarray, np.ndarray], np.ndarray] = _no_layer
    if setup.scene.atmosphere is not None:
        waves = _layer(setup, conditions, spectrum)
        gain = np.mean([layer_stream_gain(array, waves) for array in arrays], axis=0)

        def noise(motion: complex) -> list[np.ndarray]:
            return [
                in_bins(psd)
                for psd in hann.power_sums(gain[None], waves.power, _stream_frequencies(waves, motion), lines)
            ]

        layer = _interpolate_motions(setup, conditions, noise)
    return _NoiseComponents(white * flat, shared * flat, low * red, layer)


def _transmission(
    setup: Setup, spectrum: _ScanFrequencies, arrays: list[ProjectedArray], responses: list[np.ndarray]
) -> np.ndarray:
    """Transfer function (n_bin,) of scans and cleaning for the co-added map.

    Amplitudes of all observations are averaged before they are squared: scans along one direction keep modes that
    scans along the other lose.
    """
    modes = spectrum.modes
    wave = modes.wave.ravel()
    kept = [
        np.einsum("ij,ij->j", response.conj(), array.phases(wave) * array.responsivity[:, None])
        / array.responsivity.sum()
        for array, response in zip(arrays, responses, strict=True)
    ]
    amplitude = (np.mean(kept, axis=0) * spectrum.window.signal_amplitude(spectrum.at_hz)).reshape(modes.wave.shape)
    across = amplitude[:, modes.turned]
    half = len(modes.share) // 2
    across[:, :half] = across[:, :half].conj()
    n_obs = setup.scene.observations
    share = (n_obs // 2) / n_obs  # fraction of observations that scan along Dec
    both = (1 - share) * amplitude + share * across
    return modes.mean((both.real**2 + both.imag**2).ravel())
