"""Limits of the mount: derivatives against closed forms, and refusals that say where."""

import numpy as np
import pytest

from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene, scene_hash
from surveysim.scene.telescope import TelescopeSection
from surveysim.telescope.mount_limits import Motion, derivatives, limit_excess
from tests.scenes import SCHEDULE, WHITE_NOISE_SCENE, with_scan, without_sections

DAISY = """\
pattern = "daisy"
radius = "6 arcmin"
radial_period = "10 s"
rotation_period = "1 hour"
duration = "1 min"
chunk = "10 s"
dither = "0 arcmin"
sample_rate = "50 Hz"
"""
ARCMIN = 1 / 60


def refusal(folder, text, **limits):
    """Error of a scene with limits [deg, s], without its file."""
    path = folder / "scene.toml"
    keys = "\n".join(
        f'max_{name} = "{value:.9g} deg / s{order if order > 1 else ""}"'
        for name, value in limits.items()
        for order in [1 + ("velocity", "acceleration", "jerk").index(name.split("_")[1])]
    )
    path.write_text(f"{text}\n[telescope]\n{keys}\n")
    with pytest.raises(SceneError) as raised:
        prepare(load_scene(path))
    return str(raised.value)


def test_derivatives_of_a_sine():
    """Divided differences over three steps err by less than the square of a step's phase, relatively."""
    time_s = np.arange(0, 20, 0.02)
    for order, (at_s, found) in enumerate(derivatives(time_s, np.sin(time_s)), start=1):
        exact = {1: np.cos, 2: lambda t: -np.sin(t), 3: lambda t: -np.cos(t)}[order](at_s)
        assert len(found) == len(time_s) - order
        np.testing.assert_allclose(found, exact, atol=0.02**2)


def test_coarse_tracks_have_few_derivatives():
    """Of rows 10 s apart, samples at 1 Hz are thinned to one row a step."""
    motion = Motion(np.arange(25.0), np.arange(25.0) ** 2, np.arange(25.0)).thinned(10)
    assert motion.time_s.tolist() == [0, 10, 20]
    assert [len(found) for _, found in derivatives(motion.time_s, motion.azimuth_rad)] == [2, 1, 0]
    assert derivatives(motion.time_s, motion.azimuth_rad)[1][1] == 2.0
    assert limit_excess(TelescopeSection(max_azimuth_velocity="1 deg / s"), motion.thinned(100), 0) == (0.0, "")


def test_turnarounds_take_the_mean_acceleration():
    """Scans at speeds of 3 and -3, with 4 s between them; the acceleration is -6 over 4 s. No jerk is across them."""
    step_s = 0.1
    scan_s = (np.arange(50) + 0.5) * step_s
    time_s = np.concatenate([scan_s, scan_s + 5 + 4])
    values = np.concatenate([3 * scan_s, -3 * scan_s])
    (_, velocity), (at_s, acceleration), (_, jerk) = derivatives(time_s, values)
    assert len(velocity) == 98
    np.testing.assert_allclose(acceleration[np.abs(at_s - 7) < 1], -6 / 4)
    np.testing.assert_allclose(np.delete(acceleration, np.argmax(np.abs(at_s - 7) < 1)), 0, atol=1e-11)
    assert len(jerk) == 94 and np.abs(jerk).max() < 1e-9


@pytest.fixture
def raster():
    """Scans along declination at a parallactic angle of 90 degrees move in azimuth, at 55 degrees of elevation."""
    return WHITE_NOISE_SCENE.replace('parallactic_angle = "20 deg"', 'parallactic_angle = "90 deg"').replace(
        "camera_rotation_range", "camera_rotation_range"
    )


def test_azimuths_move_faster_by_the_cosine_of_the_elevation(tmp_path, raster):
    """The first observation scans along right ascension, the vertical; the second along the horizon."""
    on_sky = 4 * ARCMIN
    error = refusal(tmp_path, raster, azimuth_velocity=on_sky / np.cos(np.radians(55)) * 0.999)
    # Scans 9 arcmin long and up to 4.5 arcmin above the centre are faster by the tangent of the elevation.
    most = on_sky / np.cos(np.radians(55 + 4.5 * ARCMIN))
    found = float(error.split("found ")[1].split(" deg / s")[0])
    assert on_sky / np.cos(np.radians(55)) <= found <= most * 1.001
    assert (
        error.startswith("telescope.max_azimuth_velocity: found 0.1")
        and " deg / s in observation 1 at 55.1 deg" in error
    )
    assert error.endswith(f"; {on_sky / np.cos(np.radians(55)) * 0.999:.4g} deg / s or less is expected")
    error = refusal(tmp_path, raster, elevation_velocity=on_sky * 0.99, azimuth_velocity=1)
    assert "max_elevation_velocity: found 0.06667 deg / s in observation 0 at " in error


def test_turnarounds_of_rasters_are_checked(tmp_path, raster):
    """A change of velocity by twice the speed within 2 s."""
    error = refusal(tmp_path, raster, elevation_acceleration=4 * ARCMIN * 0.99)
    assert error.startswith("telescope.max_elevation_acceleration: found 0.06667 deg / s2 in observation 0 at ")


@pytest.mark.parametrize("order, name", [(1, "velocity"), (2, "acceleration"), (3, "jerk")])
def test_daisy_has_the_derivatives_of_a_sine(tmp_path, order, name):
    """Along the vertical, nearly: the diameter turns by 6 degrees in a minute."""
    text = with_scan(WHITE_NOISE_SCENE, DAISY).replace('parallactic_angle = "20 deg"', 'parallactic_angle = "90 deg"')
    most = 6 * ARCMIN * (2 * np.pi / 10) ** order
    error = refusal(tmp_path, text, **{f"elevation_{name}": most * 0.97})
    found = float(error.split("found ")[1].split(" deg / s")[0])
    # The diameter lies along the vertical at the start; it turns by pi / 10 while the sine makes 6 oscillations.
    assert 0.998 * most <= found <= 1.002 * most
    path = tmp_path / "slow.toml"
    unit = f"s{order}" if order > 1 else "s"
    path.write_text(f'{text}\n[telescope]\nmax_elevation_{name} = "{most * 1.003} deg / {unit}"\n')
    prepare(load_scene(path))


def test_scheduled_scenes_name_the_highest_observation(tmp_path):
    """Among 40 observations, and for a daisy of the horizon whose azimuths are fastest near the zenith."""
    text = without_sections(with_scan(WHITE_NOISE_SCENE, DAISY + 'frame = "horizon"'), "fixed_pointing") + SCHEDULE
    text = text.replace("observations = 4", "observations = 40")
    error = refusal(tmp_path, text, azimuth_velocity=0.001)
    path = tmp_path / "free.toml"
    path.write_text(text)
    angles = prepare(load_scene(path)).observing.angles
    highest = np.degrees(angles.elevation_rad.max())
    elevation = float(error.split(" at ")[1].split(" deg elevation")[0])
    assert abs(elevation - highest) < 6 * ARCMIN + 0.1
    found = float(error.split("found ")[1].split(" deg / s")[0])
    # At the centre along azimuth; the sky's own motion adds 15 arcsec/s over the cosine, about.
    fastest = 6 * ARCMIN * 2 * np.pi / 10 / np.cos(np.radians(elevation))
    assert abs(found - fastest) < 0.1 * fastest


def test_limits_do_not_change_results(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(f'{WHITE_NOISE_SCENE}\n[telescope]\nmax_azimuth_velocity = "3 deg / s"\n')
    limited = load_scene(path)
    assert limited.telescope.limit("azimuth", 1) == pytest.approx(np.radians(3))
    assert scene_hash(limited) == scene_hash(load_scene(path, {"telescope": None}))
