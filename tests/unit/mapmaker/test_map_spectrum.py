"""Exact properties of the taper, the Fourier bins, the map PSD and transfer functions."""

import numpy as np
import pytest

from mapmaker.spectrum import annuli, map_psd, mode_ell, mode_psd, split_azimuth, tukey_taper
from mapmaker.transfer_function import beam_window, measure_transfer_function, pixel_window

PIXEL_RAD = np.radians(0.5 / 60)


def test_taper_is_a_box_at_zero_and_a_hann_at_one():
    box = tukey_taper(10, 12, PIXEL_RAD, size_rad=6 * PIXEL_RAD, edge_fraction=0)
    assert box.sum() == 36
    assert (box[2:8, 3:9] == 1).all()
    hann = tukey_taper(16, 16, PIXEL_RAD, size_rad=16 * PIXEL_RAD, edge_fraction=1)
    expected = np.sin(np.pi * (np.arange(16) + 0.5) / 16) ** 2
    np.testing.assert_allclose(hann, np.outer(expected, expected), atol=1e-15)


def test_taper_is_flat_inside_its_edges_and_zero_outside():
    taper = tukey_taper(101, 121, 1.0, size_rad=80.0, edge_fraction=0.25)
    np.testing.assert_allclose(taper, taper[::-1, ::-1])
    assert (taper[50, 60 - 30 : 60 + 31] == 1).all()
    assert (taper[50, : 60 - 40] == 0).all()
    np.testing.assert_allclose(taper[50, 60 + 35], 0.5)


@pytest.mark.parametrize("size, edge", [(11.0, 0.5), (0.0, 0.5), (8.0, 1.2), (8.0, -0.1)])
def test_taper_rejects_what_does_not_fit(size, edge):
    with pytest.raises(ValueError, match="must be in"):
        tukey_taper(10, 12, 1.0, size_rad=size, edge_fraction=edge)


@pytest.mark.parametrize("shape", [(16, 20), (15, 21), (16, 21), (15, 20)])
def test_annuli_count_the_cells_of_the_full_plane(shape):
    edges = np.array([1000.0, 4000.0, 9000.0, 15000.0])
    rings = annuli(*shape, PIXEL_RAD, edges_ell=edges, taper=np.ones(shape))
    k_y, k_x = (2 * np.pi * np.fft.fftfreq(n, PIXEL_RAD) for n in shape)
    ell = np.hypot(k_y[:, None], k_x)
    np.testing.assert_allclose(rings.n_modes, np.histogram(ell, edges)[0])
    np.testing.assert_allclose(rings.ell * rings.n_modes, np.histogram(ell, edges, weights=ell)[0])
    assert rings.multiplicity.sum() == ell.size


def test_annuli_lose_modes_to_a_hann_taper():
    """Along one axis (sum T^2)^2 / (n sum T^4) = (3/8)^2 / (35/128) for a Hann taper as long as the map."""
    taper = tukey_taper(64, 64, PIXEL_RAD, size_rad=64 * PIXEL_RAD, edge_fraction=1)
    edges = np.array([1000.0, 10000.0])
    cells = annuli(64, 64, PIXEL_RAD, edges_ell=edges, taper=np.ones((64, 64))).n_modes
    kept = annuli(64, 64, PIXEL_RAD, edges_ell=edges, taper=taper).n_modes / cells
    np.testing.assert_allclose(kept, ((3 / 8) ** 2 / (35 / 128)) ** 2)


def test_annuli_reject_bad_edges_empty_bins_and_other_tapers():
    with pytest.raises(ValueError, match="increasing"):
        annuli(8, 8, PIXEL_RAD, edges_ell=np.array([2.0, 1.0]), taper=np.ones((8, 8)))
    with pytest.raises(ValueError, match=r"no Fourier mode.*10\.0 <= ell < 20\.0"):
        annuli(8, 8, PIXEL_RAD, edges_ell=np.array([10.0, 20.0, 1e4]), taper=np.ones((8, 8)))
    with pytest.raises(ValueError, match="taper"):
        annuli(8, 8, PIXEL_RAD, edges_ell=np.array([0.0, 1e4]), taper=np.ones((8, 9)))


@pytest.mark.parametrize("shape", [(16, 20), (15, 21)])
def test_binned_psd_is_the_mean_over_the_full_plane(shape):
    maps = np.random.default_rng(1).normal(size=(2, 3, *shape))
    taper = tukey_taper(*shape, PIXEL_RAD, size_rad=15 * PIXEL_RAD, edge_fraction=0.5)
    edges = np.array([1000.0, 4000.0, 9000.0, 15000.0])
    rings = annuli(*shape, PIXEL_RAD, edges_ell=edges, taper=taper)
    psd = map_psd(maps, taper, PIXEL_RAD, rings)
    k_y, k_x = (2 * np.pi * np.fft.fftfreq(n, PIXEL_RAD) for n in shape)
    ell = np.hypot(k_y[:, None], k_x)
    full = np.abs(np.fft.fft2(maps[1, 2] * taper)) ** 2 * PIXEL_RAD**2 / np.sum(taper**2)
    expected = np.histogram(ell, edges, weights=full)[0] / np.histogram(ell, edges)[0]
    assert psd.shape == (2, 3, 3)
    np.testing.assert_allclose(psd[1, 2], expected)
    np.testing.assert_allclose(mode_psd(maps, taper, PIXEL_RAD)[1, 2], full[:, : shape[1] // 2 + 1])


def test_psd_integrates_to_the_variance():
    """Parseval: the PSD summed over the cells of the full plane, each 1 / map area, is the mean square."""
    a_map = np.random.default_rng(2).normal(size=(16, 18))
    box = np.ones(a_map.shape)
    rings = annuli(16, 18, PIXEL_RAD, edges_ell=np.array([0.0, 1e9]), taper=box)
    psd = map_psd(a_map, box, PIXEL_RAD, rings)
    np.testing.assert_allclose(psd[0] * rings.n_modes[0] / (a_map.size * PIXEL_RAD**2), np.mean(a_map**2))


def test_float32_maps_give_float64_bins():
    a_map = np.random.default_rng(3).normal(size=(32, 32))
    taper = tukey_taper(32, 32, PIXEL_RAD, size_rad=32 * PIXEL_RAD, edge_fraction=0.5)
    rings = annuli(32, 32, PIXEL_RAD, edges_ell=np.array([1000.0, 10000.0]), taper=taper)
    single = map_psd(a_map.astype(np.float32), taper, PIXEL_RAD, rings)
    assert single.dtype == np.float64
    np.testing.assert_allclose(single, map_psd(a_map, taper, PIXEL_RAD, rings), rtol=1e-5)


def test_psd_rejects_other_shapes():
    taper = np.ones((8, 8))
    rings = annuli(8, 8, PIXEL_RAD, edges_ell=np.array([0.0, 1e4]), taper=taper)
    with pytest.raises(ValueError, match="annuli"):
        map_psd(np.ones((9, 9)), np.ones((9, 9)), PIXEL_RAD, rings)
    with pytest.raises(ValueError, match=r"map_mk: found the shape \(9, 9\); \(..., 8, 8\) is expected"):
        mode_psd(np.ones((9, 9)), taper, PIXEL_RAD)


def test_mode_ell_reaches_nyquist():
    ell = mode_ell(16, 16, PIXEL_RAD)
    assert ell.shape == (16, 9)
    np.testing.assert_allclose(ell[0, 8], np.pi / PIXEL_RAD)


def test_beam_window_is_the_square_of_the_transform_of_the_beam():
    """A beam of FWHM f has B = exp(-ell^2 f^2 / (16 ln 2)): B^2 is 1/2 at ell = sqrt(8) ln 2 / f."""
    fwhm_rad = np.radians(1 / 60)
    np.testing.assert_allclose(beam_window(np.array([0.0, np.sqrt(8) * np.log(2) / fwhm_rad]), fwhm_rad), [1, 0.5])


def test_pixel_window_at_small_ell_and_against_a_fine_average():
    """sinc^2(x) = 1 - x^2 / 3 + 2 x^4 / 45: to first order the mean over azimuth is 1 - (ell p)^2 / 12."""
    small = 0.01 / PIXEL_RAD
    np.testing.assert_allclose(1 - pixel_window(small, PIXEL_RAD), 0.01**2 / 12, rtol=1e-4)
    azimuth = np.linspace(0, 2 * np.pi, 100_000, endpoint=False)
    corner = np.sqrt(2) * np.pi / PIXEL_RAD
    half = corner * PIXEL_RAD / 2
    fine = (np.sinc(half * np.cos(azimuth) / np.pi) * np.sinc(half * np.sin(azimuth) / np.pi)) ** 2
    np.testing.assert_allclose(pixel_window(corner, PIXEL_RAD), fine.mean(), rtol=1e-12)


def test_transfer_function_of_a_constant_loss_has_no_error():
    reference = np.random.default_rng(4).chisquare(10, size=(5, 3))
    loss = np.array([0.1, 0.5, 0.9])
    transfer_function = measure_transfer_function(reference * loss, reference, np.arange(3.0))
    np.testing.assert_allclose(transfer_function.transmission, loss)
    np.testing.assert_allclose(transfer_function.error, 0, atol=1e-15)


def test_transfer_function_error_is_the_scatter_over_repeats():
    """400 repeats know a standard deviation to 1 / sqrt(800) = 3.5 %, here allowed three times that."""
    rng = np.random.default_rng(5)
    reference = rng.chisquare(50, size=(400, 20, 2)) / 50
    cleaned = 0.6 * reference * (1 + 0.1 * rng.normal(size=reference.shape))
    found = [measure_transfer_function(c, r, np.arange(2.0)) for c, r in zip(cleaned, reference, strict=True)]
    transmission = np.array([item.transmission for item in found])
    error = np.sqrt(np.mean([item.error**2 for item in found], axis=0))
    np.testing.assert_allclose(transmission.mean(axis=0), 0.6, atol=4 * error.max() / np.sqrt(400))
    np.testing.assert_allclose(transmission.std(axis=0), error, rtol=3 / np.sqrt(800))


def test_transfer_function_rejects_one_sky_other_shapes_and_no_power():
    ell = np.arange(3.0)
    with pytest.raises(ValueError, match="at least 2 skies"):
        measure_transfer_function(np.ones((1, 3)), np.ones((1, 3)), ell)
    with pytest.raises(ValueError, match="expected psd_cleaned"):
        measure_transfer_function(np.ones((2, 3)), np.ones((3, 3)), ell)
    with pytest.raises(ValueError, match="power"):
        measure_transfer_function(np.ones((2, 3)), np.zeros((2, 3)), ell)


def test_sectors_split_their_rings():
    taper = tukey_taper(48, 48, PIXEL_RAD, size_rad=40 * PIXEL_RAD, edge_fraction=0.5)
    edges = np.linspace(0.25, 0.9, 4) * np.pi / PIXEL_RAD
    rings = annuli(48, 48, PIXEL_RAD, edges_ell=edges, taper=taper)
    sectors = split_azimuth(rings, 48, 48, PIXEL_RAD, n_sector=3)
    assert np.allclose(sectors.n_modes.reshape(3, 3).sum(axis=1), rings.n_modes)
    # A wave along an axis falls into the first sector of its ring, one at 45 degrees into the last.
    x, y = np.meshgrid(np.arange(48), np.arange(48))
    for wave, place in ((np.cos(2 * np.pi * 14 * x / 48), 0), (np.cos(2 * np.pi * 10 * (x + y) / 48), 2)):
        psd = map_psd(wave, taper, PIXEL_RAD, sectors)
        ring = (
            np.searchsorted(
                edges,
                mode_ell(48, 48, PIXEL_RAD)[0, 14] if place == 0 else np.sqrt(2) * mode_ell(48, 48, PIXEL_RAD)[0, 10],
            )
            - 1
        )
        assert np.argmax(psd) == 3 * ring + place
    with pytest.raises(ValueError, match="without modes"):
        split_azimuth(
            annuli(48, 48, PIXEL_RAD, edges_ell=np.array([1, 1.5]) * 2 * np.pi / (48 * PIXEL_RAD), taper=taper),
            48,
            48,
            PIXEL_RAD,
            n_sector=3,
        )


def test_sectors_average_to_their_ring():
    taper = tukey_taper(40, 40, PIXEL_RAD, size_rad=36 * PIXEL_RAD, edge_fraction=0.5)
    rings = annuli(40, 40, PIXEL_RAD, edges_ell=np.array([0.3, 0.6, 0.9]) * np.pi / PIXEL_RAD, taper=taper)
    sectors = split_azimuth(rings, 40, 40, PIXEL_RAD, n_sector=2)
    sky = np.random.default_rng(5).standard_normal((40, 40))
    by_sector = map_psd(sky, taper, PIXEL_RAD, sectors).reshape(2, 2)
    weight = sectors.n_modes.reshape(2, 2)
    average = (by_sector * weight).sum(axis=1) / weight.sum(axis=1)
    assert np.allclose(average, map_psd(sky, taper, PIXEL_RAD, rings), rtol=1e-12)
