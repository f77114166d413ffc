"""Daisy scans: the published curve, its chunks, speeds, and a survey of white noise."""

import numpy as np
import pytest

from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.scene.scan_patterns import DaisyScan
from surveysim.scene.scene import load_scene
from surveysim.telescope.patterns.daisy import daisy_path, scene_daisy
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
    return daisy_path(setup.observing.scans, 0, np.array([0.5, -0.25]) * ARCMIN, None)


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


@pytest.mark.parametrize("rotation", [None, "3 s", "1 hour"])
def test_mean_and_largest_speed(rotation):
    """Of slopes on a fine grid over many periods."""
    keys = {"radius": "4 arcmin", "radial_period": "7 s", "duration": "2 hour", "chunk": "2 hour", "dither": "0 deg"}
    section = DaisyScan.model_validate(
        {"pattern": "daisy", **keys, "sample_rate": "1 Hz", **({"rotation_period": rotation} if rotation else {})}
    )
    step_s = 0.001
    x, y = scene_daisy(section).offsets(np.arange(0, 4200, step_s))
    speed = np.hypot(np.diff(x), np.diff(y)) / step_s
    assert section.speed_rad_s == pytest.approx(speed.mean(), rel=1e-4)
    assert section.fastest_rad_s == pytest.approx(speed.max(), rel=1e-4)


def test_a_survey_has_every_sample_on_its_map(setup):
    hits = observe(setup, 0, False).hits[0]
    assert hits.sum() == setup.camera.n_det * 2200
    geometry = setup.analysis.geometry
    half_rad = geometry.n_x * geometry.pixel_rad / 2
    assert half_rad - 2 * geometry.pixel_rad <= 4 * ARCMIN + setup.camera.radius_rad <= half_rad
