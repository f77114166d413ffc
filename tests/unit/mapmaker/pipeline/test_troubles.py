"""Troubles of real data: the map stays right, and everything that is left out is named."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from mapmaker.geometry import pixel_centres, plane_offsets
from mapmaker.pipeline.config import Config
from mapmaker.pipeline.run import clean_and_map
from tests.unit.mapmaker.pipeline.made import ARCMIN, N_DET, N_SCAN, WHITE_MK, N, changed, streams, written

DEAD, EMPTY, NOISY, QUIET, JUMPED, GLITCHED, STRANGE = 3, 7, 12, 16, 21, 10, 18
FILES = ("000.h5", "001.h5", "002.h5", "003.h5")
FIRST_SCAN = 100


def harm(data, bounds, rng):
    data[rng.random(data.shape) < 0.01] = np.nan
    data[NOISY] += 20 * rng.standard_normal(data.shape[1])
    data[STRANGE] = 0 * data[STRANGE] + WHITE_MK * rng.standard_normal(data.shape[1])
    data[QUIET] = 0.05 * rng.standard_normal(data.shape[1])
    data[JUMPED, bounds[4, 0] + 70 :] += 60.0
    data[GLITCHED, bounds[2, 0] + 33] += 300.0
    data[DEAD] = 77.0
    data[EMPTY] = np.nan


def rewritten(path, kind):
    """Store the data of a file in another type; integers have flags in place of NaN."""
    with h5py.File(path, "r+") as file:
        data = file["data"][()]
        del file["data"]
        file["data"] = np.nan_to_num(data).astype(kind)
        if "i" in kind:
            file["flags"] = np.isnan(data).astype(">i4")
        else:
            file["data"][...] = data


@pytest.fixture(scope="module", params=[(0.02, -30.0), pytest.param((70.0, 89.8), marks=pytest.mark.slow)], ids=str)
def pair(request, tmp_path_factory):
    """Results of unharmed files, and of harmed ones of other types and orders of detectors, one of them unreadable."""
    folder, centre, results = tmp_path_factory.mktemp("files"), request.param, []
    good = [streams(k, centre, first_scan=FIRST_SCAN) for k in range(4)]
    bad = []
    for k, item in enumerate(good):
        rng = np.random.default_rng(50 + k)
        item = changed(item, lambda data, bounds, rng=rng: harm(data, bounds, rng))
        item = replace(item, ra_rad=item.ra_rad + 2 * np.pi * (k - 1))
        order = rng.permutation(N_DET)
        bad.append(item.subset(order[order != 20] if k == 3 else order))
    section = {"centre": [f"{angle} deg" for angle in centre], "size": ["26 arcmin", "26 arcmin"]}
    for name, items in (("good", good), ("bad", bad)):
        (folder / name).mkdir()
        paths = written(folder / name, items)
        if name == "bad":
            rewritten(paths[0], ">f4")
            rewritten(paths[1], ">i2")
            paths.append(folder / "broken.h5")
            paths[-1].write_bytes(b"no file of time-streams")
        results.append(clean_and_map(paths, Config.model_validate({"map": section})))
    return results


def test_nothing_is_left_out_of_unharmed_files(pair):
    assert pair[0].dropped == () and all(item.used for item in pair[0].files)


def test_everything_that_is_left_out_is_named(pair):
    rows = [item for item in pair[1].dropped if item.what != "samples"]
    found = {(item.file, item.detector, item.scan, item.reason) for item in rows}
    expected = {("broken.h5", "", -1, "unreadable")}
    for file in FILES:
        whole = {DEAD: "constant", EMPTY: "no finite sample", NOISY: "noisy", STRANGE: "without the common signal"}
        whole[QUIET] = "constant" if file == "001.h5" else "too little noise"  # as integers, all its samples are 0
        expected |= {(file, f"d{detector:02d}", -1, reason) for detector, reason in whole.items()}
        expected.add((file, f"d{JUMPED}", FIRST_SCAN + 4, "jump"))
    assert found == expected


def test_lost_samples_are_counted(pair):
    for file in FILES:
        rows = [item for item in pair[1].dropped if item.file == file and item.what == "samples"]
        lost = {item.reason: item for item in rows if item.detector == f"d{GLITCHED}"}
        assert lost["glitch"].samples in (1, 2, 3)  # with its neighbours, if they are not lost before
        reason = "flagged in the file" if file == "001.h5" else "not a finite number"
        counts = [item.samples for item in rows if item.reason == reason]
        present = N_DET - 3 - (file == "003.h5")  # not the dead, the quiet and the empty one
        assert len(counts) == present and abs(np.mean(counts) - 0.01 * N * N_SCAN) < 4
    assert not [item for item in pair[1].dropped if item.reason == "off the map"]


def test_the_map_is_that_of_the_data_that_are_left(pair):
    """Maps of a part of the data differ from those of all by what the rest of the data averages to.

    The template of fewer detectors contains more of the source, which leaves a deeper ring about it.
    """
    good, bad = (result.maps.map for result in pair)
    far = np.hypot(*pixel_centres(bad.geometry))[None] > 5 * ARCMIN
    seen = far & (bad.weight > 0.3 * bad.weight.max())
    assert seen.sum() > 700  # the ratio scatters by 5 %
    expected = np.mean(1 / bad.weight[seen] - 1 / good.weight[seen])
    found = np.mean((bad.signal_mk - good.signal_mk)[seen] ** 2)
    assert 0.8 < found / expected < 1.25
    row, column = np.unravel_index(np.argmax(bad.signal_mk[0]), bad.signal_mk[0].shape)
    geometry = bad.geometry
    assert abs(row - geometry.n_y / 2) < 2 and abs(column - geometry.n_x / 2) < 2
    assert np.abs(plane_offsets(geometry, geometry.ra0_rad + 2 * np.pi, geometry.dec0_rad)).max() < 1e-12
    peak = (slice(None), slice(row - 1, row + 2), slice(column - 1, column + 2))
    assert bad.signal_mk[peak].mean() == pytest.approx(good.signal_mk[peak].mean(), rel=0.08)


def test_weights_are_the_measured_noise(pair):
    for result in pair:
        for item in result.detectors:
            assert item.weight == pytest.approx(item.noise_mk**-2)
    assert {item.n_det_used for item in pair[1].files if item.used} == {N_DET - 5, N_DET - 6}
