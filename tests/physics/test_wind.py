"""Wind measured on simulated observations against the wind that was drawn for them.

Tolerances: 3 standard errors of a median or of a 68 % quantile, both taken as 1.25 sigma / sqrt(n) for n
observations; for 68 % quantiles of normal deviates the factor is 1.0 to 1.3.
"""

import math
from pathlib import Path

import numpy as np
import pytest

import surveysim
from mapmaker.geometry import sky_offsets
from mapmaker.wind import measure_wind, scan_velocities
from surveysim.atmosphere.screen_simulation import add_atmosphere
from surveysim.reduction.setup import prepare
from surveysim.runtime.rng import RandomPurpose, normal_deviates
from surveysim.telescope.pointing import sky_vector
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.simulation import observation_path

SCENARIOS = Path(__file__).parents[2] / "scenarios"
ARCMIN = math.radians(1 / 60)
RATE = 10.0


def quantile_error(n):
    return 1.25 / math.sqrt(n)


def half_width(values):
    return np.quantile(np.abs(values), 0.68)


def scene(name):
    return surveysim.load_scene(SCENARIOS / f"{name}.toml", {"observations": 200})


def to_array(angle_rad, xi, eta):
    """The inverse of `sky_vector`, as a complex number x + i y."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return (-xi * cos + eta * sin) + 1j * (xi * sin + eta * cos)


def measured(name, n):
    """Fits of n observations, and for each (n,) the wind drawn in the array frame, complex [rad/s], and B2."""
    setup = prepare(scene(name))
    fits, truth, b2 = [], np.empty(n, complex), np.empty(n)
    for i in range(n):
        streams = draw_observation(setup, i)
        fits.append(
            measure_wind(
                streams.data_mk,
                streams.scan_bounds,
                streams.focal_plane,
                sample_rate_hz=RATE,
                scan_velocity_rad_s=scan_velocities(streams),
            )
        )
        _, pointing = observation_path(setup.observing, i)
        angle = math.radians(streams.attributes["wind_angle_deg"])
        drawn = streams.attributes["wind_speed_arcmin_s"] * ARCMIN * np.array([math.cos(angle), math.sin(angle)])
        sky = sky_vector(pointing.scan_parallactic_rad[0], *drawn)
        truth[i] = to_array(pointing.scan_array_angle_rad[0], *sky)
        b2[i] = streams.attributes["b2_mk2"]
    return fits, truth, b2


def test_scan_velocities_are_those_of_the_raster():
    setup = prepare(scene("lynx"))
    for observation in (0, 1):
        _, pointing = observation_path(setup.observing, observation)
        found = scan_velocities(draw_observation(setup, observation)) @ [1, 1j]
        middle = pointing.array_angle_rad.reshape(len(pointing.velocity_rad_s), -1)[:, 75]
        expected = to_array(middle, *pointing.velocity_rad_s.T)
        assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "median", "least_good"), [("lynx", 31.0, 0.45), ("cosmos", 35.0, 0.65)])
def test_drawn_winds_come_back(name, median, least_good):
    fits, truth, b2 = measured(name, 100)
    good = np.array([fit.flag == "" for fit in fits])
    n = good.sum()
    # 60 % and 80 % of 200 observations; 3 standard errors of a share of 100 are 0.15.
    assert n / len(fits) > least_good
    ratio = (np.array([fit.velocity_rad_s @ [1, 1j] for fit in fits]) / truth)[good]
    speed, angle = np.abs(ratio) - 1, np.angle(ratio)
    width = half_width(speed)
    assert width < 0.10
    assert abs(np.median(speed)) < 0.02
    # In good weather and poor: excess noise that neighbours share without a delay would pull delays to zero.
    poor = b2[good] > np.median(b2[good])
    for part in (speed, speed[poor], speed[~poor]):
        assert abs(np.median(part)) < 3 * quantile_error(part.size) * half_width(part)
    assert np.median(np.abs(angle)) < math.radians(5)
    assert abs(np.median(angle)) < 3 * quantile_error(n) * half_width(angle)
    for off, error in (
        (speed, [fit.speed_error_rad_s / fit.speed_rad_s for fit in fits]),
        (angle, [fit.angle_error_rad for fit in fits]),
    ):
        # 3 standard errors of the quantile, and as much again because a jackknife of 9 scans knows an error to 25 %.
        assert half_width(off / np.array(error)[good]) == pytest.approx(1, abs=6 * quantile_error(n))
    # The scene's median, as far as a log-normal scatter of 0.4 lets a sample know it.
    found = np.median([fit.speed_rad_s for fit in np.array(fits)[good]])
    assert math.log(found / (median * ARCMIN)) == pytest.approx(0, abs=3 * 0.4 * quantile_error(n))


def layers(winds, n, b2, noise=True):
    """Fits of n observations of Lynx through layers of given (speed [arcmin/s], angle [deg]), one strength each."""
    full = scene("lynx")
    excess = full.excess.model_copy(update={"b2": (1.0,), "variance_mk2": (6.0,)})
    without = full.cleaning.model_copy(update={"algorithm": ("none",)})
    still = prepare(full.model_copy(update={"atmosphere": None, "score": None, "cleaning": without, "excess": excess}))
    strips = prepare(full).air.layers[0].strips
    fits = []
    for i in range(n):
        streams = draw_observation(still, i)
        _, pointing = observation_path(still.observing, i)
        data = streams.data_mk if noise else np.zeros_like(streams.data_mk)
        sine = np.sin(pointing.scan_elevation_rad)[:, None]
        offsets = (
            np.stack(sky_offsets(still.camera.focal_plane, pointing.scan_array_angle_rad), axis=-1) / sine[:, None]
        )
        for number, (speed, angle) in enumerate(winds):
            # Turned from one observation to the next, so that scans lie at all angles to the winds.
            turned = math.radians(angle + 37 * i)
            moving = speed * ARCMIN * math.cos(turned), speed * ARCMIN * math.sin(turned)
            layer = np.stack(sky_vector(pointing.scan_parallactic_rad, *moving), axis=-1) / sine
            amplitude = np.sqrt(b2 / sine[:, 0])
            bounds, scan = streams.scan_bounds, pointing.velocity_rad_s / sine
            add_atmosphere(
                data,
                bounds,
                sample_rate_hz=RATE,
                offsets_rad=offsets,
                velocity_rad_s=scan,
                layer_velocity_rad_s=layer,
                amplitude_mk=amplitude,
                strips=strips.at(sine.min()),
                deviates=normal_deviates(full.seed, RandomPurpose.ATMOSPHERE, i, realization=number),
            )
        velocity = scan_velocities(streams)
        fits.append(
            measure_wind(
                data, streams.scan_bounds, streams.focal_plane, sample_rate_hz=RATE, scan_velocity_rad_s=velocity
            )
        )
    return fits


def flags(fits):
    return [fit.flag for fit in fits]


def test_one_layer_is_not_flagged():
    found = flags(layers([(31, 0)], 20, b2=1000))
    assert found.count("") >= 17


@pytest.mark.slow
def test_two_layers_are_flagged():
    """Equal layers at 31 arcmin/s with 120 degrees between them: their mean delay is that of 62 arcmin/s."""
    assert flags(layers([(31, 0), (31, 120)], 20, b2=1000)).count("") <= 1


@pytest.mark.slow
def test_opposite_layers_are_flagged():
    assert "" not in flags(layers([(31, 0), (31, 180)], 10, b2=1000))


@pytest.mark.parametrize(
    "speed", [0, pytest.param(2, marks=pytest.mark.slow), pytest.param(4, marks=pytest.mark.slow), 6]
)
def test_wind_near_or_below_the_scan_speed_is_flagged(speed):
    """In typical weather so slow a layer is hardly seen at all; in the poorest it is, and told to be too slow."""
    for b2 in (1000, 1e5):
        assert "" not in flags(layers([(speed, 0)], 10, b2=b2))


def test_noise_without_a_layer_has_no_wind():
    assert set(flags(layers([], 10, b2=0))) == {"no coherent delay"}


@pytest.mark.slow
def test_quiet_layer_is_measured_to_a_percent():
    """Without noise the speed is the flow's alone: only the layer's gradients across the wind remain, for the angle."""
    fits = layers([(31, 0)], 20, b2=1000, noise=False)
    speed = np.array([fit.speed_rad_s for fit in fits]) / (31 * ARCMIN) - 1
    assert half_width(speed) < 0.01
    assert abs(np.median(speed)) < 0.004
