"""Files of band powers: ECSV tables, and `sacc` for likelihoods."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.cross_spectra import BandPowers, Covariance
from mapmaker.errors import InputError
from mapmaker.files import atomic_write, one_line, regular_file, write_ecsv
from mapmaker.null_tests import NullTest

_KIND = "table of band powers"
_TRACER = "sky"


def write_band_powers(path: str | Path, powers: BandPowers, *, monte_carlo: Covariance | None = None) -> None:
    """Write band powers and their covariance as an ECSV table, a row a bin, and their windows as a second one.

    Parameters
    ----------
    path
        Ends in ".ecsv"; the windows go to the file of this name with "_windows" before the ending, a row a multipole.
    powers
    monte_carlo
        Covariance from realizations, written beside the analytic one.

    Raises
    ------
    OSError
        Where a file can't be written.
    """
    columns = {"ell_low": powers.ell_low, "ell_high": powers.ell_high, "ell": powers.ell, "n_modes": powers.n_modes}
    columns |= {"power": powers.power_uk2, "error": powers.covariance.error_uk2}
    units = {"power": "uK2", "error": "uK2"}
    for number, noise in enumerate(powers.noise_uk2):
        columns[f"noise_{number}"], units[f"noise_{number}"] = noise, "uK2"
    meta: dict[str, Any] = {"quantity": "l(l+1) C_l / 2 pi, thermodynamic", "flags": list(powers.flags)}
    for name, covariance in (("covariance", powers.covariance), ("monte_carlo", monte_carlo)):
        if covariance is not None:
            columns |= {f"{name}_{bin_}": row for bin_, row in enumerate(covariance.matrix_uk4)}
            units |= {f"{name}_{bin_}": "uK4" for bin_ in range(len(powers.ell))}
            meta |= {f"{name}_realizations": covariance.n_realizations, f"{name}_flags": list(covariance.flags)}
    write_ecsv(path, columns, units, meta)
    windows = {"ell": powers.window_ell} | {f"window_{bin_}": row for bin_, row in enumerate(powers.windows)}
    write_ecsv(_windows_path(path), windows, {}, {"quantity": "weight of l(l+1) C_l / 2 pi in each band power"})


def read_band_powers(path: str | Path) -> tuple[BandPowers, Covariance | None]:
    """Read the band powers and the Monte Carlo covariance, or None, of `write_band_powers`.

    Raises
    ------
    InputError
        For files that are missing or are not such tables.
    """
    table, windows = _read_table(path), _read_table(_windows_path(path))
    try:
        covariances = [_covariance(table, name) for name in ("covariance", "monte_carlo")]
        powers = BandPowers(
            ell=_column(table, "ell"),
            ell_low=_column(table, "ell_low"),
            ell_high=_column(table, "ell_high"),
            power_uk2=_column(table, "power"),
            noise_uk2=_numbered(table, "noise"),
            n_modes=_column(table, "n_modes"),
            covariance=covariances[0],
            window_ell=_column(windows, "ell"),
            windows=_numbered(windows, "window"),
            flags=tuple(table.meta["flags"]),
        )
    except (KeyError, ValueError) as error:
        raise InputError(f"{path}: not a {_KIND} ({one_line(error)})") from None
    return powers, covariances[1]


def write_null_tests(path: str | Path, powers: BandPowers, tests: Mapping[str, NullTest]) -> None:
    """Write null tests by name as an ECSV table, a row a bin; chi-squared and PTE of each are in the header.

    Raises
    ------
    OSError
        Where the file can't be written.
    """
    columns = {"ell_low": powers.ell_low, "ell_high": powers.ell_high, "ell": powers.ell}
    meta: dict[str, Any] = {}
    for name, test in tests.items():
        columns |= {f"{name}_power": test.power_uk2, f"{name}_error": test.error_uk2}
        found = test.chi_squared
        meta |= {f"{name}_chi_squared": found.value, f"{name}_bins": found.n_bin, f"{name}_pte": found.pte}
        meta |= {f"{name}_distribution": found.distribution, f"{name}_flags": list(found.flags)}
    write_ecsv(path, columns, {name: "uK2" for name in columns if not name.startswith("ell")}, meta)


def write_sacc(path: str | Path, powers: BandPowers, *, monte_carlo: Covariance | None = None) -> None:
    """Write C_l, its covariance and windows as a FITS file of `sacc`, the format of likelihoods; needs `sacc`.

    The data type is "cl_00" of the tracer "sky", in uK_CMB^2. A window, like a band power, is multiplied by
    ``2 pi / l(l+1)`` at the mean multipole of its bin, so that ``sum_l window C_l`` is the expected value. The beam of
    the tracer is 1, as beam and pixels are corrected.

    Parameters
    ----------
    path
    powers
        Bins without a band power are left out.
    monte_carlo
        Covariance to write; by default the analytic one.

    Raises
    ------
    InputError
        If `sacc` is not installed.
    OSError
        Where the file can't be written.
    """
    try:
        from sacc import BandpowerWindow, Sacc
    except ImportError:
        raise InputError("sacc is not installed; in the clone: pip install '.[spectra]'") from None
    covariance = powers.covariance if monte_carlo is None else monte_carlo
    used = np.isfinite(powers.power_uk2) & np.isfinite(covariance.error_uk2)
    ell, above = powers.ell[used], powers.window_ell > 0
    per_band_power = 2 * np.pi / (ell * (ell + 1))
    window_ell = powers.window_ell[above]
    of_spectrum = (
        powers.windows[used][:, above] * per_band_power[:, None] * (window_ell * (window_ell + 1) / (2 * np.pi))
    )
    file = Sacc()
    file.add_tracer(
        "Map",
        _TRACER,
        quantity="cmb_temperature",
        spin=0,
        ell=window_ell,
        beam=np.ones(window_ell.size),
        map_unit="uK_CMB",
    )
    window = BandpowerWindow(window_ell, of_spectrum.T)
    file.add_ell_cl("cl_00", _TRACER, _TRACER, ell, powers.power_uk2[used] * per_band_power, window=window)
    file.add_covariance(covariance.matrix_uk4[np.ix_(used, used)] * np.outer(per_band_power, per_band_power))
    file.metadata["covariance_realizations"] = covariance.n_realizations
    for number, flag in enumerate((*powers.flags, *covariance.flags)):
        file.metadata[f"flag_{number}"] = flag
    with atomic_write(path) as partial:
        file.save_fits(str(partial), overwrite=True)


def _windows_path(path: str | Path) -> Path:
    path = Path(path)
    return path.with_name(f"{path.stem}_windows{path.suffix}")


def _read_table(path: str | Path) -> Any:
    from astropy.table import Table

    regular_file(path, _KIND)
    try:
        return Table.read(str(path), format="ascii.ecsv")
    except Exception as error:  # astropy and yaml raise many
        raise InputError(f"{path}: not a {_KIND} ({one_line(error)})") from None


def _column(table: Any, name: str) -> np.ndarray:
    return np.asarray(table[name], dtype=float)


def _numbered(table: Any, name: str) -> np.ndarray:
    """Rows of numbered columns, (n_column, n_row)."""
    count = sum(column.rpartition("_")[0] == name for column in table.colnames)
    return np.array([_column(table, f"{name}_{number}") for number in range(count)])


def _covariance(table: Any, name: str) -> Covariance | None:
    if f"{name}_realizations" not in table.meta:
        return None
    return Covariance(
        _numbered(table, name), int(table.meta[f"{name}_realizations"]), tuple(table.meta[f"{name}_flags"])
    )
