"""Band powers written to files and read back."""

import builtins
from dataclasses import fields
from functools import partial

import numpy as np
import pytest
from astropy.table import Table

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.cross_spectra import cross_band_powers, monte_carlo_covariance, realized_band_powers
from mapmaker.errors import InputError
from mapmaker.flat_spectra import flat_coupling
from mapmaker.null_tests import null_power, null_test
from mapmaker.spectrum import tukey_taper
from mapmaker.spectrum_files import read_band_powers, write_band_powers, write_null_tests, write_sacc
from mapmaker.transfer_function import beam_window

N, PIXEL = 32, np.radians(0.5 / 60)


@pytest.fixture(scope="module")
def coupling():
    taper = tukey_taper(N, N, PIXEL, size_rad=N * PIXEL, edge_fraction=0.5)
    beam = partial(beam_window, fwhm_rad=np.radians(1 / 60))
    transfer = np.array([0, 0.5, 1, 1])  # the first bin is lost
    return flat_coupling(taper, PIXEL, edges_ell=np.arange(2000.0, 10001, 2000), beam=beam, transfer=transfer)


@pytest.fixture(scope="module")
def noise():
    return np.random.default_rng(1).normal(size=(20, 3, N, N))


def same(found, expected):
    for field in fields(expected):
        one, other = (getattr(item, field.name) for item in (found, expected))
        if field.name == "covariance":
            same(one, other)
        else:
            np.testing.assert_array_equal(one, other)


def test_band_powers_are_read_with_the_same_bits(tmp_path, coupling, noise):
    powers = cross_band_powers(noise[0], coupling)
    monte_carlo = monte_carlo_covariance(realized_band_powers(noise, coupling))
    assert powers.flags
    assert monte_carlo.flags
    write_band_powers(tmp_path / "a.ecsv", powers, monte_carlo=monte_carlo)
    found = read_band_powers(tmp_path / "a.ecsv")
    same(found[0], powers)
    same(found[1], monte_carlo)
    write_band_powers(tmp_path / "a.ecsv", powers)
    assert read_band_powers(tmp_path / "a.ecsv")[1] is None
    table = Table.read(tmp_path / "a.ecsv")
    assert table["power"].unit == "uK2"
    np.testing.assert_array_equal(table["error"], powers.covariance.error_uk2)


def test_null_tests_are_read(tmp_path, coupling, noise):
    powers = cross_band_powers(noise[0], coupling)
    test = null_test(null_power(noise[0, :2], coupling), null_power(noise[1:, :2], coupling), coupling)
    write_null_tests(tmp_path / "null.ecsv", powers, {"night": test, "array": test})
    table = Table.read(tmp_path / "null.ecsv")
    np.testing.assert_array_equal(table["array_power"], test.power_uk2)
    assert table.meta["night_pte"] == test.chi_squared.pte
    assert table.meta["night_flags"] == list(test.chi_squared.flags)


def test_sacc(tmp_path, coupling, noise):
    """A likelihood that multiplies C_l by the windows gets the band powers of `windows`."""
    sacc = pytest.importorskip("sacc")
    powers = cross_band_powers(noise[0], coupling)
    monte_carlo = monte_carlo_covariance(realized_band_powers(noise, coupling))
    for covariance in (powers.covariance, monte_carlo):
        write_sacc(tmp_path / "a.fits", powers, monte_carlo=covariance if covariance.n_realizations else None)
        file = sacc.Sacc.load_fits(str(tmp_path / "a.fits"))
        ell, spectrum, matrix = file.get_ell_cl("cl_00", "sky", "sky", return_cov=True)
        used, of_cl = slice(1, None), flat_spectrum_psd(powers.ell[1:])
        np.testing.assert_array_equal(ell, powers.ell[used])
        np.testing.assert_allclose(spectrum, powers.power_uk2[used] * of_cl, rtol=1e-14)
        np.testing.assert_allclose(matrix, covariance.matrix_uk4[used, used] * np.outer(of_cl, of_cl), rtol=1e-12)
        window = file.get_bandpower_windows(file.indices("cl_00"))
        theory = 7 * window.values**0.3
        expected = powers.windows[used] @ (7 * powers.window_ell**0.3) * of_cl
        np.testing.assert_allclose(window.weight.T @ (theory * flat_spectrum_psd(window.values)), expected, rtol=1e-10)
        assert file.metadata["flag_0"] == powers.flags[0]
        assert file.metadata["covariance_realizations"] == covariance.n_realizations
        assert file.tracers["sky"].map_unit == "uK_CMB"


def test_without_sacc(tmp_path, coupling, noise, monkeypatch):
    load = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name == "sacc":
            raise ImportError(name)
        return load(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match="^sacc is not installed; in the clone: pip install '.\\[spectra\\]'$"):
        write_sacc(tmp_path / "a.fits", cross_band_powers(noise[0], coupling))


def test_other_files_are_refused(tmp_path, coupling, noise):
    path = tmp_path / "a.ecsv"
    with pytest.raises(InputError, match="a.ecsv: no such file; a table of band powers is expected"):
        read_band_powers(path)
    write_band_powers(path, cross_band_powers(noise[0], coupling))
    whole = path.read_text()
    for text, match in (
        ("nonsense\n", "a.ecsv: not a table of band powers"),
        (whole.replace("n_modes", "modes"), "a.ecsv: not a table of band powers"),
        (whole.replace('"flags"', '"flag"'), "a.ecsv: not a table of band powers"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=match) as error:
            read_band_powers(path)
        assert "\n" not in str(error.value)
