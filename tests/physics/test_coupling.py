"""Expected signal PSD of tapered maps against brute force, and the amplitudes that follow from it."""

from pathlib import Path

import numpy as np
import pytest
from scipy import fft, ndimage

from mapmaker.bandpower import estimate_amplitude, flat_band_power, flat_spectrum_psd
from mapmaker.geometry import MapGeometry, boresight_pixels, sky_offsets
from mapmaker.spectrum import annuli, coupled_psd, map_psd, mode_ell, neighbour_correlation, ring_mean, tukey_taper
from mapmaker.transfer_function import beam_window, mode_pixel_window, pixel_window
from surveysim.forecasting.forecast import forecast
from surveysim.forecasting.noise_model import survey_models
from surveysim.reduction.scored_region import mapped_signal
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.timestreams.simulation import observation_path

LYNX = Path(__file__).parents[2] / "scenarios" / "lynx.toml"
FWHM = np.radians(1 / 60)


@pytest.fixture(scope="module")
def lynx():
    return prepare(load_scene(LYNX, {"observations": 20}))


def flat_modes(n, pixel):
    """Flat spectrum of unit band power behind beam and pixels on the half plane of n x n pixels."""
    return (
        flat_spectrum_psd(mode_ell(n, n, pixel))
        * beam_window(mode_ell(n, n, pixel), FWHM)
        * mode_pixel_window(n, n, pixel, pixel)
    )


def closed_form(ell, pixel):
    return flat_spectrum_psd(ell) * beam_window(ell, FWHM) * pixel_window(ell, pixel)


def patches(psd, n_sky, n, rng):
    """Square patches (n_sky per_side^2, n, n) of skies of unit pixels whose PSD on the half plane is given."""
    side = len(psd)
    white = fft.rfft2(rng.normal(size=(n_sky, side, side)))
    skies = fft.irfft2(white * np.sqrt(psd), (side, side))
    cut = skies[:, : side // n * n, : side // n * n].reshape(n_sky, side // n, n, side // n, n)
    return cut.swapaxes(2, 3).reshape(-1, n, n)


def test_ratios_of_lynx(lynx):
    """Over the closed form at the bins' mean multipoles, of a sky of the modes of 8 patches a side."""
    band, pixel = lynx.analysis.region, lynx.analysis.geometry.pixel_rad
    n = 8 * len(band.taper)
    found = ring_mean(coupled_psd(flat_modes(n, pixel), (n, n), band.padded_taper, pixel), band.rings)
    ratio = found / closed_form(band.rings.ell, pixel)
    for ell, expected, digit in (
        (727, 1.73, 0.01),
        (1245, 1.39, 0.01),
        (1749, 1.17, 0.01),
        (2738, 1.05, 0.01),
        (4749, 1.018, 0.001),
        (6251, 1.013, 0.001),
    ):
        place = np.argmin(np.abs(band.rings.ell - ell))
        assert band.rings.ell[place] == pytest.approx(ell, abs=1)
        assert ratio[place] == pytest.approx(expected, abs=digit), ell


def test_coupled_psd_is_the_mean_over_skies():
    """200 skies four times as large as the map, of a steep spectrum, for tapers that fill the map or half of it."""
    n, n_sky = 48, 200
    psd = flat_modes(4 * n, FWHM / 3)
    rng = np.random.default_rng(3)
    for taper in (
        tukey_taper(n, n, 1.0, size_rad=n, edge_fraction=0.5),
        tukey_taper(n, n, 1.0, size_rad=n // 2, edge_fraction=0.5),
        np.ones((n, n)),
    ):
        rings = annuli(n, n, FWHM / 3, edges_ell=np.array([300.0, 1500, 3000, 6000, 12000]), taper=taper)
        found = map_psd(patches(psd, n_sky, 4 * n, rng)[:, :n, :n], taper, 1.0, rings)
        expected = ring_mean(coupled_psd(psd, (4 * n, 4 * n), taper, 1.0), rings)
        error = found.std(axis=0) / np.sqrt(n_sky)
        assert (np.abs(found.mean(axis=0) - expected) < 4 * error).all()
        assert (error < 0.1 * expected)[1:].all()
        if taper.min() == 1:  # without a taper far sidelobes lift the highest bin
            assert expected[-1] > 1.05 * closed_form(rings.ell[-1], FWHM / 3)


@pytest.mark.parametrize(
    ("sky_shape", "shape", "cells"), [((24, 20), (7, 6), 1), ((24, 30), (8, 5), 2), ((8, 9), (9, 8), 1)]
)
def test_coupled_psd_is_a_convolution(sky_shape, shape, cells):
    """The sum over the sky's modes k' of S(k') |T(k - k')|^2 / (L^2 sum T^2), mode by mode."""
    rng, pixel = np.random.default_rng(4), 0.1
    taper = rng.uniform(0.2, 1, shape)
    half = np.abs(fft.rfft2(rng.normal(size=sky_shape))) ** 2
    k_sky = [2 * np.pi * np.fft.fftfreq(n, pixel / cells) for n in sky_shape]
    whole = np.abs(fft.fft2(fft.irfft2(half, sky_shape)))  # the same on the whole plane
    k_map = 2 * np.pi * np.fft.fftfreq(shape[0], pixel), 2 * np.pi * np.fft.rfftfreq(shape[1], pixel)
    wave = [
        np.exp(-1j * np.subtract.outer(k, sky)[..., None] * np.arange(n) * pixel)
        for k, sky, n in zip(k_map, k_sky, shape, strict=True)
    ]
    transform = np.einsum("aAy,bBx,yx->abAB", *wave, taper)
    area = np.prod(sky_shape) * (pixel / cells) ** 2
    expected = np.einsum("abAB,AB->ab", np.abs(transform) ** 2, whole) * pixel**2 / (area * np.sum(taper**2))
    found = coupled_psd(half, sky_shape, taper, pixel, cells_per_pixel=cells)
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_white_noise_stays_white():
    taper = tukey_taper(20, 16, 1.0, size_rad=12, edge_fraction=0.7)
    np.testing.assert_allclose(coupled_psd(np.full((20, 9), 3.0), (20, 16), taper, 1.0), 3.0, rtol=1e-12)


def test_coupled_psd_refuses():
    with pytest.raises(ValueError, match=r"sky_psd: found the shape \(4, 4\); \(4, 3\) is expected"):
        coupled_psd(np.ones((4, 4)), (4, 4), np.ones((2, 2)), 1.0)
    with pytest.raises(ValueError, match="cells_per_pixel: found 1.5; an integer of at least 1 and of at most"):
        coupled_psd(np.ones((4, 3)), (4, 4), np.ones((2, 2)), 1.0, cells_per_pixel=1.5)
    with pytest.raises(ValueError, match="annuli are for 12"):
        rings = annuli(4, 4, 1.0, edges_ell=np.array([1.0, 4.0]), taper=np.ones((4, 4)))
        neighbour_correlation(np.ones((4, 6)), rings)


def test_the_run_expects_what_its_skies_hold(lynx):
    """Band's signal PSD against signal simulations: read at every second cell, skies behind the map's pixels."""
    band, n, n_sky = lynx.analysis.region, len(lynx.analysis.region.taper), 100
    shape, cell = (lynx.sky.geometry.n_y, lynx.sky.geometry.n_x), lynx.sky.geometry.pixel_rad
    sky = flat_spectrum_psd(mode_ell(*shape, cell)) * beam_window(mode_ell(*shape, cell), FWHM)
    sky *= mode_pixel_window(*shape, cell, lynx.analysis.geometry.pixel_rad)
    rng = np.random.default_rng(8)
    maps = (patches(sky, 1, shape[0], rng)[0, : 2 * n : 2, : 2 * n : 2] for _ in range(n_sky))
    psds = [1e6 * map_psd(band.pad(item), band.padded_taper, 2e-3, band.rings) for item in maps]
    error = np.std(psds, axis=0) / np.sqrt(n_sky)
    assert (np.abs(np.mean(psds, axis=0) - band.signal_psd) < 4.5 * error).all()
    assert (error[band.selected] < 0.03 * band.signal_psd[band.selected]).all()
    sectors = band.sector_psd.reshape(-1, 3).mean(axis=1)
    np.testing.assert_allclose(sectors, band.signal_psd[band.selected], rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["none", "average", "planar"])
def test_what_cleaning_leaves_does_not_depend_on_the_skies_size(algorithm):
    """Scans and cleaning remove the modes that the periodic grid of the simulations lacks: tested with a grid 3 times
    as large.

    They matter much before cleaning, so a transfer function needs the same skies as the signal that it multiplies.
    """
    scene = load_scene(LYNX, {"observations": 20, "cleaning.algorithm": algorithm})
    setup = prepare(scene)
    share = forecast(prepare(scene)).scores["actual"].transmission
    small, ell = setup.sky.geometry, setup.analysis.region.rings.ell
    large = MapGeometry(small.ra0_rad, small.dec0_rad, small.pixel_rad, 3 * small.n_x, 3 * small.n_y)

    def signal(sky_geometry, transmission):
        modes = mapped_signal(
            setup.analysis.beams,
            setup.analysis.geometry,
            sky_geometry,
            setup.analysis.region.padded_taper,
            transmission,
        )
        return ring_mean(modes, setup.analysis.region.rings)

    def left(at):
        """Falls as it does between bins, and at least as the square below."""
        log = np.interp(np.log(np.maximum(at, 1)), np.log(ell), np.log(share))
        return np.exp(log) * np.minimum(at / ell[1], 1) ** 2

    above = ell > 1000
    np.testing.assert_allclose(signal(large, left)[above], signal(small, left)[above], rtol=5e-3)
    assert signal(large, np.ones_like)[2] > 1.1 * signal(small, np.ones_like)[2]


def test_coupling_lowers_sigma_of_lynx(lynx):
    """By 1.5 % from ell = 4500, as from 221.1 to 217.8 uK^2; before by the closed form at the bins' mean multipoles."""
    found = forecast(prepare(lynx.scene)).scores
    rings, selected = lynx.analysis.region.rings, lynx.analysis.region.selected
    for name, before, after in (("actual", 221.1, 217.8), ("uncorrelated", 135.0, 132.9), ("white", 87.5, 86.1)):
        closed = closed_form(rings.ell, lynx.analysis.geometry.pixel_rad) * found[name].transmission
        sigma = flat_band_power(found[name].noise_psd, closed, rings.n_modes, selected)
        assert found[name].band.sigma_ukcmb2 / sigma == pytest.approx(after / before, abs=1e-3)


def scanned_maps(setup, view, algorithm):
    """Patches (2, n, n) of a sky, cells as of the sky grid, seen by two observations: as it is, and cleaned."""
    n, cell, middle = setup.analysis.geometry.n_x, setup.sky.geometry.pixel_rad, len(view) / 2 - 0.5
    sums, hits = np.zeros((2, n * n)), np.zeros(n * n)
    for observation in (0, 13):
        path = observation_path(setup.observing, observation)[1]
        at = path.xi_rad, path.eta_rad, path.array_angle_rad
        east, north = (offset.T for offset in sky_offsets(setup.camera.focal_plane, at[2]))
        places = [middle + (at[1] + north) / cell, middle - (at[0] + east) / cell]
        seen = ndimage.map_coordinates(view, places, order=1)
        left = seen.reshape(len(seen), path.scan[-1] + 1, -1)
        left = left - left.mean(axis=2, keepdims=True)
        if algorithm == "average":
            left = left - left.mean(axis=0)
        pixel = boresight_pixels(setup.analysis.geometry, *at, plane=setup.camera.focal_plane).ravel()
        sums += [np.bincount(pixel, streams.ravel(), n * n) for streams in (seen, left)]
        hits += np.bincount(pixel, minlength=n * n)
    return (sums / np.maximum(hits, 1)).reshape(2, n, n)[:, setup.analysis.region.patch, setup.analysis.region.patch]


@pytest.mark.parametrize(("algorithm", "allowed"), [("none", 0.03), ("average", 1e-3)])
def test_scans_take_the_modes_that_skies_lack(lynx, algorithm, allowed):
    """Brute force: modes longer than the sky grid, of a plane four times as large, in the map at ell = 1245.

    They hold a good part of its power before scans take their means, and next to nothing afterwards: 1.6 % without
    cleaning, 0.01 % with average subtraction.
    """
    cell, period = lynx.sky.geometry.pixel_rad, lynx.sky.geometry.n_x * lynx.sky.geometry.pixel_rad
    side, rng, power = 4 * lynx.sky.geometry.n_x, np.random.default_rng(12), np.zeros((2, 2))
    ell = mode_ell(side, side, cell)
    modes = fft.rfft2(rng.normal(size=(side, side)))
    modes *= np.sqrt(flat_spectrum_psd(ell) * beam_window(ell, FWHM))
    place = np.argmin(np.abs(lynx.analysis.region.rings.ell - 1245))
    for part, chosen in enumerate((ell * period < 2 * np.pi, ell * period >= 2 * np.pi)):
        sky = fft.irfft2(modes * chosen, (side, side))
        for corner in np.ndindex(2, 2):
            maps = scanned_maps(lynx, np.roll(sky, np.multiply(corner, side // 2), (0, 1)), algorithm)
            region = lynx.analysis.region
            psd = map_psd(region.pad(maps), region.padded_taper, 1.0, region.rings)
            power[:, part] += psd[:, place]
    before, after = power[:, 0] / power.sum(axis=1)
    assert before > 0.05
    assert after < allowed


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["none", "planar"])
def test_the_forecast_interpolates_its_transmission(algorithm):
    """Bins of 500 against bins of 250, which know it at twice as many multipoles: within 1 % from ell = 1000."""
    keys = {"observations": 4, "cleaning.algorithm": algorithm, "score.noise_only_sets": []}
    coarse, fine = (load_scene(LYNX, {**keys, "score.ell_bin": width}) for width in (500, 250))
    rings = prepare(fine).analysis.region.rings
    known, cells = survey_models(prepare(fine))[0].signal_psd, rings.n_modes
    pairs = (known * cells).reshape(-1, 2).sum(axis=1) / cells.reshape(-1, 2).sum(axis=1)
    found = survey_models(prepare(coarse))[0].signal_psd
    np.testing.assert_allclose(found[2:], pairs[2:], rtol=0.01)


def test_neighbouring_bins_correlate(lynx):
    """Of lynx by 0.32: against the scatter of 1000 white maps, pooled over bins, and within each pair of bins."""
    band, n_map = lynx.analysis.region, 1000
    expected = neighbour_correlation(band.padded_taper, band.rings)
    assert expected.mean() == pytest.approx(0.32, abs=0.005)
    rng, n = np.random.default_rng(9), len(band.taper)
    psds = np.array(
        [map_psd(band.pad(rng.normal(size=(n, n))), band.padded_taper, 1.0, band.rings) for _ in range(n_map)]
    )
    found = np.diag(np.corrcoef(psds.T), 1)
    # A correlation r from n samples is known to (1 - r^2) / sqrt(n).
    assert (np.abs(found - expected) < 4.5 / np.sqrt(n_map)).all()
    assert found[1:].mean() == pytest.approx(expected[1:].mean(), abs=4 / np.sqrt(n_map * len(found)))
    # Against bins that are wide beside the taper's resolution little is left.
    wide = annuli(
        *band.padded_taper.shape,
        lynx.analysis.geometry.pixel_rad,
        edges_ell=np.array([2000.0, 7000, 12000]),
        taper=band.padded_taper,
    )
    assert neighbour_correlation(band.padded_taper, wide)[0] < 0.07


@pytest.mark.slow
def test_amplitude_of_a_sky_is_its_own(lynx):
    """Skies of 1000 uK^2 in the noise and bins of lynx average 1000; by the closed form they averaged 1014.

    3200 patches of skies four times as large, whose scatter is about 105.
    """
    band, pixel = lynx.analysis.region, lynx.analysis.geometry.pixel_rad
    n, rng = len(band.taper), np.random.default_rng(10)
    noise = forecast(prepare(lynx.scene)).scores["actual"].noise_psd
    sky = 1000 * flat_modes(4 * n, pixel) / pixel**2
    psds = np.concatenate(
        [map_psd(band.pad(patches(sky, 1, n, rng)), band.padded_taper, pixel, band.rings) for _ in range(200)]
    )
    tests = {}
    for name, signal in (("coupled", band.signal_psd), ("closed", closed_form(band.rings.ell, pixel))):
        # `estimate_amplitude` takes the noise off, which these skies do not have.
        tests[name] = estimate_amplitude(
            psds + noise, noise_psd_ukcmb2=noise, signal_psd=signal, n_modes=band.rings.n_modes, mask=band.selected
        )
    error = tests["coupled"].std() / np.sqrt(len(psds))
    assert error < 2
    assert tests["coupled"].mean() == pytest.approx(1000, abs=3.5 * error)
    assert tests["closed"].mean() == pytest.approx(1014, abs=4 * error)
