"""Lost samples: gaps are filled as by the naive twin, and maps leave them out."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

import mapmaker as mm
from mapmaker.errors import InputError
from mapmaker.formats.hdf5 import timestream_file
from tests import naive
from tests.unit.mapmaker.test_timestreams import N_DET, N_SAMP, part, path, streams  # noqa: F401


@pytest.fixture
def lost(streams):  # noqa: F811
    """Scattered samples, gaps at both ends of scans and of all detectors, a detector without a sample in a scan."""
    flags = np.random.default_rng(3).random((N_DET, N_SAMP)) < 0.2
    (first, end), (start, _), _ = streams.scan_bounds
    flags[0, first : first + 3] = flags[1, end - 2 : end] = flags[2, start : start + 10] = True
    flags[:, first + 4 : first + 6] = True
    return flags


def test_gaps_are_filled_as_by_the_twin(streams, lost):  # noqa: F811
    bounds = streams.scan_bounds
    lost[:, slice(*bounds[2])] = True
    for data in (streams.data_mk, streams.data_mk.astype(float)):
        filled = mm.fill_flagged(np.where(lost, np.nan, data).astype(data.dtype), bounds, lost)
        expected = naive.fill_flagged(data, bounds, lost)
        inside = np.zeros(N_SAMP, bool)
        for start, stop in bounds:
            inside[start:stop] = True
        np.testing.assert_allclose(filled[:, inside], expected[:, inside], rtol=1e-5, atol=1e-6)
        assert filled.dtype == data.dtype
        np.testing.assert_array_equal(filled[~lost], data[~lost])
        assert np.isnan(filled[:, slice(*bounds[2])]).all()


def test_a_common_signal_is_restored_whole(streams, lost):  # noqa: F811
    """Of detectors that differ by an offset alone."""
    air = 50 * np.cumsum(np.random.default_rng(4).normal(size=N_SAMP))
    lost[:, :] = lost & (np.arange(N_DET) < 4)[:, None]  # one detector always has a sample
    data = air + np.arange(N_DET)[:, None] * 7.0
    assert lost[2, slice(*streams.scan_bounds[1])].all()
    filled = mm.fill_flagged(data, streams.scan_bounds, lost)
    for start, stop in streams.scan_bounds:
        some = ~lost[:, start:stop].all(axis=1)
        np.testing.assert_allclose(filled[some, start:stop], data[some, start:stop], atol=1e-10 * np.abs(data).max())
        scan = filled[:, start:stop] - filled[:, start : start + 1]  # a detector without a sample: but for its offset
        np.testing.assert_allclose(scan, np.broadcast_to(scan[4], scan.shape), atol=1e-10 * np.abs(data).max())


def test_filling_is_linear(streams, lost):  # noqa: F811
    """So a signal in the data and the data without it differ by the filled signal."""
    signal = np.random.default_rng(5).normal(size=streams.data_mk.shape)
    data, bounds = streams.data_mk.astype(float), streams.scan_bounds
    both, one, other = (mm.fill_flagged(item, bounds, lost) for item in (data + signal, data, signal))
    np.testing.assert_allclose(both, one + other, atol=1e-12)


def test_maps_leave_lost_samples_out(streams, lost):  # noqa: F811
    geometry = mm.covering_geometry(0.8, 0.8, 0.05, 1.0)
    every = mm.pixel_indices(geometry, streams)
    some = mm.pixel_indices(geometry, replace(streams, flags=lost))
    np.testing.assert_array_equal(some, np.where(lost, -1, every))
    kept, bounds = np.ones(3, bool), streams.scan_bounds
    item = mm.bin_map(geometry, streams.data_mk, some, bounds, kept=kept)
    inside = np.concatenate([np.arange(*pair) for pair in bounds])
    good = (~lost & (every >= 0))[:, inside]
    assert 0 < item.hits.sum() == good.sum() < good.size
    np.testing.assert_allclose(item.weighted_sum.sum(), streams.data_mk[:, inside][good].sum(), rtol=1e-5)


def test_flags_are_in_the_file(path, streams, lost, tmp_path):  # noqa: F811
    """A file without flags has none; parts and subsets keep them."""
    assert mm.read_timestreams(path).flags is None
    flagged = replace(streams, flags=lost)
    mm.write_timestreams(tmp_path / "lost.h5", flagged)
    again = mm.read_timestreams(tmp_path / "lost.h5")
    assert again.flags.dtype == bool
    np.testing.assert_array_equal(again.flags, lost)
    np.testing.assert_array_equal(again.subset(np.array([3, 1])).flags, lost[[3, 1]])
    halves = [replace(part(streams, s), flags=lost[:, s]) for s in (slice(0, 30), slice(30, N_SAMP))]
    with timestream_file(tmp_path / "halves.h5", N_SAMP) as add:
        for half in halves:
            add(half)
    np.testing.assert_array_equal(mm.read_timestreams(tmp_path / "halves.h5").flags, lost)
    with pytest.raises(ValueError, match="flags in all parts or none"), timestream_file(path, N_SAMP) as add:
        add(halves[0])
        add(part(streams, slice(30, N_SAMP)))


@pytest.mark.parametrize("wrong", [np.zeros((N_DET, N_SAMP)), np.zeros((N_DET, N_SAMP - 1), bool)])
def test_other_flags_are_refused(streams, wrong):  # noqa: F811
    with pytest.raises(ValueError, match="flags: found"):
        replace(streams, flags=wrong)
    with pytest.raises(ValueError, match="flagged: found"):
        mm.fill_flagged(streams.data_mk, streams.scan_bounds, wrong)


@pytest.mark.parametrize("values", [np.full((N_DET, N_SAMP), 2), np.zeros((N_DET, 3), np.uint8), np.zeros(N_DET)])
def test_other_flags_of_files_are_refused(path, values):  # noqa: F811
    with h5py.File(path, "a") as file:
        file["flags"] = values
    with pytest.raises(InputError, match=f"^{path}: .*flags"):
        mm.read_timestreams(path)
