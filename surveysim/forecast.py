"""The noise of a survey's map without a Monte Carlo: closed forms for every part of the streams.

Each observation's noise in a map mode is that of `surveysim.response`, averaged over rings; observations are weighted
and co-added as in a run, with the weather that the scene's seed draws for them. What a flat sky loses comes from the
same array responses.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mapmaker.bandpower import BandPower, band_power, flat_spectrum_psd
from mapmaker.window import beam_window, pixel_window
from surveysim.conditions import (
    Conditions,
    NoiseCorrelations,
    conditions,
    fitted_courses,
    mean_hits,
    noise_correlations,
    population,
    survey_draws,
)
from surveysim.courses import Courses
from surveysim.noise import excess_psd
from surveysim.recipes import Recipe
from surveysim.response import (
    PROJECTIONS,
    Array,
    Layer,
    Modes,
    TimeWindow,
    frequency_nodes,
    hann_window,
    layer_stream_strength,
    layer_strength,
    layer_waves,
    matrix_power,
    projected_array,
    ring_modes,
    scan_window,
    stream_power,
)
from surveysim.scan import samples_per_scan
from surveysim.scene import Scene, SceneError
from surveysim.setup import Setup, prepare, screen
from surveysim.units import rj_to_cmb

NEGLECTED = (
    "the edge of the map, gaps in it and what scans share with each other",
    "scans that are discarded",
    "that an observation's weight is measured on its own map",
    "what wind and pca do beyond average subtraction, as which they are taken",
)
_ANGLES = 3  # of the array against the scan that stand for all observations
_SPEEDS, _DIRECTIONS = 5, 4  # of the layer against the scan
_SLOWEST = 0.02  # relative speed that is told from none, in scan speeds


@dataclass(frozen=True)
class DataSetForecast:
    """One data set's forecast: `noise_psd` [uK_CMB^2 sr], `signal_psd` [sr] and `transmission`, (n_bin,)."""

    name: str
    n_det: int
    band: BandPower
    noise_psd: np.ndarray
    signal_psd: np.ndarray
    transmission: np.ndarray


@dataclass(frozen=True)
class Forecast:
    """Forecasts by data set, in bins around `ell` (n_bin,); without the best of each observation and no projections."""

    ell: np.ndarray
    scores: dict[str, DataSetForecast]
    neglected: tuple[str, ...] = NEGLECTED


LayerNoise = Callable[[np.ndarray], np.ndarray]  # (n_draw, n_motion) complex [rad/s] to (n_draw, n_bin)


@dataclass(frozen=True)
class _Parts:
    """Noise variance a sample in each bin (n_bin,) of unit levels; `layer` that of motions (n_draw, 2) against it."""

    white: np.ndarray
    shared: np.ndarray
    excess: np.ndarray
    layer: LayerNoise


@dataclass(frozen=True)
class NoiseModel:
    """The noise of one data set in any conditions, and the `transmission` (n_bin,) of its cleaning."""

    name: str
    recipe: Recipe
    n_det: int
    parts: _Parts
    transmission: np.ndarray

    def noise(self, levels: Conditions) -> np.ndarray:
        """Noise variance a sample [mK^2] of every draw, (n_draw, n_bin)."""
        parts = self.parts
        flat = ((levels.white, parts.white), (levels.shared, parts.shared), (levels.excess, parts.excess))
        return sum(np.outer(*part) for part in flat) + levels.layer[:, None] * parts.layer(levels.motion)


@dataclass(frozen=True)
class _Spectrum:
    """What is known of frequencies: the scored modes' (n_mode,) as samples hold them, nodes and weights (n,), and the
    lines of the excess noise (n_line,) with the variance that each adds to one of unit variance.
    """

    modes: Modes
    at_hz: np.ndarray
    window: TimeWindow
    nodes_hz: np.ndarray
    weight_hz: np.ndarray
    excess_hz: np.ndarray
    excess: np.ndarray


def forecast(scene: Scene) -> Forecast:
    """Forecast the data sets of a scene.

    Raises SceneError for a scene that can't be run, has no [score], or a first cleaning that is none of `PROJECTIONS`.
    """
    setup = prepare(scene)
    if scene.score is None:
        raise SceneError("score: missing; a forecast says what a map is worth")
    if not can_forecast(setup):
        allowed = ", ".join(map(repr, PROJECTIONS))
        raise SceneError(f"cleaning.algorithm: found {setup.recipes[0].label!r}; one of {allowed} can be forecast")
    levels = conditions(setup, survey_draws(setup, 0, scene.observations))
    found: dict[str, DataSetForecast] = {}
    for model in survey_models(scene):
        if model.name == model.recipe.data_set:  # the sets that follow share its detectors
            hits = mean_hits(setup, model.recipe)
        found[model.name] = _scored(setup, model, model.noise(levels), hits)
    return Forecast(setup.band.rings.ell, {name: found[name] for name in setup.data_sets if name in found})


@lru_cache(maxsize=1)
def survey_models(scene: Scene) -> tuple[NoiseModel, ...]:
    """Models of a scene's data sets, good for all weather that it may have; raises SceneError as `noise_models`."""
    return tuple(noise_models(prepare(scene), population(scene)[0]))


def noise_models(setup: Setup, levels: Conditions) -> Iterator[NoiseModel]:
    """What the noise of each data set depends on, good for conditions within the range of `levels`.

    Raises SceneError where cleaning can't be forecast.
    """
    for recipe in filter(is_projection, setup.recipes):
        arrays = _arrays(setup, recipe, levels)
        spectrum = _spectrum(setup, fitted_courses(setup, recipe, arrays[0], levels))
        n_det = len(arrays[0].place)
        responses = [array.response(spectrum.modes.wave.ravel()) for array in arrays]
        transmission = _transmission(setup, spectrum, arrays, responses)
        correlations = noise_correlations(setup, recipe)
        parts = _map_parts(setup, levels, spectrum, arrays, responses, correlations)
        yield NoiseModel(recipe.data_set, recipe, n_det, parts, transmission)
        if recipe is setup.recipes[0]:
            for name in setup.scene.score.simulated:
                parts = _simulated_parts(setup, levels, spectrum, arrays, correlations, name)
                yield NoiseModel(name, recipe, n_det, parts, transmission)


def can_forecast(setup: Setup) -> bool:
    """Whether a prepared scene has a score and its first cleaning can be forecast."""
    return setup.scene.score is not None and is_projection(setup.recipes[0])


def is_projection(recipe: Recipe) -> bool:
    """Whether a recipe is, nearly at least, a projection that does not depend on the data."""
    return len(recipe.steps) == 1 and recipe.steps[0] in PROJECTIONS


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


def _arrays(setup: Setup, recipe: Recipe, levels: Conditions) -> list[Array]:
    """The recipe's detectors at angles to the scan that stand for all observations."""
    plane = setup.camera.focal_plane.subset(recipe.rows)
    angles = np.sort(np.mod(levels.angle, 2 * np.pi))
    chosen = angles[((np.arange(_ANGLES) + 0.5) * len(angles) / _ANGLES).astype(int)] if len(angles) > 1 else angles
    responsivity, assumed = setup.responsivity[recipe.rows], None
    if setup.calibration is not None and recipe.takes_responsivities:
        assumed = setup.calibration[0, recipe.rows]
    try:
        return [projected_array(plane, angle, responsivity, recipe.steps[0], assumed) for angle in np.unique(chosen)]
    except ValueError as error:
        raise SceneError(f"cleaning: {error}") from None


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
    # Pixels smooth what streams share; of each stream's own noise, scattered over all modes, they take next to nothing.
    pixel = pixel_window(setup.band.rings.ell, setup.geometry.pixel_rad)
    smoothed = white + (shared - white) * pixel, own + (low - own) * pixel
    return _Parts(white, *smoothed, lambda motion: layer(motion) * pixel)


def _layer_noise(
    setup: Setup, levels: Conditions, spectrum: _Spectrum, arrays: list[Array], responses: list[np.ndarray]
) -> LayerNoise:
    """Noise variance a sample of a layer of unit amplitude, between nodes of its motion."""
    if setup.scene.atmosphere is None:
        return _no_layer
    layer = _layer(setup, levels, spectrum)
    strengths = [layer_strength(array, response, layer) for array, response in zip(arrays, responses, strict=True)]

    def noise(motion: complex) -> np.ndarray:
        along = _along(layer, motion)
        sums = [spectrum.window.sums(strength, along, spectrum.at_hz) for strength in strengths]
        return spectrum.modes.mean(np.mean(sums, axis=0)) * setup.raster.sample_rate_hz

    return _between_motions(levels.motion, setup.raster.speed_rad_s, noise)


def _no_layer(motion: np.ndarray) -> np.ndarray:
    return np.zeros((len(motion), 1))


def _layer(setup: Setup, levels: Conditions, spectrum: _Spectrum) -> Layer:
    return layer_waves(screen(setup.scene), np.abs(levels.motion).max() * spectrum.window.duration_s)


def _along(layer: Layer, motion: complex) -> np.ndarray:
    """Frequency [Hz] that each wavevector of the layer has in the streams."""
    return (layer.alpha * np.conj(motion)).real


def _between_motions(motion: np.ndarray, speed_rad_s: float, noise: Callable[[complex], np.ndarray]) -> LayerNoise:
    """Means over columns of `noise` (n_bin,), between a few speeds and directions that hold those of `motion`.

    Mirrored directions count as one: the array stands at many angles to them. Faster motions, and slower ones, count
    as the fastest and the slowest of `motion`.
    """
    from scipy.interpolate import RegularGridInterpolator

    def place(motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.log(np.maximum(np.abs(motion), _SLOWEST * speed_rad_s)), np.abs(np.angle(motion))

    speed, turn = place(motion)
    speeds = np.linspace(speed.min(), speed.max() + 1e-6, _SPEEDS if np.ptp(speed) > 1e-3 else 2)
    turns = np.linspace(turn.min(), turn.max() + 1e-6, _DIRECTIONS if np.ptp(turn) > 1e-3 else 2)
    table = np.array([[noise(np.exp(s + 1j * t)) for t in turns] for s in speeds])
    logs = RegularGridInterpolator((speeds, turns), np.log(np.maximum(table, 1e-300)))

    def between(motion: np.ndarray) -> np.ndarray:
        clipped = [np.clip(item, nodes[0], nodes[-1]) for item, nodes in zip(place(motion), logs.grid, strict=True)]
        return np.exp(logs(np.stack(clipped, axis=-1))).mean(axis=1)

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
        high = lines > setup.scene.score.white_above_hz
        flat = window.sums(spectrum.weight_hz[None], nodes, spectrum.at_hz)
        to_modes = rate * np.outer(flat, high / high.sum())

    def in_bins(psd: np.ndarray) -> np.ndarray:
        """Bins of a two-sided PSD (n_line,) of the streams."""
        return spectrum.modes.mean(to_modes @ psd)

    # The cleaned streams' own power does not depend on how the array is turned.
    white, shared, low = (stream_power(arrays[0], item) for item in (None, *correlations))
    flat = in_bins(hann.sums(spectrum.weight_hz[None] / 2, nodes, lines))
    red = in_bins(hann.sums(spectrum.excess[None] / 2, spectrum.excess_hz, lines))
    layer = _no_layer
    if setup.scene.atmosphere is not None:
        waves = _layer(setup, levels, spectrum)
        strength = np.mean([layer_stream_strength(array, waves) for array in arrays], axis=0)
        layer = _between_motions(
            levels.motion,
            setup.raster.speed_rad_s,
            lambda motion: in_bins(hann.sums(strength, _along(waves, motion), lines)),
        )
    return _Parts(white * flat, shared * flat, low * red, layer)


def _transmission(setup: Setup, spectrum: _Spectrum, arrays: list[Array], responses: list[np.ndarray]) -> np.ndarray:
    """Share (n_bin,) of a flat sky's power that scans and cleaning leave in the co-added map.

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


def _scored(setup: Setup, model: NoiseModel, noise: np.ndarray, hits: np.ndarray) -> DataSetForecast:
    """Weight and co-add observations whose noise a sample is (n_obs, n_bin) [mK^2]; score the map."""
    scene, band, rings = setup.scene, setup.band, setup.band.rings
    taper, covered = band.taper**2, hits > 0
    if not (noise[:, band.selected].all() and taper[covered].any()):
        raise SceneError("score: found no noise in its multipoles or no scan across its patch; both are expected")
    weight = expected_weights(setup, noise)
    variance = weight**2 @ noise / weight.sum() ** 2
    area = setup.geometry.pixel_rad**2 * np.sum(taper[covered] / hits[covered]) / np.sum(taper)
    psd = variance * area * (1e3 * rj_to_cmb(scene.instrument.frequency_hz)) ** 2
    signal = expected_signal(setup, model)
    score = band_power(psd, signal, rings.n_modes, band.selected, rings.ell, rings.edges_ell, 0.0)
    return DataSetForecast(model.name, model.n_det, score, psd, signal, model.transmission)


def expected_weights(setup: Setup, noise: np.ndarray) -> np.ndarray:
    """Weight (n_draw,) [1/mK^2] of observations whose noise a sample is (n_draw, n_bin): as a run measures it."""
    band = setup.band
    sky = _beamed_sky(setup)
    weight = band.rings.n_modes * (sky * band.selected / sky[band.selected].max()) ** 2
    return 1 / (noise @ weight / weight.sum())


def expected_signal(setup: Setup, model: NoiseModel) -> np.ndarray:
    """PSD (n_bin,) [sr] that a flat spectrum of unit band power leaves in the map."""
    return _beamed_sky(setup) * pixel_window(setup.band.rings.ell, setup.scene.map.pixel_rad) * model.transmission


def _beamed_sky(setup: Setup) -> np.ndarray:
    ell = setup.band.rings.ell
    # The lowest bin of a small map may hold nothing but ell = 0.
    return flat_spectrum_psd(np.maximum(ell, 1)) * beam_window(ell, setup.scene.instrument.beam_fwhm_rad)
