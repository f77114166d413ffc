"""Turnarounds: limits of acceleration and jerk, durations in closed form, and samples that no map has."""

import numpy as np
import pytest

from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scan_sweeps import AzimuthScan
from surveysim.scene.scene import load_scene
from surveysim.telescope.turnarounds import Turnaround, in_turnaround, mean_speed, step_shares, sweep_offsets
from surveysim.timestreams.observation import Stopwatch, draw_block
from surveysim.timestreams.simulation import observation_path
from tests.scenes import WHITE_NOISE_SCENE

SWEEP_S, SPEED = 10.0, 0.02


def azimuth_scan(**keys):
    whole = {"pattern": "azimuth", "throw": "5 deg", "speed": "1 deg / s", "scans": 4, "dither": "0 deg"}
    return AzimuthScan.model_validate(whole | {"sample_rate": "50 Hz"} | keys)


@pytest.mark.parametrize(
    ("jerk", "expected"),
    [
        (None, 2 / 0.8),  # 2 v / a
        ("1.6 deg / s3", 2 / 0.8 + 0.8 / 1.6),  # 2 v / a + a / j
        ("0.02 deg / s3", 2 * np.sqrt(2 / 0.02)),  # the acceleration never reaches its limit
    ],
)
def test_durations_of_turnarounds(jerk, expected):
    section = azimuth_scan(acceleration="0.8 deg / s2", jerk=jerk)
    assert section.turnaround_s == pytest.approx(expected, rel=1e-12)
    assert section.duration_s == pytest.approx(5.0)
    assert azimuth_scan(turnaround="3 s").turnaround_s == 3.0


@pytest.mark.parametrize("ramp_s", [0.0, 0.5, 2.0])
def test_acceleration_and_jerk_stay_within_limits(ramp_s):
    """Of two sweeps, there and back: by differences of a path without a jump."""
    turning, step = Turnaround(4.0, ramp_s), 1e-3
    scan_s = SWEEP_S + turning.duration_s
    time = np.arange(-scan_s / 2 + step / 2, scan_s / 2, step)
    there = SPEED * sweep_offsets(time, scan_s, turning)
    position = np.concatenate([there, -there])
    velocity = np.diff(position) / step
    acceleration = np.diff(velocity) / step
    assert np.abs(velocity).max() <= SPEED * (1 + 1e-9)
    sweep = np.abs(time) < SWEEP_S / 2 - step
    np.testing.assert_allclose(np.diff(there)[sweep[1:]] / step, SPEED, rtol=1e-9)
    limit = 2 * SPEED / (4.0 - ramp_s)
    assert np.abs(acceleration).max() == pytest.approx(limit, rel=1e-3)
    if ramp_s:  # a / j
        assert np.abs(np.diff(acceleration)).max() / step == pytest.approx(limit / ramp_s, rel=0.01)
    # The overshoot is the first moment of the deceleration, over the velocity: a ramp r of a pulse of (T - r) a.
    overshoot_s = (4.0**2 / 4 - ramp_s**2 / 3) / (4.0 - ramp_s)
    assert mean_speed(scan_s, turning) * scan_s / 2 == pytest.approx(SWEEP_S / 2 + overshoot_s, rel=1e-12)


def test_steps_begin_and_end_at_rest():
    turning, scan_s = Turnaround(4.0, 1.0), 14.0
    time = np.array([-7.0, -6.999, -5.0, 0.0, 5.0, 5.001, 7.0])
    share = step_shares(time, scan_s, turning)
    np.testing.assert_allclose(share, [-0.5, -0.5, 0, 0, 0, 0, 0.5], atol=6e-4)
    assert abs(share[5]) < 1e-9  # at rest
    assert in_turnaround(time, scan_s, turning).tolist() == [True, True, False, False, False, True, True]


@pytest.fixture
def scene_of(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(WHITE_NOISE_SCENE)
    return lambda **keys: load_scene(path, {f"scan.{name}": value for name, value in keys.items()})


def test_flagged_turnarounds_of_rasters_are_in_streams_and_not_in_maps(scene_of):
    """Sweeps are those of a raster without turnarounds, at the same times but for half a turnaround."""
    left_out, flagged = prepare(scene_of()), prepare(scene_of(turnarounds="flagged"))
    path, seen = (observation_path(setup.observing, 1)[0] for setup in (left_out, flagged))
    assert path.straight and path.flagged is None and not seen.straight
    inside = ~seen.flagged
    for name, late in (("time_s", 1.0), ("xi_rad", 0.0), ("eta_rad", 0.0)):
        np.testing.assert_allclose(getattr(seen, name)[inside], getattr(path, name) + late, rtol=0, atol=1e-12)
    assert np.diff(seen.time_s) == pytest.approx(0.1)
    # Between sweeps nothing jumps: the largest step is that of a sweep.
    step = np.hypot(np.diff(seen.xi_rad), np.diff(seen.eta_rad))
    assert step.max() <= left_out.observing.scans.speed_rad_s * 0.1 * 1.2
    block = flagged.observing.blocks[0]
    drawn = draw_block(flagged, 1, observation_path(flagged.observing, 1)[1], block, Stopwatch())
    np.testing.assert_array_equal(drawn.flags, np.tile(seen.flagged, (flagged.camera.n_det, 1)))
    result = observe(flagged, 1, False)
    assert result.hits[0].sum() == flagged.camera.n_det * inside.sum() == observe(left_out, 1, False).hits[0].sum()
    assert result.flagged == pytest.approx(2 / 8)  # turnarounds of 2 s, scans of 6 s


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "scan.turnaround: missing; exactly one of 'turnaround' and 'acceleration' is expected"),
        ({"turnaround": "2 s", "acceleration": "1 deg / s2"}, "exactly one of 'turnaround' and 'acceleration'"),
        ({"turnaround": "2 s", "jerk": "1 deg / s3"}, "jerk: found without 'acceleration'"),
        ({"turnaround": "2 s", "turnarounds": "kept"}, "left out"),
    ],
)
def test_turnarounds_that_are_refused(scene_of, keys, message):
    whole = {"pattern": "azimuth", "throw": "1 deg", "speed": "0.1 deg / s", "scans": 4}
    with pytest.raises(SceneError, match=message):
        scene_of(**whole | {"duration": None, "turnaround": None, "step": None} | keys)
