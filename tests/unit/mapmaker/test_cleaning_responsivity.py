"""Responsivities of template cleaning: of each scan, of an observation's scans together, and known ones."""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker import chunks
from mapmaker.cleaning import (
    TEMPLATE_CLEANINGS,
    PcaOptions,
    PolynomialOptions,
    TemplateOptions,
    WindOptions,
    clean,
    clean_in_order,
)
from mapmaker.cleaning import responsivity as module
from mapmaker.timestreams import FocalPlane
from tests import naive

N_DET, N_SAMP, N_SCAN = 25, 40, 6
BOUNDS = np.array([[45 * s, 45 * s + N_SAMP] for s in range(N_SCAN)])  # gaps of 5 samples
ORDERS = {"average": 0, "planar": 1, "quadratic": 2}
TEMPLATES = TemplateOptions(1e-10, 100)
OPTIONS = dict.fromkeys(ORDERS, TEMPLATES) | {
    "polynomial": PolynomialOptions(1, 2, 1e-10, 100),
    "wind": WindOptions(np.tile([1.0, -0.5], (N_SCAN, 1)), 10.0, 1e-10, 100),
}
PLANE = FocalPlane(*np.random.default_rng(0).uniform(-1e-3, 1e-3, (2, N_DET)), fwhm_rad=1.5e-4)


def _gains(seed=1):
    return 1 + 0.05 * np.random.default_rng(seed).standard_normal(N_DET)


def _shapes(order):
    x, y = PLANE.x_rad / 1e-3, PLANE.y_rad / 1e-3
    return np.array([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)]).T


def _data(order=0, noise=1.0, seed=2, strength=10.0):
    """Templates up to an order times the gains, and noise; the mean of a scan is anything."""
    rng, shapes = np.random.default_rng(seed), _shapes(order)
    templates = strength * rng.standard_normal((shapes.shape[1], BOUNDS[-1, 1]))
    templates[1:] *= 0.1
    return 40 + _gains()[:, None] * (shapes @ templates) + noise * rng.standard_normal((N_DET, BOUNDS[-1, 1]))


def _scans(data):
    """The scans side by side, each less its means."""
    parts = [data[:, start:stop] for start, stop in BOUNDS]
    return np.hstack([part - part.mean(axis=1, keepdims=True) for part in parts])


@pytest.mark.parametrize("asked", ["scan", "observation", "known"])
@pytest.mark.parametrize("name", TEMPLATE_CLEANINGS)
def test_every_cleaning_takes_every_responsivity(name, asked):
    data = _data().astype(np.float32)
    before = data.copy()
    options = replace(OPTIONS[name], responsivities=_gains() if asked == "known" else asked)
    found = clean(name, data, BOUNDS, PLANE, options=options)
    np.testing.assert_array_equal(data, before)
    assert found.kept.all() and found.data_mk.dtype == np.float32
    alike = (found.responsivity == found.responsivity[0]).all()
    assert alike == (asked != "scan")
    assert (found.iterations == 0).all() == (asked == "known")
    c = found.responsivity / found.responsivity.mean(axis=1, keepdims=True)
    if name in ("average", "wind"):  # the others hold c free of gradients where they fit it
        np.testing.assert_allclose(c, np.tile(_gains() / _gains().mean(), (N_SCAN, 1)), atol=0.08)
    # Fitted, given or neither: white noise of 1 is left, but for the templates.
    assert _scans(found.data_mk).std() == pytest.approx(1, abs=0.2)


@pytest.mark.parametrize("most", [N_DET, N_DET - 1], ids=["Gram matrix", "passes"])
@pytest.mark.parametrize("name", ORDERS)
def test_one_fit_to_all_scans_is_the_loop_over_their_samples(name, most, monkeypatch):
    """It ends where the paper's own iteration would, on all scans side by side."""
    monkeypatch.setattr(module, "MOST_GRAM", most)
    data, shapes = _data(2), _shapes(ORDERS[name])
    found = clean(name, data, BOUNDS, PLANE, options=replace(TEMPLATES, responsivities="observation"))
    expected, c, _ = naive.template_cleaning(_scans(data), shapes, name != "average", 1e-12, 1000)
    np.testing.assert_allclose(_scans(found.data_mk), expected, atol=1e-7)
    np.testing.assert_allclose(found.responsivity[0] / found.responsivity[0].mean(), c / c.mean(), rtol=1e-8)


def test_one_fit_finds_responsivities_within_their_noise():
    """c_i is a regression on the template: its error is sigma / sqrt(sum T^2) over all scans; of 500, rms to 13 %."""
    misses = []
    for seed in range(20):
        data = _data(seed=seed)
        common = _scans(np.tile(data.mean(axis=0), (2, 1)))[0]
        c = clean(
            "average", data, BOUNDS, PLANE, options=replace(TEMPLATES, responsivities="observation")
        ).responsivity[0]
        error = 1 / np.sqrt(np.sum(common**2) - common.size / N_DET)  # less the noise of the mean
        misses.append((c / c.mean() - _gains() / _gains().mean()) / error)
    assert np.std(misses) == pytest.approx(np.sqrt(1 - 1 / N_DET), rel=4 / np.sqrt(2 * 500))


@pytest.mark.parametrize("name", ["average", "planar", "quadratic", "polynomial"])
def test_known_responsivities_leave_nothing_of_the_templates(name):
    order = ORDERS.get(name, 1)
    found = clean(name, _data(order, noise=0.0), BOUNDS, PLANE, options=replace(OPTIONS[name], responsivities=_gains()))
    assert np.abs(found.data_mk).max() < 1e-12


@pytest.mark.parametrize("name", ORDERS)
def test_given_responsivities_are_a_projection(name):
    """Right ones or wrong ones: each scan less its mean, times 1 - P."""
    data, c = _data(2), np.exp(0.3 * np.random.default_rng(4).standard_normal(N_DET))
    found = clean(name, data, BOUNDS, PLANE, options=replace(TEMPLATES, responsivities=c))
    left = naive.cleaning_matrix(PLANE.x_rad, PLANE.y_rad, c, ORDERS[name])
    np.testing.assert_allclose(_scans(found.data_mk), left @ _scans(data), atol=1e-10)


@pytest.mark.parametrize("name", ["average", "quadratic", "polynomial"])
@pytest.mark.parametrize("bad", [None, 0.0, np.nan])
def test_known_responsivities_take_some_detectors_at_a_time(name, bad, monkeypatch):
    """Three rows at a time or all at once; a dead detector or a NaN in the second scan discards it."""
    data, options = _data(order=1), replace(OPTIONS[name], responsivities=_gains())
    if bad is not None:
        data[7, slice(*BOUNDS[1])] = bad
    whole = clean(name, data, BOUNDS, PLANE, options=options)
    monkeypatch.setattr(chunks, "CHUNK_SAMPLES", 6 * N_SAMP)
    found = clean(name, data, BOUNDS, PLANE, options=options)
    assert found.kept.tolist() == whole.kept.tolist() == [scan != 1 or bad is None for scan in range(N_SCAN)]
    np.testing.assert_allclose(found.data_mk, whole.data_mk, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.removed, whole.removed)
    basis, c = np.linalg.qr(_shapes(ORDERS.get(name, 1)))[0], _gains()[:, None]
    if name != "polynomial":
        scan = _scans(data)[:, :N_SAMP]
        np.testing.assert_allclose(found.data_mk[:, :N_SAMP], scan - c * (basis @ (basis.T @ (scan / c))), atol=1e-11)


@pytest.mark.parametrize("name, n_par", [("average", 1), ("planar", 3), ("quadratic", 6)])
def test_an_error_of_the_responsivities_leaves_as_much_of_the_template(name, n_par):
    """c (1 + e) instead of c: e times the template, less what the templates take of it; of 1000 errors, rms to 9 %."""
    data, left = _data(0, noise=0.0), []
    for seed in range(40):
        wrong = _gains() * (1 + 0.01 * np.random.default_rng(100 + seed).standard_normal(N_DET))
        left.append(_scans(clean(name, data, BOUNDS, PLANE, options=replace(TEMPLATES, responsivities=wrong)).data_mk))
    expected = 0.01 * np.sqrt(1 - n_par / N_DET) * _scans(data).std()
    assert np.std(left) == pytest.approx(expected, rel=4 / np.sqrt(2 * 40 * (N_DET - n_par)))


@pytest.mark.parametrize("name", ["average", "planar", "quadratic"])
def test_weak_templates_are_fitted_to_all_scans_alone(name):
    """A template as weak as its own noise: no scan has what it takes, all together have it in some thirty steps."""
    data = _data(strength=0.2)
    each = clean(name, data, BOUNDS, PLANE, options=TemplateOptions(1e-8, 100))
    together = clean(name, data, BOUNDS, PLANE, options=TemplateOptions(1e-8, 100, "observation"))
    assert each.kept.sum() < N_SCAN / 2
    assert together.kept.all() and (together.iterations < 40).all()


@pytest.mark.parametrize("most", [N_DET, 0], ids=["Gram matrix", "passes"])
@pytest.mark.parametrize("bad", [np.nan, 0.0])
@pytest.mark.parametrize("name", TEMPLATE_CLEANINGS)
def test_a_bad_scan_has_no_part_in_the_fit(name, bad, most, monkeypatch):
    monkeypatch.setattr(module, "MOST_GRAM", most)
    data, options = _data(), replace(OPTIONS[name], responsivities="observation")
    data[3, BOUNDS[2, 0] : BOUNDS[2, 1]] = bad
    found = clean(name, data, BOUNDS, PLANE, options=options)
    good = np.arange(N_SCAN) != 2
    np.testing.assert_array_equal(found.kept, good)
    if name == "wind":
        options = replace(options, slowness_s_rad=options.slowness_s_rad[good])
    others = clean(name, data, BOUNDS[good], PLANE, options=options)
    np.testing.assert_array_equal(found.data_mk, others.data_mk)
    np.testing.assert_array_equal(found.responsivity[good], others.responsivity)


@pytest.mark.parametrize("name", TEMPLATE_CLEANINGS)
def test_a_fit_that_does_not_converge_discards_all_scans(name):
    found = clean(
        name, _data(), BOUNDS, PLANE, options=replace(OPTIONS[name], max_iterations=1, responsivities="observation")
    )
    assert not found.kept.any() and (found.iterations == 1).all() and not found.data_mk.any()


def test_no_good_scan_is_no_fit():
    data = np.full((N_DET, BOUNDS[-1, 1]), np.nan)
    found = clean("average", data, BOUNDS, PLANE, options=replace(TEMPLATES, responsivities="observation"))
    assert not found.kept.any()


def test_in_order_the_responsivities_are_those_of_the_templates():
    steps = [("pca", PcaOptions(3.0)), ("average", replace(TEMPLATES, responsivities=_gains()))]
    np.testing.assert_array_equal(clean_in_order(steps, _data(), BOUNDS, PLANE).responsivity[0], _gains())


@pytest.mark.parametrize(
    "make", [lambda c: TemplateOptions(1e-8, 100, c), lambda c: PolynomialOptions(1, 1, 1e-8, 9, c)]
)
@pytest.mark.parametrize(
    "wrong, words",
    [
        ("survey", "responsivities must be 'scan', 'observation' or those of the detectors, got 'survey'"),
        (np.ones((2, 3)), r"responsivities: found the shape \(2, 3\); \(n_det,\) is expected"),
        (np.array([1.0, 0.0]), "a zero; finite numbers other than zero are expected"),
        (np.array([1.0, np.nan]), r"found nan at \[1\]; finite numbers are expected"),
    ],
)
def test_bad_responsivities(make, wrong, words):
    with pytest.raises(ValueError, match=words):
        make(wrong)


def test_responsivities_of_other_detectors():
    with pytest.raises(ValueError, match="24 responsivities found for 25 detectors"):
        clean("average", _data(), BOUNDS, PLANE, options=replace(TEMPLATES, responsivities=np.ones(24)))
