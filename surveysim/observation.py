"""One observation, end to end: streams, cleaning, maps of every data set, noise levels."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from mapmaker.binning import bin_map
from mapmaker.cleaning import Cleaned, clean
from mapmaker.geometry import boresight_pixels, plane_directions, sky_offsets
from mapmaker.kernels.pixels import add_sky
from mapmaker.timestreams import FocalPlane, Timestreams, scan_bounds
from surveysim.noise import (
    add_correlated_white,
    add_excess,
    add_white,
    draw_from_psd,
    excess_variance,
    hann_psd,
    white_level,
)
from surveysim.pointing import Pointing, sky_vector
from surveysim.setup import Setup, observation_path
from surveysim.streams import Stage, generator
from surveysim.weather import Weather, draw_weather


@dataclass(frozen=True)
class ObservationResult:
    """What one observation leaves behind: maps and sums, never time-streams.

    `sums` (n_set, n_y, n_x) float32 [mK] with `hits` (n_set, n_y, n_x) int32; `noise_mk2` (n_set,), the
    noise variance a sample in the scored band, by which observations are weighted; `window` (n_sky, n_array,
    2, n_y, n_x) float32, signal of the window skies binned without [0] and with [1] cleaning for the
    whole and the masked array, or None; `discarded` and `iterations` per array; `raw_psd`, `clean_psd`
    (n_freq,) [mK^2/Hz], mean over detectors; `seconds` spent per stage.
    """

    observation: int
    sums: np.ndarray
    hits: np.ndarray
    noise_mk2: np.ndarray
    window: np.ndarray | None
    discarded: tuple[int, ...]
    iterations: tuple[float, ...]
    weather: Weather | None
    elevation_rad: float
    raw_psd: np.ndarray
    clean_psd: np.ndarray
    white_mk2_hz: float
    seconds: dict[str, float] = field(default_factory=dict)


class Stopwatch:
    """Seconds spent in named stages."""

    def __init__(self):
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Add the time of the block to `stage`."""
        start = perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + perf_counter() - start


def draw_observation(setup: Setup, observation: int, watch: Stopwatch | None = None) -> Timestreams:
    """The time-streams of one observation, with the weather drawn for it in the attributes."""
    watch = watch or Stopwatch()
    path, pointing = observation_path(setup, observation)
    weather = observation_weather(setup, observation)
    data = np.zeros((setup.n_det, len(path.time_s)), np.float32)
    with watch("atmosphere"):
        if weather is not None:
            add_layer(setup, observation, pointing, weather, data)
    with watch("excess"):
        _add_excess(setup, observation, weather, data)
    with watch("sky"):
        if setup.sky_mk is not None:
            add_sky_signal(setup, pointing, setup.sky_mk, data, np.ones(len(data)))
    # Atmosphere, excess and sky are seen with each detector's own responsivity; the levels of photon and detector
    # noise are those at its output.
    data *= setup.responsivity[:, None].astype(np.float32)
    with watch("photon"):
        _add_photon(setup, observation, data)
    with watch("detector"):
        if setup.scene.detector:
            rng = generator(setup.scene.seed, Stage.DETECTOR, observation)
            add_white(data, setup.scene.detector.psd_mk2_hz, setup.raster.sample_rate_hz, rng)
    return _timestreams(setup, observation, pointing, weather, data)


def observation_weather(setup: Setup, observation: int) -> Weather | None:
    """The weather drawn for one observation; None without an atmosphere."""
    if setup.scene.atmosphere is None:
        return None
    rng = generator(setup.scene.seed, Stage.WEATHER, observation)
    return draw_weather(setup.scene.atmosphere, setup.water, rng)


def observe(setup: Setup, observation: int, with_window: bool) -> tuple[ObservationResult, Timestreams]:
    """Simulate, clean and bin one observation: every data set, and the window skies where asked."""
    watch = Stopwatch()
    streams = draw_observation(setup, observation, watch)
    _, pointing = observation_path(setup, observation)
    bounds = streams.scan_bounds
    plane = streams.focal_plane
    with watch("pixels"):
        index = boresight_pixels(setup.geometry, pointing.xi_rad, pointing.eta_rad, streams.array_angle_rad, plane)
    arrays = [slice(None)] + ([] if setup.masked is None else [setup.masked])
    with watch("cleaning"):
        cleaned = [_clean(setup, streams.data_mk[rows], bounds, plane.subset(rows)) for rows in arrays]
    with watch("spectra"):
        rate, n_scans = setup.raster.sample_rate_hz, len(bounds)
        psd = hann_psd(cleaned[0].data_mk, n_scans, _some(cleaned[0].kept), rate)
        raw = hann_psd(_mean_removed(streams.data_mk, n_scans), n_scans, np.ones(n_scans, bool), rate)
    maps = [_bin(setup, cleaned[0].data_mk, index, bounds, cleaned[0].kept, watch)]
    white = np.full(1, np.nan)
    if setup.scene.score:
        white = white_level(psd, streams.data_mk.shape[1] // n_scans, rate, setup.scene.score.white_above_hz)
        for name in setup.scene.score.simulated:
            with watch("simulated sets"):
                data = _simulated_set(setup, observation, name, psd, white, streams.data_mk.shape[1])
            maps.append(_bin(setup, data, index, bounds, cleaned[0].kept, watch))
    if setup.masked is not None:
        maps.append(_bin(setup, cleaned[1].data_mk, index[setup.masked], bounds, cleaned[1].kept, watch))
    window = None
    if with_window:
        with watch("window"):
            window = _window_maps(setup, pointing, streams, index, arrays, cleaned)
    sums, hits = (np.stack(planes) for planes in zip(*maps, strict=True))
    with watch("weights"):
        noise = np.array([map_noise(setup, *item) for item in maps])
    result = ObservationResult(
        observation=observation,
        sums=sums,
        hits=hits,
        noise_mk2=noise,
        window=window,
        discarded=tuple(int((~item.kept).sum()) for item in cleaned),
        iterations=tuple(float(item.iterations.mean()) for item in cleaned),
        weather=observation_weather(setup, observation),
        elevation_rad=float(pointing.elevation_rad.mean()),
        raw_psd=raw.mean(axis=0),
        clean_psd=psd.mean(axis=0),
        white_mk2_hz=float(white.mean()),
        seconds=watch.seconds,
    )
    return result, streams


def add_sky_signal(setup: Setup, pointing: Pointing, sky_mk: np.ndarray, data_mk: np.ndarray, gain: np.ndarray) -> None:
    """Add what the detectors see of a sky on the setup's sky grid to the streams, in place."""
    grid, plane = setup.sky_geometry, setup.camera.focal_plane
    scale = 1 / grid.pixel_rad
    angle = pointing.array_angle_rad[pointing.scan]
    column = grid.n_x / 2 - 0.5 - pointing.xi_rad * scale
    row = grid.n_y / 2 - 0.5 + pointing.eta_rad * scale
    cos, sin = np.cos(angle) * scale, np.sin(angle) * scale
    add_sky(data_mk, sky_mk, column, row, cos, sin, plane.x_rad, plane.y_rad, gain.astype(np.float32))


def add_layer(
    setup: Setup, observation: int, pointing: Pointing, weather: Weather, data: np.ndarray, realization: int = 0
) -> None:
    """Add one realization of the moving layer in this weather to the streams (n_det, n_samp) [mK], in place."""
    from surveysim.atmosphere.screen import add_atmosphere

    air = setup.scene.atmosphere
    offsets = np.stack(sky_offsets(setup.camera.focal_plane, pointing.array_angle_rad), axis=-1)
    layer = np.stack(sky_vector(pointing.parallactic_rad, *weather.wind_rad_s), axis=-1)
    # Equation 2 of the paper: P = B2 sin(el)^(1 - b) alpha^-b.
    amplitude = np.sqrt(weather.b2 * np.sin(pointing.elevation_rad) ** (1 - air.index))
    rng = generator(setup.scene.seed, Stage.ATMOSPHERE, observation, realization)
    add_atmosphere(
        data,
        scan_bounds(pointing.scan),
        setup.raster.sample_rate_hz,
        offsets,
        pointing.velocity_rad_s,
        layer,
        amplitude,
        setup.strips,
        rng,
    )


def _add_excess(setup: Setup, observation: int, weather: Weather | None, data: np.ndarray) -> None:
    section = setup.scene.excess
    if section is None:
        return
    variance = excess_variance(section, None if weather is None else weather.b2)
    rng = generator(setup.scene.seed, Stage.EXCESS, observation)
    rate, n_scans = setup.raster.sample_rate_hz, setup.raster.n_scans
    add_excess(data, section, variance, n_scans, rate, setup.excess_factor, rng)


def _add_photon(setup: Setup, observation: int, data: np.ndarray) -> None:
    section = setup.scene.photon
    if section is None:
        return
    rng = generator(setup.scene.seed, Stage.PHOTON, observation)
    add_correlated_white(data, section.psd_mk2_hz, setup.raster.sample_rate_hz, setup.photon_factor, rng)


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


def _timestreams(
    setup: Setup, observation: int, pointing: Pointing, weather: Weather | None, data: np.ndarray
) -> Timestreams:
    ra, dec = plane_directions(setup.geometry, pointing.xi_rad, pointing.eta_rad)
    truth = {}
    if weather is not None:
        truth = {
            "b2_mk2": weather.b2,
            "wind_speed_arcmin_s": np.degrees(weather.wind_speed_rad_s) * 60,
            "wind_angle_deg": np.degrees(weather.wind_angle_rad),
            "layer_height_m": setup.scene.atmosphere.layer_height_m,
        }
    if setup.water is not None:
        truth["pwv_mm"] = weather.pwv_mm
    attributes = {
        "scene": setup.scene.name,
        "seed": setup.scene.seed,
        "observation": observation,
        "start_mjd_utc": pointing.start_mjd,
        "sample_rate_hz": setup.raster.sample_rate_hz,
        "elevation_deg": float(np.degrees(pointing.elevation_rad.mean())),
        "camera_angle_deg": float(np.degrees(pointing.array_angle_rad[0] - pointing.parallactic_rad[0])),
        **truth,
    }
    angle = pointing.array_angle_rad[pointing.scan]
    plane = setup.camera.focal_plane
    return Timestreams(data, pointing.time_s, ra, dec, angle, pointing.scan, plane, attributes)


def _clean(setup: Setup, data: np.ndarray, bounds: np.ndarray, plane: FocalPlane) -> Cleaned:
    return clean(setup.scene.cleaning.algorithm, data, bounds, plane, setup.cleaning)


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
        return streams.reshape(n_det, n_samp)
    rng = generator(seed, Stage.WHITE, observation)
    data = rng.standard_normal((n_det, n_samp), dtype=np.float32)
    data *= np.sqrt(white * rate / 2).astype(np.float32)[:, None]
    return _mean_removed(data, n_scans)


def _bin(
    setup: Setup, data: np.ndarray, index: np.ndarray, bounds: np.ndarray, kept: np.ndarray, watch: Stopwatch
) -> tuple[np.ndarray, np.ndarray]:
    with watch("binning"):
        item = bin_map(setup.geometry, data, index, bounds, kept)
    return item.weighted_sum.astype(np.float32), item.hits.astype(np.int32)


def _window_maps(
    setup: Setup,
    pointing: Pointing,
    streams: Timestreams,
    index: np.ndarray,
    arrays: list[np.ndarray | slice],
    cleaned: list[Cleaned],
) -> np.ndarray:
    """Signal of each window sky without and with cleaning, the difference that it makes to the cleaned data."""
    skies, bounds = setup.window_skies_mk, streams.scan_bounds
    shape = (setup.geometry.n_y, setup.geometry.n_x)
    maps = np.zeros((len(skies), len(arrays), 2, *shape), np.float32)
    for s, sky in enumerate(skies):
        signal = np.zeros_like(streams.data_mk)
        add_sky_signal(setup, pointing, sky, signal, setup.responsivity)
        for a, (rows, base) in enumerate(zip(arrays, cleaned, strict=True)):
            plane = streams.focal_plane.subset(rows)
            both = _clean(setup, streams.data_mk[rows] + signal[rows], bounds, plane)
            kept = both.kept & base.kept
            for state, data in enumerate((signal[rows], both.data_mk - base.data_mk)):
                maps[s, a, state] = bin_map(setup.geometry, data, index[rows], bounds, kept).weighted_sum
    return maps
