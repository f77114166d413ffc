"""Matched filter: closed forms, a twin of loops, and amplitudes of sources in stationary noise."""

import numpy as np
import pytest

from mapmaker.matched_filter import (
    filter_depth,
    filter_information,
    filtered_map,
    profile_power,
    source_amplitudes,
    source_filter,
)
from mapmaker.profiles import gaussian_profile
from mapmaker.spectrum import annuli, map_psd, mode_ell, tukey_taper
from mapmaker.transfer_function import measure_amplitude_transfer, measure_transfer_function

ARCSEC = np.radians(1 / 3600)
PIXEL, FWHM, N = 20 * ARCSEC, 60 * ARCSEC, 48
EDGES = np.arange(0, 21001.0, 1000)
GRID = 2 * N
ELL = mode_ell(GRID, GRID, PIXEL)
BOX = np.zeros((GRID, GRID))
BOX[:N, :N] = 1
RINGS = annuli(GRID, GRID, PIXEL, edges_ell=EDGES, taper=BOX)
USED = RINGS.ell > 1000
PROFILE = gaussian_profile(ELL, FWHM)


def filter_of(noise, transfer=1.0):
    transfer = np.broadcast_to(transfer, RINGS.ell.shape)
    return source_filter(PROFILE, noise, transfer=transfer, mask=USED, rings=RINGS, pixel_rad=PIXEL)


def red(ell):
    """PSD of noise that rises to low multipoles [mK^2 sr]."""
    return 1e-8 * (1 + (4000 / np.maximum(ell, 500)) ** 3)


def noise_map(rng, psd):
    """Stationary noise (N, N), cut from a grid of twice the side."""
    white = np.fft.rfft2(rng.standard_normal((GRID, GRID)))
    return np.fft.irfft2(white * np.sqrt(psd) / PIXEL, (GRID, GRID))[:N, :N]


def source_map(transfer=1.0, row=20.0, column=23.0):
    """A source of amplitude 1 between pixels, as cleaning leaves it, (N, N)."""
    shift = np.exp(-2j * np.pi * (np.fft.fftfreq(GRID)[:, None] * row + np.fft.rfftfreq(GRID) * column))
    left = np.append(np.broadcast_to(transfer, RINGS.ell.shape), 1.0)[RINGS.bin_of_mode].reshape(ELL.shape)
    return np.fft.irfft2(PROFILE * left * shift / PIXEL**2, (GRID, GRID))[:N, :N]


def test_depth_in_white_noise():
    """sigma = sqrt(N / pi) / s of the beam, s = FWHM / sqrt(8 ln 2): int of the squared beam is pi s^2."""
    edges = np.linspace(0, 60000, 61)
    power = profile_power(lambda ell: gaussian_profile(ell, FWHM), edges)
    found = filter_depth(np.full(60, 4e-9), power, np.ones(60), np.ones(60, bool))
    assert found == pytest.approx(np.sqrt(4e-9 / np.pi * 8 * np.log(2)) / FWHM, rel=1e-6)
    half = filter_depth(np.full(60, 4e-9), power, np.full(60, 0.25), np.ones(60, bool))
    assert half == pytest.approx(2 * found, rel=1e-12)


def test_depth_of_the_filter_on_a_grid_is_that_of_the_integral():
    noise = red(RINGS.ell)
    power = profile_power(lambda ell: gaussian_profile(ell, FWHM), EDGES)
    # Modes of 1000 in multipole sample bins of 1000: 10 % in the narrowest used, less above.
    assert filter_of(noise, 0.8).sigma == pytest.approx(filter_depth(noise, power, np.full(21, 0.64), USED), rel=0.01)


def test_information_is_of_used_bins_alone():
    power = profile_power(lambda ell: gaussian_profile(ell, FWHM), EDGES)
    found = filter_information(np.where(USED, 1e-9, 0.0), power, np.ones(21), USED)
    assert (found > 0).tolist() == USED.tolist()


def naive_amplitude(item, map_mk, weight, row, column):
    """Sums over all pixels of the map: the kernel at the source times the map, over the same of the source."""
    kernel = np.fft.irfft2(item.kernel, item.profile.shape)
    numerator = response = 0.0
    for y in range(N):
        for x in range(N):
            place, root = ((y - row) % GRID, (x - column) % GRID), np.sqrt(weight[y, x])
            numerator += kernel[place] * root * map_mk[y, x]
            response += kernel[place] * root * item.profile[place]
    return numerator / response, item.sigma / response


def test_twin_of_loops():
    rng = np.random.default_rng(4)
    item, weight = filter_of(red(RINGS.ell), 0.7), rng.uniform(0.2, 2, (N, N))
    map_mk = noise_map(rng, red(ELL))
    found = filtered_map(item, map_mk, weight)
    for row, column in ((5, 40), (0, 0), (31, 17)):
        expected = naive_amplitude(item, map_mk, weight, row, column)
        assert (found.amplitude[row, column], found.scatter[row, column]) == pytest.approx(expected, rel=1e-9)
        at = source_amplitudes(item, map_mk, weight, row=[float(row)], column=[float(column)])
        assert (at.amplitude[0], at.scatter[0]) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("row, column", [(20.0, 23.0), (20.37, 23.81), (3.0, 45.0)])
def test_a_source_comes_back_without_noise(row, column):
    """Through a transfer function, uneven weights, a hole and the map's edge.

    Between pixels the response is interpolated, as exactly as pixels of a third of the beam sample it.
    """
    transfer = 1 - 0.9 * np.exp(-RINGS.ell / 3000)
    item, weight = filter_of(red(RINGS.ell), transfer), np.full((N, N), 1.3)
    weight[:, 26:30] = 0.2
    weight[18, 24] = 0
    found = source_amplitudes(item, source_map(transfer, row, column), weight, row=[row], column=[column])
    assert found.amplitude[0] == pytest.approx(1, abs=1e-9 if row == round(row) else 2e-3)


def test_unobserved_pixels_have_no_amplitude():
    weight = np.zeros((N, N))
    weight[:20, :20] = 1
    found = filtered_map(filter_of(red(RINGS.ell)), np.zeros((N, N)), weight)
    assert np.isnan(found.amplitude[40, 40]) and np.isinf(found.scatter[40, 40])
    assert np.isfinite(found.amplitude[:20, :20]).all()


def test_scatter_is_as_stated():
    """In red noise whose variance goes as one over the weight: chi^2 of 400 maps and 9 places."""
    rng = np.random.default_rng(5)
    weight = np.linspace(0.5, 2, N)[:, None] * np.ones(N)
    item = filter_of(red(RINGS.ell))
    places = {"row": np.repeat([14.0, 23.6, 33.0], 3), "column": np.tile([14.0, 23.6, 33.0], 3)}
    drawn = [source_amplitudes(item, noise_map(rng, red(ELL)) / np.sqrt(weight), weight, **places) for _ in range(400)]
    pulls = np.array([found.amplitude / found.scatter for found in drawn])
    assert abs(pulls.mean()) < 4 / np.sqrt(pulls.size)
    # Bins take the mean of a steep spectrum: 2 % beside the sampling.
    assert np.mean(pulls**2) == pytest.approx(1, abs=0.02 + 4 * np.sqrt(2 / pulls.size))


def test_amplitude_transfer_of_filtered_skies():
    """A filter that keeps x modes but not y modes keeps half the amplitude and half the power; an even one its own."""
    rng = np.random.default_rng(6)
    taper = tukey_taper(N, N, PIXEL, size_rad=N * PIXEL, edge_fraction=1.0)
    padded = np.zeros((GRID, GRID))
    padded[:N, :N] = taper
    rings = annuli(GRID, GRID, PIXEL, edges_ell=np.arange(3000, 18001.0, 3000), taper=padded)
    skies = np.array([noise_map(rng, red(ELL)) for _ in range(20)])
    skies = np.pad(skies, ((0, 0), (0, N), (0, N)))

    def left(kept):
        return np.fft.irfft2(np.fft.rfft2(skies) * kept, (GRID, GRID))

    k_y, k_x = np.abs(np.fft.fftfreq(GRID))[:, None], np.fft.rfftfreq(GRID)
    of_map = {"taper": padded, "pixel_rad": PIXEL, "rings": rings}
    one_way, even = left(k_x > k_y), left(np.full(ELL.shape, 0.6))
    amplitude = measure_amplitude_transfer(one_way, skies, **of_map)
    power = measure_transfer_function(*(map_psd(item, padded, PIXEL, rings) for item in (one_way, skies)), rings.ell)
    assert (np.abs(amplitude.transmission - 0.5) < 5 * amplitude.error).all()
    assert (np.abs(power.transmission - 0.5) < 5 * power.error).all()
    assert (amplitude.transmission**2 < power.transmission).all()
    np.testing.assert_allclose(measure_amplitude_transfer(even, skies, **of_map).transmission, 0.6, rtol=1e-10)
