"""Drawn noise against the spectra and correlations asked for.

Tolerances are 5 standard deviations: a variance from n independent normals is known to sqrt(2 / n), a bin of
a periodogram has the relative scatter 1. A Hann taper correlates the powers of neighbouring bins, by (2/3)^2
and (1/6)^2, so that their mean over N bins scatters by sqrt(HANN / N), HANN = 1 + 2 (4/9 + 1/36).
"""

import math

import numpy as np
import pytest

from mapmaker.kernels.spectra import scale_mean_removed
from mapmaker.stream_psd import hann_power, hann_psd, highest_frequency, white_level
from surveysim.scene.noise_and_sky import Excess
from surveysim.telescope.illumination import UNIFORM
from surveysim.telescope.layouts import hexagon
from surveysim.telescope.pixel_coherence import correlation_factor
from surveysim.timestreams.low_frequency import LONGEST_ROOT, add_excess, excess_psd, excess_variance
from surveysim.timestreams.noise import add_correlated_white, add_white, draw_from_psd
from tests import naive
from tests.deviates import deviates
from tests.pixels import correlation_matrix

RATE = 10.0
HANN = 1 + 2 * (4 / 9 + 1 / 36)
PAPER = {
    "spectral_index": 1.0,
    "band_limit": "1 Hz",
    "b2": [46, 170, 580, 4000],
    "variance": "[2.05, 2.12, 4.52, 10.9] mK2",
    "coherence": "field",
}


@pytest.fixture
def rng():
    return np.random.default_rng(20031028)


def excess(**changes):
    return Excess.model_validate(PAPER | changes)


def test_white_level_by_psd_and_by_variance(rng):
    n_det, n_scans, n = 20, 10, 150
    data = np.full((n_det, n_scans * n), 100, np.float32)  # the mean is no part of the noise
    add_white(data, 2.5, RATE, deviates(rng))
    assert data.mean() == pytest.approx(100, abs=5 * math.sqrt(12.5 / data.size))
    assert data.var(dtype=float) == pytest.approx(2.5 * RATE / 2, rel=5 * math.sqrt(2 / data.size))
    psd = hann_psd(data - np.float32(100), n_scans, np.ones(n_scans, bool), RATE)
    assert psd.shape == (n_det, n // 2 + 1)
    inner = psd[:, 2:-2]
    assert inner.mean() == pytest.approx(2.5, rel=5 * math.sqrt(HANN / (inner.size * n_scans)))
    level = white_level(psd, n, RATE, 2.5)
    used = 37  # 2.53 to 4.93 Hz in steps of 1/15 Hz
    assert level.shape == (n_det,)
    assert np.abs(level / 2.5 - 1).max() < 5 * math.sqrt(HANN / (used * n_scans))
    correlation = np.corrcoef(data) - np.eye(n_det)
    assert np.abs(correlation).max() < 5 / math.sqrt(n_scans * n)


@pytest.mark.parametrize(("kind", "tolerance"), [(np.float32, 1e-6), (np.float64, 1e-13)])
@pytest.mark.parametrize("n", [12, 15])
def test_power_equals_its_twin(rng, kind, tolerance, n):
    data = (3 + rng.standard_normal((4, 3 * n))).astype(kind)
    kept = np.array([True, False, True])
    expected = naive.hann_power(data, 3, kept)
    found = hann_power(data, 3, kept)
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * expected.max())
    assert found[:, 0].max() < (3 * n / 2) ** 2 / 4  # the power of the mean, 3, at f = 0 is twice (3 n / 2)^2
    assert not hann_power(data, 3, np.zeros(3, bool)).any()


@pytest.mark.parametrize(("kind", "tolerance"), [(np.float32, 1e-6), (np.float64, 1e-14)])
def test_scale_mean_removed_equals_its_twin(rng, kind, tolerance):
    data, level = (3 + rng.standard_normal((4, 45))).astype(kind), rng.uniform(0, 2, 4).astype(kind)
    expected = naive.scale_mean_removed(data, 3, level)
    scale_mean_removed(data, 3, level)
    np.testing.assert_allclose(data, expected, rtol=0, atol=5 * tolerance)


def test_psd_of_kept_scans_only(rng):
    data = rng.standard_normal((2, 400)).astype(np.float32)
    kept = np.array([True, False, True, False])
    spoiled = data.copy()
    spoiled[:, 100:200] = 1e6
    spoiled[:, 300:] = np.nan
    some = hann_psd(data, 4, kept, RATE)
    np.testing.assert_array_equal(hann_psd(spoiled, 4, kept, RATE), some)
    both = [hann_psd(data[:, start : start + 100], 1, np.ones(1, bool), RATE) for start in (0, 200)]
    np.testing.assert_allclose(some, np.mean(both, axis=0), rtol=1e-5)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_psd_of_a_sine(kind):
    """A sine of amplitude a has the power a^2 / 2, all of it within two bins of its frequency."""
    n, amplitude, bin_of_sine = 200, 3.0, 31
    time = np.arange(n) / RATE
    data = (amplitude * np.sin(2 * np.pi * bin_of_sine * RATE / n * time + 0.3)).astype(kind)[None, :]
    psd = hann_psd(data, 1, np.ones(1, bool), RATE)[0]
    assert psd[29:34].sum() * RATE / n == pytest.approx(amplitude**2 / 2, rel=1e-5)
    assert np.delete(psd, range(29, 34)).max() < 1e-9 * psd.max()


def test_white_level_leaves_out_red_noise_and_nyquist():
    frequency = np.linspace(0, 5, 51)
    psd = np.where(frequency > 2.5, 4.0, 1e6)[None, :] * np.array([[1], [2]])
    psd[:, -1] = 1e6
    np.testing.assert_allclose(white_level(psd, 100, RATE, 2.5), [4, 8], rtol=1e-14)


@pytest.mark.parametrize("n", [8, 60, 61, 150])
def test_highest_frequency_is_the_last_below_nyquist(n):
    frequency = np.fft.rfftfreq(n, 1 / RATE)
    assert highest_frequency(n, RATE) == pytest.approx(frequency[frequency < RATE / 2 * (1 - 1e-12)].max(), rel=1e-14)


def test_correlated_white_has_the_covariance_of_its_factor(rng):
    """Elements of a covariance from n samples scatter as Wishart: (C_ii C_jj + C_ij^2) / n."""
    correlation = 0.6 * correlation_matrix(hexagon(2, 0.7), "field") + 0.4 * np.eye(19)
    n = 40000
    data = np.zeros((19, n), np.float32)
    add_correlated_white(data, 2.5, RATE, correlation_factor(correlation), deviates(rng))
    expected = 2.5 * RATE / 2 * correlation
    covariance = data.astype(float) @ data.T.astype(float) / n
    spread = np.sqrt((np.outer(np.diagonal(expected), np.diagonal(expected)) + expected**2) / n)
    assert (np.abs(covariance - expected) < 5 * spread).all()
    # Neighbours share 0.3 of their power, so that this would show a factor left out or used twice.
    assert 0.6 * UNIFORM.aperture(0.7) > 20 / math.sqrt(n)
    # White: neighbouring samples do not know of each other.
    assert abs(np.mean(data[:, 1:] * data[:, :-1])) < 5 * 12.5 / math.sqrt(n)


def test_noise_is_added_to_what_is_there(rng):
    start = rng.standard_normal((3, 200)).astype(np.float32)
    section, factor = excess(), np.eye(3)
    adders = [
        lambda data, drawn: add_white(data, 1.0, RATE, drawn),
        lambda data, drawn: add_correlated_white(data, 1.0, RATE, factor, drawn),
        lambda data, drawn: add_excess(
            data, section, variance_mk2=1.0, n_scans=2, sample_rate_hz=RATE, factor=factor, deviates=drawn
        ),
    ]
    for add in adders:
        empty, full = np.zeros_like(start), start.copy()
        add(empty, deviates(4))
        add(full, deviates(4))
        assert empty.std() > 0.1
        np.testing.assert_allclose(full - start, empty, atol=1e-5)


@pytest.mark.parametrize("index", [0.0, 0.5, 1.0, 5 / 3, 2.0, 4.0])
def test_excess_spectrum_is_a_power_law(index):
    psd = excess_psd(excess(spectral_index=index), 4.52, 150, 300, RATE)
    assert len(psd) == 151 and psd[0] == 0
    assert psd[24] / psd[6] == pytest.approx(4**-index, rel=1e-12)
    assert psd[90] == pytest.approx(psd[9] * 10**-index, rel=1e-12)  # and goes on beyond the band


def test_excess_variance_goes_through_the_paper_table():
    section = excess()
    for b2, variance in zip(section.b2, section.variance_mk2, strict=True):
        assert excess_variance(section, b2) == pytest.approx(variance, rel=1e-13)
    # Log-log between: the geometric mean at the geometric mean.
    assert excess_variance(section, math.sqrt(170 * 580)) == pytest.approx(math.sqrt(2.12 * 4.52), rel=1e-13)
    # Held beyond.
    assert [excess_variance(section, b2) for b2 in (0.0, 1.0, 1e6)] == pytest.approx([2.05, 2.05, 10.9], rel=1e-13)


def test_excess_of_one_value_does_not_follow_the_weather():
    section = excess(b2=[280], variance="[3] mK2")
    assert [excess_variance(section, b2) for b2 in (None, 0.0, 46.0, 1e6)] == [3, 3, 3, 3]


@pytest.mark.parametrize("n", [240, 241])
def test_drawn_spectrum(rng, n):
    """Periodic streams: each periodogram bin is exponential about the PSD, the Nyquist bin a squared normal.

    A bin's mean squared amplitude is psd * rate * n / 2 up to Nyquist, as it is for white samples."""
    n_det, n_scans = 10, 150
    frequency = np.arange(n // 2 + 1) * RATE / n
    psd = 1 + 3 / np.maximum(frequency, RATE / n)
    streams = draw_from_psd(psd, (n_det, n_scans), n, RATE, deviates(rng))
    assert streams.shape == (n_det, n_scans, n) and streams.dtype == np.float32
    power = np.abs(np.fft.rfft(streams.astype(float))) ** 2 * 2 / (RATE * n)
    mean = power.mean(axis=(0, 1))
    n_draws = n_det * n_scans
    inner = slice(1, n // 2 if n % 2 == 0 else None)
    assert np.abs(mean[inner] / psd[inner] - 1).max() < 5 / math.sqrt(n_draws)
    assert (mean[inner] / psd[inner]).mean() == pytest.approx(1, abs=5 / math.sqrt(n_draws * len(psd[inner])))
    # Exponential: the scatter is the mean, known to sqrt(8 / N) for N values of kurtosis 9.
    scatter = (power[..., inner] / psd[inner]).std()
    assert scatter == pytest.approx(1, abs=0.5 * 5 * math.sqrt(8 / (n_draws * len(psd[inner]))))
    if n % 2 == 0:
        assert mean[-1] == pytest.approx(psd[-1], rel=5 * math.sqrt(2 / n_draws))
    assert np.abs(streams.mean(axis=-1)).max() < 1e-5


@pytest.mark.parametrize("n", [240, 241])
def test_drawn_variance_is_the_integral_of_the_spectrum(rng, n):
    """White draws: sample variance psd * rate / 2 less the share of the mean, one of n degrees of freedom."""
    streams = draw_from_psd(np.full(n // 2 + 1, 2.5), (40, 100), n, RATE, deviates(rng))
    expected = 2.5 * RATE / 2 * (n - 1) / n
    assert streams.var(dtype=float) == pytest.approx(expected, rel=5 * math.sqrt(2 / streams.size))


def test_drawn_spectra_of_each_detector(rng):
    """PSDs broadcast: (n_det, 1, n_freq) against (n_det, n_scans); the caller's array stays as it is."""
    psd = np.array([1.0, 4.0, 9.0])[:, None, None] * np.ones(101)
    before = psd.copy()
    streams = draw_from_psd(psd, (3, 200), 200, RATE, deviates(rng))
    np.testing.assert_array_equal(psd, before)
    variance = streams.var(axis=(1, 2), dtype=float) / (RATE / 2 * 199 / 200)
    np.testing.assert_allclose(variance, [1, 4, 9], rtol=5 * math.sqrt(2 / (200 * 200)))
    correlation = np.corrcoef(streams.reshape(3, -1)) - np.eye(3)
    assert np.abs(correlation).max() < 5 / math.sqrt(200 * 200)


N_SCANS, PER_SCAN = 60, 600


def excess_streams(rng, index, factor):
    data = np.zeros((len(factor), N_SCANS * PER_SCAN), np.float32)
    add_excess(
        data,
        excess(spectral_index=index),
        variance_mk2=4.52,
        n_scans=N_SCANS,
        sample_rate_hz=RATE,
        factor=factor,
        deviates=deviates(rng),
    )
    return data


@pytest.mark.parametrize("index", [0.5, 1.0, 2.0])
def test_excess_streams_have_the_spectrum(rng, index):
    """Level and slope of the Hann PSD in the band, from bin 5 on.

    The taper's kernel of variance 1/3 bins raises f^-a at bin k by a (a + 1) / 6 k^2: 4 % at most, at bin 5
    for a = 2, and that is allowed for.
    """
    n_det = 12
    data = excess_streams(rng, index, np.eye(n_det))
    psd = hann_psd(data, N_SCANS, np.ones(N_SCANS, bool), RATE).mean(axis=0)
    k = np.arange(5, 61)  # 1/12 to 1 Hz
    expected = excess_psd(excess(spectral_index=index), 4.52, PER_SCAN, 2 * PER_SCAN, RATE)[2 * k]
    ratio = psd[k] / (expected * (1 + index * (index + 1) / (6 * k**2)))
    n_spectra = n_det * N_SCANS
    # The next order, a (a + 1) (a + 2) (a + 3) / 72 k^4 from the fourth moment 1/3: 0.3 % at most.
    assert ratio.mean() == pytest.approx(1, abs=5 * math.sqrt(HANN / (n_spectra * len(k))) + 0.0005)
    assert np.abs(ratio - 1).max() < 5 / math.sqrt(n_spectra) + 0.003
    # The error of a fitted slope: scatter of a bin over the spread of ln k.
    x = np.log(k) - np.log(k).mean()
    slope = np.sum(x * np.log(ratio)) / np.sum(x**2)
    assert slope == pytest.approx(0, abs=5 * math.sqrt(HANN / n_spectra / np.sum(x**2)) + 0.002)


@pytest.mark.parametrize("index", [0.0, 1.0, 2.0])
def test_excess_of_a_scan_less_its_mean_has_the_variance_of_the_table(rng, index):
    """The variance is that of Table 2 plus that of the power law above the band."""
    n_scans, n, n_det = 400, 150, 20
    data = np.zeros((n_det, n_scans * n), np.float32)
    section = excess(spectral_index=index)
    options = {"n_scans": n_scans, "sample_rate_hz": RATE, "factor": np.eye(n_det)}
    add_excess(data, section, variance_mk2=4.52, deviates=deviates(rng), **options)
    scans = data.reshape(n_det * n_scans, n).astype(float)
    variance = scans.var(axis=1)
    frequency = np.arange(151) * RATE / 300
    above = excess_psd(section, 4.52, n, 300, RATE)[frequency > 1.0].sum() * RATE / 300
    # Means are removed from samples, not from an integral: for white noise the last of the difference is 1 / n.
    assert variance.mean() == pytest.approx(4.52 + above, rel=5 * variance.std() / variance.mean() / 89 + 0.002)


def test_a_scan_does_not_know_where_it_ends(rng):
    """Red noise: ends of a scan differ by far more than neighbours do, and scans are independent."""
    data = excess_streams(rng, 2.0, np.eye(12)).reshape(12, N_SCANS, PER_SCAN)
    neighbours = np.mean((data[..., 1:] - data[..., :-1]) ** 2)
    ends = np.mean((data[..., -1] - data[..., 0]) ** 2)
    assert ends > 50 * neighbours
    correlation = np.mean(data[:, 1:].mean(axis=-1) * data[:, :-1].mean(axis=-1)) / np.var(data.mean(axis=-1))
    assert abs(correlation) < 5 / math.sqrt(12 * (N_SCANS - 1))


@pytest.mark.parametrize("coherence", ["field", "intensity", "none"])
def test_excess_is_shared_as_overlap_says(rng, coherence):
    """Correlations of Hann spectra over the band, each bin with the same weight.

    A coherence from N independent complex amplitudes scatters by less than sqrt((1 + rho^2) / 2 N).
    """
    from scipy.fft import rfft

    positions = hexagon(1, 0.7)
    expected = correlation_matrix(positions, coherence)
    data = excess_streams(rng, 1.0, correlation_factor(expected)).reshape(7, N_SCANS, PER_SCAN)
    modes = rfft(data * np.hanning(PER_SCAN + 1)[:PER_SCAN], axis=-1)[..., 2:200].astype(complex)
    modes /= np.sqrt(np.mean(np.abs(modes) ** 2, axis=(0, 1)))
    modes = modes.reshape(7, -1)
    n = modes.shape[1] / HANN
    cross = (modes @ modes.conj().T).real / modes.shape[1]
    spread = np.sqrt((1 + expected**2) / (2 * n))
    assert (np.abs(cross - expected) < 5 * np.where(np.eye(7, dtype=bool), math.sqrt(2) * spread, spread)).all()
    if coherence == "field":
        adjacent = [cross[0, d] for d in range(1, 7)]
        assert np.mean(adjacent) == pytest.approx(0.506, abs=5 * spread[0, 1])


@pytest.mark.parametrize(("n", "index"), [(41, 1.0), (60, 2.0), (LONGEST_ROOT, 1.0), (LONGEST_ROOT + 25, 1.0)])
def test_excess_of_a_scan_has_the_covariance_of_the_spectrum(rng, n, index):
    """Drawn by the root of the covariance or by Fourier modes. Whitened by the root of the exact covariance, samples
    are independent: the mean squares of N elements of the sample covariance of m scans scatter by sqrt(2 / N).
    """
    m, section = 8000, excess(spectral_index=index)
    data = np.zeros((20, m // 20 * n), np.float32)
    options = {"n_scans": m // 20, "sample_rate_hz": RATE, "factor": None}
    add_excess(data, section, variance_mk2=4.52, deviates=deviates(rng), **options)
    lag = np.abs(np.arange(n) - np.arange(n)[:, None])
    exact = (np.fft.irfft(excess_psd(section, 4.52, n, 2 * n, RATE)) * RATE / 2)[lag]
    white = np.linalg.solve(np.linalg.cholesky(exact), data.reshape(m, n).T.astype(float))
    excess_of = math.sqrt(m) * (white @ white.T / m - np.eye(n))
    for found, variance in ((excess_of[np.triu_indices(n, 1)], 1), (np.diagonal(excess_of), 2)):
        assert np.mean(found**2) == pytest.approx(variance, rel=5 * math.sqrt(2 / len(found)))
        assert abs(found.mean()) < 5 * math.sqrt(variance / len(found))
