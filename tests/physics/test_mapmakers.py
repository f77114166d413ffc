"""Iterative and maximum-likelihood maps of simulated rasters: what comes back of the sky, and with how much noise.

61 detectors with 5 % scatter of responsivity scan a field of 20 arcmin along both axes in turn, 0.4 arcmin a
sample at 10 Hz. The atmosphere is one red time-stream of all detectors, of PSD f^-8/3, the index of a thin layer;
each detector's own slow noise has a PSD of 1 / f.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from mapmaker.binning import bin_map, coadd
from mapmaker.cleaning import TemplateOptions, clean
from mapmaker.geometry import MapGeometry, boresight_pixels, pixel_centres, sky_offsets
from mapmaker.gls import GlsOptions, gls_map
from mapmaker.iterative import IterationOptions, StreamBlock, iterate_map
from mapmaker.normal_equations import SolveOptions
from mapmaker.spectrum import annuli, map_psd, tukey_taper
from mapmaker.timestreams import FocalPlane

ARCMIN = math.radians(1 / 60)
RATE, FWHM = 10.0, ARCMIN
GEOMETRY = MapGeometry(2.3, 0.7, ARCMIN / 3, 108, 108)
N_SCAN, N_SAMP = 14, 90
BOUNDS = np.arange(N_SCAN)[:, None] * N_SAMP + [0, N_SAMP]
AVERAGE = TemplateOptions(1e-8, 100)
GLS = GlsOptions(solve=SolveOptions(1e-6))


def focal_plane():
    """Hexagons of pitch 40 arcsec."""
    row, column = np.indices((9, 9)) - 4
    x, y = (column + row / 2) * 2 / 3 * ARCMIN, row * math.sqrt(1 / 3) * ARCMIN
    inside = np.abs(row + column) <= 4
    return FocalPlane(x[inside], y[inside], FWHM)


def raster(observation):
    """Boresight (n_samp,) of both axes, along x and y in turn."""
    along = (np.arange(N_SAMP) - (N_SAMP - 1) / 2) * 0.4 * ARCMIN
    across = (np.arange(N_SCAN) - (N_SCAN - 1) / 2) * 1.9 * ARCMIN + 0.3 * observation * ARCMIN
    way = np.where(np.arange(N_SCAN) % 2, -1, 1)
    axes = (way[:, None] * along).ravel(), np.repeat(across, N_SAMP)
    return axes if observation % 2 == 0 else axes[::-1]


def gains():
    return 1 + 0.05 * np.random.default_rng(99).standard_normal(61)


def blocks(n, rng, white_mk, atmosphere_mk, sky=None, slow_mk=0.0):
    """`n` observations: white level a sample, amplitudes of common and own time-streams, and a sky(xi, eta) [mK]."""
    plane, result = focal_plane(), []
    for observation in range(n):
        xi, eta = raster(observation)
        angle = np.full(len(xi), 0.2 + 0.7 * observation)
        index = boresight_pixels(GEOMETRY, xi, eta, angle, plane=plane)
        east, north = sky_offsets(plane, angle[:1])
        stream = np.concatenate([red_stream(rng, 8 / 3, ()) for _ in range(N_SCAN)]) * atmosphere_mk
        data = gains()[:, None] * stream + white_mk * rng.standard_normal(index.shape)
        data += slow_mk * np.concatenate([red_stream(rng, 1, (61,)) for _ in range(N_SCAN)], axis=-1)
        if sky is not None:
            data += gains()[:, None] * sky(xi + east.T, eta + north.T)
        result.append(StreamBlock(data, index, BOUNDS, plane))
    return result


def red_stream(rng, index, shape):
    """(*shape, N_SAMP) of two-sided PSD f^-index [1/Hz], the first half of a period of twice that."""
    n = 2 * N_SAMP
    frequency = np.fft.rfftfreq(n, 1 / RATE)
    frequency[0] = np.inf
    white = np.fft.rfft(rng.standard_normal((*shape, n)))
    return np.fft.irfft(white * frequency ** (-index / 2) * math.sqrt(RATE))[..., :N_SAMP]


def averaged(block):
    return clean("average", block.data_mk, block.scan_bounds, block.focal_plane, options=AVERAGE)


def binned(items, cleaning=None):
    maps = []
    for b in items:
        data = b.data_mk if cleaning is None else cleaning(b).data_mk
        maps.append(bin_map(GEOMETRY, data, b.index, BOUNDS, kept=np.ones(N_SCAN, bool)))
    return coadd(maps, [1.0] * len(maps))


def source(peak_mk):
    width = FWHM**2 / (8 * math.log(2))
    return lambda xi, eta: peak_mk * np.exp(-((xi - 0.1 * ARCMIN) ** 2 + (eta + 0.2 * ARCMIN) ** 2) / (2 * width))


def flux(item):
    """Sum over the map within 1.5 beams of the source."""
    xi, eta = pixel_centres(GEOMETRY)
    near = np.hypot(xi - 0.1 * ARCMIN, eta + 0.2 * ARCMIN) < 1.5 * FWHM
    return float(item[0, near].sum())


@pytest.mark.parametrize("white_mk", [0.0, 3.0])
def test_flux_of_a_bright_source_comes_back(white_mk):
    """Against the same samples binned without atmosphere, noise or cleaning.

    The same noise is mapped without the source and taken off, so that only the loss of flux is left.
    """
    peak = 100.0
    items = blocks(2, np.random.default_rng(1), white_mk, 10.0, source(peak))
    empty = blocks(2, np.random.default_rng(1), white_mk, 10.0)
    truth = flux(binned(blocks(2, np.random.default_rng(1), 0.0, 0.0, source(peak))).signal_mk)
    background = flux(binned(empty, averaged).signal_mk)
    once = (flux(binned(items, averaged).signal_mk) - background) / truth
    result = iterate_map(GEOMETRY, lambda: iter(items), averaged, IterationOptions())
    found = (flux(result.map.signal_mk) - background) / truth
    assert once < 0.85
    assert found == pytest.approx(1, abs=0.01)
    assert result.converged and result.change[-1] < 1e-3


def test_noise_is_not_fed_back():
    """A blank field: variance grows by less than 1 %; with every pixel taken for signal, by much more."""
    items = blocks(2, np.random.default_rng(2), 3.0, 10.0)
    once = binned(items, averaged)
    seen = once.hits > 20

    def variance(options):
        result = iterate_map(GEOMETRY, lambda: iter(items), averaged, options)
        return np.var(result.map.signal_mk[seen]) / np.var(once.signal_mk[seen])

    assert variance(IterationOptions()) == pytest.approx(1, abs=0.01)
    assert variance(IterationOptions(threshold=4.0)) == pytest.approx(1, abs=0.01)
    assert variance(IterationOptions(threshold=0.01, loss=0.0, max_iterations=5)) > 1.05


TAPER = tukey_taper(108, 108, GEOMETRY.pixel_rad, size_rad=24 * ARCMIN, edge_fraction=0.5)
RINGS = annuli(108, 108, GEOMETRY.pixel_rad, edges_ell=np.array([2000, 4000, 7000, 12000.0]), taper=TAPER)
N_DRAW = 4


def psd(map_mk):
    return map_psd(map_mk[0], TAPER, GEOMETRY.pixel_rad, RINGS)


def transfer(map_mk, truth):
    """Amplitude (n_bin,) of the sky in the map, by its cross-power with the sky as binned."""
    return (psd(truth + map_mk) - psd(truth - map_mk)) / (4 * psd(truth))


def waves(rng):
    """A sky of 300 plane waves of multipole 500 to 9000, with the beam, 0.3 mK rms without it."""
    ell, azimuth = rng.uniform(500, 9000, 300), rng.uniform(0, 2 * np.pi, 300)
    phase = rng.uniform(0, 2 * np.pi, 300)
    amplitude = 0.3 * math.sqrt(2 / 300) * np.exp(-(ell**2) * FWHM**2 / (16 * math.log(2)))

    def sky(xi, eta):
        total = np.zeros(np.broadcast(xi, eta).shape)
        for a, k, t, p in zip(amplitude, ell, azimuth, phase, strict=True):
            total += a * np.cos(k * (xi * np.cos(t) + eta * np.sin(t)) + p)
        return total

    return sky


def average_map(items):
    return binned(items, averaged).signal_mk


def likelihood_map(items):
    return gls_map(GEOMETRY, lambda: items, sample_rate_hz=RATE, options=GLS).map.signal_mk


@lru_cache(maxsize=1)
def transfers():
    """Transfer (n_bin,) of both map-makers under atmosphere and white noise, the mean of two draws."""
    sky = waves(np.random.default_rng(7))
    pure = blocks(2, np.random.default_rng(0), 0.0, 0.0, sky)
    truth = binned(pure).signal_mk
    total = np.zeros((2, len(RINGS.ell)))
    for seed in (10, 11):
        empty = blocks(2, np.random.default_rng(seed), 2.0, 10.0)
        both = [replace(b, data_mk=b.data_mk + s.data_mk) for b, s in zip(empty, pure, strict=True)]
        total += [transfer(make(both) - make(empty), truth) for make in (average_map, likelihood_map)]
    return total / 2


def noise_ratio(reference, **noise):
    """Noise PSD (n_bin,) of the maximum-likelihood map over that of the reference, of the same streams."""
    draws = [blocks(2, np.random.default_rng(20 + k), 2.0, **noise) for k in range(N_DRAW)]
    return sum(psd(likelihood_map(items)) for items in draws) / sum(psd(reference(items)) for items in draws)


@pytest.mark.slow
def test_maximum_likelihood_keeps_the_sky_that_the_average_loses():
    """Modes and levels are measured with the sky in the streams, which takes a little: 3 % is allowed."""
    average, likelihood = transfers()
    np.testing.assert_allclose(likelihood, 1, atol=0.03)
    assert average[0] < 0.8
    assert (average < likelihood - 0.02).all()


@pytest.mark.slow
def test_maximum_likelihood_is_less_noisy_under_slow_noise():
    """Above l = 4000, even before what the average loses of the sky is counted."""
    ratio = noise_ratio(average_map, atmosphere_mk=10.0, slow_mk=1.0)
    assert (ratio[1:] < 1).all(), ratio


def test_white_noise_alone_gives_the_hit_weighted_map():
    """All that differs is that means of scans are found rather than known, and levels of detectors measured.

    Modes that do not vary along a scan of length L, within 2 pi / L, are left to the scans of the other
    direction, and their noise doubles: 8 / (L l) of all modes of multipole l, 14 % in the first of the bins above
    l = 4000. Levels scatter by sqrt(2 / 1260), whose square is lost.
    """
    ell = RINGS.ell[1:]
    ratio = noise_ratio(lambda items: binned(items).signal_mk, atmosphere_mk=0.0)[1:]
    assert (ratio > 0.98).all() and (ratio < 1 + 8 / (N_SAMP * 0.4 * ARCMIN * ell)).all(), ratio
    items = blocks(2, np.random.default_rng(20), 2.0, 0.0)
    result, plain = gls_map(GEOMETRY, lambda: items, sample_rate_hz=RATE, options=GLS).map, binned(items)
    np.testing.assert_array_equal(result.hits, plain.hits)
    seen = plain.hits > 20
    # A pixel's 20 or more samples are of several detectors: their levels' scatter of 4 % averages.
    np.testing.assert_allclose(result.weight[seen], plain.hits[seen] / 4, rtol=0.1)
    difference = result.signal_mk[seen] - plain.signal_mk[seen]
    difference -= np.average(difference, weights=plain.hits[seen])
    # 1708 means, each known from 90 samples, change a pixel by less than a fifth of its noise.
    assert np.average(difference**2 * plain.hits[seen]) < 0.2**2 * 2.0**2
