"""Speeds and directions along tracks: those of their closed forms, weighted as maps weight their samples."""

import numpy as np
import pytest

from surveysim.forecasting.coverage import PLACES, Coverage, mean_hits
from surveysim.forecasting.track_motions import AZIMUTHS, representatives, track_motions
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.timestreams.simulation import observation_path
from tests.scenes import SMALL_SCENE, with_scan

ARCMIN = np.pi / 10800
DAISY = """
pattern = "daisy"
radius = "12 arcmin"
radial_period = "12 s"
duration = "240 s"
chunk = "12 s"
dither = "0 arcmin"
sample_rate = "10 Hz"
"""


@pytest.fixture
def setup_of(tmp_path):
    def make(text: str = SMALL_SCENE, **keys):
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return prepare(load_scene(path, {key.replace("__", "."): value for key, value in keys.items()}))

    return make


def test_a_raster_has_one_speed_and_two_directions(setup_of):
    """Along RA in even observations, along Dec in odd ones; three of five are along RA."""
    tracks = track_motions(setup_of(observations=5))
    assert tracks.straight and tracks.speed_rad_s == pytest.approx([4 * ARCMIN])
    np.testing.assert_array_equal(tracks.share, np.ones((5, 1)))
    turns = tracks.turn_rad[tracks.track_of]
    np.testing.assert_allclose(turns[::2], np.broadcast_to([0, np.pi], (3, 1, 2)), atol=1e-12)
    np.testing.assert_allclose(turns[1::2], np.broadcast_to([np.pi / 2, 3 * np.pi / 2], (2, 1, 2)), atol=1e-12)
    assert np.flatnonzero(tracks.directions[0, 0]).tolist() == [0, AZIMUTHS // 2]
    assert tracks.directions[0, 0, 0] == pytest.approx(3 / 5)


def test_a_daisy_has_its_speeds_in_all_directions(setup_of):
    """Between the speed at the rim and that at the centre; slower than the mean in time, as the rim has few hits."""
    setup = setup_of(with_scan(SMALL_SCENE, DAISY), score__size="20 arcmin", observations=2)
    tracks = track_motions(setup)
    fastest, slowest = 2 * np.pi * ARCMIN, 2 * ARCMIN  # R w at the centre, and R w / pi at the rim
    assert not tracks.straight and len(tracks.speed_rad_s) == 4
    assert (np.diff(tracks.speed_rad_s) > 0).all() and slowest < tracks.speed_rad_s[0]
    assert fastest * 0.9 < tracks.speed_rad_s[-1] < fastest
    np.testing.assert_allclose(tracks.share.mean(axis=0), 0.25, atol=0.01)
    np.testing.assert_allclose(tracks.share.sum(axis=1), 1)
    np.testing.assert_allclose(tracks.directions.sum(axis=(1, 2)), 1)
    assert tracks.place_share.sum() == pytest.approx(1)
    # Eight directions of equal weight are a turn apart in equal steps.
    steps = np.diff(tracks.turn_rad, axis=-1)
    assert np.abs(steps / (np.pi / 4) - 1).mean() < 0.2


def test_samples_count_as_their_pixels_do(setup_of):
    """Taper squared over hits squared in the noise, over hits in the signal, detector by detector."""
    setup = setup_of(with_scan(SMALL_SCENE, DAISY), score__size="20 arcmin", observations=2)
    pipeline, region = setup.analysis.pipelines[0], setup.analysis.region
    _, pointing = observation_path(setup.observing, 1)
    used = np.arange(0, len(pointing.time_s), 37)
    found = Coverage(setup, pipeline).of_samples(pointing, used)
    hits, n = mean_hits(setup, pipeline), len(region.taper)
    noise, places = np.zeros(len(used)), np.zeros((len(used), PLACES))
    plane, first = setup.camera.focal_plane, region.patch.start
    geometry = setup.analysis.geometry
    for row, sample in enumerate(used):
        angle = pointing.array_angle_rad[sample]
        for x, y in zip(plane.x_rad, plane.y_rad, strict=True):
            xi = pointing.xi_rad[sample] - x * np.cos(angle) + y * np.sin(angle)
            eta = pointing.eta_rad[sample] + x * np.sin(angle) + y * np.cos(angle)
            i = int(np.floor(geometry.n_x / 2 - xi / geometry.pixel_rad)) - first
            j = int(np.floor(geometry.n_y / 2 + eta / geometry.pixel_rad)) - first
            if 0 <= i < n and 0 <= j < n and hits[j, i]:
                square = region.taper[j, i] ** 2
                noise[row] += square / hits[j, i] ** 2
                places[row, 4 * (4 * j // n) + 4 * i // n] += square / hits[j, i]
    assert noise.any() and not noise.all()
    close = np.isclose(found.noise, noise, rtol=1e-9)
    assert close.mean() > 0.97  # offsets are added on the sphere, so few samples are in a neighbouring pixel
    assert np.isclose(found.places, places, rtol=1e-9).all(axis=1).mean() > 0.97


def test_observations_are_represented_by_their_like(setup_of):
    """Of the same parity, and of a near parallactic angle."""
    observing = setup_of(observations=100).observing
    numbers, track_of = representatives(observing)
    assert len(numbers) == 16 and (numbers[track_of] % 2 == np.arange(100) % 2).all()
