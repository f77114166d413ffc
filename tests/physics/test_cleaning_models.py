"""Wind, PCA and localized templates against closed forms: what they remove and what they leave."""

import numpy as np
import pytest

from mapmaker.cleaning import LocalOptions, PcaOptions, WindOptions, clean
from mapmaker.cleaning.wind import delay_phases, phase_shifted
from mapmaker.timestreams import FocalPlane

RATE_HZ = 10.0
N_DET, N_SAMP = 40, 150
ONE_SCAN = np.array([[0, N_SAMP]])


def _wind(slowness_s_rad, tolerance):
    return WindOptions(np.array([slowness_s_rad]), RATE_HZ, tolerance, 100)


def _row(delay):
    """Detectors along x whose delays [samples] from their centre a slowness of 100 s/rad gives."""
    return FocalPlane(np.asarray(delay) / (100 * RATE_HZ), np.zeros(len(delay)), 1e-4)


@pytest.mark.parametrize(("dtype", "level"), [(np.float64, 1e-12), (np.float32, 1e-6)])
def test_planted_signal_delayed_by_whole_samples_vanishes(dtype, level):
    """White, so that nothing but the right samples will do, to the very ends of the scan."""
    rng = np.random.default_rng(0)
    delay = np.concatenate([np.arange(-5, 6), [-5, 5]])
    common = rng.standard_normal(N_SAMP + 10)
    c = 1 + 0.05 * rng.standard_normal((len(delay), 1))
    data = (100 * c * np.stack([common[5 - d : 5 - d + N_SAMP] for d in delay])).astype(dtype)
    options = _wind([100.0, 0.0], 1e-13 if dtype is np.float64 else 1e-8)
    cleaned = clean("wind", data, ONE_SCAN, _row(delay), options=options)
    assert cleaned.kept.all()
    assert np.abs(cleaned.data_mk).max() < level * np.abs(data).max()
    ratio = cleaned.responsivity[0] / c[:, 0]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-11 if dtype is np.float64 else 1e-6)


@pytest.mark.parametrize("f_hz", [0.3, 1.0])
def test_planted_wave_with_any_delay_is_removed_to_the_phase_of_the_interpolation(f_hz):
    """Linear interpolation turns by arg(S), not by 2 pi f dt; away from the ends no more than that is left.

    The error of a detector and of the template, which is delayed with it again, cancel but for the difference
    between detectors: at most twice the largest. What the mirror images do falls off from the ends: 20 samples are
    left out, and a thousandth is allowed for them.
    """
    rng = np.random.default_rng(1)
    delay = rng.uniform(-3, 3, N_DET)
    delay -= delay.mean()
    t = np.arange(N_SAMP)
    w = 2 * np.pi * f_hz / RATE_HZ
    data = np.cos(w * (t - delay[:, None]) + 0.4) + 0.5 * np.sin(0.5 * w * (t - delay[:, None]))
    cleaned = clean("wind", data, ONE_SCAN, _row(delay), options=_wind([100.0, 0.0], 1e-8))
    part = np.linspace(0, 1, 101)
    error = np.abs(np.angle(1 - part + part * np.exp(1j * w)) - part * w).max()
    assert cleaned.kept.all()
    assert np.abs(cleaned.data_mk[:, 20:-20]).max() < 1.5 * 2 * error + 1e-3 * np.abs(data).max()
    assert 3 * error < 0.03


def test_power_spectrum_of_a_shifted_white_stream_is_unchanged():
    """2000 streams: a standard error of 1 / sqrt(2000), at zero frequency sqrt(2) more; five of them.

    Mirror images add 1 in 512 samples. Interpolation alone would leave |S|^2, next to nothing near Nyquist for half a
    sample. Nyquist itself is left out: there the phase of half a sample jumps, and the cut ends mix both sides.
    """
    rng = np.random.default_rng(2)
    n_stream, n_samp = 2000, 512
    delay = np.full(n_stream, 0.5)
    delay[::2] = rng.uniform(-1, 1, n_stream // 2)
    white = rng.standard_normal((n_stream, n_samp))
    shifted = phase_shifted(white, delay_phases(delay, n_samp))
    power = np.mean(np.abs(np.fft.rfft(shifted)) ** 2, axis=0)[:-1] / n_samp
    error = np.full(len(power), 1 / np.sqrt(n_stream))
    error[0] *= np.sqrt(2)
    assert np.all(np.abs(power - 1) < 5 * error + 4 / n_samp)


def test_wind_leaves_white_noise_white():
    """Noise on a slow common signal: residual spectrum flat, less one of N_DET degrees of freedom and the mean's.

    Tolerance: N_DET * 8 scans values a frequency, four standard errors over two neighbouring bins; c's fit takes
    from the lowest frequencies, left out.
    """
    rng = np.random.default_rng(3)
    n_scan = 8
    delay = rng.uniform(-1.5, 1.5, N_DET)
    delay -= delay.mean()
    t = np.arange(N_SAMP)
    bounds = N_SAMP * (np.arange(n_scan)[:, None] + np.array([0, 1]))
    slow = np.hstack([np.cos(2 * np.pi * (t - delay[:, None]) / N_SAMP + phase) for phase in range(n_scan)])
    data = 30 * slow + rng.standard_normal((N_DET, n_scan * N_SAMP))
    options = WindOptions(np.full((n_scan, 2), [100.0, 0.0]), RATE_HZ, 1e-8, 100)
    cleaned = clean("wind", data, bounds, _row(delay), options=options)
    assert cleaned.kept.all()
    blocks = cleaned.data_mk.reshape(N_DET, n_scan, N_SAMP)
    power = np.mean(np.abs(np.fft.rfft(blocks)) ** 2, axis=(0, 1))[5:-1] / N_SAMP
    pairs = power.reshape(-1, 2).mean(axis=1)
    assert np.abs(pairs / (1 - 1 / N_DET) - 1).max() < 4 / np.sqrt(2 * N_DET * n_scan) + 0.02


def _noisy_common(rng, level):
    common = rng.standard_normal(N_SAMP)
    return level * common + rng.standard_normal((N_DET, N_SAMP)), common - common.mean()


def test_leading_mode_is_the_average_template():
    """A common signal s times the noise: the mode is off by 1 / (s^2 n_det) in power, n_det / n_samp of it seen."""
    rng = np.random.default_rng(4)
    data, common = _noisy_common(rng, 3.0)
    plane = _row(rng.uniform(-1, 1, N_DET))
    left = clean("pca", data, ONE_SCAN, plane, options=PcaOptions(3.0))
    taken = (data - data.mean(axis=1, keepdims=True)) - left.data_mk
    assert left.removed[0] == 1
    assert np.linalg.matrix_rank(taken, rtol=1e-10) == 1
    correlation = np.corrcoef(taken[0], common)[0, 1]
    assert 1 - abs(correlation) < 2 / (2 * 3.0**2 * N_DET)


def test_pca_takes_the_noise_of_its_mode():
    """One of min(n_det, n_samp - 1) directions: 1 / n_det of the power and 1 / n_samp, less their product."""
    rng = np.random.default_rng(5)
    left = []
    for _ in range(20):
        data, common = _noisy_common(rng, 10.0)
        cleaned = clean("pca", data, ONE_SCAN, _row(rng.uniform(-1, 1, N_DET)), options=PcaOptions(3.0))
        assert cleaned.removed[0] == 1
        left.append(cleaned.data_mk.var())
    expected = (1 - 1 / N_DET) * (1 - 2 / N_SAMP)
    assert abs(np.mean(left) / expected - 1) < 4 * np.sqrt(2 / (20 * N_DET * N_SAMP))


def test_local_templates_take_their_share_of_white_noise():
    """With k neighbours 1 - 1 / (k + 1) is left; the fit of the coefficient takes 1 / n_samp of what is, the mean too.

    Tolerance: four standard errors of a variance, doubled for neighbours that share noise.
    """
    rng = np.random.default_rng(6)
    steps = [(i, j) for i in range(-5, 6) for j in range(-5, 6) if abs(i + j) <= 5]
    place = np.array([i + 0.5 * j + 1j * np.sqrt(0.75) * j for i, j in steps])
    inner = np.array([max(abs(i), abs(j), abs(i + j)) < 5 for i, j in steps])
    plane = FocalPlane(2e-4 * place.real, 2e-4 * place.imag, 3e-4)
    data = rng.standard_normal((len(steps), 40 * N_SAMP))
    bounds = N_SAMP * (np.arange(40)[:, None] + np.array([0, 1]))
    left = clean("local", data, bounds, plane, options=LocalOptions()).data_mk[inner]
    expected = (6 / 7) * (1 - 2 / N_SAMP)
    assert abs(left.var() / expected - 1) < 2 * 4 * np.sqrt(2 / left.size)
