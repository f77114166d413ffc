"""One observation reduced: cleaning by every recipe, maps of every data set, noise levels, the best recipe."""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from mapmaker.binning import bin_map
from mapmaker.cleaning import Cleaned
from mapmaker.geometry import boresight_pixels
from mapmaker.timestreams import Timestreams
from surveysim.choice import TARGETS, best_places, merits
from surveysim.noise import draw_from_psd, hann_psd, white_level
from surveysim.observation import Stopwatch, add_sky_signal, draw_colours, draw_observation, observation_weather
from surveysim.pointing import Pointing
from surveysim.recipes import OPTIMAL, Beside, Recipe, apply_recipe, what_is_beside
from surveysim.scene import Scene
from surveysim.setup import Setup, observation_path, prepare
from surveysim.streams import Stage, generator
from surveysim.weather import Weather

REFERENCE = (0, 1)  # observations that tell what recipes leave of a signal: one along each direction


@dataclass(frozen=True)
class ObservationResult:
    """What one observation leaves behind: maps and sums, never time-streams.

    `sums` (n_set, n_y, n_x) of the streams' type [mK] with `hits` (n_set, n_y, n_x) int32; `noise_mk2` (n_set,), the
    noise variance a sample in the scored band, by which observations are weighted; `window` (n_sky, n_window,
    2, n_y, n_x) of that type, signal of the window skies binned without [0] and with [1] cleaning for each of the
    setup's windows, or None; `discarded`, `iterations` and `removed` (templates a scan) per recipe; `merits`
    (n_recipe, n_target) figures of merit of the recipes for all detectors, or None without a choice; `raw_psd` and
    `clean_psd` (n_freq,) [mK^2/Hz], means over detectors, `compared_psd` (n_compare, n_freq) that of the other
    recipes; `seconds` spent per stage.
    """

    observation: int
    sums: np.ndarray
    hits: np.ndarray
    noise_mk2: np.ndarray
    window: np.ndarray | None
    discarded: tuple[int, ...]
    iterations: tuple[float, ...]
    removed: tuple[float, ...]
    merits: np.ndarray | None
    weather: Weather | None
    elevation_rad: float
    raw_psd: np.ndarray
    clean_psd: np.ndarray
    compared_psd: np.ndarray
    white_mk2_hz: float
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Reduced:
    """Streams on their way to maps: `index` (n_det, n_samp) of pixels, `cleaned` per recipe, what they know beside."""

    setup: Setup
    observation: int
    pointing: Pointing
    streams: Timestreams
    index: np.ndarray
    beside: Beside
    cleaned: tuple[Cleaned, ...]


def observe(setup: Setup, observation: int, with_window: bool) -> tuple[ObservationResult, Timestreams]:
    """Simulate, clean and bin one observation: every data set, and the window skies where asked."""
    watch = Stopwatch()
    work = _reduce(setup, observation, watch)
    streams, cleaned = work.streams, work.cleaned
    with watch("spectra"):
        rate, n_scans = setup.raster.sample_rate_hz, len(streams.scan_bounds)
        psd = hann_psd(cleaned[0].data_mk, n_scans, _some(cleaned[0].kept), rate)
        raw = hann_psd(_mean_removed(streams.data_mk, n_scans), n_scans, np.ones(n_scans, bool), rate)
        others = cleaned[1 : len(setup.whole_recipes)]
        psds = [hann_psd(item.data_mk, n_scans, _some(item.kept), rate).mean(axis=0) for item in others]
        compared = np.array(psds).reshape(len(psds), psd.shape[1])
    white = np.full(1, np.nan)
    if setup.scene.score:
        white = white_level(psd, streams.data_mk.shape[1] // n_scans, rate, setup.scene.score.white_above_hz)
    maps = _maps(work, psd, white, watch)
    worth, best = None, 0
    if setup.chooses:
        with watch("choice"):
            of_recipes = [maps[recipe.data_set] for recipe in setup.whole_recipes]
            worth = merits(setup, transmissions(setup.scene), of_recipes)
        best = max(0, int(best_places(worth[:, 0])))
        maps[OPTIMAL] = maps[setup.whole_recipes[best].data_set]
    window = None
    if with_window:
        with watch("window"):
            window = _window_maps(work, best)
    ordered = [maps[name] for name in setup.data_sets]
    sums, hits = (np.stack(planes) for planes in zip(*ordered, strict=True))
    with watch("weights"):
        noise = np.array([map_noise(setup, *item) for item in ordered])
    result = ObservationResult(
        observation=observation,
        sums=sums,
        hits=hits,
        noise_mk2=noise,
        window=window,
        discarded=tuple(int((~item.kept).sum()) for item in cleaned),
        iterations=tuple(float(item.iterations.mean()) for item in cleaned),
        removed=tuple(float(item.removed[_some(item.kept)].mean()) for item in cleaned),
        merits=worth,
        weather=observation_weather(setup, observation),
        elevation_rad=float(work.pointing.elevation_rad.mean()),
        raw_psd=raw.mean(axis=0),
        clean_psd=psd.mean(axis=0),
        compared_psd=compared,
        white_mk2_hz=float(white.mean()),
        seconds=watch.seconds,
    )
    return result, streams


def _reduce(setup: Setup, observation: int, watch: Stopwatch) -> _Reduced:
    streams = draw_observation(setup, observation, watch)
    _, pointing = observation_path(setup, observation)
    plane = streams.focal_plane
    with watch("pixels"):
        index = boresight_pixels(setup.geometry, pointing.xi_rad, pointing.eta_rad, streams.array_angle_rad, plane)
    with watch("wind"):
        beside = what_is_beside(setup.recipes, streams, draw_colours(setup, observation), setup.raster.sample_rate_hz)
    cleaned = []
    for recipe in setup.recipes:
        with watch("cleaning" if recipe.steps == setup.scene.cleaning.algorithm else f"cleaning {recipe.label}"):
            cleaned.append(_clean(setup, recipe, streams, streams.data_mk[recipe.rows], beside))
    return _Reduced(setup, observation, pointing, streams, index, beside, tuple(cleaned))


def _clean(setup: Setup, recipe: Recipe, streams: Timestreams, data_mk: np.ndarray, beside: Beside) -> Cleaned:
    """Clean the streams of a recipe's detectors."""
    plane, rate = streams.focal_plane.subset(recipe.rows), setup.raster.sample_rate_hz
    return apply_recipe(setup.scene.cleaning, recipe, data_mk, streams.scan_bounds, plane, beside, rate)


Map = tuple[np.ndarray, np.ndarray]  # sums and hits, (n_y, n_x) each


def _maps(work: _Reduced, psd: np.ndarray, white: np.ndarray, watch: Stopwatch) -> dict[str, Map]:
    """Sums and hits by data set, but for the optimal one."""
    setup, kept = work.setup, work.cleaned[0].kept
    maps = {
        recipe.data_set: _bin(work, item.data_mk, recipe.rows, item.kept, watch)
        for recipe, item in zip(setup.recipes, work.cleaned, strict=True)
    }
    for name in setup.scene.score.simulated if setup.scene.score else ():
        with watch("simulated sets"):
            data = _simulated_set(setup, work.observation, name, psd, white, work.streams.data_mk.shape[1])
        maps[name] = _bin(work, data, slice(None), kept, watch)
    return maps


def map_noise(setup: Setup, total: np.ndarray, hits: np.ndarray) -> float:
    """Noise variance a sample [mK^2] of one observation's map; inf without a hit.

    With a score: in the multipoles and with the weights that a flat band power gives them,
    ``sum M^2 |FT(T S)|^2 / (sum M^2 sum T^2 H)``, for sums S and hits H under the taper T: white noise of
    variance v a sample has v. It counts correlations between detectors, which a time-stream PSD can't
    see. Without a score: the mean of ``S^2 / H`` over hit pixels.
    """
    hit = hits > 0
    if not hit.any():
        return np.inf
    if setup.band is None:
        return float(np.mean(total[hit].astype(float) ** 2 / hits[hit]))
    rows = setup.band.patch
    return setup.band.noise(total[rows, rows], hits[rows, rows])


def _some(kept: np.ndarray) -> np.ndarray:
    """The kept scans, or all (of zeros) where none is kept, so that a mean is defined."""
    return kept if kept.any() else np.ones_like(kept)


def _mean_removed(data: np.ndarray, n_scans: int) -> np.ndarray:
    scans = data.reshape(len(data), n_scans, -1)
    return (scans - scans.mean(axis=-1, keepdims=True)).reshape(data.shape)


def _simulated_set(
    setup: Setup, observation: int, name: str, psd: np.ndarray, white: np.ndarray, n_samp: int
) -> np.ndarray:
    """Streams of section 5.2's simulated sets: each detector's measured PSD, or its measured white level.

    Uncorrelated between detectors; the mean of each scan is removed, as cleaning does.
    """
    rate, seed, n_scans = setup.raster.sample_rate_hz, setup.scene.seed, setup.raster.n_scans
    n_det = len(psd)
    if name == "uncorrelated":
        rng = generator(seed, Stage.UNCORRELATED, observation)
        streams = draw_from_psd(psd[:, None, :], (n_det, n_scans), n_samp // n_scans, rate, rng)
        return streams.reshape(n_det, n_samp).astype(setup.stream_type, copy=False)
    rng = generator(seed, Stage.WHITE, observation)
    data = rng.standard_normal((n_det, n_samp), dtype=np.float32).astype(setup.stream_type, copy=False)
    data *= np.sqrt(white * rate / 2).astype(data.dtype)[:, None]
    return _mean_removed(data, n_scans)


def _bin(work: _Reduced, data_mk: np.ndarray, rows: np.ndarray | slice, kept: np.ndarray, watch: Stopwatch) -> Map:
    with watch("binning"):
        item = bin_map(work.setup.geometry, data_mk, work.index[rows], work.streams.scan_bounds, kept)
    return item.weighted_sum.astype(work.setup.stream_type), item.hits.astype(np.int32)


def _window_maps(work: _Reduced, best: int) -> np.ndarray:
    """Signal of each window sky without and with cleaning, the difference that it makes to the cleaned data."""
    setup, streams = work.setup, work.streams
    skies, bounds = setup.window_skies_mk, streams.scan_bounds
    shape = (setup.geometry.n_y, setup.geometry.n_x)
    maps = np.zeros((len(skies), len(setup.windows), 2, *shape), setup.stream_type)
    for s, sky in enumerate(skies):
        signal = np.zeros_like(streams.data_mk)
        add_sky_signal(setup, work.pointing, sky, signal, setup.responsivity)
        for recipe, base in zip(setup.recipes, work.cleaned, strict=True):
            rows = recipe.rows
            both = _clean(setup, recipe, streams, streams.data_mk[rows] + signal[rows], work.beside)
            kept = both.kept & base.kept
            place = setup.windows.index(recipe.data_set)
            for state, data in enumerate((signal[rows], both.data_mk - base.data_mk)):
                item = bin_map(setup.geometry, data, work.index[rows], bounds, kept)
                maps[s, place, state] = item.weighted_sum
    if setup.chooses:
        chosen = setup.windows.index(setup.whole_recipes[best].data_set)
        maps[:, setup.windows.index(OPTIMAL)] = maps[:, chosen]
    return maps


@lru_cache(maxsize=2)
def transmissions(scene: Scene) -> np.ndarray:
    """What each recipe leaves of the power of a flat CMB sky and of a point source, (n_recipe, 2, n_bin).

    From the observations of `REFERENCE`, 0 for a recipe that discards all their scans.
    """
    setup = prepare(scene)
    setup = replace(setup, window_skies_mk=setup.window_skies_mk[[0, -1]])
    rows, everywhere = setup.band.patch, np.ones_like(setup.band.taper)
    powers = np.zeros((len(setup.whole_recipes), len(TARGETS), 2, len(setup.band.rings.ell)))
    for observation in REFERENCE:
        maps = _window_maps(_reduce(setup, observation % scene.observations, Stopwatch()), 0)[..., rows, rows]
        for r, recipe in enumerate(setup.whole_recipes):
            place = setup.windows.index(recipe.data_set)
            for s, state in np.ndindex(powers.shape[1:3]):
                powers[r, s, state] += setup.band.ring_noise(maps[s, place, state], everywhere)
    return np.divide(powers[:, :, 1], powers[:, :, 0], out=np.zeros_like(powers[:, :, 0]), where=powers[:, :, 0] > 0)
