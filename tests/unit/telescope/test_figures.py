"""Daisy, Lissajous figure and pong: published curves, speeds, chunks, frames, and a survey of white noise."""

import numpy as np
import pytest

from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scan_figures import DaisyScan, LissajousScan, PongScan
from surveysim.scene.scene import load_scene
from surveysim.telescope.directions import FieldCentre, Site
from surveysim.telescope.horizon_frame import HorizonFrame, to_horizon
from surveysim.telescope.patterns.figures import figure_extent, figure_path
from surveysim.telescope.scan_pattern import scan_pattern
from surveysim.telescope.scans import samples_per_scan
from tests.scenes import WHITE_NOISE_SCENE, with_scan

DAISY = """\
pattern = "daisy"
radius = "4 arcmin"
radial_period = "7 s"
duration = "2 min"
chunk = "11 s"
dither = "0 arcmin"
sample_rate = "20 Hz"
"""
ARCMIN = np.pi / 180 / 60


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    path = tmp_path_factory.mktemp("daisy") / "daisy.toml"
    path.write_text(with_scan(WHITE_NOISE_SCENE, DAISY))
    return prepare(load_scene(path))


@pytest.fixture(scope="module")
def path(setup):
    return figure_path(setup.observing.scans, 0, np.array([0.5, -0.25]) * ARCMIN, None)


def test_chunks_are_contiguous_scans(setup, path):
    scans = setup.observing.scans
    assert (scans.n_scans, scans.scan_s, scans.turnaround_s) == (10, 11, 0)
    assert np.bincount(path.scan).tolist() == [220] * 10 and samples_per_scan(scans) == 220
    np.testing.assert_allclose(np.diff(path.time_s), 0.05)


def test_boresight_follows_the_published_curve(path):
    """Radius and angle, each from its own period: pi times the radial one for the angle."""
    xi, eta = path.xi_rad - 0.5 * ARCMIN, path.eta_rad + 0.25 * ARCMIN
    radius = 4 * ARCMIN * np.abs(np.sin(2 * np.pi * path.time_s / 7))
    np.testing.assert_allclose(np.hypot(xi, eta), radius, atol=1e-12)
    far = radius > 0.1 * ARCMIN
    diameter = np.exp(2j * np.arctan2(eta, xi))[far]  # an angle modulo pi
    np.testing.assert_allclose(diameter, np.exp(4j * path.time_s / 7)[far], atol=1e-9)


def test_velocity_of_a_chunk_is_its_displacement(path):
    """The mean of the slopes of the samples is that of the chunk but for half a sample at each end."""
    for number in range(10):
        xi = path.xi_rad[path.scan == number]
        slope = (xi[-1] - xi[0]) / (219 * 0.05)
        # Both ends move by less than half a sample at the largest speed.
        assert abs(path.velocity_rad_s[number, 0] - slope) < 2 * 0.025 * 8 * np.pi / 7 * ARCMIN / 11 * 1.01


COMMON = {"duration": "2 hour", "chunk": "2 hour", "dither": "0 deg", "sample_rate": "1 Hz"}


def figure(section):
    return scan_pattern(section).scans(section, FieldCentre(0.0, 0.0), None)


def daisy(**keys):
    return DaisyScan.model_validate(
        {"pattern": "daisy", "radius": "4 arcmin", "radial_period": "7 s", **COMMON, **keys}
    )


def lissajous(**keys):
    size = {"amplitude_x": "5 arcmin", "amplitude_y": "3 arcmin", "period_x": "11 s", "period_y": "7.3 s"}
    return LissajousScan.model_validate({"pattern": "lissajous", **size, **COMMON, **keys})


def pong(**keys):
    size = {"width": "18 arcmin", "height": "14 arcmin", "spacing": "1 arcmin", "velocity": "2 arcmin / s", "terms": 5}
    return PongScan.model_validate({"pattern": "pong", **size, **COMMON, **keys})


@pytest.mark.parametrize(
    "section, mean, most",
    [
        (daisy(), 1e-4, 1e-4),
        (daisy(rotation_period="3 s"), 1e-4, 1e-4),
        (daisy(rotation_period="1 hour"), 1e-4, 1e-4),
        (lissajous(), 2e-3, 1e-3),
        (pong(), 5e-3, 1e-2),
        (pong(terms=1), 5e-3, 1e-3),
    ],
)
def test_mean_and_largest_speed(section, mean, most):
    """Of slopes on a fine grid; figures whose phases fill all pairs only in the long run are less close."""
    step_s = 0.01
    x, y = figure(section).curve(np.arange(0, 4200, step_s))
    speed = np.hypot(np.diff(x), np.diff(y)) / step_s
    assert section.speed_rad_s == pytest.approx(speed.mean(), rel=mean)
    assert speed.max() <= section.fastest_rad_s * (1 + 1e-9) <= speed.max() * (1 + most)


def test_lissajous_is_two_sines():
    time_s = np.linspace(0, 100, 1000)
    x, y = figure(lissajous(phase="30 deg")).curve(time_s)
    np.testing.assert_allclose(x, 5 * ARCMIN * np.sin(2 * np.pi * time_s / 11 + np.pi / 6))
    np.testing.assert_allclose(y, 3 * ARCMIN * np.sin(2 * np.pi * time_s / 7.3))


ADDED = {"amplitude_x": "1 arcmin", "amplitude_y": "2 arcmin", "period_x": "30 s", "period_y": "41 s"}


@pytest.mark.parametrize("make, reach", [(daisy, 4 + 2), (lissajous, 5 + 1), (pong, 13 / np.sqrt(2) + 1)])
def test_a_lissajous_figure_is_added_to_a_curve(make, reach):
    """To offsets, extents and speeds; the mean speed is that of slopes, the fastest an upper bound."""
    plain, both = make(), make(lissajous=ADDED)
    time_s = np.arange(0, 7200, 0.05)
    path = figure(both).curve(time_s)
    offsets = figure_path(figure(both), 0, np.zeros(2), None), figure_path(figure(plain), 0, np.zeros(2), None)
    x, y = offsets[0].xi_rad - offsets[1].xi_rad, offsets[0].eta_rad - offsets[1].eta_rad
    np.testing.assert_allclose(x, ARCMIN * np.sin(2 * np.pi * offsets[0].time_s / 30), atol=1e-12)
    np.testing.assert_allclose(y, 2 * ARCMIN * np.sin(2 * np.pi * offsets[0].time_s / 41), atol=1e-12)
    assert figure_extent(figure(both), 0.5) == pytest.approx(reach * ARCMIN)
    path = path + [ARCMIN * np.sin(2 * np.pi * time_s / 30), 2 * ARCMIN * np.sin(2 * np.pi * time_s / 41)]
    speed = np.hypot(*np.diff(path)) / 0.05
    assert both.speed_rad_s == pytest.approx(speed.mean(), rel=5e-3)
    assert 0.95 * both.fastest_rad_s < speed.max() <= both.fastest_rad_s


def test_pong_bounces_on_all_vertices_before_it_closes():
    """Boxes of 13 by 10 vertices, sqrt(2) spacings apart; with many terms the speed is that of the lines."""
    section = pong(terms=100)
    assert section.vertices == (13, 10)
    step = np.sqrt(2) * ARCMIN
    closes_s = 13 * 10 * 2 * np.sqrt(2) * step / (2 * ARCMIN)
    time_s = (np.arange(20_000) + 0.5) / 20_000 * closes_s
    path = figure(section).curve(np.append(time_s, time_s + closes_s))
    np.testing.assert_allclose(path[:, :20_000], path[:, 20_000:], atol=1e-12)
    x, y = path[:, :20_000]
    # On the lower side of the box the track bounces at 13 places, evenly sqrt(2) spacings apart.
    low = y < -5 * step + 0.05 * ARCMIN
    place = np.unique(np.round((x[low] / step + 6.5) * 2).astype(int))
    assert len(place) == 13 and set(np.diff(place)) == {2}
    speed = np.hypot(np.diff(x), np.diff(y)) / np.diff(time_s)
    assert np.median(speed) == pytest.approx(2 * ARCMIN, rel=0.01)


@pytest.mark.parametrize("width, height, found", [(10, 10, (8, 9)), (5, 14.2, (4, 11)), (12, 4.3, (9, 4))])
def test_vertices_are_coprime_and_one_is_even(width, height, found):
    """Of numbers 8 and 8, 4 and 11, 9 and 4 that fit the box."""
    assert pong(width=f"{width} arcmin", height=f"{height} arcmin").vertices == found


def test_pattern_turns_from_x_to_y_and_further_in_each_observation():
    straight, turned = figure(lissajous()), figure(lissajous(angle="20 deg", angle_step="5 deg"))
    start = [figure_path(item, 3, np.zeros(2), None) for item in (straight, turned)]
    x, y = (start[0].xi_rad, start[0].eta_rad)
    cos, sin = np.cos(np.radians(35)), np.sin(np.radians(35))
    np.testing.assert_allclose(start[1].xi_rad, x * cos - y * sin, atol=1e-15)
    np.testing.assert_allclose(start[1].eta_rad, x * sin + y * cos, atol=1e-15)
    np.testing.assert_allclose(figure_extent(turned, 0.5), np.hypot(5, 3) * ARCMIN)
    np.testing.assert_allclose(figure_extent(straight, 0.5), 5 * ARCMIN)
    np.testing.assert_allclose(figure_extent(figure(lissajous(angle="90 deg")), 0.5), 5 * ARCMIN)
    np.testing.assert_allclose(figure_extent(figure(lissajous(angle="45 deg")), 0.5), 8 / np.sqrt(2) * ARCMIN)


def test_pattern_of_the_horizon_keeps_its_axes_along_azimuth_and_elevation():
    """Offsets from the centre, by the chain of directions: az cos(el) and el, up to second order in the offset."""
    frame = HorizonFrame(FieldCentre(2.3, 0.2), Site(np.radians(19.8), np.radians(-155.5), 4070.0), 52968.5)
    path = figure_path(figure(lissajous(frame="horizon", sample_rate="0.2 Hz")), 0, np.zeros(2), frame)
    azimuth, elevation, _ = to_horizon(frame, path.time_s, path.xi_rad, path.eta_rad)
    centre = to_horizon(frame, path.time_s, 0 * path.xi_rad, 0 * path.xi_rad)
    x = (azimuth - centre[0] + np.pi) % (2 * np.pi) - np.pi
    steepest = np.tan(elevation.max())
    expected = figure(lissajous()).curve(path.time_s)
    # Second order: offsets of 5 arcmin times themselves and the tangent of the elevation.
    np.testing.assert_allclose(x * np.cos(centre[1]), expected[0], atol=(5 * ARCMIN) ** 2 * steepest)
    np.testing.assert_allclose(elevation - centre[1], expected[1], atol=(5 * ARCMIN) ** 2 * steepest)
    assert np.ptp(centre[2]) > 0.1


def test_pattern_of_the_horizon_needs_a_schedule(tmp_path):
    path = tmp_path / "daisy.toml"
    path.write_text(with_scan(WHITE_NOISE_SCENE, f'{DAISY}frame = "horizon"'))
    with pytest.raises(
        SceneError, match=r"scan.frame: found 'horizon' with \[fixed_pointing\]; a section \[schedule\] is"
    ):
        load_scene(path)


def test_a_survey_has_every_sample_on_its_map(setup):
    hits = observe(setup, 0, False).hits[0]
    assert hits.sum() == setup.camera.n_det * 2200
    geometry = setup.analysis.geometry
    half_rad = geometry.n_x * geometry.pixel_rad / 2
    assert half_rad - 2 * geometry.pixel_rad <= 4 * ARCMIN + setup.camera.radius_rad <= half_rad
