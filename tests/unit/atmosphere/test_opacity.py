"""Opacity tables, their averages over a band and the interpolation in water vapour."""

from dataclasses import replace
from functools import partial
from importlib.resources import files

import numpy as np
import pytest
from astropy.table import Table
from scipy.interpolate import CubicSpline

from surveysim.atmosphere.opacity import (
    band_opacity,
    fluctuation_factor_mk2,
    optical_depth,
    optical_depth_slope,
    slant_factor,
)
from surveysim.atmosphere.tables import build_opacity
from surveysim.atmosphere.tables.am_spectra import WATER_CM2_PER_MM, am_opacity, cell_optical_depth
from surveysim.scene.passband import top_hat
from surveysim.scene.place import shipped_place

SITES = tuple(build_opacity.SITES)  # with tables of their own
TABLES = files("surveysim.atmosphere") / "tables"


def read(site):
    return Table.read(str(TABLES / f"opacity_{site}.ecsv"), format="ascii.ecsv")


@pytest.mark.parametrize("site", SITES)
def test_table_is_whole(site):
    table = read(site)
    np.testing.assert_array_equal(table["frequency"], np.arange(80.5, 420))
    assert table["frequency"].unit == "GHz"
    pwv = np.array(table.meta["pwv"])
    assert table.colnames[1:] == [f"pwv_{p:g}" for p in pwv]
    depth = np.stack([table[name] for name in table.colnames[1:]])
    assert (np.diff(pwv) > 0).all() and depth.min() > 0 and depth.max() <= table.meta["ceiling"]
    assert (np.diff(depth, axis=0) > 0)[:, depth.max(axis=0) < table.meta["ceiling"]].all()
    assert (TABLES / f"opacity_{site}.ecsv").stat().st_size < 60e3
    setup = build_opacity.SITES[site]
    assert (table.meta["site"], tuple(pwv), table.meta["profile"]) == (site, setup.pwv_mm, setup.profile)
    expected = build_opacity.atmosphere_temperature_k(setup)
    assert table.meta["atmosphere_temperature"] == pytest.approx(expected, abs=0.05)  # one decimal


def test_band_of_one_cell_is_the_table():
    table = read("alma")
    band = band_opacity(shipped_place("alma"), top_hat(183.5e9, 1 / 183.5))
    row = [table[f"pwv_{pwv:g}"][103] for pwv in band.pwv_mm]
    np.testing.assert_allclose(band.optical_depth, row, rtol=1e-12)
    np.testing.assert_allclose(optical_depth(band, band.pwv_mm), row, rtol=1e-12)
    assert band.temperature_k == table.meta["atmosphere_temperature"]


def test_cells_at_the_edges_count_by_the_part_inside():
    """182.25 to 184.5 GHz: three quarters of a cell, a whole one, half a cell; the line is steep there."""
    table = read("mauna_kea")
    band = band_opacity(shipped_place("mauna_kea"), top_hat(183.375e9, 2.25 / 183.375))
    transmission = np.exp(-np.array([table["pwv_0.5"][row] for row in (102, 103, 104)]))
    expected = -np.log(np.array([0.75, 1.0, 0.5]) @ transmission / 2.25)
    assert optical_depth(band, 0.5) == pytest.approx(expected, rel=1e-12)
    assert np.ptp(np.log(transmission)) > 0.3


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize(("frequency_ghz", "tolerance"), [(143, 5e-5), (268, 5e-5), (183.3, 1e-3), (350, 1e-3)])
def test_a_knot_left_out_is_predicted(site, frequency_ghz, tolerance):
    """To half a unit of the five digits of the tables, in bands without a saturated line."""
    band = band_opacity(shipped_place(site), top_hat(frequency_ghz * 1e9, 0.15))
    for i in range(1, len(band.pwv_mm) - 1):
        spline = CubicSpline(np.delete(band.pwv_mm, i), np.delete(band.optical_depth, i))
        assert spline(band.pwv_mm[i]) == pytest.approx(band.optical_depth[i], rel=tolerance)


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("frequency_ghz", [100, 143, 183.3, 268, 350])
def test_monotone_between_the_knots(site, frequency_ghz):
    band = band_opacity(shipped_place(site), top_hat(frequency_ghz * 1e9, 0.1))
    pwv_mm = np.linspace(band.pwv_mm[0], band.pwv_mm[-1], 2001)
    assert (np.diff(optical_depth(band, pwv_mm)) > 0).all()
    # A spline that swings would not keep the slope positive.
    assert (optical_depth_slope(band, pwv_mm) > 0).all()


def test_slope_is_the_derivative():
    band = band_opacity(shipped_place("mauna_kea"), top_hat(268e9, 0.15))
    pwv_mm = np.array([[0.06, 0.5], [1.68, 5.9]])
    difference = optical_depth(band, pwv_mm + 1e-4) - optical_depth(band, pwv_mm - 1e-4)
    np.testing.assert_allclose(optical_depth_slope(band, pwv_mm), difference / 2e-4, rtol=1e-7)


def test_factor_is_the_emission_s_change_above_the_atmosphere():
    """The emission changes as the emissivity does, and the calibration is above the atmosphere: over exp(-tau)."""
    band = band_opacity(shipped_place("mauna_kea"), top_hat(268e9, 0.15))
    pwv_mm = np.array([[0.06, 0.5], [1.68, 5.9]])
    emissivity = [1 - np.exp(-optical_depth(band, pwv_mm + step)) for step in (-1e-4, 1e-4)]
    expected = (pwv_mm * (emissivity[1] - emissivity[0]) / 2e-4 * band.temperature_k * 1e3) ** 2
    transmission = np.exp(-optical_depth(band, pwv_mm))
    np.testing.assert_allclose(fluctuation_factor_mk2(band, pwv_mm), expected / transmission**2, rtol=1e-6)


AIRMASSES = (1.0, 1.15, 1.5, 2.0, 11.5)
# Bands in and beside lines of water, with edges on the cells of the tables, and a window.
BANDS = [("alma", 315, 385), ("alma", 309, 341), ("mauna_kea", 170, 200), ("mauna_kea", 135, 165)]


def spectrum(site, low_ghz, high_ghz, knot):
    """Zenith optical depth of the cells of a band, at three knots of the water about one: (n_cell, 3)."""
    table = read(site)
    rows = (table["frequency"] > low_ghz) & (table["frequency"] < high_ghz)
    return np.stack([table[name][rows] for name in table.colnames[knot : knot + 3]], axis=1)


@pytest.mark.parametrize("airmass", AIRMASSES)
@pytest.mark.parametrize(("site", "low", "high"), BANDS)
def test_depth_at_an_airmass_is_that_of_the_spectrum(site, low, high, airmass):
    band = band_opacity(shipped_place(site), top_hat((low + high) / 2 * 1e9, (high - low) / ((low + high) / 2)))
    expected = -np.log(np.exp(-airmass * spectrum(site, low, high, 5)).mean(axis=0))
    np.testing.assert_allclose(optical_depth(band, band.pwv_mm[4:7], airmass=airmass), expected, rtol=1e-9)


@pytest.mark.parametrize("airmass", AIRMASSES[:-1])
@pytest.mark.parametrize(("site", "low", "high"), BANDS)
def test_slant_factor_is_the_emission_s_change_of_the_spectrum(site, low, high, airmass):
    """A slant column that changes by as much gives the emission <1 - exp(-X tau)> a change of its own, over <exp(-X
    tau)>. Each cell's derivative is that of its own spline of the optical depth; splines agree within 0.5 %.
    """
    table = read(site)
    rows = (table["frequency"] > low) & (table["frequency"] < high)
    pwv = np.array(table.meta["pwv"])
    cells = CubicSpline(pwv, np.stack([table[name][rows] for name in table.colnames[1:]]))
    depth, slope = cells(pwv[5]), cells(pwv[5], 1)

    def seen(x):
        return np.mean(slope * np.exp(-x * depth)) / np.mean(np.exp(-x * depth))  # of a change of x C by 1

    band = band_opacity(shipped_place(site), top_hat((low + high) / 2 * 1e9, (high - low) / ((low + high) / 2)))
    found = slant_factor(band, pwv[5], airmass=airmass)
    assert found == pytest.approx((seen(airmass) / seen(1.0)) ** 2, rel=5e-3)
    assert found == 1 if airmass == 1 else found < 1


@pytest.mark.parametrize(("site", "low", "high"), BANDS[:3])
def test_slant_factor_matters_in_lines(site, low, high):
    band = band_opacity(shipped_place(site), top_hat((low + high) / 2 * 1e9, (high - low) / ((low + high) / 2)))
    assert slant_factor(band, 1.0, airmass=2.0) < 0.85


@pytest.mark.parametrize("frequency_ghz", [143, 268])
def test_slant_factor_of_the_windows_is_one(frequency_ghz):
    band = band_opacity(shipped_place("mauna_kea"), top_hat(frequency_ghz * 1e9, 0.15))
    assert slant_factor(band, 1.68, airmass=2.0) == pytest.approx(1, abs=5e-3)


@pytest.mark.parametrize("frequency_ghz", [100, 143])
def test_thin_limit_goes_as_the_column_squared(frequency_ghz):
    """From 0.03 to 0.06 mm the slope changes by 0.6 % for water broadens itself."""
    band = band_opacity(shipped_place("south_pole"), top_hat(frequency_ghz * 1e9, 0.15))
    low, high = fluctuation_factor_mk2(band, np.array([0.03, 0.06]))
    assert high / low == pytest.approx(4.0, rel=0.015)


def test_thick_limit_has_no_fluctuations_on_the_ground():
    """At the centre of the 183 GHz line the atmosphere is black: its emission, seen below it, cannot change."""
    band = band_opacity(shipped_place("mauna_kea"), top_hat(183.5e9, 1 / 183.5))
    wet, dry = (fluctuation_factor_mk2(band, pwv) * np.exp(-2 * optical_depth(band, pwv)) for pwv in (6.0, 0.5))
    assert wet < 1e-4 * dry


def test_bands_are_kept_and_cannot_be_written_to():
    band = band_opacity(shipped_place("ccat"), top_hat(143e9, 0.15))
    assert band_opacity(shipped_place("ccat"), top_hat(143e9, 0.15)) is band
    for array in (band.pwv_mm, band.optical_depth):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_water_outside_the_table():
    band = band_opacity(shipped_place("mauna_kea"), top_hat(143e9, 0.15))
    at_two = partial(slant_factor, airmass=2.0)
    for function in (optical_depth, optical_depth_slope, fluctuation_factor_mk2, at_two):
        for wrong in (7.0, [1.0, 7.0], [[7.0]]):
            with pytest.raises(ValueError, match=r"found 7 mm of water vapour; 0.05 to 6 mm is allowed"):
                function(band, wrong)
        for wrong in (0.04, -1.0, np.nan):
            with pytest.raises(ValueError, match="0.05 to 6 mm is allowed"):
                function(band, wrong)


@pytest.mark.parametrize(
    ("frequency_hz", "bandwidth"),
    [(10.5e9, 0.15), (990e9, 0.15), (143e9, 0.0), (143e9, -0.1), (143.0, 0.15), (np.nan, 0.1)],
)
def test_bands_outside_the_table(frequency_hz, bandwidth):
    with pytest.raises(ValueError, match=r"found a band of .* GHz; bands within 10 to 1000 GHz are allowed"):
        band_opacity(shipped_place("mauna_kea"), top_hat(frequency_hz, bandwidth))


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("frequency_hz", [85e9, 410e9, 850e9])
def test_bands_beyond_a_site_s_own_table(site, frequency_hz):
    """The table of all heights, at the site's height and temperature, takes its place."""
    place, band = shipped_place(site), top_hat(frequency_hz, 0.15)
    found, heights = band_opacity(place, band), band_opacity(replace(place, opacity=None), band)
    np.testing.assert_array_equal(found.optical_depth, heights.optical_depth)
    assert found.place == place and found.pwv_mm[-1] == pytest.approx(60)


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize(("frequency_hz", "width"), [(95e9, 0.2), (150e9, 0.2), (280e9, 0.15), (350e9, 0.1)])
def test_table_of_all_heights_against_the_site_s_own(site, frequency_hz, width):
    """The same model of absorption in air of two kinds: at the South Pole with its inversion up to 2.7 %."""
    place, band = shipped_place(site), top_hat(frequency_hz, width)
    own, heights = band_opacity(place, band), band_opacity(replace(place, opacity=None), band)
    for pwv_mm in (own.pwv_mm[2], own.pwv_mm[8]):
        assert optical_depth(heights, pwv_mm) == pytest.approx(optical_depth(own, pwv_mm), rel=0.04)


@pytest.mark.parametrize("site", SITES)
def test_layers_share_out_the_columns(site):
    setup = build_opacity.SITES[site]
    pressure, temperature, water, ozone = build_opacity.layers(setup)
    assert pressure[0] == setup.pressure_mbar and temperature[0] == setup.temperature[0][1]
    assert (np.diff(pressure) < 0).all()
    assert water.sum() == pytest.approx(1) and ozone.sum() == pytest.approx(1)
    assert water[:10].sum() > 0.85 and ozone[:10].sum() < 0.05  # below 5 km


def test_layers_of_exponential_vapour_are_hydrostatic():
    """T = 272 K - 6 K/km: pressure is a power of T, vapour of 2 km has 1 - exp(-1/2) below 1 km."""
    pressure, temperature, water, _ = build_opacity.layers(build_opacity.SITES["mauna_kea"])
    index = build_opacity.GRAVITY_M_S2 / build_opacity.GAS_CONSTANT_J_KG_K / 6e-3
    np.testing.assert_allclose(pressure[:14], 620 * (temperature[:14] / 272) ** index, rtol=1e-6)
    assert water[:4].sum() == pytest.approx(1 - np.exp(-0.5), rel=1e-3)
    np.testing.assert_allclose(WATER_CM2_PER_MM, 3.3428e21, rtol=1e-4)


def test_cells_average_transmission():
    depth = np.array([1.0, 2.0, 3.0, 300.0, 300.0])
    expected = -np.log((np.exp(-1.0) + 2 * np.exp(-2.0) + np.exp(-3.0)) / 4)
    np.testing.assert_allclose(cell_optical_depth(depth, ceiling=50.0, steps=2)[0], expected, rtol=1e-12)
    assert cell_optical_depth(np.full(5, 300.0), ceiling=50.0, steps=2).tolist() == [50.0, 50.0]


@pytest.mark.slow
@pytest.mark.parametrize("site", SITES)
def test_table_is_what_am_computes(site):
    """Direct spectra at a column that is not one of the three a table is made of: 6e-4 was measured."""
    pytest.importorskip("am")
    setup = build_opacity.SITES[site]
    pwv = setup.pwv_mm[6]
    spectrum, _ = am_opacity(build_opacity.configuration(setup, pwv), first_ghz=224, last_ghz=227)
    row = int(np.flatnonzero(read(site)["frequency"] == 224.5)[0])
    np.testing.assert_allclose(
        read(site)[f"pwv_{pwv:g}"][row : row + 3], cell_optical_depth(spectrum, ceiling=50.0), rtol=1.5e-3
    )
