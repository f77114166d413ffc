"""Skies through the scans of Lynx, without noise: maps and spectra that come back, against what went in.

A FITS image of sources, and skies of a spectrum of CAMB, beside the simulated skies that measure the transfer function.
"""

import math
from functools import partial

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from mapmaker.binning import weighted_mean
from mapmaker.geometry import MapGeometry
from mapmaker.spectrum import ring_mean
from mapmaker.transfer_function import beam_window
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.results.sky_fluxes import _aperture, _left, _profile, _Source
from surveysim.results.sky_recovery import _share, _spectra, input_map
from surveysim.scene.map_units import SR_PER_FWHM2
from surveysim.scene.scene import load_scene
from surveysim.scene.shipped import shipped_folder
from surveysim.scene.sky import Sky, SkyMap
from surveysim.survey.coadds import add_observations, empty_coadds, observation_sums
from surveysim.timestreams.fixed_sky import map_mk, peak_mk_per_jy
from surveysim.timestreams.shared_parts import signal_skies
from surveysim.timestreams.sky_maps import flat_sky, sharpened, sky_spectrum_mk2

PIXEL = 12.0  # of the images [arcsec]
NOISELESS = {
    "photon": None,
    "instrument.responsivity_scatter": 0,
    "map.pixel": "10 arcsec",
    "excess": None,
    "atmosphere.turbulence": "none",
    "cleaning.responsivities": "known",
    "schedule.nights": 1,
    "score.noise_only_sets": [],
    "score.mask_separation_f_lambda": None,
    "score.reference": None,
}


def source_file(path, seed, number, reach):
    """An image of some sources at random within a reach [pixels] of the centre; returns directions and fluxes [Jy]."""
    rng, n = np.random.default_rng(seed), 330
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval = ["RA---TAN", "DEC--TAN"], [132.3, 44.84]
    wcs.wcs.cdelt, wcs.wcs.crpix = [-PIXEL / 3600, PIXEL / 3600], [n / 2 + 0.5, n / 2 + 0.5]
    columns, rows = np.rint(n / 2 + rng.uniform(-reach, reach, (2, number))).astype(int)
    flux_jy, image = np.linspace(0.1, 0.3, number), np.zeros((n, n))
    image[rows, columns] = flux_jy
    header = wcs.to_header()
    header["BUNIT"] = "Jy/sr"
    fits.writeto(path, image / math.radians(PIXEL / 3600) ** 2, header)
    return np.radians(wcs.pixel_to_world_values(columns, rows)).T, flux_jy


def setup_of(n_sky, observations, **settings):
    """Lynx with some simulated skies, which the caller draws, in a few observations; its own sky is empty."""
    own = {"observations": observations, "score.signal_sims.observations": observations}
    keys = NOISELESS | own | {"score.signal_sims.skies": n_sky, "sky.cmb_band_power": "0 uK2"} | settings
    return prepare(load_scene(shipped_folder() / "lynx.toml", keys))


def flat_skies(setup, number):
    """Skies of a flat band power, as signal simulations are, (number, 1, n_y, n_x)."""
    sims = setup.scene.score.signal_sims.model_copy(update={"skies": number})
    scene = setup.scene.model_copy(update={"score": setup.scene.score.model_copy(update={"signal_sims": sims})})
    return signal_skies(scene, setup.sky.geometry, setup.sky.fwhm_rad, own_mk=None)


def passed(setup, skies, observations):
    """Pass skies through some observations: maps that go in (n_sky, n, n), maps that come out, and their weights."""
    analysis = setup.analysis
    vars(analysis)["signal_skies_mk"] = np.concatenate([skies, np.zeros_like(skies[:1])])
    coadds = empty_coadds(analysis)
    for number in observations:
        add_observations(analysis, coadds, [observation_sums(analysis, observe(setup, number, True))])
    weight = coadds.signal_weight[0]
    inputs = np.stack([input_map(analysis, sky) for sky in skies]) * (weight > 0)
    return inputs, weighted_mean(coadds.signal_maps[: len(skies), 0, 1], weight), weight


def image_sky(setup, path):
    """The sky of an image, as the scene's own sky is made, (1, n_y, n_x)."""
    section = SkyMap.model_validate({"map_file": path, "frequency": "143 GHz", "spectral_index": 2})
    sky = map_mk(setup.scene, section, setup.sky.geometry, setup.sky.fwhm_rad)
    return np.stack([sharpened(item) for item in sky]).astype(np.float32)


@pytest.mark.slow
def test_a_map_divided_by_its_transfer_is_the_map_that_went_in(tmp_path):
    """Images of sources through six observations; the transfer function is of 30 skies of another spectrum.

    Ten images of a hundred sources, all scored multipoles together: within 0.1 %. Three images of a bright source
    alone: within 1 % each.
    """
    n_flat, paths = 30, [tmp_path / f"{number}.fits" for number in range(13)]
    setup = setup_of(n_flat + len(paths), 6)
    analysis = setup.analysis
    truth = [source_file(path, seed, 100 if seed < 10 else 1, 60) for seed, path in enumerate(paths)]
    skies = np.concatenate([flat_skies(setup, n_flat), [image_sky(setup, path) for path in paths]])
    inputs, outputs, weight = passed(setup, skies, range(6))
    found = _spectra(analysis, inputs, outputs)
    ratios = np.array([_share(analysis, found, n_flat + number, range(n_flat))[1] for number in range(10)])
    assert ratios.std(ddof=1) < 0.003
    assert ratios.mean() == pytest.approx(1, abs=1e-3)
    transfer, beam = found.transfer(range(n_flat)), setup.sky.fwhm_rad[0]
    pixels = MapGeometry(
        setup.scene.field.ra_rad, setup.scene.field.dec_rad, analysis.geometry.pixel_rad, *weight.shape
    )
    for number in range(10, 13):
        ((ra, dec),), (flux_jy,) = truth[number]
        source = _Source("", "catalogue", ra, dec, flux_jy, 0.0)
        aperture = _aperture(pixels, source, beam, weight)
        left = _left(_profile(pixels, source, beam), aperture, transfer)
        to_jy = analysis.geometry.pixel_rad**2 / (peak_mk_per_jy(setup.scene) * SR_PER_FWHM2 * beam**2)
        out, went_in = (to_jy * float(np.sum(aperture * maps[n_flat + number])) for maps in (outputs, inputs))
        assert out / left == pytest.approx(went_in, rel=0.01)
        # The closed form of the aperture, within its pixels along the edge.
        assert went_in == pytest.approx(flux_jy * (1 - 2 * 2.0**-4 + 2.0**-8), rel=0.03)


# ---------------------------------------------------------------- spectra


def brute_force(psd, shape, cell_rad, taper, pixel_rad):
    """Expected power of the Laplacian of tapered maps, by direct sums over all modes of a periodic sky.

    The tapered map's mode k gets the amplitude W(k - k') of each mode k' of the sky, the sum of the taper times a wave.
    For a taper of x times one of y the sum over k' is two matrix products.
    """
    n_pad = len(taper)
    profile = taper[n_pad // 4] / math.sqrt(taper[n_pad // 4, n_pad // 4])
    at = np.arange(n_pad) * pixel_rad
    k_map = 2 * np.pi * np.fft.fftfreq(n_pad, pixel_rad)
    mixing = []
    for n in shape:
        k_sky = 2 * np.pi * np.fft.fftfreq(n, cell_rad)
        window = np.exp(1j * k_sky[:, None] * at) * profile @ np.exp(-1j * np.outer(at, k_map))
        mixing.append(np.abs(window) ** 2 / (n * cell_rad))
    return mixing[0].T @ psd @ mixing[1]


def covariance(power, taper, bin_of_mode, n_bin):
    """Covariance (n_bin, n_bin) of binned powers of Gaussian skies: sums over pairs of modes that the taper ties.

    Modes of expected powers P and P' have the covariance ``P P' |r(k - k')|^2``, r the transform of the squared taper.
    """
    tied = np.fft.fft2(np.abs(np.fft.fft2(taper**2) / np.sum(taper**2)) ** 2)
    masks = [np.where(bin_of_mode == b, power, 0.0) for b in range(n_bin)]
    counts = [np.sum(bin_of_mode == b) for b in range(n_bin)]
    spread = [np.fft.ifft2(np.fft.fft2(mask) * tied).real for mask in masks]
    found = [[2 * np.sum(one * other) for other in spread] for one in masks]
    return np.array(found) / np.outer(counts, counts)


@pytest.mark.slow
def test_spectra_of_sixty_skies():
    """Skies of a spectrum of CAMB and a flat one, through the scans: their mean, and the chi^2 of each.

    Cross-spectra of the maps of two pairs of observations, over the transfer function of 36 flat skies. The expectation
    and its covariance are direct sums over the modes of the sky. Means that scans lose leave stripes, which mix long
    waves into short ones: some 3 uK2 of this sky at l = 8000 to 10000, less than the errors of the mean.
    """
    n_flat, n_sky = 36, 60
    setup = setup_of(n_flat + n_sky, 4, **{"map.pixel": "20 arcsec"})
    region, grid, pixel = setup.analysis.region, setup.sky.geometry, setup.analysis.geometry.pixel_rad
    rings, n_bin = region.rings, len(region.rings.ell)
    table = shipped_folder() / "lynx_sky_spectrum.dat"
    section = Sky.model_validate({"spectrum": table, "cmb_band_power": "300 uK2"})
    spectrum, rng = partial(sky_spectrum_mk2, section, setup.scene.instrument.cmb_per_rj), np.random.default_rng(5)
    drawn = [sharpened(flat_sky(grid, spectrum, setup.sky.fwhm_rad[0], rng))[None] for _ in range(n_sky)]
    skies = np.concatenate([flat_skies(setup, n_flat), drawn])
    halves = [passed(setup, skies, pair) for pair in ((0, 1), (2, 3))]
    found = _spectra(setup.analysis, halves[0][0], halves[0][0]), _spectra(setup.analysis, halves[0][1], halves[1][1])
    before, after = (np.array([ring_mean(sky, rings) for sky in item.cross]) for item in found)

    shape = grid.n_y, grid.n_x
    k = [2 * np.pi * np.fft.fftfreq(n, grid.pixel_rad) for n in shape]
    windows = [np.sinc(item * pixel / (2 * np.pi)) ** 2 for item in k]
    sharp = (4 - 2 * np.cos(k[0] * pixel)[:, None] - 2 * np.cos(k[1] * pixel)) ** 2
    ell = np.hypot(k[0][:, None], k[1])
    psd = spectrum(ell) * beam_window(ell, setup.sky.fwhm_rad[0]) * windows[0][:, None] * windows[1] * sharp
    whole = brute_force(psd, shape, grid.pixel_rad, region.padded_taper, pixel)
    n_pad = len(whole)
    steps = 2 * np.pi * np.fft.fftfreq(n_pad, pixel)
    bins = np.searchsorted(rings.edges_ell, np.hypot(steps[:, None], steps), side="right") - 1
    expected = np.array([whole[bins == b].mean() for b in range(n_bin)])
    used = region.selected
    relative = (covariance(whole, region.padded_taper, bins, n_bin) / np.outer(expected, expected))[np.ix_(used, used)]
    inverse, count = np.linalg.inv(relative), int(used.sum())
    left = after[:n_flat].sum(axis=0) / before[:n_flat].sum(axis=0)
    for name, powers in (("in", before[n_flat:] / expected), ("out", after[n_flat:] / (expected * left))):
        off = powers[:, used] - 1
        mean = off.mean(axis=0)
        # Chi^2 of the mean, and the mean chi^2 of a sky, within three of their standard deviations.
        assert n_sky * mean @ inverse @ mean < count + 3 * math.sqrt(2 * count), name
        each = np.einsum("ij,jk,ik->i", off, inverse, off)
        assert each.mean() == pytest.approx(count, abs=3 * each.std() / math.sqrt(n_sky)), name
