"""Scans of one observation under one layer: trends in common, each scan's own statistics as they were, B2 of 18 scans.

The closed form is the covariance -D / 2 between all samples of all scans, at their places in the layer.
"""

import math
from functools import cache

import numpy as np
import pytest

from surveysim.atmosphere.scan_trends import draw_trends, strip_points
from surveysim.atmosphere.screen_simulation import StripCache, add_atmosphere, scan_tracks, strip_step
from surveysim.atmosphere.thin_screen import Screen, structure_function
from surveysim.atmosphere.weather import Weather
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.timestreams.atmosphere import add_layers
from surveysim.timestreams.observed_block import observation_weather
from surveysim.timestreams.simulation import observation_path
from tests.deviates import deviates
from tests.scenes import SMALL_SCENE

ARCMIN = math.radians(1 / 60)
SCREEN = Screen(11 / 3, 8e-3)
N_SCAN, N_SAMP, SECONDS, GAP, STEP = 18, 30, 15.0, 10.0, 2.4 * ARCMIN
RATE = N_SAMP / SECONDS


def places(wind, speed, n_scan=N_SCAN):
    """Places (n_scan, N_SAMP) complex [rad] of the boresight in the layer: scans along x there and back."""
    time = (np.arange(N_SAMP) + 0.5) / RATE - SECONDS / 2
    k = np.arange(n_scan)[:, None]
    middle = SECONDS / 2 + k * (SECONDS + GAP)
    return speed * (1 - 2 * (k % 2)) * time + 1j * STEP * k - wind * (middle + time)


def closed_form(place, screen=SCREEN):
    """Covariance of all samples about the means of their scans."""
    flat, (n_scan, n_samp) = place.ravel(), place.shape
    left = np.kron(np.eye(n_scan), np.eye(n_samp) - 1 / n_samp)
    return left @ (-0.5 * structure_function(screen, np.abs(flat[:, None] - flat))) @ left


def slopes(covariance, n_scan=N_SCAN):
    time = np.arange(N_SAMP) - (N_SAMP - 1) / 2
    fit = np.kron(np.eye(n_scan), time / (time @ time))
    return fit @ covariance @ fit.T


def correlations(covariance):
    spread = np.sqrt(np.diag(covariance))
    return covariance / np.outer(spread, spread)


@cache
def drawn(wind, speed, n_draw, n_scan=N_SCAN, offsets=(0j,), seed=1):
    """Streams (n_draw, n_det, n_scan, N_SAMP) of detectors at offsets in observations drawn afresh."""
    places_of = places(wind, speed, n_scan)
    strips = StripCache(SCREEN, 4 * ARCMIN, strip_step(SCREEN, 0.0))
    place = np.array([[z.real, z.imag] for z in offsets])
    bounds = N_SAMP * np.arange(n_scan)[:, None] + [0, N_SAMP]
    sign = 1.0 - 2.0 * (np.arange(n_scan) % 2)
    velocity = np.stack([speed * sign, np.zeros(n_scan)], axis=1)
    layer = np.tile([wind.real, wind.imag], (n_scan, 1))
    motion = {
        "sample_rate_hz": RATE,
        "offsets_rad": np.broadcast_to(place, (n_scan, *place.shape)),
        "velocity_rad_s": velocity,
        "layer_velocity_rad_s": layer,
        "strips": strips,
    }
    tracks = scan_tracks(bounds, **motion)
    begin = np.stack([places_of[:, 0].real, places_of[:, 0].imag], axis=1)
    item = strip_points(strips, begin + tracks.corner_rad, tracks.direction, tracks.length_rad)
    rng, streams = np.random.default_rng(seed), []
    for _ in range(n_draw):
        data = np.zeros((len(offsets), n_scan * N_SAMP), np.float32)
        trends = draw_trends(item, deviates(rng))
        add_atmosphere(data, bounds, **motion, amplitude_mk=np.ones(n_scan), deviates=deviates(rng), trends=trends)
        streams.append(data.reshape(len(offsets), n_scan, N_SAMP))
    return np.array(streams, float)


WIND = 31 * ARCMIN * np.exp(0.7j)
WINDS = [complex(31 * ARCMIN), 31j * ARCMIN, complex(15 * ARCMIN), 60j * ARCMIN, complex(WIND)]


@pytest.mark.parametrize("speed", [0.0, 4 * ARCMIN])
@pytest.mark.parametrize("wind", WINDS)
def test_slopes_correlate_whatever_the_wind(wind, speed):
    """+0.44 from scan to scan and +0.35 to the next but one: the closed form itself."""
    found = correlations(slopes(closed_form(places(wind, speed))))
    assert np.diag(found, 1).mean() == pytest.approx(0.44, abs=0.02)
    assert np.diag(found, 2).mean() == pytest.approx(0.35, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("wind", [complex(WIND), complex(3 * ARCMIN)])
def test_drawn_slopes_correlate_as_the_closed_form(wind):
    """Means over all pairs of scans that are as far apart, to four standard errors of such a mean over the draws."""
    n_draw, speed = 400, 4 * ARCMIN
    expected = slopes(closed_form(places(wind, speed)))
    time = np.arange(N_SAMP) - (N_SAMP - 1) / 2
    slope = drawn(wind, speed, n_draw)[:, 0] @ time / (time @ time)
    spread = np.sqrt(np.diag(expected))
    products = slope[:, :, None] * slope[:, None] / np.outer(spread, spread)
    for lag in (0, 1, 2, 3, 8, 17):
        each = np.diagonal(products, lag, 1, 2).mean(axis=1)
        error = each.std() / math.sqrt(n_draw)
        assert error < 0.06
        assert each.mean() == pytest.approx(np.diag(correlations(expected), lag).mean(), abs=4 * error)


def test_gradients_across_correlate_as_the_closed_form():
    n_draw, wind, width = 400, complex(31 * ARCMIN), 8 * ARCMIN
    streams = drawn(wind, 0.0, n_draw, 6, (-0.5j * width, 0.5j * width))
    gradient = (streams[:, 1] - streams[:, 0]).mean(axis=-1)
    # Means over a scan of the difference of two places, from -D / 2 between four.
    place = np.stack([places(wind, 0.0, 6) + side * 0.5j * width for side in (-1, 1)])
    flat = place.reshape(2, -1)
    field = [[-0.5 * structure_function(SCREEN, np.abs(a[:, None] - b)) for b in flat] for a in flat]
    both = field[0][0] + field[1][1] - field[0][1] - field[1][0]
    mean = np.kron(np.eye(6), np.full(N_SAMP, 1 / N_SAMP))
    expected = mean @ both @ mean.T
    for lag in (0, 1, 2):
        each = np.diagonal(gradient[:, :, None] * gradient[:, None], lag, 1, 2).mean(axis=1) / expected[0, 0]
        error = each.std() / math.sqrt(n_draw)
        assert each.mean() == pytest.approx(np.diag(correlations(expected), lag).mean(), abs=4 * error)
    assert correlations(expected)[0, 1] > 0.4


def test_a_scan_s_own_structure_function_is_as_it_was():
    """Along, across and oblique, of the second of three scans: D to 4.5 standard errors, sqrt(2 / n)."""
    n_draw, offsets = 1200, (0j, 4j * ARCMIN, complex(-2 * ARCMIN, -3.5 * ARCMIN))
    wind, speed = complex(WIND), 4 * ARCMIN
    streams = drawn(wind, speed, n_draw, 3, offsets, 2)[:, :, 1]
    place = (places(wind, speed, 3)[1] + np.array(offsets)[:, None]).ravel()[::7]
    values = streams.reshape(n_draw, -1)[:, ::7]
    found = np.square(values[:, :, None] - values[:, None]).mean(axis=0)
    apart = np.abs(place[:, None] - place)
    far = apart > 1e-9
    expected = structure_function(SCREEN, apart[far])
    np.testing.assert_allclose(found[far] / expected, 1.0, atol=4.5 * math.sqrt(2.0 / n_draw))


@pytest.mark.slow
def test_b2_of_18_scans():
    """The variance about the means of 18 scans scatters by 0.45, not by 0.30, and its median is 0.90 of its mean."""
    covariance = closed_form(places(complex(WIND), 4 * ARCMIN))
    scatter = math.sqrt(2 * np.sum(covariance**2)) / np.trace(covariance)
    own = covariance * np.kron(np.eye(N_SCAN), np.ones((N_SAMP, N_SAMP)))
    assert scatter == pytest.approx(0.45, abs=0.01)
    assert math.sqrt(2 * np.sum(own**2)) / np.trace(own) == pytest.approx(0.30, abs=0.01)
    n_draw = 400
    streams = drawn(complex(WIND), 4 * ARCMIN, n_draw)[:, 0]
    b2 = streams.var(axis=-1).mean(axis=-1) / (np.trace(covariance) / covariance.shape[0])
    assert b2.mean() == pytest.approx(1, abs=4 * scatter / math.sqrt(n_draw))
    # Errors of standard deviation and median of n values so skew: some 1.6 / sqrt(2 n) and 1.3 scatter / sqrt(n).
    assert b2.std() == pytest.approx(scatter, rel=4 * 1.6 / math.sqrt(2 * n_draw))
    assert np.median(b2) == pytest.approx(0.90, abs=4 * 1.3 * scatter / math.sqrt(n_draw))


# ---------------------------------------------------------------- observations of scenes


@pytest.fixture
def scene_of(tmp_path):
    def load(**changes):
        path = tmp_path / "small.toml"
        path.write_text(SMALL_SCENE, encoding="utf-8")
        return load_scene(path, {name.replace("__", "."): value for name, value in changes.items()})

    return load


def layer_alone(setup, observation=0, weather=None, block=None, realization=0):
    pointing = observation_path(setup.observing, observation)[1]
    n_scan = block.n_scans if block else setup.observing.scans.n_scans
    data = np.zeros((setup.camera.n_det, n_scan * (len(pointing.time_s) // setup.observing.scans.n_scans)), np.float32)
    weather = weather or observation_weather(setup, observation)
    add_layers(setup, observation, pointing, weather=weather, data=data, realization=realization, block=block)
    return data


def test_an_observation_s_slopes_are_those_of_its_places_on_the_sky(scene_of):
    """Boresight, wind, elevation and the turning sky: the closed form at the places that the pointing says."""
    n_draw, setup = 250, prepare(scene_of(scan__scans=6))
    weather, pointing = Weather(1.0, 12 * ARCMIN, 0.8, math.nan), observation_path(setup.observing, 1)[1]
    sine = np.sin(pointing.scan_elevation_rad)
    n_samp = len(pointing.time_s) // 6
    wind = weather.wind_rad_s
    parallactic = np.interp(pointing.time_s, pointing.time_s.reshape(6, -1).mean(axis=1), pointing.scan_parallactic_rad)
    cos, sin = np.cos(parallactic), np.sin(parallactic)
    velocity = -wind[0] * cos + wind[1] * sin + 1j * (wind[0] * sin + wind[1] * cos)
    step = np.diff(pointing.time_s) * (velocity[1:] + velocity[:-1]) / 2
    place = pointing.xi_rad + 1j * pointing.eta_rad - np.concatenate([[0], np.cumsum(step)])
    place = place.reshape(6, n_samp) / sine.mean()
    time = np.arange(n_samp) - (n_samp - 1) / 2
    fit = np.kron(np.eye(6), time / (time @ time))
    flat = place.ravel()
    expected = (
        fit
        @ structure_function(setup.air.layers[0].strips.screen, np.abs(flat[:, None] - flat))
        @ fit.T
        / -2
        / sine.mean()
    )
    centre = np.argmin(np.hypot(setup.camera.focal_plane.x_rad, setup.camera.focal_plane.y_rad))
    data = np.array([layer_alone(setup, 1, weather, None, k)[centre] for k in range(n_draw)], float)
    slope = data.reshape(n_draw, 6, n_samp) @ time / (time @ time)
    spread = np.sqrt(np.diag(expected))
    found = slope.T @ slope / n_draw / np.outer(spread, spread)
    np.testing.assert_allclose(found, correlations(expected), atol=4.5 * math.sqrt(2 / n_draw))
    assert abs(correlations(expected)[0, 1]) > 0.3


@pytest.mark.parametrize("elevation, height", [("45 deg", "1000 m"), ("30 deg", "500 m")])
def test_the_beam_in_the_layer_is_that_of_the_slant_distance(scene_of, elevation, height):
    """D of drawn streams at low elevation is B2 sin(el)^(1 - b) times that of a beam of D sin(el) / h."""
    n_draw = 600
    fine = {"numerics__interpolation": "cubic", "numerics__screen_step": 0.5, "scan__scans": 1}
    scene = scene_of(fixed_pointing__elevation=elevation, atmosphere__layer_height=height, **fine)
    setup, air = prepare(scene), scene.atmosphere
    sine = math.sin(scene.fixed_pointing.elevation_rad)
    weather = Weather(280.0, 5 * ARCMIN, 0.3, math.nan)
    data = np.array([layer_alone(setup, 0, weather, None, k)[:, 0] for k in range(n_draw)], float)
    place = np.stack([setup.camera.focal_plane.x_rad, setup.camera.focal_plane.y_rad], axis=1)
    apart = np.linalg.norm(place[:, None] - place, axis=-1)
    seen = Screen(air.spectral_index, air.illuminated_aperture_m / air.layer_height_m * sine)
    found = np.square(data[:, :, None] - data[:, None]).mean(axis=0)
    expected = 280 * sine ** (1 - air.spectral_index) * structure_function(seen, apart)
    far = apart > 1e-9
    # Pairs share detectors and the gradient: as one value, with the scatter of a square.
    ratio = found[far] / expected[far]
    assert ratio.mean() == pytest.approx(1, abs=4 * math.sqrt(2 / n_draw))
    np.testing.assert_allclose(ratio, 1.0, atol=5 * math.sqrt(2 / n_draw))
    # The contrast of three detectors on a line is all the beam's: a wider beam would leave far less.
    others = [(a, b, c) for a in range(7) for b in range(7) for c in range(7)]
    a, b, c = next(t for t in others if len(set(t)) == 3 and np.allclose(place[t[0]] + place[t[2]], 2 * place[t[1]]))
    contrast = np.zeros(len(place))
    contrast[[a, b, c]] = 1, -2, 1
    left = np.square(data @ contrast).mean() / (280 * sine ** (1 - air.spectral_index))
    assert left == pytest.approx(-0.5 * contrast @ structure_function(seen, apart) @ contrast, rel=0.25)
    overhead = Screen(air.spectral_index, air.illuminated_aperture_m / air.layer_height_m)
    assert left > 1.3 * -0.5 * contrast @ structure_function(overhead, apart) @ contrast


def test_blocks_share_an_observation_s_trends(scene_of):
    """Two blocks and one: other draws within the scans, nearly the same slopes, of which trends are the most."""
    whole = prepare(scene_of(scan__scans=8))
    parts = prepare(scene_of(scan__scans=8, numerics__max_block_memory="18 kB"))
    assert len(whole.observing.blocks) == 1 and len(parts.observing.blocks) == 2
    one = layer_alone(whole)
    two = np.concatenate([layer_alone(parts, block=block) for block in parts.observing.blocks], axis=1)
    slopes_of = []
    for data in (one, two):
        scans = data.mean(axis=0).reshape(8, -1)
        time = np.arange(scans.shape[1]) - (scans.shape[1] - 1) / 2
        slopes_of.append(scans @ time)
    assert np.corrcoef(*slopes_of)[0, 1] > 0.99 and not np.array_equal(one, two)
    assert not np.allclose(layer_alone(whole, realization=1), one)
