"""The list of scan patterns: observations, maps and forecasts follow the row alone."""

from dataclasses import replace

import numpy as np
import pytest

from surveysim.forecasting.forecast import why_no_forecast
from surveysim.reduction import setup as preparation
from surveysim.reduction.observation import observe
from surveysim.scene.scene import load_scene
from surveysim.telescope import scan_pattern
from surveysim.telescope.scan_pattern import SCAN_PATTERNS
from surveysim.telescope.scans import ScanPath, mid_times, samples_per_scan
from surveysim.timestreams.simulation import observation_path
from tests.scenes import WHITE_NOISE_SCENE


def circle(scans, observation, dither, frame):
    """One turn a scan at the speed of the scans."""
    n = samples_per_scan(scans)
    time_s = (mid_times(scans)[:, None] + (np.arange(n) + 0.5 - n / 2) / scans.sample_rate_hz).ravel()
    phase = np.tile(2 * np.pi * np.arange(n) / n, scans.n_scans)
    radius = scans.speed_rad_s * scans.scan_s / (2 * np.pi)
    scan = np.repeat(np.arange(scans.n_scans), n)
    xi, eta = radius * np.cos(phase) + dither[0], radius * np.sin(phase) + dither[1]
    return ScanPath(time_s, xi, eta, scan, np.zeros((scans.n_scans, 2)), mid_times(scans), straight=False)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(WHITE_NOISE_SCENE)
    return load_scene(path)


def test_a_pattern_is_observed_mapped_and_forecast_by_its_row_alone(scene, monkeypatch):
    raster = preparation.prepare(scene)
    row = replace(
        SCAN_PATTERNS[0],
        name="circle",
        path=circle,
        extent_rad=lambda scans, lowest_rad: scans.speed_rad_s * scans.scan_s / (2 * np.pi),
    )
    monkeypatch.setattr(scan_pattern, "SCAN_PATTERNS", (row,))
    preparation.prepare.cache_clear()
    setup = preparation.prepare(scene)
    preparation.prepare.cache_clear()
    path, pointing = observation_path(setup.observing, 1)
    radius = np.hypot(pointing.xi_rad - path.xi_rad.mean(), pointing.eta_rad - path.eta_rad.mean())
    np.testing.assert_allclose(radius, row.extent_rad(setup.observing.scans, 0.5))
    assert setup.analysis.geometry.n_x < raster.analysis.geometry.n_x
    hits = observe(setup, 1, False).hits[0]
    assert hits.sum() == setup.camera.n_det * len(path.time_s)
    assert why_no_forecast(raster) is None and why_no_forecast(setup) is None
