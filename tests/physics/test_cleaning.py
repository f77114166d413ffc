"""Noise that cleaning removes and leaves, and the convergence of its iterations."""

import numpy as np
import pytest

from mapmaker.cleaning import TemplateOptions, clean
from mapmaker.cleaning.templates import PLANAR, template_basis
from mapmaker.kernels.cleaning import iterate_responsivity
from mapmaker.timestreams import FocalPlane

OPTIONS = TemplateOptions(tolerance=1e-8, max_iterations=100)
N_PAR = {"average": 1, "planar": 3, "quadratic": 6}
N_DET, N_SAMP, RADIUS_RAD = 115, 150, 1.2e-3
ONE_SCAN = np.array([[0, N_SAMP]])


def _focal_plane(rng):
    radius, angle = RADIUS_RAD * np.sqrt(rng.uniform(size=N_DET)), rng.uniform(0, 2 * np.pi, N_DET)
    return FocalPlane(x_rad=radius * np.cos(angle), y_rad=radius * np.sin(angle), fwhm_rad=1.5e-4)


def _shapes(focal_plane, n_par):
    x, y = focal_plane.x_rad / RADIUS_RAD, focal_plane.y_rad / RADIUS_RAD
    return np.stack([np.ones(N_DET), x, y, x * y, x**2, y**2], axis=1)[:, :n_par]


def _amplitudes(rng, n_par, gradient=0.3):
    """Random mean-free template amplitudes; the common mode has rms 1."""
    size = np.array([1, gradient, gradient, gradient**2, gradient**2, gradient**2])[:n_par]
    amplitude = rng.standard_normal((n_par, N_SAMP))
    return size[:, None] * (amplitude - amplitude.mean(axis=1, keepdims=True))


def _responsivities(rng, shapes):
    """Scatter of 5%, with none of the non-constant shapes in it; mean 1."""
    scatter = 0.05 * rng.standard_normal(N_DET)
    return 1 + scatter - shapes @ np.linalg.lstsq(shapes, scatter, rcond=None)[0]


@pytest.mark.parametrize(("dtype", "level"), [(np.float64, 1e-12), (np.float32, 5e-7)])
@pytest.mark.parametrize("name", N_PAR)
def test_planted_polynomials_vanish(name, dtype, level):
    """Level relative to the atmosphere: thousands of float64 roundings; float32: rounding of the input."""
    rng = np.random.default_rng(0)
    focal_plane = _focal_plane(rng)
    shapes = _shapes(focal_plane, N_PAR[name])
    c = _responsivities(rng, shapes)
    data = (1e3 * c[:, None] * (shapes @ _amplitudes(rng, N_PAR[name]))).astype(dtype)
    # float32 input is in the model only to its own rounding
    tolerance = 1e-13 if dtype is np.float64 else 1e-8
    cleaned = clean(name, data, ONE_SCAN, focal_plane, options=TemplateOptions(tolerance, 100))
    assert cleaned.kept.all()
    assert np.abs(cleaned.data_mk).max() < level * np.abs(data).max()
    np.testing.assert_allclose(cleaned.responsivity[0], c, rtol=1e-6 if dtype is np.float32 else 1e-11)


@pytest.mark.parametrize("slope", [0.01, 0.05])
def test_responsivity_gradient_is_left_at_second_order(slope):
    """d = (1 + a x)(p_0 + p_1 x) is a p_1 x^2 away from a plane, and the cleaning leaves no more than that.

    The second-order term is at most slope * rms(p_1) * 1; the fit to it can only make it smaller, the
    iteration's other directions move at the same order.
    """
    rng = np.random.default_rng(1)
    focal_plane = _focal_plane(rng)
    shapes, amplitude = _shapes(focal_plane, 3), _amplitudes(rng, 3)
    data = (1 + slope * shapes[:, 1])[:, None] * (shapes @ amplitude)
    left = clean("planar", data, ONE_SCAN, focal_plane, options=OPTIONS).data_mk
    assert left.std() < slope * amplitude[1:].std()
    assert left.std() > 0.05 * slope * amplitude[1:].std()


@pytest.mark.parametrize("name", N_PAR)
def test_orthogonal_signal_is_untouched(name):
    """C = 1, a signal orthogonal to the shapes and, in time, to their amplitudes: c = 1 is the solution."""
    rng = np.random.default_rng(2)
    focal_plane = _focal_plane(rng)
    shapes, amplitude = _shapes(focal_plane, N_PAR[name]), 100 * _amplitudes(rng, N_PAR[name])
    signal = rng.standard_normal((N_DET, N_SAMP))
    signal -= shapes @ np.linalg.lstsq(shapes, signal, rcond=None)[0]
    templates = np.vstack([np.ones(N_SAMP), amplitude]).T
    signal -= (templates @ np.linalg.lstsq(templates, signal.T, rcond=None)[0]).T
    cleaned = clean(name, shapes @ amplitude + signal, ONE_SCAN, focal_plane, options=OPTIONS)
    np.testing.assert_allclose(cleaned.responsivity, 1, rtol=1e-12)
    np.testing.assert_allclose(cleaned.data_mk, signal, atol=1e-11)


@pytest.mark.parametrize("name", N_PAR)
def test_subtraction_is_a_projection(name):
    """P = 1 - C V V^T C^-1 leaves its own result as it is."""
    rng = np.random.default_rng(3)
    focal_plane = _focal_plane(rng)
    shapes = _shapes(focal_plane, N_PAR[name])
    data = 30 * (shapes @ _amplitudes(rng, N_PAR[name])) + rng.standard_normal((N_DET, N_SAMP))
    cleaned = clean(name, data, ONE_SCAN, focal_plane, options=OPTIONS)
    c = cleaned.responsivity[0]
    basis = np.linalg.qr(shapes)[0]
    project = np.eye(N_DET) - (c[:, None] * basis) @ (basis / c[:, None]).T
    np.testing.assert_allclose(project @ cleaned.data_mk, cleaned.data_mk, atol=1e-12)
    data -= data.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(project @ data, cleaned.data_mk, atol=1e-12)


def test_float32_streams_under_a_thousandfold_atmosphere():
    """float32 and float64 results differ by the rounding of the input, 6e-8 of up to 4e3 noise rms."""
    rng = np.random.default_rng(4)
    focal_plane = _focal_plane(rng)
    data = 1e3 * (_shapes(focal_plane, 6) @ _amplitudes(rng, 6)) + rng.standard_normal((N_DET, N_SAMP))
    double = clean("quadratic", data, ONE_SCAN, focal_plane, options=OPTIONS).data_mk
    single = clean("quadratic", data.astype(np.float32), ONE_SCAN, focal_plane, options=OPTIONS).data_mk
    assert double.std() < 1.01
    assert np.abs(single - double).max() < 1e-3


@pytest.mark.parametrize("name", N_PAR)
def test_white_noise_loses_the_removed_degrees_of_freedom(name):
    """The templates take n_par / n_det of the variance, the mean 1 / n_samp and c another 1 / n_samp.

    Tolerance: four standard errors, sqrt(2 / N) of the variance for N independent values.
    """
    rng = np.random.default_rng(5)
    focal_plane = _focal_plane(rng)
    n_scan = 8
    bounds = N_SAMP * (np.arange(n_scan)[:, None] + np.array([0, 1]))
    common = np.hstack([_shapes(focal_plane, 1) @ _amplitudes(rng, 1) for _ in range(n_scan)])
    data = 10 * common + rng.standard_normal((N_DET, n_scan * N_SAMP))
    cleaned = clean(name, data, bounds, focal_plane, options=OPTIONS)
    expected = (1 - N_PAR[name] / N_DET) * (1 - 2 / N_SAMP)
    assert cleaned.kept.all()
    assert abs(cleaned.data_mk.var() / expected - 1) < 4 * np.sqrt(2 / data.size)


@pytest.mark.parametrize("name", N_PAR)
def test_converges_in_five_to_ten_iterations(name):
    """The paper's number, with a common mode as strong as a detector's noise.

    Each step shrinks errors of c by about lambda / (n_det s^2), lambda = (1 + sqrt(n_det / n_samp))^2 the
    largest eigenvalue of the noise's sample covariance (Marchenko-Pastur): 3.5 / 115 = 0.03, and seven-odd
    decades are to be crossed: about 6 steps.
    """
    steps = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        focal_plane = _focal_plane(rng)
        shapes = _shapes(focal_plane, 1)
        c = 1 + 0.05 * rng.standard_normal((N_DET, 1))
        data = c * (shapes @ _amplitudes(rng, 1)) + rng.standard_normal((N_DET, N_SAMP))
        cleaned = clean(name, data.astype(np.float32), ONE_SCAN, focal_plane, options=OPTIONS)
        assert cleaned.kept.all()
        steps.append(cleaned.iterations[0])
    assert min(steps) >= 5 and max(steps) <= 10


def test_why_responsivities_are_held():
    """Planar iteration as the paper states it: not converged after its 100 steps, yet it subtracts the same.

    The two residuals differ by less than 1% of the noise variance although the drift still changes c.
    """
    rng = np.random.default_rng(6)
    focal_plane = _focal_plane(rng)
    data = 3 * (_shapes(focal_plane, 3) @ _amplitudes(rng, 3)) + rng.standard_normal((N_DET, N_SAMP))
    data -= data.mean(axis=1, keepdims=True)
    basis = template_basis(focal_plane, PLANAR)
    c = np.ones(N_DET)
    converged, _ = iterate_responsivity(data @ data.T, basis, basis[:0], 1e-8, 100, 1.0, c)
    literal = data - (basis * c).T @ ((basis / c) @ data)
    held = clean("planar", data, ONE_SCAN, focal_plane, options=OPTIONS)
    assert not converged and held.kept.all() and held.iterations[0] <= 10
    assert abs(held.data_mk.var() - literal.var()) < 0.01
