"""Tree of sums: the same bits for any order of arrival and any grouping, the sums of a plain loop."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from surveysim import load_scene
from surveysim.reduction.observation import observe
from surveysim.reduction.resource_limits import LEAF
from surveysim.reduction.setup import prepare
from surveysim.survey import coadd_tree
from surveysim.survey.coadd_tree import CoAddTree, is_node
from surveysim.survey.coadds import add_observations, add_sums, empty_coadds, observation_sums
from surveysim.survey.spans import SPAN_S, Span, Spans
from tests import naive
from tests.scenes import SMALL_SCENE, SPECTRA, write_scene

N_OBS = 150  # nine leaves and a part of one
ARRAYS = ("sums", "weight", "hits", "flipped", "signal_maps", "signal_weight")
ARRAYS += ("split_sums", "split_weight", "split_flipped")


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    path = write_scene(tmp_path_factory.mktemp("scene"), SMALL_SCENE + SPECTRA)
    return prepare(load_scene(path, {"observations": N_OBS, "spectra.realizations": 2}))


@pytest.fixture(scope="module")
def singles(setup):
    """Observations that differ in their maps and weights; the first few carry signals."""
    rng = np.random.default_rng(5)
    observed = observe(setup, 0, with_signal_sims=True)

    def drawn(number):
        scale = rng.uniform(0.1, 10, len(observed.noise_mk2))
        return replace(
            observed,
            observation=number,
            sums=rng.standard_normal(observed.sums.shape).astype(np.float32) * (observed.hits > 0),
            noise_mk2=observed.noise_mk2 * scale,
            signal_maps=observed.signal_maps if number < 4 else None,
        )

    return [observation_sums(setup.analysis, drawn(number)) for number in range(N_OBS)]


@pytest.fixture(scope="module")
def in_order(setup, singles):
    return of_all(setup, singles)


def of_all(setup, items):
    tree = CoAddTree(setup)
    for item in items:
        tree.add(coadd_tree.copied(item))
        while tree.advance():
            pass
    assert (tree.done, tree.finished, tree.missing()) == (N_OBS, N_OBS, [])
    return tree.so_far()


def node(setup, singles, first, end):
    tree = CoAddTree(setup, first=first)
    for number in range(first, end):
        tree.add(singles[number])
        assert tree.advance()
    return tree.so_far()


def same(one, other):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.rows, other.rows)
    assert one.seconds.keys() == other.seconds.keys()


def test_naive_tree(setup, singles, in_order):
    patch = setup.analysis.region.patch
    signs = np.stack([naive.jackknife_signs(setup.scene, number) for number in range(N_OBS)], axis=1)
    flipped = naive.tree_sum(
        [
            (signs[:, i, None, None, None] * item.sums[:, patch, patch]).astype(np.float32)
            for i, item in enumerate(singles)
        ]
    )
    np.testing.assert_array_equal(in_order.flipped, flipped)
    for name in ("sums", "weight", "hits"):
        np.testing.assert_array_equal(
            getattr(in_order, name), naive.tree_sum([getattr(item, name) for item in singles])
        )
    np.testing.assert_allclose(in_order.sums, sum(item.sums for item in singles), rtol=1e-9, atol=1e-12)


def test_any_order_of_single_observations(setup, singles, in_order):
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(N_OBS)
        same(of_all(setup, [singles[number] for number in order]), in_order)


def test_any_nodes_in_any_order(setup, singles, in_order):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        items, first = [], 0
        while first < N_OBS:
            sizes = [size for size in (1, 16, 32, 64, 128) if first % size == 0 and first + size <= N_OBS]
            size = rng.choice(sizes)
            items.append(singles[first] if size == 1 else node(setup, singles, first, first + size))
            first += size
        same(of_all(setup, [items[place] for place in rng.permutation(len(items))]), in_order)


def test_sums_so_far_are_of_the_first_observations(setup, singles):
    tree, late = CoAddTree(setup), (3, 40, 41, 64)
    for number in range(N_OBS):
        if number not in late:
            tree.add(singles[number])
    assert not any(tree.missing()) or tree.missing() == list(late)
    for count in range(1, 4):
        assert tree.advance() and tree.done == count
        assert tree.so_far().done == count
    assert not tree.advance()
    tree.add(singles[3])
    while tree.advance():
        assert tree.so_far().done == tree.done
    assert tree.done == 40
    same(tree.so_far(), of_first(setup, singles, 40))
    again = CoAddTree(setup, tree.nodes())
    assert all(is_node(setup, item) for item in tree.nodes()) and again.missing() == [40, 41, 64]
    tree.forget_later()
    assert tree.finished == 40 and tree.missing() == list(range(40, N_OBS))


def of_first(setup, singles, count):
    tree = CoAddTree(setup, [coadd_tree.copied(item) for item in singles[:count]])
    while tree.advance():
        pass
    return tree.so_far()


def test_nodes_taken_up_again_give_the_same_bits(setup, singles, in_order):
    tree = CoAddTree(setup)
    for number in [*range(21), *range(30, 90), 100]:
        tree.add(singles[number])
        while tree.advance():
            pass
    again = CoAddTree(setup, [coadd_tree.copied(item) for item in tree.nodes()])
    while again.advance():
        pass
    for number in reversed(again.missing()):
        again.add(singles[number])
        while again.advance():
            pass
    same(again.so_far(), in_order)


def test_large_sums_are_held_once(setup, singles, monkeypatch):
    monkeypatch.setattr(coadd_tree, "LARGE_SUMS", 1.0)
    tree = CoAddTree(setup)
    for item in singles:
        tree.add(coadd_tree.copied(item))
        tree.advance()
    assert len(tree.nodes()) == 1
    plain = empty_coadds(setup.analysis)
    for item in singles:
        add_observations(setup.analysis, plain, [item])
    same(tree.so_far(), plain)


def test_sums_that_do_not_follow_are_refused(setup, singles):
    sums = empty_coadds(setup.analysis)
    add_observations(setup.analysis, sums, singles[:2])
    for later in (singles[1:2], singles[3:4], singles[2:5:2]):
        with pytest.raises(ValueError, match="is the next in order"):
            add_observations(setup.analysis, sums, later)
    for later in (singles[2], node(setup, singles, 16, 32)):
        with pytest.raises(ValueError, match="is the next in order"):
            add_sums(sums, later)
    assert sums.done == 2


def handed_out(missing, each_s, workers, **options):
    spans = Spans(missing, single=options.get("single", False))
    found = []
    while (taken := spans.take(workers)) is not None:
        number, span = taken
        assert number == span.first
        found.append(span)
        if each_s is not None:
            spans.measured(each_s)
    return found


@pytest.mark.parametrize("workers", [1, 2, 7, 1000])
def test_spans_are_nodes_that_cover_all_missing_observations(workers):
    missing = [*range(1000), *range(1003, 2048), 2050]
    spans = handed_out(missing, 0.01, workers)
    assert [number for span in spans for number in range(span.first, span.end)] == missing
    sizes = np.array([span.end - span.first for span in spans])
    starts = np.array([span.first for span in spans])
    assert ((sizes == 1) | ((sizes % LEAF == 0) & (starts % sizes == 0))).all()
    assert sizes.max() * 0.01 <= SPAN_S
    assert sizes[0] == 1 and sizes.max() == {1: 256, 2: 256, 7: 128, 1000: 16}[workers]
    # At the end of the work no worker is left with a large share.
    left = len(missing) - np.cumsum(sizes) + sizes
    assert (sizes[sizes > LEAF] <= left[sizes > LEAF] / (2 * workers)).all()
    assert workers > 32 or (left[sizes == LEAF] >= LEAF * workers).all()


def one_by_one(n_obs):
    return [Span(number, number + 1) for number in range(n_obs)]


def test_slow_observations_go_one_by_one():
    assert handed_out(list(range(100)), SPAN_S / 10, 1) == one_by_one(100)
    assert handed_out(list(range(100)), 1e-9, 1, single=True) == one_by_one(100)


def test_few_observations_are_handed_out_before_one_has_told_its_time():
    spans = Spans(list(range(100)), single=False)
    assert [spans.take(1000)[1] for _ in range(8)] == one_by_one(8) and spans.take(1000) is None
    spans.measured(0.01)
    assert spans.take(1000) is not None and spans.left() == 91
    assert handed_out(list(range(100)), None, 1, single=True) == one_by_one(100)


def test_an_estimate_of_the_time_gives_leaves_until_one_is_timed():
    spans = Spans(list(range(500)), single=False, each_s=0.01)
    assert [spans.take(2)[1] for _ in range(2)] == [Span(0, 16), Span(16, 32)]
    spans.measured(0.01)
    assert spans.take(2)[1] == Span(32, 64)
    slow = Spans(list(range(500)), single=False, each_s=SPAN_S)
    assert slow.take(2)[1] == Span(0, 1)


def test_pickles_leave_out_what_follows_from_the_rest(setup, singles):
    """Sums are the same after the way between processes; those of single observations without signals are small."""
    for item in (singles[0], singles[50], node(setup, singles, 0, LEAF), node(setup, singles, LEAF, 2 * LEAF)):
        sent = pickle.dumps(item)
        same(pickle.loads(sent), item)
        assert {name: getattr(pickle.loads(sent), name).dtype for name in ARRAYS} == {
            name: getattr(item, name).dtype for name in ARRAYS
        }
    maps, of_splits = singles[50].sums.nbytes, singles[50].split_sums.nbytes + singles[50].split_weight.nbytes
    assert len(pickle.dumps(singles[50])) - of_splits < 1.6 * maps < len(pickle.dumps(singles[0])) - of_splits
