"""Pointing of simulated detectors on the sky; scans and sources beyond the tangent plane."""

import math

import numpy as np
import pytest

from mapmaker.geometry import boresight_pixels, pixel_indices
from mapmaker.wind import scan_velocities
from surveysim.reduction.motion_checks import MAX_AIRMASS_CHANGE, MAX_TURN_RAD
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.telescope.pointing import SIDEREAL_RAD_S
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.simulation import observation_path
from surveysim.timestreams.sky_maps import add_point_sources
from tests.scenes import SCHEDULE, SMALL_SCENE, without_sections, write_scene

LATITUDE = math.radians(19.8)


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


@pytest.fixture
def dated(tmp_path):
    """The small scene without sky and score, under a schedule."""
    file = tmp_path / "dated.toml"
    file.write_text(without_sections(SMALL_SCENE, "fixed_pointing", "sky", "score") + SCHEDULE)
    return file


@pytest.mark.parametrize("dec_deg", [0, 45, 89, -89])
def test_saved_streams_say_where_simulated_detectors_look(path, dec_deg):
    """`mapmaker` finds each sample in the pixel that it was simulated in, from boresight and position angle alone."""
    setup = prepare(load_scene(path, {"field.ra": "359.99 deg", "field.dec": f"{dec_deg} deg", "sky": None}))
    _, pointing = observation_path(setup.observing, 1)
    streams = draw_observation(setup, 1)
    angle, plane = pointing.array_angle_rad, setup.camera.focal_plane
    expected = boresight_pixels(setup.analysis.geometry, pointing.xi_rad, pointing.eta_rad, angle, plane=plane)
    found = pixel_indices(setup.analysis.geometry, streams)
    # Rounding, 1e-15 rad, takes one in 10^11 samples to another pixel.
    np.testing.assert_array_equal(found, expected)
    turned = np.abs(streams.array_angle_rad - angle).max()
    # Meridians converge by xi tan(dec), and towards the pole by more.
    converged = np.abs(pointing.xi_rad * np.tan(setup.analysis.geometry.dec0_rad)).max()
    assert turned == 0 if dec_deg == 0 else turned > 0.9 * converged


@pytest.mark.parametrize("dec_deg", [0, 45, 89, -89])
def test_scan_velocities_of_saved_streams(path, dec_deg):
    """In the array's frame, from boresight and position angles alone; planes about two centres differ by 1e-5 here."""
    setup = prepare(load_scene(path, {"field.ra": "359.99 deg", "field.dec": f"{dec_deg} deg", "sky": None}))
    _, pointing = observation_path(setup.observing, 1)
    (xi, eta), angle = pointing.velocity_rad_s.T, pointing.scan_array_angle_rad
    expected = -xi * np.cos(angle) + eta * np.sin(angle), xi * np.sin(angle) + eta * np.cos(angle)
    found = scan_velocities(draw_observation(setup, 1)).T
    np.testing.assert_allclose(found, expected, atol=3e-5 * setup.observing.scans.speed_rad_s)


@pytest.mark.parametrize(
    "ra, dec, found",
    [
        ("20h49m12s", "-44d50m24s", "180 deg"),  # the antipode, whose gnomonic offsets are those of the centre
        ("08h49m12s", "-45d09m36s", "90 deg"),
        ("08h49m12s", "+46d50m24s", "2 deg"),
    ],
)
def test_a_source_off_the_map_is_refused(path, ra, dec, found):
    source = {"ra": ra, "dec": dec, "peak": "1000 mK"}
    with pytest.raises(SceneError, match=f"^sky.point_sources.0: found a source {found} from the field's centre"):
        prepare(load_scene(path, {"sky.point_sources": [source]}))


def test_no_sky_has_a_source_behind_its_plane(path):
    setup = prepare(load_scene(path, {}))
    (source,) = setup.scene.sky.point_sources
    behind = source.model_copy(update={"ra_rad": source.ra_rad + math.pi, "dec_rad": -source.dec_rad})
    with pytest.raises(ValueError, match="90 degrees or more from the map's centre"):
        add_point_sources(setup.sky.map_mk[0], setup.sky.geometry, (behind,), 3e-4)


def turn_of_half_a_scan(elevation_rad, dec_rad, duration_s):
    """The parallactic angle's rate, ``w cos(lat) cos(az) / cos(el)``, azimuth from the spherical triangle."""
    rate = (math.sin(dec_rad) - math.sin(LATITUDE) * math.sin(elevation_rad)) / math.cos(elevation_rad) ** 2
    return abs(SIDEREAL_RAD_S * rate) * duration_s / 2


def test_scans_in_which_the_sky_turns_are_refused(dated):
    """From the duration on at which the sky turns by 0.05 in half a scan, as the spherical triangle has it."""
    keys = {"field.dec": "21.8 deg", "observations": 1, "schedule.first_night": "2000-01-01", "scan.scans": 1}
    setup = prepare(load_scene(dated, keys))
    # The one observation is at transit, 2 degrees from the zenith.
    elevation = setup.observing.angles.elevation_rad[0, 0]
    assert elevation == pytest.approx(math.radians(88), abs=math.radians(0.02))
    one_s = turn_of_half_a_scan(elevation, setup.scene.field.dec_rad, 1.0)
    allowed_s = MAX_TURN_RAD / one_s
    # Aberration and nutation move the field by 0.01 degrees of these 2; the rate is that of the middle.
    prepare(load_scene(dated, keys | {"scan.duration": f"{0.98 * allowed_s} s", "scan.speed": "10 arcsec / s"}))
    with pytest.raises(SceneError, match="^scan.duration: found scans of observation 0, at 88.0 deg elevation, during"):
        prepare(load_scene(dated, keys | {"scan.duration": f"{1.02 * allowed_s} s", "scan.speed": "10 arcsec / s"}))


def test_a_scan_through_the_zenith_is_refused(dated):
    keys = {"field.dec": "19.8 deg", "observations": 1, "scan.scans": 1}
    message = "the sky turns by .* deg in half a scan; 2.9 deg or less is expected: shorter scans, or a field"
    with pytest.raises(SceneError, match=message):
        prepare(load_scene(dated, keys))


def test_scans_in_which_the_airmass_changes_are_refused(dated):
    """From ``cot(el) cos(lat) sin(az) w t / 2`` of 2 % on, with the azimuth of the spherical triangle."""
    keys = {"field.dec": "0 deg", "observations": 2, "schedule.max_hour_angle": "5 hourangle", "scan.scans": 1}
    keys |= {"schedule.min_elevation": "15 deg", "scan.speed": "1 arcsec / s"}
    up = prepare(load_scene(dated, keys | {"scan.duration": "100 s"})).observing.angles.elevation_rad[:, 0]
    # In the middle of the two halves of the visibility: the lower of these two decides.
    rates = [SIDEREAL_RAD_S * math.cos(LATITUDE) * math.sin(_azimuth(el)) / math.tan(el) for el in up]
    allowed_s = 2 * MAX_AIRMASS_CHANGE / max(rates)
    assert 200 < allowed_s < 1000
    # In a scan that long the rate itself changes by 2 %: the airmass grows faster as it grows.
    prepare(load_scene(dated, keys | {"scan.duration": f"{0.95 * allowed_s} s"}))
    with pytest.raises(SceneError, match="in half of which the airmass changes by 0.02.* of itself; 0.02 or less"):
        prepare(load_scene(dated, keys | {"scan.duration": f"{1.03 * allowed_s} s"}))


def _azimuth(elevation_rad):
    """Of a field on the equator: sin(dec) = 0 = sin(lat) sin(el) + cos(lat) cos(el) cos(az)."""
    return math.acos(-math.tan(LATITUDE) * math.tan(elevation_rad))
