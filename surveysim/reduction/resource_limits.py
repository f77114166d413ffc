"""Limits that are checked before a run: the longest strip of the turbulent layer in the worst weather, and memory."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from mapmaker.wind import HIGHEST_HZ
from surveysim.atmosphere.dated_weather import DatedWeather
from surveysim.atmosphere.layers import Layer
from surveysim.atmosphere.weather import Water, fastest_wind, survey_weather
from surveysim.runtime.errors import OutOfRangeError, SceneError
from surveysim.runtime.memory import machine_bytes
from surveysim.scene.atmosphere import Atmosphere
from surveysim.scene.readout import DroppedSamples, Glitches
from surveysim.scene.scene import Scene
from surveysim.telescope.noise_levels import stop_emits
from surveysim.telescope.pixel_coherence import MOST_DENSE
from surveysim.telescope.scans import Scans, samples_per_scan
from surveysim.timestreams.simulation import AirSetup

if TYPE_CHECKING:
    from surveysim.atmosphere.curved_limits import BoresightMotion
    from surveysim.atmosphere.screen_simulation import SlantStrips

PROGRAM_BYTES = 250e6  # Python and the libraries
MANY_SAMPLES = 1e9  # detector-samples; each takes 0.07 to 6 microseconds of a core
LEAF = 16  # observations that are added one after the other; groups of them are added in pairs
LARGE_SUMS = 128e6  # bytes: larger sums over observations are held once
MANY_PIXELS = 4e6  # map pixels: a minute for the skies and the score
SOLVED_MAPS = 12.0  # maps in double precision that conjugate gradients hold for each right-hand side
MOST_DRAWN = 1000  # most observations whose weather is drawn for the check


def check_layer(
    scene: Scene,
    air: AirSetup,
    *,
    radius_rad: float,
    scans: Scans,
    lowest_rad: float,
    curved: "Sequence[BoresightMotion]" = (),
) -> int:
    """Check the weather and the longest strip of each turbulent layer in a run.

    The weather of up to `MOST_DRAWN` observations is drawn. For larger surveys it is an extreme that hardly any survey
    of their length exceeds. A strip is as long as the longest track at the lowest elevation. For scans that are not
    straight it holds the tracks of some observations, `curved`.

    Returns
    -------
    int
        Number of matrix elements of the strips; 0 without a layer.

    Raises
    ------
    SceneError
        For weather or a strip that cannot be drawn.
    """
    if not air.layers:
        return 0
    drawn = scene.observations <= MOST_DRAWN
    if drawn:
        wind = _drawn_wind(scene.atmosphere, air.water, scene.seed, scene.observations, dated=air.dated)
    else:
        wind = fastest_wind(scene.atmosphere, air.water, scene.observations, dated=air.dated)

    def check(layer: Layer) -> int:
        strips, fastest = layer.strips, wind * layer.fastest_factor
        try:
            if curved:
                return _check_curved(strips, fastest, curved)
            return _check_strip(strips, fastest, radius_rad=radius_rad, scans=scans, lowest_rad=lowest_rad)
        except SceneError as error:
            if len(air.layers) == 1:
                raise
            raise SceneError(f"{error}; this is the layer {layer.section.name!r}") from None

    return sum(map(check, air.layers))


@lru_cache(maxsize=2)  # points of a sweep have weather in common
def _drawn_wind(
    atmosphere: Atmosphere, water: Water | None, seed: int, n_obs: int, *, dated: DatedWeather | None
) -> float:
    """Draw the fastest wind [rad/s] of all observations; raises an error for weather that is not finite."""
    drawn = (survey_weather(atmosphere, water, seed, number, dated=dated) for number in range(n_obs))
    return max(weather.wind_speed_rad_s for weather in drawn)


def _check_strip(
    strips: "SlantStrips", wind_rad_s: float, *, radius_rad: float, scans: Scans, lowest_rad: float
) -> int:
    from surveysim.atmosphere.strip_limits import check_strip

    sine = math.sin(lowest_rad)
    seconds = (samples_per_scan(scans) - 1) / scans.sample_rate_hz
    longest = (2 * radius_rad + (scans.speed_rad_s + wind_rad_s) * seconds) / sine
    cache = strips.at(sine)
    try:
        return check_strip(cache, longest)
    except OutOfRangeError as error:
        wind = math.degrees(wind_rad_s) * 60
        raise SceneError(
            f"atmosphere: {error} (tracks through the layer are up to {math.degrees(longest):.3g} deg long, in wind of"
            f" {wind:.3g} arcmin / s)"
        ) from None


def _check_curved(strips: "SlantStrips", wind_rad_s: float, motions: "Sequence[BoresightMotion]") -> int:
    from surveysim.atmosphere.curved_limits import check_curved_strips

    try:
        return check_curved_strips(strips, wind_rad_s, motions)
    except OutOfRangeError as error:
        raise SceneError(f"atmosphere: {error}") from None


@dataclass(frozen=True)
class Sizes:
    """Sizes of the arrays of a run.

    Attributes
    ----------
    n_det, n_samp, n_scans
        Detectors, samples of a scan, scans of the largest block.
    n_bands
        Bands that are simulated.
    n_pixel, n_patch, n_pad
        Pixels of the map; pixels along a side of the scored patch and of the padded patch.
    n_set, n_transfer, n_sky, n_split
        Data sets, transfer functions, simulated skies, split maps.
    n_beam
        Different beams.
    strip_elements
        Matrix elements of a strip of the layer.
    n_coefficients
        Coefficients of a curved sky.
    """

    n_det: int
    n_samp: int
    n_scans: int
    n_bands: int
    n_pixel: int
    n_patch: int
    n_pad: int
    n_set: int
    n_transfer: int
    n_sky: int
    n_split: int
    n_beam: int
    strip_elements: int
    n_coefficients: int


def sums_held(n_obs: int, sums_bytes: float) -> int:
    """Largest number of sums over observations that a run holds: the nodes of a tree, or one set where it is large."""
    return 1 if sums_bytes > LARGE_SUMS else 2 + (n_obs // LEAF).bit_length()


def needed_memory(scene: Scene, of: Sizes) -> dict[str, float]:
    """Estimate the memory [bytes] of the largest process of a run, by the scene key that it depends on most.

    Counts arrays that exist at the same time; the largest have been measured. A run takes between half and twice as
    much.
    """
    real = 4 if scene.numerics.precision == "float32" else 8
    n_freq, flips = of.n_samp // 2 + 1, scene.score.jackknives if scene.score else 0
    patch = of.n_pixel if scene.map.solved else of.n_patch**2
    skies = of.n_sky * (8 * 4 * of.n_beam * of.n_pixel + 16 * of.n_transfer * of.n_pixel + 40 * of.n_transfer * patch)
    shared = any(section and section.coherence != "none" for section in (scene.photon, scene.excess))
    pairs = of.n_det**2 if shared and of.n_det <= MOST_DENSE else 0
    splits = 16.0 * (1 + (scene.spectra.realizations if scene.spectra else 0)) * of.n_split * patch
    sums = 8.0 * flips * of.n_set * patch + 24.0 * of.n_set * of.n_pixel + splits
    more_sums = (sums_held(scene.observations, sums) - 1) * sums
    compared = 2 + len(scene.cleaning.compare)
    # Flags, and streams whose gaps are filled, beside the streams.
    filled = of.n_det * of.n_samp * of.n_scans * (1 + 2 * real) if scene.losses else 0
    seconds = of.n_det * of.n_samp * of.n_scans / scene.scan.sample_rate_hz
    events = {key: 100.0 * seconds * section.rate_hz for key, section in _events(scene).items() if section}
    # A block of one scan does not depend on the limit.
    block_key = "numerics.max_block_memory" if of.n_scans > 1 else scene.scan.duration_key
    needed = {
        block_key: of.n_det * of.n_samp * of.n_scans * (5 + of.n_bands) * real + 16 * of.n_det * n_freq + filled,
        "cleaning.algorithm": _cleaning_memory(scene, of),
        "scan.sample_rate": 100.0 * scene.scan.scans * of.n_samp,
        "map.pixel": 64.0 * of.n_set * of.n_pixel + (140.0 * of.n_pixel if scene.sky or scene.score else 0),
        "score.signal_sims.skies": float(skies),
        "score.jackknives": 12.0 * flips * of.n_set * patch + more_sums + _solution_memory(scene, of),
        "spectra.realizations": 2 * splits,
        "score.size": 110.0 * of.n_pad**2,
        "atmosphere.layer_height": 32.0 * of.strip_elements,
        "instrument.layout": (56.0 if stop_emits(scene) else 32.0) * pairs,
        "observations": 8.0 * scene.observations * (compared * n_freq + 4 * scene.scan.scans),
        "sky.curved_lmax": 48.0 * of.n_coefficients,
        **events,
    }
    return {key: float(size) for key, size in needed.items()} | {"instrument": PROGRAM_BYTES}


def _events(scene: Scene) -> dict[str, Glitches | DroppedSamples | None]:
    """Sections, by the key of their rate, of random events in the streams."""
    return {"glitches.rate": scene.glitches, "dropped_samples.rate": scene.dropped_samples}


def _solution_memory(scene: Scene, of: Sizes) -> float:
    """Memory [bytes] of the conjugate gradients of a map that is solved for, with its jackknives."""
    flips = scene.score.jackknives if scene.score else 0
    return SOLVED_MAPS * 8.0 * (1 + flips) * of.n_pixel if scene.map.solved else 0.0


def _cleaning_memory(scene: Scene, of: Sizes) -> float:
    """Memory [bytes] of the eigenvectors of one scan, and of the transforms of all scans that tell the wind."""
    steps = {name for pipeline in (scene.cleaning.algorithm, *scene.cleaning.compare) for name in pipeline}
    eigenvectors = 32.0 * min(of.n_det, of.n_samp) ** 2
    transforms = 200.0 * of.n_det * scene.scan.scans * scene.scan.duration_s * HIGHEST_HZ
    return eigenvectors * ("pca" in steps) + transforms * ("wind" in steps)


def check_memory(needed: Mapping[str, float]) -> None:
    """Raise SceneError if a process of a run needs more memory than this machine has.

    `needed` is in bytes, by the scene key that it depends on most.
    """
    total, there = sum(needed.values()), machine_bytes()
    if not total <= there:
        key, most = max(needed.items(), key=lambda item: item[1])
        raise SceneError(
            f"{key}: found a scene that needs about {total / 1e9:.3g} GB of memory in one process, {most / 1e9:.3g} GB"
            f" of it because of this key; {there / 1e9:.3g} GB or less is expected, the memory of this machine"
        )


def said_of_size(detector_samples: float, n_pixel: int = 0) -> str:
    """Return a line about a survey that takes minutes or more; empty for other surveys."""
    if detector_samples < MANY_SAMPLES and n_pixel < MANY_PIXELS:
        return ""
    maps = f" and maps of {n_pixel / 1e6:.3g} million pixels" if n_pixel >= MANY_PIXELS else ""
    size = f"{detector_samples / 1e6:,.0f} million detector-samples{maps}"
    return f"it is large, with {size}: 'surveysim plan' says what time and memory it takes"
