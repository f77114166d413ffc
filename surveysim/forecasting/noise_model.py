"""The noise of one observation's map in closed form, for any conditions that it may be made in.

Every part of the streams is put through `surveysim.reduction.mode_response` and averaged over rings of multipole; what
a flat sky keeps comes from the same array responses.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mapmaker.transfer_function import pixel_window
from surveysim.forecasting.observing_conditions import (
    Conditions,
    NoiseCorrelations,
    fitted_courses,
    noise_correlations,
    population,
)
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.fitted_modes import Courses
from surveysim.reduction.mode_response import (
    PROJECTIONS,
    Array,
    Layer,
    Modes,
    ScanApodization,
    frequency_nodes,
    hann_window,
    layer_gain,
    layer_stream_gain,
    layer_waves,
    matrix_power,
    projected_array,
    ring_modes,
    scan_window,
    stream_power,
)
from surveysim.reduction.scored_region import left_signal
from surveysim.reduction.setup import Setup, prepare
from surveysim.runtime.errors import InsufficientDataError, NotForecastableError
from surveysim.scene.scene import Scene
from surveysim.telescope.raster import samples_per_scan
from surveysim.timestreams.noise import excess_psd
from surveysim.timestreams.shared_parts import screen

_ANGLES = 3  # of the array against the scan that stand for all observations
_SPEEDS, _DIRECTIONS = 5, 4  # of the layer against the scan
_SINES = 3  # of the elevation
_SLOWEST = 0.02  # relative speed that is told from none, in scan speeds


# Of (n_draw, n_motion) complex [rad/s] and sines of elevations (n_draw,), to (n_draw, n_bin).
LayerNoise = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class _Parts:
    """Noise variance a sample in each bin (n_bin,) of unit levels; `layer` that of motions (n_draw, 2)
    against it at elevations with sines (n_draw,)."""

    white: np.ndarray
    shared: np.ndarray
    excess: np.ndarray
    layer: LayerNoise


@dataclass(frozen=True)
class NoiseModel:
    """The noise of one data set in any conditions, and the `signal_psd` (n_bin,) [sr] that its scans and cleaning leave
    of a flat spectrum of unit band power.
    """

    name: str
    pipeline: CleaningPipeline
    n_det: int
    parts: _Parts
    signal_psd: np.ndarray

    def noise(self, levels: Conditions) -> np.ndarray:
        """Noise variance a sample [mK^2] of every draw, (n_draw, n_bin)."""
        parts = self.parts
        flat = ((levels.white, parts.white), (levels.shared, parts.shared), (levels.excess, parts.excess))
        return sum(np.outer(*part) for part in flat) + self.layer_noise(levels)

    def layer_noise(self, levels: Conditions) -> np.ndarray:
        """The layer's part of `noise`, (n_draw, n_bin)."""
        return levels.layer[:, None] * self.parts.layer(levels.motion, levels.sine)


@dataclass(frozen=True)
class _Spectrum:
    """What is known of frequencies: the scored modes' (n_mode,) as samples hold them, nodes and weights (n,), and the
    lines of the excess noise (n_line,) with the variance that each adds to one of unit variance.
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
    """Models of a scene's data sets, good for all weather that it may have; raises as `noise_models`."""
    return tuple(noise_models(prepare(scene), population(scene)[0]))


def noise_models(setup: Setup, levels: Conditions) -> Iterator[NoiseModel]:
    """What the noise of each data set depends on, good for conditions within the range of `levels`.

    Raises NotForecastableError where cleaning can't be forecast.
    """
    for pipeline in filter(is_projection, setup.pipelines):
        arrays = _arrays(setup, pipeline, levels)
        spectrum = _spectrum(setup, fitted_courses(setup, pipeline, arrays[0], levels))
        n_det = len(arrays[0].place)
        responses = [array.response(spectrum.modes.wave.ravel()) for array in arrays]
        transmission = _transmission(setup, spectrum, arrays, responses)
        signal = left_signal(setup.scene, setup.geometry, setup.sky_geometry, setup.band, transmission)
        correlations = noise_correlations(setup, pipeline)
        parts = _map_parts(setup, levels, spectrum, arrays, responses, correlations)
        yield NoiseModel(pipeline.data_set, pipeline, n_det, parts, signal)
        if pipeline is setup.pipelines[0]:
            for name in setup.scene.score.noise_only_sets:
                parts = _simulated_parts(setup, levels, spectrum, arrays, correlations, name)
                yield NoiseModel(name, pipeline, n_det, parts, signal)


def is_projection(pipeline: CleaningPipeline) -> bool:
    """Whether a pipeline is, nearly at least, a projection that does not depend on the data."""
    return len(pipeline.steps) == 1 and pipeline.steps[0] in PROJECTIONS


def _spectrum(setup: Setup, courses: Courses) -> _Spectrum:
    scene, lines = setup.scene, setup.raster
    seconds = samples_per_scan(lines) / lines.sample_rate_hz
    modes = ring_modes(setup.band.rings.ell)
    rate = lines.sample_rate_hz
    at_hz = modes.wave.real.ravel() * lines.speed_rad_s / (2 * np.pi)
    at_hz -= rate * np.round(at_hz / rate)  # what samples can't tell apart
    window = scan_window(seconds, lines.speed_rad_s, scene.score.size_rad, scene.score.taper_fraction, courses)
    nodes, weight = frequency_nodes(window, max(1.1 * np.abs(at_hz).max(), 0.5 * rate))
    excess_hz, excess = np.zeros(0), np.zeros(0)
    if scene.excess:
        # Lines of streams twice as long as a scan, as they are drawn: a steep spectrum is mostly the lowest.
        n_samp = samples_per_scan(lines)
        psd = excess_psd(scene.excess, 1.0, n_samp, 2 * n_samp, rate)[1:]
        step = rate / (2 * n_samp)
        positive = step * np.arange(1, n_samp + 1)
        excess_hz, excess = np.concatenate([-positive, positive]), np.tile(psd * step, 2)
    return _Spectrum(modes, at_hz, window, nodes, weight, excess_hz, excess)


def _arrays(setup: Setup, pipeline: CleaningPipeline, levels: Conditions) -> list[Array]:
    """The pipeline's detectors at angles to the scan that stand for all observations."""
    plane = setup.camera.focal_plane.subset(pipeline.rows)
    angles = np.sort(np.mod(levels.angle, 2 * np.pi))
    chosen = angles[((np.arange(_ANGLES) + 0.5) * len(angles) / _ANGLES).astype(int)] if len(angles) > 1 else angles
    responsivity, assumed = setup.responsivity[pipeline.rows], None
    if setup.calibration is not None and pipeline.takes_responsivities:
        assumed = setup.calibration[0, pipeline.rows]
    try:
        return [projected_array(plane, angle, responsivity, pipeline.steps[0], assumed) for angle in np.unique(chosen)]
    except InsufficientDataError as error:
        raise NotForecastableError(f"cleaning: {error}") from None


def _map_parts(
    setup: Setup,
    levels: Conditions,
    spectrum: _Spectrum,
    arrays: list[Array],
    responses: list[np.ndarray],
    correlations: NoiseCorrelations,
) -> _Parts:
    rate, modes = setup.raster.sample_rate_hz, spectrum.modes
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
    layer = _layer_noise(setup, levels, spectrum, arrays, responses)
    # Pixels smooth modes, and scatter over all modes the noise of streams that they take: a stream's whole white noise,
    # of which templates of few detectors leave little in modes that are longer than the array.
    pixel = pixel_window(setup.band.rings.ell, setup.geometry.pixel_rad)
    scattered = modes.mean(flat) * rate / 2 * (1 - pixel)
    white = white * pixel + stream_power(arrays[0], None) * scattered
    shared = shared * pixel + stream_power(arrays[0], photon) * scattered
    # Excess is scattered across the scan, among modes of one frequency: what detectors do not share stays whole.
    low = own + (low - own) * pixel
    return _Parts(white, shared, low, lambda motion, sine: layer(motion, sine) * pixel)


def _layer_noise(
    setup: Setup, levels: Conditions, spectrum: _Spectrum, arrays: list[Array], responses: list[np.ndarray]
) -> LayerNoise:
    """Noise variance a sample of a layer of unit amplitude, between nodes of its motion."""
    if setup.scene.atmosphere is None:
        return _no_layer
    layer = _layer(setup, levels, spectrum)
    gains = [layer_gain(array, response, layer) for array, response in zip(arrays, responses, strict=True)]

    def noise(motion: complex) -> list[np.ndarray]:
        along = _along(layer, motion)
        sums = np.mean([spectrum.window.power_sums(gain, layer.power, along, spectrum.at_hz) for gain in gains], axis=0)
        return [spectrum.modes.mean(item) * setup.raster.sample_rate_hz for item in sums]

    return _between_motions(setup, levels, noise)


def _no_layer(motion: np.ndarray, sine: np.ndarray) -> np.ndarray:
    return np.zeros((len(motion), 1))


def _layer(setup: Setup, levels: Conditions, spectrum: _Spectrum) -> Layer:
    longest = np.abs(levels.motion).max() * spectrum.window.duration_s
    return layer_waves(screen(setup.scene), longest, _sine_nodes(levels).tolist())


def _sine_nodes(levels: Conditions) -> np.ndarray:
    """Sines of elevations that hold those of all observations."""
    first, last = levels.sine.min(), levels.sine.max()
    return np.linspace(first, last * (1 + 1e-6), _SINES if last > 1.01 * first else 2)


def _along(layer: Layer, motion: complex) -> np.ndarray:
    """Frequency [Hz] that each wavevector of the layer has in the streams."""
    return (layer.alpha * np.conj(motion)).real


def _between_motions(setup: Setup, levels: Conditions, noise: Callable[[complex], list[np.ndarray]]) -> LayerNoise:
    """Means over motions of `noise`, between a few speeds, directions and elevations that hold those of `levels`.

    `noise` of a motion is (n_bin,) at each elevation of `_sine_nodes`. Mirrored directions count as one: the array
    stands at many angles to them. Whatever lies outside counts as the nearest inside.
    """
    from scipy.interpolate import RegularGridInterpolator

    slowest = _SLOWEST * setup.raster.speed_rad_s

    def place(motion: np.ndarray, sine: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        logs = np.broadcast_to(np.log(sine)[:, None], motion.shape)
        return np.log(np.maximum(np.abs(motion), slowest)), np.abs(np.angle(motion)), logs

    speed, turn, _ = place(levels.motion, levels.sine)
    speeds = np.linspace(speed.min(), speed.max() + 1e-6, _SPEEDS if np.ptp(speed) > 1e-3 else 2)
    turns = np.linspace(turn.min(), turn.max() + 1e-6, _DIRECTIONS if np.ptp(turn) > 1e-3 else 2)
    table = np.array([[noise(np.exp(s + 1j * t)) for t in turns] for s in speeds])
    nodes = speeds, turns, np.log(_sine_nodes(levels))
    logs = RegularGridInterpolator(nodes, np.log(np.maximum(table, 1e-300)))

    def between(motion: np.ndarray, sine: np.ndarray) -> np.ndarray:
        places = zip(place(motion, sine), nodes, strict=True)
        return np.exp(logs(np.stack([np.clip(item, node[0], node[-1]) for item, node in places], axis=-1))).mean(axis=1)

    return between


def _simulated_parts(
    setup: Setup,
    levels: Conditions,
    spectrum: _Spectrum,
    arrays: list[Array],
    correlations: NoiseCorrelations,
    name: str,
) -> _Parts:
    """Noise of the sets that take the measured PSDs of the cleaned streams: "uncorrelated" or "white"."""
    rate = setup.raster.sample_rate_hz
    seconds = spectrum.window.duration_s
    n_samp = samples_per_scan(setup.raster)
    lines = np.arange(1, (n_samp - 1) // 2 + 1) / seconds
    hann, nodes = hann_window(seconds, spectrum.window.courses), spectrum.nodes_hz
    window = spectrum.window
    if name == "uncorrelated":
        # Streams of a whole number of periods a scan: lines, without a mean.
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

    # The cleaned streams' own power does not depend on how the array is turned.
    white, shared, low = (stream_power(arrays[0], item) for item in (None, *correlations))
    flat = in_bins(hann.sums(spectrum.weight_hz[None] / 2, nodes, lines))
    red = in_bins(hann.sums(spectrum.excess[None] / 2, spectrum.excess_hz, lines))
    layer: Callable[[np.ndarray, np.ndarray], np.ndarray] = _no_layer
    if setup.scene.atmosphere is not None:
        waves = _layer(setup, levels, spectrum)
        gain = np.mean([layer_stream_gain(array, waves) for array in arrays], axis=0)

        def noise(motion: complex) -> list[np.ndarray]:
            return [in_bins(psd) for psd in hann.power_sums(gain[None], waves.power, _along(waves, motion), lines)]

        layer = _between_motions(setup, levels, noise)
    return _Parts(white * flat, shared * flat, low * red, layer)


def _transmission(setup: Setup, spectrum: _Spectrum, arrays: list[Array], responses: list[np.ndarray]) -> np.ndarray:
    """Share (n_bin,) of a mode's power that scans and cleaning leave in the co-added map.

    Amplitudes of all observations are averaged before they are squared: what scans along one direction lose, those
    along the other keep.
    """
    modes = spectrum.modes
    wave = modes.wave.ravel()
    kept = [
        np.einsum("ij,ij->j", response.conj(), array.seen(wave) * array.responsivity[:, None])
        / array.responsivity.sum()
        for array, response in zip(arrays, responses, strict=True)
    ]
    amplitude = (np.mean(kept, axis=0) * spectrum.window.passed(spectrum.at_hz)).reshape(modes.wave.shape)
    across = amplitude[:, modes.turned]
    half = len(modes.share) // 2
    across[:, :half] = across[:, :half].conj()
    n_obs = setup.scene.observations
    share = (n_obs // 2) / n_obs  # of scans along Dec
    both = (1 - share) * amplitude + share * across
    return modes.mean((both.real**2 + both.imag**2).ravel())
