"""Several algorithms one after the other."""

import numpy as np
import pytest

from mapmaker.cleaning import LocalOptions, PcaOptions, TemplateOptions, clean, clean_in_order
from mapmaker.timestreams import FocalPlane

N_DET = 20
BOUNDS = np.array([[0, 50], [50, 90], [95, 140]])
AVERAGE = ("average", TemplateOptions(1e-8, 100))
PLANAR = ("planar", TemplateOptions(1e-8, 100))
LOCAL = ("local", LocalOptions(neighbour_radius=5.0))
PCA = ("pca", PcaOptions(2.0))


def _plane():
    x, y = np.random.default_rng(0).uniform(-1e-3, 1e-3, (2, N_DET))
    return FocalPlane(x_rad=x, y_rad=y, fwhm_rad=1.5e-4)


def _data(dtype=np.float64):
    rng = np.random.default_rng(1)
    c = 1 + 0.05 * rng.standard_normal((N_DET, 1))
    return (c * 20 * rng.standard_normal(150) + rng.standard_normal((N_DET, 150))).astype(dtype)


@pytest.mark.parametrize("step", [("none", None), AVERAGE, LOCAL, PCA])
def test_one_step_is_that_step(step):
    found, expected = (
        clean_in_order([step], _data(), BOUNDS, _plane()),
        clean(step[0], _data(), BOUNDS, _plane(), options=step[1]),
    )
    for name in ("data_mk", "kept", "responsivity", "iterations", "removed"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_steps_follow_each_other(dtype):
    data = _data(dtype)
    before = data.copy()
    found = clean_in_order([PLANAR, LOCAL], data, BOUNDS, _plane())
    first = clean(PLANAR[0], data, BOUNDS, _plane(), options=PLANAR[1])
    second = clean(LOCAL[0], first.data_mk, BOUNDS, _plane(), options=LOCAL[1])
    np.testing.assert_array_equal(data, before)
    np.testing.assert_array_equal(found.data_mk, second.data_mk)
    np.testing.assert_array_equal(found.responsivity, first.responsivity)
    np.testing.assert_array_equal(found.iterations, first.iterations)
    np.testing.assert_array_equal(found.removed, 4)
    assert found.data_mk.dtype == dtype and found.kept.all()


def test_responsivity_is_that_of_the_step_that_fits_one():
    found = clean_in_order([("none", None), AVERAGE], _data(), BOUNDS, _plane())
    alone = clean(AVERAGE[0], _data(), BOUNDS, _plane(), options=AVERAGE[1])
    np.testing.assert_allclose(found.responsivity, alone.responsivity, rtol=1e-11)
    np.testing.assert_array_equal(found.removed, alone.removed)


def test_eigenvalues_that_a_first_step_made_zero_do_not_count():
    """Average, then PCA: a second common signal still stands out, float32 rounding of the first step or not."""
    rng = np.random.default_rng(2)
    contrast = rng.standard_normal((N_DET, 1)) * 10 * rng.standard_normal(150)
    for dtype in (np.float32, np.float64):
        data = (_data() + contrast).astype(dtype)
        found = clean_in_order([AVERAGE, ("pca", PcaOptions(3.0))], data, BOUNDS[:1], _plane())
        assert found.kept.all()
        np.testing.assert_array_equal(found.removed, 2)


@pytest.mark.parametrize(
    "steps", [[("none", None), AVERAGE], [AVERAGE, ("none", None)], [AVERAGE, LOCAL], [LOCAL, PCA]]
)
def test_a_scan_that_one_step_discards_is_discarded(steps):
    data = _data()
    data[4, 50:90] = 0  # dead, which "none" does not mind
    found = clean_in_order(steps, data, BOUNDS, _plane())
    np.testing.assert_array_equal(found.kept, [True, False, True])
    assert np.isnan(found.responsivity[1]).all() and found.removed[1] == 0
    assert not found.data_mk[:, 50:90].any() and found.data_mk[:, :50].any()


def test_bad_steps():
    with pytest.raises(ValueError, match="no cleaning steps found"):
        clean_in_order([], _data(), BOUNDS, _plane())
    with pytest.raises(ValueError, match="unknown cleaning 'cubic'"):
        clean_in_order([AVERAGE, ("cubic", None)], _data(), BOUNDS, _plane())
    with pytest.raises(ValueError, match="options of 'local' must be LocalOptions, got NoneType"):
        clean_in_order([AVERAGE, ("local", None)], _data(), BOUNDS, _plane())
