"""The layer in observations of scenes with curved scans, against the closed form at the places of the pointing."""

import math

import numpy as np
import pytest

from mapmaker.geometry import sky_offsets
from surveysim.atmosphere.thin_screen import structure_function
from surveysim.atmosphere.weather import Weather
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.timestreams.atmosphere import add_layers
from surveysim.timestreams.simulation import observation_path
from tests.scenes import SMALL_SCENE, without_sections

ARCMIN = math.radians(1 / 60)
DAISY = """
pattern = "daisy"
radius = "6 arcmin"
radial_period = "4 s"
rotation_period = "12 s"
duration = "40 s"
chunk = "10 s"
sample_rate = "10 Hz"
dither = "0 arcmin"
"""
AZIMUTH = """
pattern = "azimuth"
speed = "40 arcmin / s"
throw = "5 deg"
scans = 4
turnaround = "1 s"
turnarounds = "flagged"
sample_rate = "10 Hz"
dither = "0 arcmin"
"""
SCHEDULE = """
[schedule]
latitude = "-22d59m08s"
longitude = "-67d44m25s"
height = "5600 m"
first_night = "2026-09-15"
nights = 1
max_hour_angle = "2 hourangle"
min_elevation = "20 deg"
"""


@pytest.fixture
def setup_of(tmp_path):
    def make(scan, schedule=False, **changes):
        sections = ["scan", "sky", "score"] + ["fixed_pointing"] * schedule
        text = without_sections(SMALL_SCENE, *sections) + f"[scan]{scan}" + SCHEDULE * schedule
        text = text.replace("+44d50m24s", "-20d00m00s")
        path = tmp_path / "curved.toml"
        path.write_text(text, encoding="utf-8")
        return prepare(load_scene(path, {name.replace("__", "."): value for name, value in changes.items()}))

    return make


def layer_alone(setup, weather, realization=0, block=None):
    pointing = observation_path(setup.observing, 1)[1]
    n_scan = block.n_scans if block else setup.observing.scans.n_scans
    data = np.zeros((setup.camera.n_det, n_scan * (len(pointing.scan) // setup.observing.scans.n_scans)), np.float32)
    add_layers(setup, 1, pointing, weather=weather, data=data, realization=realization, block=block)
    return data


def places(setup, weather):
    """Places (n_det, n_scan, n) complex in the layer at a fixed pointing, in the frame of the tangent plane."""
    pointing = observation_path(setup.observing, 1)[1]
    east, north = sky_offsets(setup.camera.focal_plane, pointing.scan_array_angle_rad[:1])
    # In azimuth (on the sky) and elevation, whose y axis has the position angle of the vertical.
    wind = complex(*weather.wind_rad_s)
    vertical = pointing.scan_parallactic_rad[0]
    wind = complex(
        -wind.real * math.cos(vertical) + wind.imag * math.sin(vertical),
        wind.real * math.sin(vertical) + wind.imag * math.cos(vertical),
    )
    boresight = pointing.xi_rad + 1j * pointing.eta_rad - wind * pointing.time_s
    seen = boresight + (east[0] + 1j * north[0])[:, None]
    sine = math.sin(pointing.scan_elevation_rad[0])
    return seen.reshape(len(seen), setup.observing.scans.n_scans, -1) / sine, sine


def test_structure_function_of_a_daisy_s_chunk(setup_of):
    """Detectors and times of one chunk, with the camera and the wind turned on the sky."""
    n_draw, setup = 300, setup_of(DAISY, atmosphere__layer_height="400 m")
    weather = Weather(280.0, 25 * ARCMIN, 0.8, math.nan)
    place, sine = places(setup, weather)
    place = place[::4, 2, ::9].ravel()
    draws = np.array([layer_alone(setup, weather, k) for k in range(n_draw)], float)
    values = draws.reshape(n_draw, len(draws[0]), 4, -1)[:, ::4, 2, ::9].reshape(n_draw, -1)
    found = np.square(values[:, :, None] - values[:, None]).mean(axis=0)
    apart = np.abs(place[:, None] - place)
    far = apart > 1e-9
    expected = 280 / sine * structure_function(setup.air.layers[0].strips.screen, apart[far])
    np.testing.assert_allclose(found[far] / expected, 1.0, atol=5 * math.sqrt(2 / n_draw))


def slopes(setup, weather, n_draw):
    """Correlations (n_scan, n_scan) of the slopes in time of the boresight's detector: drawn, and from its places."""
    n_scan, plane = setup.observing.scans.n_scans, setup.camera.focal_plane
    centre = np.argmin(np.hypot(plane.x_rad, plane.y_rad))
    draws = np.array([layer_alone(setup, weather, k)[centre] for k in range(n_draw)], float).reshape(n_draw, n_scan, -1)
    time = np.arange(draws.shape[-1]) - (draws.shape[-1] - 1) / 2
    slope = draws @ time
    return np.corrcoef(slope.T), np.kron(np.eye(n_scan), time)


def correlations(covariance):
    spread = np.sqrt(np.diag(covariance))
    return covariance / np.outer(spread, spread)


def test_chunks_of_a_daisy_share_their_trends(setup_of):
    n_draw, setup = 250, setup_of(DAISY)
    weather = Weather(1.0, 15 * ARCMIN, 2.8, math.nan)
    found, fit = slopes(setup, weather, n_draw)
    place = places(setup, weather)[0].mean(axis=0).ravel()
    screen = setup.air.layers[0].strips.screen
    expected = fit @ structure_function(screen, np.abs(place[:, None] - place)) @ fit.T / -2
    np.testing.assert_allclose(found, correlations(expected), atol=4.5 * math.sqrt(1 / n_draw))
    assert correlations(expected)[0, 1] > 0.3


@pytest.mark.slow
def test_sweeps_in_azimuth_share_their_trends(setup_of):
    """At the elevation of the pointing, in a wind that keeps its direction while the telescope turns."""
    n_draw, setup = 250, setup_of(AZIMUTH, schedule=True)
    weather = Weather(1.0, 15 * ARCMIN, 2.8, math.nan)
    found, fit = slopes(setup, weather, n_draw)
    pointing = observation_path(setup.observing, 1)[1]
    elevation = pointing.elevation_rad.mean()
    assert np.ptp(pointing.elevation_rad) < 1e-7
    away = np.exp(1j * (math.pi / 2 - pointing.azimuth_rad))
    middle = np.exp(1j * np.angle(away.mean()))
    wind = complex(*weather.wind_rad_s)
    wind = (wind.real * -1j * middle - wind.imag * middle) / math.sin(elevation)
    place = away / math.tan(elevation) - wind * pointing.time_s
    screen = setup.air.layers[0].strips.screen
    expected = fit @ structure_function(screen, np.abs(place[:, None] - place)) @ fit.T / -2
    np.testing.assert_allclose(found, correlations(expected), atol=4.5 * math.sqrt(1 / n_draw))
    assert abs(correlations(expected)[0, 1]) > 0.3


def test_blocks_share_an_observation_s_trends(setup_of):
    weather = Weather(280.0, 31 * ARCMIN, 0.5, math.nan)
    whole, parts = setup_of(DAISY), setup_of(DAISY, numerics__max_block_memory="15 kB")
    assert len(whole.observing.blocks) == 1 and len(parts.observing.blocks) == 2
    one = layer_alone(whole, weather)
    two = np.concatenate([layer_alone(parts, weather, block=block) for block in parts.observing.blocks], axis=1)
    time = np.arange(100) - 49.5
    slope_one, slope_two = (data.mean(axis=0).reshape(4, -1) @ time for data in (one, two))
    assert np.corrcoef(slope_one, slope_two)[0, 1] > 0.99 and not np.array_equal(one, two)


@pytest.mark.slow
def test_a_curved_layer_that_evolves_has_its_structure_function(setup_of):
    """Squares of the weights of two realizations add to one: differences at one time are those of a frozen layer."""
    n_draw, setup = 100, setup_of(DAISY, atmosphere__decorrelation_time="8 s")
    weather = Weather(280.0, 25 * ARCMIN, 0.8, math.nan)
    place, sine = places(setup, weather)
    draws = np.array([layer_alone(setup, weather, k) for k in range(n_draw)], float)[..., ::37]
    found = np.square(draws[:, :, None] - draws[:, None]).mean(axis=(0, 3))  # of samples that are far from independent
    apart = np.abs(place[:, None, 0, 0] - place[:, 0, 0])
    far = apart > 1e-9
    expected = 280 / sine * structure_function(setup.air.layers[0].strips.screen, apart[far])
    np.testing.assert_allclose(found[far] / expected, 1.0, atol=4.5 * math.sqrt(2 / n_draw))


def test_wind_cleaning_needs_straight_scans(setup_of):
    with pytest.raises(SceneError, match="cleaning.algorithm: found 'wind' with the pattern 'daisy'; straight scans"):
        setup_of(DAISY, cleaning__algorithm="wind")


def test_rectangles_that_are_too_large_are_refused(setup_of):
    """Three sweeps of 20 degrees across a wind, in one scan of a minute."""
    figure = AZIMUTH.split("speed")[0].replace("azimuth", "lissajous") + (
        'amplitude_x = "10 deg"\namplitude_y = "1 deg"\nperiod_x = "40 s"\nperiod_y = "37 s"\nduration = "60 s"\n'
        'chunk = "60 s"\nsample_rate = "10 Hz"\ndither = "0 arcmin"\n'
    )
    with pytest.raises(SceneError, match=r"atmosphere: found a rectangle of the layer .* fill .* deg, in wind of"):
        setup_of(figure, atmosphere__wind_median="60 arcmin / s", map__pixel="3 arcmin")


def test_tracks_to_the_horizon_are_refused(setup_of):
    """A radius of 8 degrees about an elevation of 6: with the layer at h / sin(el), the run would not be defined."""
    low = DAISY.replace("6 arcmin", "8 deg").replace("4 s", "40 s").replace("12 s", "130 s").replace("10 s", "5 s")
    with pytest.raises(SceneError, match=r"scan: found the boresight at -1.* deg elevation in observation 0, with"):
        setup_of(low, fixed_pointing__elevation="6 deg", map__pixel="3 arcmin")
    with pytest.raises(SceneError, match=r"scan: found the boresight at .* deg elevation in observation .* dither; 2"):
        setup_of(DAISY.replace("0 arcmin", "8 deg"), fixed_pointing__elevation="6 deg", map__pixel="3 arcmin")
