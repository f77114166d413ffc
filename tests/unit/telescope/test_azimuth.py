"""Azimuth scans against their definition: elevation, sweeps, drift of the field, speed on the sky, hits, extent."""

import numpy as np
import pytest

from mapmaker.geometry import boresight_pixels, pixel_indices
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.telescope.directions import FieldCentre, Site
from surveysim.telescope.horizon_frame import HorizonFrame, to_horizon
from surveysim.telescope.patterns.azimuth import AzimuthSweeps, azimuth_extent, azimuth_path
from surveysim.telescope.pointing import SIDEREAL_RAD_S
from surveysim.telescope.scans import duration_s
from surveysim.telescope.turnarounds import Turnaround
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.simulation import observation_path
from tests.scenes import SCHEDULE, WHITE_NOISE_SCENE, with_scan, without_sections

DEG = np.pi / 180
FIELD = FieldCentre(132.3 * DEG, 40 * DEG)
SITE = Site(19.8 * DEG, -155.5 * DEG, 4070.0)
RISING = HorizonFrame(FIELD, SITE, 52963.45)
NO_DITHER = np.zeros(2)
KEYS = """pattern = "azimuth"
speed = "6 arcmin / s"
throw = "48 arcmin"
scans = 24
acceleration = "6 arcmin / s2"
dither = "2 arcmin"
sample_rate = "10 Hz"
"""


def sweeps(**changed):
    values = {"speed_rad_s": DEG, "fastest_rad_s": DEG, "sweep_rad_s": DEG, "n_scans": 21, "scan_s": 10.0}
    values |= {"turnaround_s": 3.0, "dither_rad": 0.0, "sample_rate_hz": 20.0, "in_azimuth": False, "turning": None}
    return AzimuthSweeps(**values | changed)


@pytest.mark.parametrize("in_azimuth", [True, False])
@pytest.mark.parametrize("turning", [None, Turnaround(2.0, 0.5)])
def test_sweeps_are_in_azimuth_at_one_elevation(in_azimuth, turning):
    """A triangle wave about the azimuth, and at the elevation, of the dithered centre at the middle."""
    scans, dither = sweeps(in_azimuth=in_azimuth, turning=turning), np.array([0.01, -0.02])
    path = azimuth_path(scans, 0, dither, RISING)
    azimuth, elevation, _ = to_horizon(RISING, path.time_s, path.xi_rad, path.eta_rad)
    middle = to_horizon(RISING, np.array([duration_s(scans) / 2]), dither[:1], dither[1:])
    np.testing.assert_allclose(elevation, middle[1][0], rtol=0, atol=1e-8)  # as directions come back from the plane
    speed = DEG if in_azimuth else DEG / np.cos(middle[1][0])
    offset = (azimuth - middle[0][0]).reshape(21, -1) * (1 - 2 * (np.arange(21) % 2))[:, None]
    time = (np.arange(200) + 0.5) / 20 - 5
    sweep = np.abs(time) < (5.0 if turning is None else 4.0)
    np.testing.assert_allclose(offset[:, sweep], np.tile(speed * time[sweep], (21, 1)), rtol=0, atol=3e-8)
    assert (path.flagged is None) == (turning is None)
    if turning:
        np.testing.assert_array_equal(path.flagged.reshape(21, -1), np.tile(~sweep, (21, 1)))


def test_the_field_drifts_through():
    """There and back the boresight moves east on the sky at the sidereal rate, to the order of the short throw."""
    scans = sweeps(sweep_rad_s=0.01 * DEG, speed_rad_s=0.01 * DEG)
    path = azimuth_path(scans, 0, NO_DITHER, RISING)
    by_scan = np.stack([path.xi_rad, path.eta_rad]).reshape(2, 21, -1).mean(axis=2)
    drift = SIDEREAL_RAD_S * np.cos(FIELD.dec_rad)
    np.testing.assert_allclose(np.diff(by_scan[0]) / 13.0, drift, rtol=2e-3)  # precession, and the plane's stretch
    np.testing.assert_allclose(by_scan[:, 10], 0, atol=1e-8 + drift * 1e-4)
    # Small parallels curve: (drift of an observation)^2 tan(dec) / 2.
    assert np.abs(by_scan[1]).max() < (drift * duration_s(scans) / 2) ** 2 + drift * duration_s(scans) * 3e-3


def test_velocities_on_the_sky_are_across_the_vertical():
    """Short throws: the speed along the horizon, and the drift; mean velocities are those of the samples."""
    scans = sweeps(sweep_rad_s=0.1 * DEG, speed_rad_s=0.1 * DEG)
    path = azimuth_path(scans, 0, NO_DITHER, RISING)
    _, _, vertical = to_horizon(RISING, path.mid_time_s, *np.zeros((2, 21)))
    there = 1 - 2 * (np.arange(21) % 2)
    # Azimuths increase clockwise of the vertical, position angles counter-clockwise.
    expected = 0.1 * DEG * there * np.array([-np.cos(vertical), np.sin(vertical)])
    expected[0] += SIDEREAL_RAD_S * np.cos(FIELD.dec_rad)
    # The vertical turns by some 1e-3 over the drift within an observation.
    np.testing.assert_allclose(path.velocity_rad_s.T, expected, rtol=0, atol=2e-3 * 0.1 * DEG)
    samples = np.stack([path.xi_rad, path.eta_rad]).reshape(2, 21, -1)
    slope = (samples[:, :, -1] - samples[:, :, 0]) / (199 / 20)
    np.testing.assert_allclose(path.velocity_rad_s.T, slope, rtol=0, atol=1e-4 * 0.1 * DEG)


def test_the_extent_holds_rising_and_setting_scans():
    for in_azimuth in (True, False):
        scans = sweeps(in_azimuth=in_azimuth, scan_s=14.0, n_scans=200, turning=Turnaround(4.0, 1.0))
        for start in (52963.40, 52963.50, 52963.60, 52963.66):
            path = azimuth_path(scans, 0, NO_DITHER, HorizonFrame(FIELD, SITE, start))
            _, elevation, _ = to_horizon(HorizonFrame(FIELD, SITE, start), path.time_s, path.xi_rad, path.eta_rad)
            reach = max(np.abs(path.xi_rad).max(), np.abs(path.eta_rad).max())
            assert reach <= azimuth_extent(scans, elevation.min())
    assert azimuth_extent(scans, 0.5) < 2 * reach


def test_hits_of_the_boresight_are_uniform_where_the_field_drifts_through():
    """Density in closed form: samples a length along a sweep, over the distance between sweeps across it."""
    scans = sweeps(sweep_rad_s=0.2 * DEG, speed_rad_s=0.2 * DEG, n_scans=100, sample_rate_hz=100.0)
    path = azimuth_path(scans, 0, NO_DITHER, RISING)
    _, _, vertical = to_horizon(RISING, np.array([duration_s(scans) / 2]), np.zeros(1), np.zeros(1))
    # Along a sweep, and across it: the drift is along xi. The vertical turns while the field drifts.
    across = SIDEREAL_RAD_S * np.cos(FIELD.dec_rad) * abs(np.sin(vertical[0]))
    density = 100.0 / (0.2 * DEG * across * 13.0)
    cos, sin = np.cos(vertical[0]), np.sin(vertical[0])
    along = -path.xi_rad * cos + path.eta_rad * sin
    over = path.xi_rad * sin + path.eta_rad * cos
    half = across * duration_s(scans) / 2
    hits, x, y = np.histogram2d(along, over, (6, 6), ((-0.6 * DEG, 0.6 * DEG), (-0.6 * half, 0.6 * half)))
    expected = density * (x[1] - x[0]) * (y[1] - y[0])
    assert hits.mean() == pytest.approx(expected, rel=0.005)
    np.testing.assert_allclose(hits, expected, rtol=0.01)
    # Sweeps end at half a throw, 1 degree, on lines that turn.
    assert np.abs(along).max() == pytest.approx(DEG, rel=0.05)


@pytest.fixture
def scene_of(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(without_sections(with_scan(WHITE_NOISE_SCENE, KEYS), "fixed_pointing") + SCHEDULE)
    return lambda **keys: load_scene(path, {f"scan.{name}": value for name, value in keys.items()})


def test_hits_are_uniform_along_the_sweeps_and_widen_by_the_drift(scene_of):
    """Hits against the definition: each instant's offset along the horizon is uniform in the throw."""
    setup = prepare(scene_of(dither="0 deg", turnarounds="flagged"))
    _, pointing = observation_path(setup.observing, 1)
    hits = observe(setup, 1, False).hits[0]
    kept = ~pointing.flagged
    assert hits.sum() == setup.camera.n_det * kept.sum()
    azimuth = pointing.azimuth_rad[kept] - pointing.azimuth_rad.mean()
    along = azimuth * np.cos(pointing.elevation_rad[kept])
    half = 24 / 60 * DEG
    counts, _ = np.histogram(along, bins=8, range=(-half, half))
    assert counts.sum() == kept.sum() and np.ptp(counts) <= 2 * setup.observing.scans.n_scans
    # Turnarounds: 2 v / a = 2 s beside sweeps of 8 s.
    assert np.mean(pointing.flagged) == pytest.approx(0.2)


def test_saved_streams_are_mapped_as_simulated_ones(scene_of):
    """From the boresight and the position angle of a file alone; samples in turnarounds are off the map."""
    setup = prepare(scene_of(turnarounds="flagged"))
    _, pointing = observation_path(setup.observing, 2)
    at = pointing.xi_rad, pointing.eta_rad, pointing.array_angle_rad
    expected = boresight_pixels(setup.analysis.geometry, *at, plane=setup.camera.focal_plane)
    assert (expected >= 0).all()
    expected[:, pointing.flagged] = -1
    np.testing.assert_array_equal(pixel_indices(setup.analysis.geometry, draw_observation(setup, 2)), expected)


def test_observations_of_a_night_have_centres_of_their_own(scene_of):
    """Elevations follow the schedule; each observation's array angle turns with the vertical."""
    setup = prepare(scene_of())
    pointings = [observation_path(setup.observing, number)[1] for number in range(4)]
    elevations = [item.elevation_rad.mean() for item in pointings]
    assert np.ptp(elevations) > 0.1
    for item in pointings:
        assert np.ptp(item.elevation_rad) < 1e-8
        middle = item.scan_elevation_rad[11:13].mean()
        # The dither is 1 arcmin at most.
        assert item.elevation_rad[0] == pytest.approx(middle, abs=np.hypot(1, 1) / 60 * DEG)
        turn = item.array_angle_rad - item.camera_angle_rad
        assert np.ptp(turn) > 1e-3


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"throw": "170 deg", "speed": "20 deg / s"}, "scan: found a map that reaches"),
        ({"scans": 20_000}, "scan: found a map that reaches 90 or more deg from its centre"),
        ({"turnaround": "1 s"}, "exactly one of 'turnaround' and 'acceleration'"),
    ],
)
def test_azimuth_scans_that_are_refused(scene_of, keys, message):
    with pytest.raises(SceneError, match=message):
        prepare(scene_of(**keys))


def test_sweeps_about_the_zenith_are_refused(scene_of):
    scene = scene_of(throw="5 deg", speed="1 deg / s")
    near = {"dec_rad": 19.9 * DEG}
    # The one observation is at transit.
    scene = scene.model_copy(update={"field": scene.field.model_copy(update=near), "observations": 1})
    with pytest.raises(SceneError, match="^scan.throw: found sweeps of .* deg in azimuth .* 180 deg or less"):
        prepare(scene)


def test_azimuth_scans_need_a_schedule(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(with_scan(WHITE_NOISE_SCENE, KEYS))
    with pytest.raises(SceneError, match="scan.pattern: found 'azimuth' with .fixed_pointing."):
        load_scene(path)
