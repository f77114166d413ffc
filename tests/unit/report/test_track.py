"""Figure of the track of an observation and of the hits of a survey."""

from types import SimpleNamespace

import numpy as np
import pytest

from surveysim.reduction.setup import prepare
from surveysim.report.figures.track import track_and_hits, track_segments
from surveysim.scene.scene import load_scene
from surveysim.timestreams.simulation import observation_path
from tests.scenes import write_scene


def segments(scene):
    pointing = observation_path(prepare(scene).observing, 0)[1]
    return pointing, *track_segments(pointing)


def test_scans_of_a_raster_are_apart_and_coloured_by_time(tmp_path):
    pointing, place, lost, colour, label = segments(load_scene(write_scene(tmp_path)))
    n_scan, n_samp = len(pointing.velocity_rad_s), len(pointing.time_s)
    assert place.shape == (n_samp - n_scan, 2, 2) and not lost.any() and label == "Time [min]"
    np.testing.assert_allclose(np.linalg.norm(place[:, 1] - place[:, 0], axis=1), np.radians(4 / 60) / 10, rtol=1e-9)
    assert colour[0] * 60 == pytest.approx(pointing.time_s[0])


def test_turnarounds_are_lost(tmp_path):
    scene = load_scene(write_scene(tmp_path), {"scan.turnarounds": "flagged"})
    pointing, place, lost, _, _ = segments(scene)
    assert len(place) == len(pointing.time_s) - 1
    np.testing.assert_array_equal(lost, pointing.flagged[1:] | pointing.flagged[:-1])
    np.testing.assert_array_equal(place[:, 0], np.column_stack([pointing.xi_rad, pointing.eta_rad])[:-1])


@pytest.fixture(scope="module")
def daisy():
    return load_scene("scenarios/daisy_mustang2.toml")


def test_a_daisy_is_coloured_by_its_speed(daisy):
    """Chords of a tenth of a second are shorter than the path: by 1e-4 at the centre, where the speed is largest."""
    _, _, _, colour, label = segments(daisy)
    assert label == "Speed on the sky [arcsec/s]"
    assert colour.max() == pytest.approx(np.degrees(daisy.scan.fastest_rad_s) * 3600, rel=2e-3)
    assert colour.mean() == pytest.approx(np.degrees(daisy.scan.speed_rad_s) * 3600, rel=2e-2)


def test_east_is_to_the_left_in_both_panels(daisy):
    setup = prepare(daisy)
    hits = np.zeros((setup.analysis.geometry.n_y, setup.analysis.geometry.n_x))
    hits[-1, 0] = 7  # north-east
    left, right = track_and_hits(setup, SimpleNamespace(hits=[hits])).axes[:2]
    for axes in (left, right):
        assert axes.get_xlim()[0] > axes.get_xlim()[1] and axes.get_ylim()[0] < axes.get_ylim()[1]
    (image,) = right.images
    east, west, south, north = image.get_extent()
    assert east == -west > 0 and north == -south > 0 and image.origin == "lower"
    assert image.get_array()[-1, 0] == 7 and np.isnan(np.asarray(image.get_array())[0, 0])
