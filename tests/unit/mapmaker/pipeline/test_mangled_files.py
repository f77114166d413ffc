"""Any data of valid files give finite maps with reasons for what is missing, or one line for each file."""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker.errors import InputError
from mapmaker.pipeline.config import Config
from mapmaker.pipeline.dropped import EXPLANATIONS
from mapmaker.pipeline.run import clean_and_map
from tests.unit.mapmaker.pipeline.made import streams, written

STEPS = ("none", "average", "planar", "quadratic", "pca", "local", "time_polynomial")
BASE = [streams(k) for k in range(2)]


def scaled(data, rng):
    data *= rng.choice([1e-30, 1e-9, 1e8, 1e14])


def emptied(data, rng):
    data[:] = rng.choice([0, 7.0])


def some(data, rng):
    """Some detector, and a part of the samples."""
    first, last = np.sort(rng.integers(0, data.shape[1], 2))
    return rng.integers(len(data)), slice(first, last)


def put(value, whole_detector=False, all_detectors=False):
    def change(data, rng):
        detector, samples = some(data, rng)
        data[slice(None) if all_detectors else detector, slice(None) if whole_detector else samples] = value

    return change


def step(data, rng):
    detector, samples = some(data, rng)
    data[detector, samples.start :] += 1e6


def holes(data, rng):
    data[rng.random(data.shape) < 0.5] = np.nan


def alike(data, rng):
    data[:] = data[0]


def rounded(data, rng):
    data[:] = 50 * np.round(data / 50)


CHANGES = [scaled, emptied, step, holes, alike, rounded, put(np.nan), put(np.inf), put(np.nan, True), put(0.0, True)]
CHANGES += [put(1e30, True), put(np.nan, False, True)]


def scans(scan, rng):
    """Other scans: none, one, one a sample, some missing."""
    kinds = [np.full_like(scan, -1), np.zeros_like(scan), np.arange(len(scan)), np.where(scan % 3 == 0, -1, scan)]
    return kinds[rng.integers(len(kinds))]


@pytest.mark.parametrize("seed", [*range(10), *(pytest.param(k, marks=pytest.mark.slow) for k in range(10, 60))])
@pytest.mark.filterwarnings("ignore")
def test_mangled_files(seed, tmp_path):
    rng, items = np.random.default_rng(seed), []
    for item in BASE[: rng.integers(1, 3)]:
        data = item.data_mk.copy()
        for change in rng.choice(np.array(CHANGES, object), rng.integers(0, 4)):
            change(data, rng)
        scan = scans(item.scan, rng) if rng.random() < 0.2 else item.scan
        made = replace(item, data_mk=np.clip(data, -1e30, 1e30), scan=scan)
        items.append(made.subset(np.arange(rng.integers(1, 6))) if rng.random() < 0.2 else made)
    makers = ("binned", "iterative") if seed < 10 else ("binned", "iterative", "destriped", "maximum_likelihood")
    steps = [{"algorithm": str(name)} for name in rng.choice(STEPS, rng.integers(1, 3))]
    for item in steps:
        item |= {"order": 2} if item["algorithm"] == "time_polynomial" else {}
    section = {"maker": str(rng.choice(makers)), "weights": str(rng.choice(["detector", "file", "uniform"]))}
    config = {"cleaning": steps, "map": section, "flags": {"max_lost": float(rng.choice([0.1, 0.5, 1.0]))}}
    try:
        result = clean_and_map(written(tmp_path, items), Config.model_validate(config))
    except InputError as error:
        lines = str(error).split("\n")
        if section["maker"] == "iterative" and "its last cleaning discarded all scans" in lines[0]:
            return
        assert lines[0] == "nothing is left to map" and len(lines) == 1 + len(items)
        return
    for item in (result.maps.map, *result.maps.noise):
        assert np.isfinite(item.signal_mk).all() and np.isfinite(item.weight).all()
    assert result.spectra is None or np.isfinite(result.spectra.psd_mk2).all()
    assert {row.reason for row in result.dropped} <= EXPLANATIONS.keys()
    unused = {item.name for item in result.files if not item.used}
    assert unused == {row.file for row in result.dropped if row.what == "file"}
