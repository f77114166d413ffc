"""Template cleaning: table, options, bad input, discarded scans, twins."""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker.cleaning import (
    ALGORITHMS,
    TIME_FILTERS,
    HighpassOptions,
    LocalOptions,
    NotchOptions,
    PcaOptions,
    PolynomialOptions,
    SpectralOptions,
    TemplateOptions,
    TimePolynomialOptions,
    WindOptions,
    clean,
    detectors_needed,
)
from mapmaker.cleaning.polynomial import exponents
from mapmaker.cleaning.templates import PLANAR, QUADRATIC, template_basis
from mapmaker.timestreams import FocalPlane
from tests import naive

TEMPLATE_OPTIONS = TemplateOptions(tolerance=1e-8, max_iterations=100)
BOUNDS = np.array([[0, 50], [50, 90], [95, 140]])  # samples 90-94 and 140-149 are outside scans
N_SAMP = 150
TEMPLATES = ["average", "planar", "quadratic"]
CHOSEN = dict.fromkeys(["none", *TEMPLATES], TEMPLATE_OPTIONS) | {
    "polynomial": PolynomialOptions(1, 2, 1e-8, 100),
    "wind": WindOptions(np.array([[20.0, -10.0], [15.0, 0.0], [-20.0, 10.0]]), 10.0, 1e-8, 100),
    "pca": PcaOptions(3.0),
    "local": LocalOptions(neighbour_radius=10.0),
    "spectral": SpectralOptions(np.random.default_rng(7).standard_normal((2, 25, N_SAMP))),
    "highpass": HighpassOptions(0.05, 1.0),
    "notch": NotchOptions((0.2,), (0.0,), 1.0),
    "time_polynomial": TimePolynomialOptions(2),
}
FITTED = ["average", "planar", "quadratic", "polynomial", "wind"]


def _focal_plane(n_det=25, seed=0):
    x, y = np.random.default_rng(seed).uniform(-1e-3, 1e-3, (2, n_det))
    return FocalPlane(x_rad=x, y_rad=y, fwhm_rad=1.5e-4)


def _data(seed=1, n_det=25, dtype=np.float64):
    rng = np.random.default_rng(seed)
    common = 10 * rng.standard_normal(N_SAMP)
    c = 1 + 0.05 * rng.standard_normal((n_det, 1))
    return (40 + c * common + rng.standard_normal((n_det, N_SAMP))).astype(dtype)


def _shapes(focal_plane, name):
    x, y = focal_plane.x_rad, focal_plane.y_rad
    n_par = {"average": 1, "planar": 3, "quadratic": 6}[name]
    x, y = x / 1e-3, y / 1e-3  # the twin inverts S^T S, so it gets coordinates of order one
    return np.stack([np.ones_like(x), x, y, x * y, x**2, y**2], axis=1)[:, :n_par]


def _outside():
    outside = np.ones(N_SAMP, dtype=bool)
    for start, stop in BOUNDS:
        outside[start:stop] = False
    return outside


def test_none_removes_the_scan_mean_only():
    data = _data()
    cleaned = clean("none", data, BOUNDS, _focal_plane(), options=None)
    for start, stop in BOUNDS:
        scan = data[:, start:stop]
        np.testing.assert_allclose(cleaned.data_mk[:, start:stop], scan - scan.mean(axis=1, keepdims=True))
    assert cleaned.kept.all() and (cleaned.iterations == 0).all()
    assert (cleaned.responsivity == 1).all()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", ALGORITHMS)
def test_keeps_type_input_and_gaps(name, dtype):
    data = _data(dtype=dtype)
    before = data.copy()
    cleaned = clean(name, data, BOUNDS, _focal_plane(), options=CHOSEN[name])
    assert cleaned.data_mk.dtype == dtype and cleaned.data_mk.shape == data.shape
    assert cleaned.kept.all() and cleaned.responsivity.shape == (3, 25)
    np.testing.assert_array_equal(data, before)
    np.testing.assert_array_equal(cleaned.data_mk[:, _outside()], 0)


def test_average_is_the_paper_s_own_equations():
    """Its template has another common factor; converged to rounding, c_i T_n is the same to rounding."""
    data = _data()
    cleaned = clean("average", data, BOUNDS, _focal_plane(), options=TemplateOptions(1e-14, 100))
    for s, (start, stop) in enumerate(BOUNDS):
        expected, c = naive.average_cleaning(data[:, start:stop], 1e-14, 100)
        np.testing.assert_allclose(cleaned.data_mk[:, start:stop], expected, atol=1e-12)
        ratio = cleaned.responsivity[s] / c
        np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)


@pytest.mark.parametrize("name", TEMPLATES)
def test_equals_the_loop_over_samples(name):
    data, focal_plane = _data(), _focal_plane()
    cleaned = clean(name, data, BOUNDS, focal_plane, options=TEMPLATE_OPTIONS)
    for s, (start, stop) in enumerate(BOUNDS):
        scan = data[:, start:stop]
        shapes = _shapes(focal_plane, name)
        expected, c, steps = naive.template_cleaning(scan, shapes, name != "average", 1e-8, 100)
        np.testing.assert_allclose(cleaned.data_mk[:, start:stop], expected, atol=1e-10)
        np.testing.assert_allclose(cleaned.responsivity[s], c, rtol=1e-10)
        assert cleaned.iterations[s] == steps


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ALGORITHMS)
def test_scan_with_a_value_not_finite_is_discarded(name, bad):
    data = _data(dtype=np.float32)
    good = clean(name, data, BOUNDS, _focal_plane(), options=CHOSEN[name])
    data[7, 60] = bad
    cleaned = clean(name, data, BOUNDS, _focal_plane(), options=CHOSEN[name])
    np.testing.assert_array_equal(cleaned.kept, [True, False, True])
    assert np.isnan(cleaned.responsivity[1]).all() and cleaned.iterations[1] == 0 and cleaned.removed[1] == 0
    expected = good.data_mk.copy()
    expected[:, 50:90] = 0
    np.testing.assert_array_equal(cleaned.data_mk, expected)


def test_value_not_finite_outside_scans_does_not_matter():
    data = _data()
    data[:, _outside()] = np.nan
    cleaned = clean("planar", data, BOUNDS, _focal_plane(), options=TEMPLATE_OPTIONS)
    assert cleaned.kept.all() and np.isfinite(cleaned.data_mk).all()


@pytest.mark.parametrize("stuck_at_mk", [0.0, 40.1])
@pytest.mark.parametrize("name", [name for name in ALGORITHMS if name not in ("none", *TIME_FILTERS)])
def test_scan_with_a_dead_detector_is_discarded(name, stuck_at_mk):
    data = _data()
    data[3, 50:90] = stuck_at_mk
    cleaned = clean(name, data, BOUNDS, _focal_plane(), options=CHOSEN[name])
    np.testing.assert_array_equal(cleaned.kept, [True, False, True])
    np.testing.assert_array_equal(cleaned.data_mk[:, 50:90], 0)
    assert np.isfinite(cleaned.data_mk).all() and cleaned.iterations[1] == 0


@pytest.mark.parametrize("name", [name for name in ALGORITHMS if name not in ("none", *TIME_FILTERS)])
def test_all_zero_scan_is_discarded(name):
    data = _data()
    data[:, 50:90] = 0
    cleaned = clean(name, data, BOUNDS, _focal_plane(), options=CHOSEN[name])
    np.testing.assert_array_equal(cleaned.kept, [True, False, True])
    np.testing.assert_array_equal(cleaned.data_mk[:, 50:90], 0)


@pytest.mark.parametrize("name", FITTED)
def test_unconverged_scans_are_discarded_and_counted(name):
    cleaned = clean(name, _data(), BOUNDS, _focal_plane(), options=replace(CHOSEN[name], max_iterations=1))
    assert (~cleaned.kept).sum() == 3
    np.testing.assert_array_equal(cleaned.iterations, 1)
    np.testing.assert_array_equal(cleaned.removed, 0)
    np.testing.assert_array_equal(cleaned.data_mk, 0)
    assert np.isnan(cleaned.responsivity).all()


@pytest.mark.parametrize("name", ALGORITHMS)
def test_templates_taken_are_counted(name):
    taken = {"none": 0, "average": 1, "planar": 3, "quadratic": 6, "polynomial": 6, "wind": 1, "pca": 1, "local": 1}
    taken["spectral"] = 2  # one for each other band
    # Cosines below the corner in scans of 50, 40 and 45 samples, the cosine and sine of a line, two powers.
    taken |= {"highpass": [4, 3, 4], "notch": 2, "time_polynomial": 2}
    cleaned = clean(name, _data(), BOUNDS, _focal_plane(), options=CHOSEN[name])
    np.testing.assert_array_equal(cleaned.removed, taken[name])
    assert (cleaned.iterations > 0).all() == (name in FITTED)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_observation_without_scans(name):
    options = replace(CHOSEN["wind"], slowness_s_rad=np.zeros((0, 2))) if name == "wind" else CHOSEN[name]
    cleaned = clean(name, _data(), BOUNDS[:0], _focal_plane(), options=options)
    assert len(cleaned.kept) == 0 and not cleaned.data_mk.any()


def test_each_detector_has_its_own_bands():
    assert detectors_needed("spectral", CHOSEN["spectral"]) == 1


@pytest.mark.parametrize("name", [name for name in ALGORITHMS if name != "spectral"])
def test_detectors_needed(name):
    needed = detectors_needed(name, CHOSEN[name])
    alone = dict.fromkeys(("none", *TIME_FILTERS), 1)
    assert needed == (alone | {"planar": 4, "quadratic": 7, "polynomial": 8, "pca": 11}).get(name, 2)
    clean(name, _data(n_det=needed), BOUNDS, _focal_plane(needed), options=CHOSEN[name])
    if name not in alone:
        with pytest.raises(ValueError, match="at least"):
            clean(name, _data(n_det=needed - 1), BOUNDS, _focal_plane(needed - 1), options=CHOSEN[name])


@pytest.mark.parametrize(("name", "n_par"), [("average", 1), ("planar", 3), ("quadratic", 6)])
def test_too_few_detectors(name, n_par):
    with pytest.raises(ValueError, match=f"at least {n_par + 1} detectors, got {n_par}"):
        clean(name, _data(n_det=n_par), BOUNDS, _focal_plane(n_par), options=TEMPLATE_OPTIONS)
    clean(name, _data(n_det=n_par + 1), BOUNDS, _focal_plane(n_par + 1), options=TEMPLATE_OPTIONS)


def test_detectors_on_a_line_do_not_support_planes():
    x = np.linspace(-1e-3, 1e-3, 25)
    line = FocalPlane(x_rad=x, y_rad=0.3 * x + 1e-4, fwhm_rad=1e-4)
    with pytest.raises(ValueError, match="support 2 independent templates, need 3"):
        clean("planar", _data(), BOUNDS, line, options=TEMPLATE_OPTIONS)
    assert clean("average", _data(), BOUNDS, line, options=TEMPLATE_OPTIONS).kept.all()


def test_detectors_on_a_circle_do_not_support_quadratics():
    angle = np.linspace(0, 6, 25)
    circle = FocalPlane(x_rad=1e-3 * np.cos(angle), y_rad=1e-3 * np.sin(angle), fwhm_rad=1e-4)
    with pytest.raises(ValueError, match="support 5 independent templates, need 6"):
        clean("quadratic", _data(), BOUNDS, circle, options=TEMPLATE_OPTIONS)


@pytest.mark.parametrize("exponents", [PLANAR, QUADRATIC])
def test_basis_is_orthonormal_and_constant_first(exponents):
    basis = template_basis(_focal_plane(), exponents)
    np.testing.assert_allclose(basis @ basis.T, np.eye(len(exponents)), atol=1e-14)
    np.testing.assert_allclose(basis[0], basis[0, 0], rtol=1e-13)


@pytest.mark.parametrize("order", [2, 6, 16])
def test_basis_of_any_order_keeps_its_digits(order):
    """The rows are orthonormal and span the products of Legendre polynomials of that order, to rounding."""
    focal_plane = _focal_plane(1000)
    x, y = (axis / np.abs(axis).max() for axis in (focal_plane.x_rad, focal_plane.y_rad))
    basis = template_basis(focal_plane, exponents(order))
    products = np.polynomial.legendre.legvander2d(x, y, (order, order)).reshape(1000, order + 1, order + 1)
    wanted = np.array([products[:, a, b] for a, b in exponents(order)])
    np.testing.assert_allclose(basis @ basis.T, np.eye(len(basis)), atol=1e-13)
    np.testing.assert_allclose(wanted - (wanted @ basis.T) @ basis, 0, atol=1e-10)


@pytest.mark.parametrize(("off", "supports"), [(1e-5, True), (1e-8, False)])
def test_positions_count_to_a_millionth(off, supports):
    rng, x = np.random.default_rng(3), np.linspace(-1e-3, 1e-3, 25)
    nearly = FocalPlane(x_rad=x, y_rad=1e-3 * off * rng.standard_normal(25), fwhm_rad=1e-4)
    if supports:
        assert template_basis(nearly, PLANAR).shape == (3, 25)
    else:
        with pytest.raises(ValueError, match="too close to it"):
            template_basis(nearly, PLANAR)


@pytest.mark.parametrize("options", [(0.0, 10), (-1.0, 10), (np.nan, 10), (1e-8, 0)])
def test_options_out_of_range(options):
    with pytest.raises(
        ValueError,
        match="tolerance: found .* a finite number above 0|max_iterations: found 0; an integer of at least 1",
    ):
        TemplateOptions(*options)


def test_bad_arguments_say_what_was_found():
    data, focal_plane = _data(), _focal_plane()
    with pytest.raises(
        ValueError,
        match="'cubic', allowed: none, average, planar, quadratic, polynomial, wind, pca, local, spectral, highpass",
    ):
        clean("cubic", data, BOUNDS, focal_plane, options=TEMPLATE_OPTIONS)
    with pytest.raises(ValueError, match="options of 'pca' must be PcaOptions, got TemplateOptions"):
        clean("pca", data, BOUNDS, focal_plane, options=TEMPLATE_OPTIONS)
    with pytest.raises(ValueError, match="'cubic', allowed"):
        detectors_needed("cubic", TEMPLATE_OPTIONS)
    with pytest.raises(ValueError, match=r"data_mk: found the shape \(24, 150\); \(25, n_samp\) is expected"):
        clean("planar", data[:24], BOUNDS, focal_plane, options=TEMPLATE_OPTIONS)
    with pytest.raises(ValueError, match="data_mk: found the type complex128; real numbers are expected"):
        clean("planar", data.astype(complex), BOUNDS, focal_plane, options=TEMPLATE_OPTIONS)
    with pytest.raises(ValueError, match=r"scan_bounds: found the shape \(2,\); \(n_scan, 2\) is expected"):
        clean("planar", data, BOUNDS[0], focal_plane, options=TEMPLATE_OPTIONS)
    for wrong in ([5, 5], [-1, 5], [100, 151]):
        with pytest.raises(ValueError, match="0 <= start < stop <= 150, the number of samples, is expected"):
            clean("planar", data, np.array([wrong]), focal_plane, options=TEMPLATE_OPTIONS)
