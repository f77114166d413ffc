"""Delays of wind cleaning in observations of several blocks: those of the whole observation."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from surveysim.reduction import cleaned_block
from surveysim.reduction import observation as reduction
from surveysim.reduction.cleaning_pipelines import AuxiliaryData, apply_pipeline
from surveysim.reduction.layer_delays import delays_of_all_blocks, layer_motion, measured_delays
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.studies import resources
from surveysim.timestreams.observation import Stopwatch, draw_observation
from surveysim.timestreams.simulation import observation_path
from tests.scenes import write_scene

N_SCANS = 8
SETTINGS = {
    "scan.duration": "15 s",
    "scan.scans": N_SCANS,
    "cleaning.algorithm": "wind",
    "atmosphere.b2": "[20000, 50000, 100000] mK2 rad(-5/3)",
    "instrument.layout.rings": 4,
}
# A scan of 60 detectors and 150 samples takes 36 kB.
MEMORY = {1: "1 MB", 2: "150 kB", 8: "40 kB"}


@pytest.fixture
def setup_of(tmp_path):
    def make(blocks, **overrides):
        settings = SETTINGS | {"numerics.max_block_memory": MEMORY[blocks]} | overrides
        setup = prepare(load_scene(write_scene(tmp_path), settings))
        assert len(setup.observing.blocks) == blocks
        return setup

    return make


def _some_scans(streams, first, end):
    samples = (streams.scan >= first) & (streams.scan < end)
    names = ("time_s", "ra_rad", "dec_rad", "array_angle_rad", "scan")
    pointing = {name: getattr(streams, name)[samples] for name in names}
    return replace(streams, data_mk=streams.data_mk[:, samples], **pointing)


@pytest.mark.parametrize("n", [1, 3])
def test_streams_in_blocks_have_the_delays_of_the_whole(setup_of, n):
    """The transforms of a scan do not depend on its block; velocities are measured about the centre of a block."""
    setup = setup_of(1)
    streams, rate = draw_observation(setup, 0), setup.observing.scans.sample_rate_hz
    motion = layer_motion(streams, rate)
    whole = measured_delays([motion], streams.focal_plane)
    assert np.abs(whole).sum(axis=1).all()
    parts = [layer_motion(_some_scans(streams, first, first + n), rate) for first in range(0, N_SCANS, n)]
    np.testing.assert_array_equal(np.concatenate([part.transforms.scans for part in parts]), motion.transforms.scans)
    np.testing.assert_allclose(measured_delays(parts, streams.focal_plane), whole, rtol=1e-5)


def test_delays_without_lost_data(setup_of):
    """Dead detectors, a lost scan, gaps of all detectors and of each: with wild values there, the same delays.

    Some observations have just enough data to trust the wind: of twenty, three lose it with the data and one gains it.
    """
    setup, both = setup_of(1, observations=8), 0
    for number in range(8):
        streams, rate = draw_observation(setup, number), setup.observing.scans.sample_rate_hz
        flagged = _with_lost_data(streams)
        motion = layer_motion(flagged, rate)
        assert motion.used.tolist() == [True] * 2 + [False] + [True] * 5
        assert motion.transforms.live.sum() == len(streams.data_mk) - 3
        whole = measured_delays([layer_motion(streams, rate)], streams.focal_plane)
        lossy = measured_delays([motion], streams.focal_plane)
        if whole.any() and lossy.any():
            both += 1
            assert (np.linalg.norm(lossy - whole, axis=1) < 0.05 * np.linalg.norm(whole, axis=1)).all()
    assert both >= 4
    assert layer_motion(replace(streams, flags=np.ones_like(flagged.flags)), rate).transforms is None


def _with_lost_data(streams):
    rng = np.random.default_rng(1)
    flags = rng.random(streams.data_mk.shape) < 0.01
    flags[[3, 20, 41]] = flags[:, slice(*streams.scan_bounds[2])] = True
    flags[:, streams.scan_bounds[4, 0] + 70 : streams.scan_bounds[4, 0] + 75] = True
    wild = np.where(flags, np.float32(1e4) * rng.standard_normal(flags.shape, np.float32), streams.data_mk)
    return replace(streams, data_mk=wild, flags=flags)


@pytest.mark.parametrize("blocks", [2, 8])
def test_blocks_are_cleaned_as_the_same_streams_side_by_side(setup_of, blocks):
    """Blocks of four scans, and of one, in which no wind can be measured."""
    setup = setup_of(blocks)
    streams, (_, pointing) = draw_observation(setup, 0), observation_path(setup.observing, 0)
    delays = delays_of_all_blocks(setup, 0, pointing, Stopwatch())
    parts = [
        cleaned_block.reduce_block(setup, 0, pointing, block, delays_s_rad=delays, watch=Stopwatch())
        for block in setup.observing.blocks
    ]
    rate, pipeline = setup.observing.scans.sample_rate_hz, setup.analysis.pipelines[0]
    own = measured_delays([layer_motion(streams, rate)], streams.focal_plane)
    whole = apply_pipeline(
        setup.scene.cleaning,
        pipeline,
        streams.data_mk,
        scan_bounds=streams.scan_bounds,
        focal_plane=streams.focal_plane,
        auxiliary=AuxiliaryData(own, np.zeros((0, *streams.data_mk.shape), np.float32)),
        sample_rate_hz=rate,
    )
    assert whole.kept.all() and np.abs(own).sum(axis=1).all()
    found = np.concatenate([part.cleaned[0].data_mk for part in parts], axis=1)
    np.testing.assert_array_equal(np.concatenate([part.cleaned[0].kept for part in parts]), whole.kept)
    np.testing.assert_allclose(found, whole.data_mk, atol=1e-4 * whole.data_mk.std())
    c = np.concatenate([part.cleaned[0].responsivity for part in parts])
    np.testing.assert_allclose(c, whole.responsivity, rtol=1e-5)


def test_other_cleaning_needs_no_pass_before(setup_of, monkeypatch):
    drawn, draw = [], cleaned_block.draw_block
    monkeypatch.setattr("surveysim.reduction.layer_delays.draw_block", lambda *args: drawn.append(args) or draw(*args))
    reduction.observe(setup_of(2, **{"cleaning.algorithm": "average"}), 0, with_signal_sims=False)
    reduction.observe(setup_of(1), 0, with_signal_sims=False)
    assert not drawn
    reduction.observe(setup_of(2), 0, with_signal_sims=False)
    assert len(drawn) == 2


def test_wind_cleaning_of_blocks_leaves_less_than_the_average(setup_of):
    """As that of one block, of the same weather with other noise: over 25 observations the scatter is 0.18."""
    n_obs, means = 8, []
    for blocks in (1, 2, 8):
        setup = setup_of(blocks, **{"cleaning.compare": ["average"], "observations": n_obs})
        found = [reduction.observe(setup, number, with_signal_sims=False) for number in range(n_obs)]
        means.append(np.mean([item.clean_psd[2:6].mean() / item.compared_psd[0, 2:6].mean() for item in found]))
        assert all(item.discarded == (0, 0, 0) for item in found)
    error = 0.18 / np.sqrt(n_obs)
    assert max(means) + 3 * error < 1  # what it would be without delays
    assert np.ptp(means) < 3 * np.sqrt(2) * error


def test_plan_counts_the_pass_before(setup_of):
    """The components and the wind once more, and nothing else."""
    scan = SimpleNamespace(seconds={"atmosphere": 4.0, "photon": 2.0, "response": 0.5, "wind": 1.0, "cleaning": 8.0})
    setup = setup_of(8)
    assert resources._drawn_again_s(setup, scan) == 7.5
    assert resources._drawn_again_s(setup_of(8, **{"cleaning.algorithm": "average"}), scan) == 0
    # The plan draws one block, too short to measure the wind in it.
    assert resources.make_plan(setup, 1).stages["blocks"].startswith("8 an observation, 1 scans or fewer")


def test_wind_needs_three_scans(setup_of):
    with pytest.raises(SceneError, match="cleaning.algorithm: found 'wind' with 2 scans; 3 or more are expected"):
        setup_of(1, **{"scan.scans": 2})
