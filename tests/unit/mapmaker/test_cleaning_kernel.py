"""The kernels of cleaning against their sample-by-sample twins."""

import numpy as np
import pytest

from mapmaker.cleaning import TemplateOptions, clean, responsivity
from mapmaker.kernels.cleaning import (
    DISCARDED,
    GIVEN_UP,
    KEPT,
    clean_on_streams,
    iterate_responsivity,
    remove_means,
    subtract_templates,
)
from mapmaker.timestreams import FocalPlane
from tests import naive

N_DET, N_SAMP = 20, 60


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def _scan(seed, n_par, noise=0.3):
    """Shapes with a constant first column, and a mean-removed scan with gradients, scatter of c and noise."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1, 1, (2, N_DET))
    shapes = np.stack([np.ones(N_DET), x, y, x * y, x * x, y * y], axis=1)
    amplitude = np.array([1, 0.3, 0.3, 0.1, 0.1, 0.1])[:, None] * rng.standard_normal((6, N_SAMP))
    c = 1 + 0.05 * rng.standard_normal((N_DET, 1))
    data = c * (shapes @ amplitude) + noise * rng.standard_normal((N_DET, N_SAMP))
    return shapes[:, :n_par], data - data.mean(axis=1, keepdims=True)


def _iterate(data, shapes, n_held, tolerance, max_iterations):
    basis = np.ascontiguousarray(np.linalg.qr(shapes)[0].T)
    c = np.ones(N_DET)
    held = basis[len(basis) - n_held :]
    converged, steps = iterate_responsivity(data @ data.T, basis, held, tolerance, max_iterations, 1.0, c)
    cleaned = data - (basis * c).T @ ((basis / c) @ data)
    return cleaned, c, converged, steps


@pytest.mark.parametrize("n_par", [1, 3, 6])
@pytest.mark.parametrize("seed", [0, 1])
def test_equals_the_loop_over_samples(n_par, seed):
    shapes, data = _scan(seed, n_par)
    cleaned, c, converged, steps = _iterate(data, shapes, n_par - 1, 1e-8, 100)
    expected, expected_c, expected_steps = naive.template_cleaning(data, shapes, n_par > 1, 1e-8, 100)
    assert converged and steps == expected_steps
    np.testing.assert_allclose(c, expected_c, rtol=1e-11)
    np.testing.assert_allclose(cleaned, expected, atol=1e-11)


def test_without_held_shapes_equals_the_literal_loop():
    shapes, data = _scan(2, 3)
    cleaned, c, converged, steps = _iterate(data, shapes, 0, 1e-4, 1000)
    expected, expected_c, expected_steps = naive.template_cleaning(data, shapes, False, 1e-4, 1000)
    assert converged and steps == expected_steps
    np.testing.assert_allclose(c, expected_c, rtol=1e-9)
    np.testing.assert_allclose(cleaned, expected, atol=1e-9)


def test_held_components_vanish_and_mean_is_one():
    shapes, data = _scan(3, 6)
    _, c, converged, _ = _iterate(data, shapes, 5, 1e-8, 100)
    fit = np.linalg.lstsq(shapes, c, rcond=None)[0]
    assert converged
    np.testing.assert_allclose(fit, [1, 0, 0, 0, 0, 0], atol=1e-13)


def test_gives_up_after_max_iterations():
    shapes, data = _scan(4, 1)
    _, _, converged, steps = _iterate(data, shapes, 0, 1e-8, 2)
    assert not converged and steps == 2


@pytest.mark.parametrize(("fill", "expected_steps"), [(0.0, 0), (np.nan, 1), (np.inf, 0)])
def test_singular_gram_matrix_ends_unconverged(fill, expected_steps):
    basis = np.full((1, N_DET), N_DET**-0.5)
    c = np.ones(N_DET)
    converged, steps = iterate_responsivity(np.full((N_DET, N_DET), fill), basis, basis[1:], 1e-8, 100, 1.0, c)
    assert not converged and steps == expected_steps


def test_vanishing_responsivity_ends_unconverged():
    """The third detector's correlation with the template is exactly zero."""
    gram = np.array([[2.0, 2.0, -1.0], [2.0, 2.0, -1.0], [-1.0, -1.0, 2.0]])
    basis = np.full((1, 3), 3**-0.5)
    converged, steps = iterate_responsivity(gram, basis, basis[1:], 1e-8, 100, 1.0, np.ones(3))
    assert not converged and steps == 1


# ---------------------------------------------------------------- passes over the stream


@pytest.mark.parametrize("n_par", [1, 3, 6])
def test_passes_over_the_stream_do_what_the_gram_matrix_does(n_par, monkeypatch):
    shapes, data = _scan(5, n_par)
    basis = np.ascontiguousarray(np.linalg.qr(shapes)[0].T)
    found = []
    for most in (N_DET, N_DET - 1):
        monkeypatch.setattr(responsivity, "MOST_GRAM", most)
        found.append(responsivity.fit_responsivity(lambda: (data,), basis, TemplateOptions(1e-8, 100)))
    (by_gram, steps), (by_passes, as_many) = found
    assert steps == as_many > 2
    np.testing.assert_allclose(by_passes, by_gram, rtol=1e-11)


@pytest.mark.parametrize("most", [0, 1000], ids=["given up at once", "never given up"])
@pytest.mark.parametrize("n_par", [1, 3, 6])
def test_passes_over_a_scan_do_what_the_gram_matrix_does(n_par, most):
    """Of two scans, one of them not finite: c, iterations and what is left, or the scan given up."""
    shapes, data = _scan(5, n_par)
    basis = np.ascontiguousarray(np.linalg.qr(shapes)[0].T)
    expected = np.ones(N_DET)
    converged, steps = iterate_responsivity(data @ data.T, basis, basis[1:], 1e-8, 100, 1.0, expected)
    assert converged and steps > 3
    bounds, streams = np.array([[0, 30], [30, 30 + N_SAMP]]), np.hstack([np.ones((N_DET, 30)), data + 7.0])
    streams[4, 3] = np.nan
    for limit in (100, steps - 1):
        c, cleaned = np.ones((2, N_DET)), np.zeros(streams.shape)
        iterations, outcome = np.empty((2, 2), np.int64)
        clean_on_streams(streams, bounds, basis, basis[1:], 1e-8, limit, 1.0, most, c, cleaned, iterations, outcome)
        assert (iterations[0], outcome[0]) == (0, DISCARDED)
        if most == 0:
            assert (iterations[1], outcome[1]) == (3, GIVEN_UP)
        elif limit < steps:
            assert (iterations[1], outcome[1]) == (limit, DISCARDED)
        else:
            assert (iterations[1], outcome[1]) == (steps, KEPT)
            np.testing.assert_allclose(c[1], expected, rtol=1e-11)
            template = (basis / expected) @ data
            np.testing.assert_allclose(cleaned[:, 30:], data - (basis * expected).T @ template, atol=1e-10)


@pytest.mark.parametrize("few", [0, 1000])
def test_scans_that_are_given_up_are_cleaned_alike(few, monkeypatch):
    """By the Gram matrix or on the streams, from a first guess or from 1: the same c and streams."""
    plane = FocalPlane(*np.random.default_rng(3).uniform(-1e-3, 1e-3, (2, N_DET)), 1e-4)
    data, bounds = np.hstack([_scan(seed, 1)[1] for seed in (5, 8)]), np.array([[0, N_SAMP], [N_SAMP, 2 * N_SAMP]])
    expected = clean("average", data, bounds, plane, options=TemplateOptions(1e-12, 100))
    monkeypatch.setattr(responsivity, "_FEW_ITERATIONS", few)
    guess = expected.responsivity * (1 + 1e-6)
    found = clean("average", data, bounds, plane, options=TemplateOptions(1e-12, 100, first_guess=guess))
    assert found.kept.all() and (found.iterations < expected.iterations).all()
    np.testing.assert_allclose(
        found.responsivity / found.responsivity.mean(axis=1)[:, None],
        expected.responsivity / expected.responsivity.mean(axis=1)[:, None],
        rtol=1e-11,
    )
    np.testing.assert_allclose(found.data_mk, expected.data_mk, atol=1e-10)


@pytest.mark.parametrize("most", [N_DET, N_DET - 1])
def test_blocks_are_fitted_as_one(most, monkeypatch):
    """Two halves, each less its means, have together the responsivities of both side by side."""
    _, data = _scan(7, 3)
    basis = np.ascontiguousarray(np.linalg.qr(_scan(7, 3)[0])[0].T)
    halves = [part - part.mean(axis=1, keepdims=True) for part in (data[:, :25], data[:, 25:])]
    monkeypatch.setattr(responsivity, "MOST_GRAM", most)
    options = TemplateOptions(1e-10, 100)
    found, steps = responsivity.fit_responsivity(lambda: iter(halves), basis, options)
    expected, as_many = responsivity.fit_responsivity(lambda: (np.hstack(halves),), basis, options)
    assert steps == as_many
    np.testing.assert_allclose(found, expected, rtol=1e-11)


@pytest.mark.parametrize("spoiled", ["dead", "few iterations", "vanishing"])
def test_passes_end_where_the_gram_matrix_does(spoiled, monkeypatch):
    _, data = _scan(6, 1)
    if spoiled == "dead":
        data[3] = 0
    if spoiled == "vanishing":  # three detectors, the third's correlation with the template exactly zero
        data = np.array([[1.0, -1, 1, -1], [1, -1, 1, -1], [-1, 1, 0, 0]])
        data[2] = [-1.0, 1, -1, 1]
        data[2] /= 0.5
    basis = np.full((1, len(data)), len(data) ** -0.5)
    options, found = TemplateOptions(1e-8, 2 if spoiled == "few iterations" else 100), []
    for most in (len(data), 0):
        monkeypatch.setattr(responsivity, "MOST_GRAM", most)
        found.append(responsivity.fit_responsivity(lambda: (data,), basis, options))
    (by_gram, steps), (by_passes, as_many) = found
    assert steps == as_many and by_gram is by_passes is None


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_remove_means_equals_its_twin(rng, kind):
    data = (100 + rng.standard_normal((5, 40))).astype(kind)
    block = np.empty((5, 17))
    assert remove_means(data, 3, 20, block)
    np.testing.assert_allclose(block, naive.remove_means(data[:, 3:20]), rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("values", [[np.nan], [np.inf], [-np.inf], [np.inf, -np.inf]])
def test_remove_means_finds_values_that_are_not_finite(rng, kind, values):
    data = rng.standard_normal((5, 40)).astype(kind)
    data[3, 7 : 7 + len(values)] = values
    assert naive.remove_means(data) is None and not remove_means(data, 0, 40, np.empty(data.shape))
    data[3, 7 : 7 + len(values)] = np.finfo(np.float32).max
    assert remove_means(data, 0, 40, np.empty(data.shape))


def test_subtract_templates_equals_its_twin(rng):
    block, shapes, templates = (rng.standard_normal(shape) for shape in ((7, 12), (3, 7), (3, 12)))
    expected = naive.subtract_templates(block, shapes, templates)
    subtract_templates(block, shapes, templates)
    np.testing.assert_allclose(block, expected, rtol=0, atol=1e-14)
