"""Average subtraction at rest with the layer: twins, shifts, ends, options."""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker import chunks
from mapmaker.cleaning import TemplateOptions, WindOptions, clean, slowness
from mapmaker.cleaning.wind import delay_phases, phase_shifted
from mapmaker.timestreams import FocalPlane
from tests import naive

N_DET, RATE_HZ = 12, 10.0
BOUNDS = np.array([[0, 60], [60, 101], [110, 160]])  # one odd length


def _focal_plane(seed=0):
    x, y = np.random.default_rng(seed).uniform(-1e-3, 1e-3, (2, N_DET))
    return FocalPlane(x_rad=x, y_rad=y, fwhm_rad=1.5e-4)


def _data(seed=1):
    rng = np.random.default_rng(seed)
    common = np.cumsum(rng.standard_normal(160))
    c = 1 + 0.05 * rng.standard_normal((N_DET, 1))
    return 30 + c * common + 0.3 * rng.standard_normal((N_DET, 160))


def _options(slowness_s_rad, tolerance=1e-14):
    return WindOptions(np.asarray(slowness_s_rad, dtype=float), RATE_HZ, tolerance, 100)


def test_equals_the_loop_over_detectors():
    data, plane = _data(), _focal_plane()
    options = _options([[200, -120], [0, 90], [-310, 60]])
    cleaned = clean("wind", data, BOUNDS, plane, options=options)
    assert cleaned.kept.all()
    r = np.stack([plane.x_rad - plane.x_rad.mean(), plane.y_rad - plane.y_rad.mean()])
    for s, (start, stop) in enumerate(BOUNDS):
        delay = RATE_HZ * (options.slowness_s_rad[s] @ r)
        expected, c = naive.wind_cleaning(data[:, start:stop], delay, 1e-14, 100)
        np.testing.assert_allclose(cleaned.data_mk[:, start:stop], expected, atol=1e-11)
        ratio = cleaned.responsivity[s] / c
        np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)


@pytest.mark.parametrize("samples", [1, 300])
def test_chunks_of_detectors_change_no_bit(monkeypatch, samples):
    """One detector at a time, and a few."""
    data, options = _data(), _options([[200, -120], [0, 90], [-310, 60]])
    whole = clean("wind", data, BOUNDS, _focal_plane(), options=options)
    monkeypatch.setattr(chunks, "CHUNK_SAMPLES", samples)
    found = clean("wind", data, BOUNDS, _focal_plane(), options=options)
    np.testing.assert_array_equal(found.data_mk, whole.data_mk)
    np.testing.assert_array_equal(found.responsivity, whole.responsivity)


def test_without_slowness_it_is_average_subtraction():
    data, plane = _data(), _focal_plane()
    found = clean("wind", data, BOUNDS, plane, options=_options(np.zeros((3, 2)), 1e-8))
    expected = clean("average", data, BOUNDS, plane, options=TemplateOptions(1e-8, 100))
    np.testing.assert_allclose(found.data_mk, expected.data_mk, atol=1e-11)
    np.testing.assert_allclose(found.responsivity, expected.responsivity, rtol=1e-11)
    np.testing.assert_array_equal(found.iterations, expected.iterations)


@pytest.mark.parametrize("delay", [0.0, 0.25, -0.25, 0.8, -3.7, 5.0])
@pytest.mark.parametrize("n_samp", [40, 41])
def test_shift_is_the_appendix_s(delay, n_samp):
    stream = np.random.default_rng(2).standard_normal(n_samp)
    expected = naive.shifted_stream(np.concatenate([stream, stream[::-1]]), delay)[:n_samp]
    found = phase_shifted(stream[None], delay_phases(np.array([delay]), n_samp))
    np.testing.assert_allclose(found[0], expected, atol=1e-12)


def test_shift_and_its_conjugate_are_inverse():
    """On the periodic stream, mirror image and all: half a sample, where |S| is zero at Nyquist, included."""
    stream = np.random.default_rng(3).standard_normal(2 * 50)
    turn = delay_phases(np.array([0.5, -2.5, 0.3]), 50)
    np.testing.assert_allclose(np.abs(turn), 1, rtol=1e-14)
    back = np.fft.irfft(np.fft.rfft(np.fft.irfft(np.fft.rfft(stream) * turn, 100)) * turn.conj(), 100)
    np.testing.assert_allclose(back, np.tile(stream, (3, 1)), atol=1e-13)


def test_dtype_is_kept():
    cleaned = clean("wind", _data().astype(np.float32), BOUNDS, _focal_plane(), options=_options([[200, 0]] * 3, 1e-8))
    double = clean("wind", _data(), BOUNDS, _focal_plane(), options=_options([[200, 0]] * 3, 1e-8))
    assert cleaned.data_mk.dtype == np.float32
    np.testing.assert_allclose(cleaned.data_mk, double.data_mk, atol=1e-4)


def test_slowness_is_the_inverse_velocity():
    found = slowness(np.array([3.0, 1.0]), np.array([[1.0, 1.0], [3.0, -4.0]]))
    np.testing.assert_allclose(found, [[0.5, 0], [0, 0.2]], atol=1e-15)


@pytest.mark.parametrize("wind", [[1.0, 1.0], [np.nan, np.nan]])
def test_no_slowness_of_a_layer_at_rest_or_unknown(wind):
    with pytest.raises(ValueError, match="zero or not finite"):
        slowness(np.array(wind), np.array([[1.0, 1.0]]))


def test_delays_of_a_quarter_of_a_scan_are_the_longest():
    """The second scan has 41 samples: 10.25."""
    data, plane = _data(), _focal_plane()
    reach = np.abs(plane.x_rad - plane.x_rad.mean()).max() * RATE_HZ
    clean("wind", data, BOUNDS, plane, options=_options([[0, 0], [10.2 / reach, 0], [0, 0]]))
    with pytest.raises(ValueError, match="delays of up to 10.3 samples found in a scan of 41; a quarter is allowed"):
        clean("wind", data, BOUNDS, plane, options=_options([[0, 0], [-10.3 / reach, 0], [0, 0]]))


def test_one_slowness_a_scan():
    with pytest.raises(ValueError, match="2 slownesses found for 3 scans"):
        clean("wind", _data(), BOUNDS, _focal_plane(), options=_options(np.zeros((2, 2))))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"slowness_s_rad": np.zeros(2)}, r"found the shape \(2,\); \(n_scan, 2\) is expected"),
        ({"slowness_s_rad": np.zeros((2, 3))}, r"found the shape \(2, 3\); \(n_scan, 2\) is expected"),
        ({"slowness_s_rad": np.array([[0, np.nan]])}, r"found nan at \[0, 1\]; finite numbers are expected"),
        ({"sample_rate_hz": 0.0}, "sample_rate_hz: found .*; a finite number above 0"),
        ({"sample_rate_hz": np.nan}, "sample_rate_hz: found .*; a finite number above 0"),
        ({"tolerance": 0.0}, "tolerance: found 0.0; a finite number above 0"),
        ({"max_iterations": 0}, "max_iterations: found 0; an integer of at least 1"),
    ],
)
def test_options_out_of_range(changed, message):
    with pytest.raises(ValueError, match=message):
        replace(_options(np.zeros((1, 2))), **changed)
