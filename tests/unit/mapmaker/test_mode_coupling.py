"""Coupling matrices, windows and scatter against brute force, and what is flagged or refused."""

from functools import partial

import numpy as np
import pytest

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.errors import InsufficientDataError, OutOfRangeError
from mapmaker.flat_spectra import flat_coupling, plane_distortion
from mapmaker.spectrum import coupled_psd, mode_ell, neighbour_correlation, ring_mean, tukey_taper
from mapmaker.transfer_function import beam_window, mode_pixel_window
from tests import naive

PIXEL = np.radians(0.5 / 60)
BEAM = partial(beam_window, fwhm_rad=np.radians(1 / 60))
EDGES = np.arange(1000.0, 10001, 1500)


@pytest.fixture(scope="module")
def taper():
    return tukey_taper(40, 48, PIXEL, size_rad=40 * PIXEL, edge_fraction=0.7)


@pytest.mark.parametrize(("sky_shape", "cells"), [(None, 1), ((100, 96), 1), ((160, 200), 2), ((30, 34), 1)])
def test_matrix_is_the_adjoint_of_coupled_psd(taper, sky_shape, cells):
    """Decoupled, the binned `coupled_psd` of a sky of constant band powers in the bins has those band powers."""
    found = flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=BEAM, sky_shape=sky_shape, cells_per_pixel=cells)
    power = np.array([5.0, 1, 4, 2, 3, 7])
    sky_shape = sky_shape or (160, 192)
    ell = mode_ell(*sky_shape, PIXEL / cells)
    sky = power[np.clip(np.searchsorted(EDGES, ell, side="right") - 1, 0, 5)] * flat_spectrum_psd(ell) * BEAM(ell)
    sky *= mode_pixel_window(*sky_shape, PIXEL / cells, PIXEL)
    rings = found.field.rings
    pseudo = ring_mean(coupled_psd(sky, sky_shape, taper, PIXEL, cells_per_pixel=cells), rings)
    np.testing.assert_allclose(found.expected_pseudo_power(power), pseudo, rtol=1e-10)
    np.testing.assert_allclose(found.decouple(pseudo), power, rtol=1e-10)
    np.testing.assert_allclose(found.windows.sum(axis=1), 1, rtol=1e-12)


def test_windows_give_the_expected_band_powers_of_any_spectrum(taper):
    """A steep spectrum that falls within bins, to the width of the windows' own bins."""
    found = flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=BEAM)

    def spectrum(ell):
        return 1e3 * np.exp(-ell / 3000)

    ell = mode_ell(160, 192, PIXEL)
    sky = spectrum(ell) * flat_spectrum_psd(ell) * BEAM(ell) * mode_pixel_window(160, 192, PIXEL, PIXEL)
    expected = found.decouple(ring_mean(coupled_psd(sky, (160, 192), taper, PIXEL), found.field.rings))
    by_windows = found.windows @ spectrum(found.window_ell)
    np.testing.assert_allclose(by_windows, expected, rtol=2e-3)
    assert (np.abs(spectrum(found.ell) / expected - 1) > 0.1).any()


def test_dense_matrix_over_modes():
    """All waves of a small map and its sky, one by one."""
    taper = np.random.default_rng(1).uniform(0.1, 1, (8, 10))
    edges = np.array([3000.0, 7000, 12000, 20000])
    found = flat_coupling(taper, PIXEL, edges_ell=edges, beam=BEAM, sky_shape=(17, 24))
    response = naive.mode_response(taper, PIXEL, edges, (17, 24))
    k_y, k_x = (2 * np.pi * np.fft.fftfreq(n, PIXEL) for n in (17, 24))
    ell = np.hypot(k_y[:, None], k_x)
    window = np.outer(np.sinc(k_y * PIXEL / 2 / np.pi), np.sinc(k_x * PIXEL / 2 / np.pi)) ** 2
    of_mode = response * flat_spectrum_psd(ell) * BEAM(ell) * window
    expected = [
        [row[(ell >= low) & (ell < high)].sum() for low, high in ((0, 7000), (7000, 12000), (12000, 1e9))]
        for row in of_mode
    ]
    np.testing.assert_allclose(found.matrix, expected, rtol=1e-10)


def test_scatter_of_neighbours(taper):
    found = flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=BEAM)
    deviation = np.sqrt(np.diag(found.scatter))
    correlation = np.diag(found.scatter / np.outer(deviation, deviation), 1)
    np.testing.assert_allclose(correlation, neighbour_correlation(taper, found.field.rings), rtol=1e-10)
    # Wide bins have the modes that annuli count.
    wide = flat_coupling(taper, PIXEL, edges_ell=np.array([5000.0, 20000]), beam=BEAM)
    np.testing.assert_allclose(wide.n_modes, wide.field.rings.n_modes, rtol=0.05)


def test_transfer_function_multiplies_the_pseudo_power(taper):
    transfer = np.array([0.1, 0.3, 0.5, 0.8, 1, 1])
    whole = flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=BEAM)
    found = flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=BEAM, transfer=transfer)
    pseudo = np.random.default_rng(2).uniform(1, 2, 6) * 1e-6
    np.testing.assert_allclose(found.decouple(pseudo * transfer), whole.decouple(pseudo), rtol=1e-12)
    np.testing.assert_allclose(found.windows, whole.windows, rtol=1e-9, atol=1e-12)


def test_lost_bins_have_no_band_power(taper):
    """Their neighbours do not feel them; a flat spectrum keeps its power."""
    transfer = np.array([0, 0.5, np.nan, 1, 1, 1])
    found = flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=BEAM, transfer=transfer)
    whole = flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=BEAM)
    pseudo = np.nan_to_num(transfer) * whole.expected_pseudo_power(np.full(6, 3.0))
    np.testing.assert_allclose(found.decouple(pseudo), [np.nan, 3, np.nan, 3, 3, 3], rtol=1e-10)
    assert found.flags == ("2 of 6 bins: no band power, because beam, scans or cleaning remove it",)
    with pytest.raises(InsufficientDataError, match="leave no power in any bin"):
        flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=BEAM, transfer=np.zeros(6))


def test_narrow_bins_are_flagged(taper):
    padded = np.pad(taper, ((0, 60), (0, 52)))
    found = flat_coupling(padded, PIXEL, edges_ell=np.arange(1000.0, 6001, 250), beam=BEAM)
    assert found.flags[0] == "bins 250 wide in ell: the taper resolves 1438, and wider bins are better"
    assert found.flags[1] == "8 of 20 bins: fewer than 10 modes, and errors that are not Gaussian"
    assert found.flags[2].startswith("a coupling matrix of the condition number ")
    assert len(found.flags) == 3
    assert flat_coupling(taper, PIXEL, edges_ell=np.arange(2000.0, 12001, 2500), beam=BEAM).flags == ()


def test_coupling_without_inverse():
    padded = np.pad(tukey_taper(8, 8, PIXEL, size_rad=8 * PIXEL, edge_fraction=1.0), (0, 88))
    with pytest.raises(
        InsufficientDataError, match="coupling of bins 240 wide has no inverse: wider bins are expected"
    ):
        flat_coupling(padded, PIXEL, edges_ell=np.arange(1000.0, 18000, 240), sky_shape=(96, 96), beam=BEAM)


def test_resolution_of_a_box():
    """Power of a box (n, n) in modes of 2 pi / n."""
    box = np.pad(np.ones((20, 20)), 12)
    found = flat_coupling(box, PIXEL, edges_ell=EDGES, beam=BEAM)
    assert found.resolution_ell == pytest.approx(2 * np.pi / (20 * PIXEL))


def test_distortion_of_a_plane():
    """Numerical stretch of a gnomonic plane at all directions, under a taper of 16 degrees."""
    n, pixel = 64, np.radians(0.25)
    taper = tukey_taper(n, n, pixel, size_rad=n * pixel, edge_fraction=1)
    at = (np.arange(n) - (n - 1) / 2) * pixel
    theta = np.arctan(np.hypot(at[:, None], at))
    angle = np.arange(0.5, 90) * np.pi / 180
    inverse = np.hypot(np.cos(angle) * np.cos(theta)[..., None] ** 2, np.sin(angle) * np.cos(theta)[..., None])
    stretch = np.average((1 / inverse).mean(axis=-1), weights=taper**2)
    assert plane_distortion(taper, pixel) == pytest.approx(stretch - 1, rel=0.05)
    # Neither padding nor the taper's place on the map matters.
    assert plane_distortion(np.pad(taper, ((0, 9), (5, 0))), pixel) == pytest.approx(plane_distortion(taper, pixel))


def test_large_fields_are_flagged():
    n, pixel = 48, np.radians(0.5)
    taper = tukey_taper(n, n, pixel, size_rad=n * pixel, edge_fraction=0.5)
    found = flat_coupling(taper, pixel, edges_ell=np.arange(50.0, 351, 50), beam=np.ones_like)
    assert found.flags == ("the plane shifts multipoles by 1.1 %: such a field needs curved_coupling",)


def test_refusals(taper):
    with pytest.raises(OutOfRangeError, match="edges_ell: found 30000; at most 21600, the Nyquist multipole"):
        flat_coupling(taper, PIXEL, edges_ell=np.array([1000.0, 30000]), beam=BEAM)
    with pytest.raises(ValueError, match=r"transfer: found the shape \(3,\); \(6,\) is expected"):
        flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=BEAM, transfer=np.ones(3))
    with pytest.raises(ValueError, match=r"beam\(ell\): found -1.0 at"):
        flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=lambda ell: -np.ones_like(ell))
    with pytest.raises(ValueError, match="edges_ell: found -1.0 at"):
        flat_coupling(taper, PIXEL, edges_ell=np.array([-1.0, 5000]), beam=BEAM)
