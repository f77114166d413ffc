"""Observations in several blocks: how they are cut, what is refused, what does not depend on the cut."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mapmaker.cleaning.responsivity import MOST_GRAM
from mapmaker.formats import read_timestreams
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.studies.sweep.axes import load_sweep
from surveysim.telescope.diffraction import with_beam
from surveysim.telescope.focal_plane import camera
from surveysim.telescope.pixel_coherence import MOST_DENSE
from surveysim.timestreams.observation import Stopwatch, draw_block, draw_observation
from surveysim.timestreams.scan_blocks import Block, scan_blocks
from surveysim.timestreams.simulation import observation_path
from tests.cameras import scenes_of
from tests.scenes import SMALL_SCENE, without_sections

SCENARIOS = sorted((Path(__file__).parents[3] / "scenarios").glob("*.toml"))
# A scan of the small scene's 18 detectors and 60 samples takes 4320 bytes: two scans a block, and one.
CUTS = {2: "9 kB", 4: "5 kB"}


@pytest.fixture
def setup_of(tmp_path):
    def make(text=SMALL_SCENE, blocks=1, **overrides):
        path = tmp_path / "small.toml"
        path.write_text(text)
        settings = {key.replace("__", "."): value for key, value in overrides.items()}
        if blocks > 1:
            settings.setdefault("numerics.max_block_memory", CUTS[blocks])
        setup = prepare(load_scene(path, settings))
        assert len(setup.observing.blocks) == blocks
        return setup

    return make


@pytest.mark.parametrize("n_scans, most", [(18, 18), (18, 17), (18, 4), (7, 3), (5, 1), (1, 1)])
def test_blocks_hold_every_scan_once(n_scans, most):
    blocks = scan_blocks(n_scans, 1000, 1000.0 * most + 999)
    assert [block.number for block in blocks] == list(range(len(blocks)))
    assert [scan for block in blocks for scan in range(block.first, block.end)] == list(range(n_scans))
    sizes = [block.n_scans for block in blocks]
    assert max(sizes) <= most and max(sizes) - min(sizes) <= 1
    assert len(blocks) == 1 + (n_scans - 1) // most


@pytest.mark.parametrize("most", [1.0, 999.0, 1000.0, 1999.0])
def test_a_block_holds_a_scan_or_more(most):
    assert scan_blocks(3, 1000, most) == (Block(0, 0, 1), Block(1, 1, 2), Block(2, 2, 3))


def test_a_scan_above_the_limit_is_a_block_by_itself(setup_of):
    """Its streams are those of the largest limit that holds one scan."""
    setup = setup_of(blocks=4)
    above = setup_of(blocks=4, numerics__max_block_memory="1 byte")
    assert above.observing.blocks == setup.observing.blocks
    np.testing.assert_array_equal(draw_observation(above, 1).data_mk, draw_observation(setup, 1).data_mk)


def test_blocks_do_not_depend_on_the_precision(setup_of):
    assert setup_of(blocks=2, numerics__precision="float64").observing.blocks == setup_of(blocks=2).observing.blocks


def test_a_scan_larger_than_the_machine_is_refused(setup_of, monkeypatch):
    """By its duration: the limit of a block has nothing to do with it."""
    from surveysim.reduction import resource_limits

    text = without_sections(SMALL_SCENE, "atmosphere", "excess", "photon")
    long = {"scan__duration": "1000 s", "scan__speed": "0.1 arcmin / s", "instrument__layout__rings": 20}
    long["cleaning__algorithm"] = "none"
    monkeypatch.setattr(resource_limits, "machine_bytes", lambda: 5e8)
    with pytest.raises(SceneError, match="^scan.duration: found a scene that needs about 0.[67].* GB of memory in one"):
        setup_of(text, numerics__max_block_memory="1 MB", **long)


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_scenarios_are_of_one_block_and_dense(path):
    for scene in scenes_of(path):
        _check_size(path, with_beam(scene))


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", [path for path in SCENARIOS if "[sweep" in path.read_text()], ids=lambda path: path.stem
)
def test_points_of_sweeps_are_of_one_block_and_dense(path):
    for point in load_sweep(path).points:
        _check_size(path, with_beam(point.scene))


def _check_size(path, scene):
    """Assert that a scene fits into one block, which its results depend on; only the large camera does not.

    Matrices of pairs are for all but that and TolTEC. Responsivities of more than 600 detectors are fitted on their
    streams.
    """
    n_det = camera(scene.instrument, scene.seed).n_det
    samples = n_det * scene.scan.scans * scene.scan.duration_s * scene.scan.sample_rate_hz
    many = path.stem == "large_camera"
    assert (n_det > MOST_DENSE) == (path.stem in ("large_camera", "lissajous_toltec"))
    assert n_det <= MOST_GRAM or n_det > MOST_DENSE or scene.name in ("three_bands_220", "pixel_spacing_hbt")
    # Four bytes a sample, and as many for each other band.
    assert (4 * samples * (1 + len(scene.others)) > scene.numerics.max_block_bytes) == many


def test_layer_and_sky_do_not_depend_on_the_first_cut(setup_of):
    """Strips are drawn scan by scan, so the first block has those of the first scans; later blocks draw their own.

    Other noise is drawn detector by detector over all scans of a block, and so is another from the first sample on.
    """
    text = without_sections(SMALL_SCENE, "excess", "photon", "detector")
    whole, cut = (draw_observation(setup_of(text, blocks=n), 1).data_mk for n in (1, 2))
    np.testing.assert_array_equal(whole[:, :120], cut[:, :120])
    assert not (whole[:, 120:] == cut[:, 120:]).any()


def test_blocks_side_by_side_are_the_observation(setup_of):
    setup = setup_of(blocks=4)
    whole, (_, pointing) = draw_observation(setup, 1), observation_path(setup.observing, 1)
    blocks = setup.observing.blocks
    parts = [draw_block(setup, 1, pointing, block, Stopwatch()).timestreams() for block in blocks]
    np.testing.assert_array_equal(whole.data_mk, np.concatenate([part.data_mk for part in parts], axis=1))
    for name in ("time_s", "ra_rad", "dec_rad", "array_angle_rad", "scan"):
        np.testing.assert_array_equal(getattr(whole, name), np.concatenate([getattr(part, name) for part in parts]))
    one = draw_observation(setup_of(), 1)
    np.testing.assert_array_equal(whole.scan, one.scan)
    assert dict(whole.attributes) == dict(parts[2].attributes)
    # The memory that a block may take is a key of the scene.
    other = {"survey_sha256": whole.attributes["survey_sha256"]}
    assert dict(whole.attributes) == dict(one.attributes) | other
    # No block repeats another's noise.
    first, second = (part.data_mk[:, 1:] - part.data_mk[:, :-1] for part in parts[:2])
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 5 / np.sqrt(first.size)


def test_signal_and_hits_do_not_depend_on_the_cut(setup_of):
    """A sky without noise, a cleaning that does not depend on the data: sums agree to rounding, hits exactly."""
    text = without_sections(SMALL_SCENE, "atmosphere", "excess", "photon", "detector")
    found = [
        observe(
            setup_of(text, blocks=n, cleaning__algorithm="none", score__noise_only_sets=[]), 0, with_signal_sims=True
        )
        for n in (1, 2, 4)
    ]
    for cut in found[1:]:
        np.testing.assert_array_equal(cut.hits, found[0].hits)
        for name in ("sums", "signal_maps", "noise_mk2", "raw_psd", "clean_psd"):
            expected = getattr(found[0], name)
            np.testing.assert_allclose(getattr(cut, name), expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


def test_discarded_scans_are_counted_over_blocks(setup_of, monkeypatch):
    """One scan in every block lost: as many hits less, and means over what is left."""
    from surveysim.reduction import cleaned_block as reduction

    strong = {"atmosphere__b2": "[2000, 5000, 10000] mK2 rad(-5/3)"}  # so that no other scan is lost
    whole = setup_of(blocks=2, score__noise_only_sets=["white"], **strong)
    clean = reduction.apply_pipeline

    def lossy(*arguments, **options):
        done = clean(*arguments, **options)
        done.data_mk[:, :60] = 0
        kept = done.kept.copy()
        kept[0] = False
        return replace(done, kept=kept, removed=np.where(kept, done.removed, 0))

    everything = observe(whole, 0, with_signal_sims=False)
    monkeypatch.setattr(reduction, "apply_pipeline", lossy)
    found = observe(whole, 0, with_signal_sims=False)
    assert everything.discarded == (0, 0) and found.discarded == (2, 2) and found.removed == (1.0, 1.0)
    actual, white = (whole.analysis.data_set_names.index(name) for name in ("actual", "white"))
    np.testing.assert_array_equal(found.hits[actual], found.hits[white])
    assert 0.4 < found.hits[actual].sum() / everything.hits[actual].sum() < 0.6
    assert 0.3 < found.clean_psd[5:].mean() / everything.clean_psd[5:].mean() < 3


def test_streams_are_written_block_by_block(setup_of, tmp_path):
    setup = setup_of(blocks=4)
    observe(setup, 2, False, tmp_path / "two.h5")
    read, made = read_timestreams(tmp_path / "two.h5"), draw_observation(setup, 2)
    np.testing.assert_array_equal(read.data_mk, made.data_mk)
    np.testing.assert_array_equal(read.scan, made.scan)
    np.testing.assert_array_equal(read.time_s, made.time_s)
    assert dict(read.attributes) == pytest.approx(dict(made.attributes))


def test_no_more_than_a_block_is_drawn_at_a_time(setup_of, monkeypatch):
    from surveysim.timestreams import photon

    shapes = []
    add = photon.add_correlated_white

    def noted(data, *rest):
        shapes.append(data.shape)
        add(data, *rest)

    monkeypatch.setattr(photon, "add_correlated_white", noted)
    observe(setup_of(blocks=4), 0, with_signal_sims=True)
    assert shapes == [(18, 60)] * 4


def test_blocks_number_their_samples(setup_of):
    setup = setup_of(blocks=2)
    assert setup.observing.blocks == (Block(0, 0, 2), Block(1, 2, 4))
    assert [setup.observing.samples(block) for block in setup.observing.blocks] == [slice(0, 120), slice(120, 240)]
