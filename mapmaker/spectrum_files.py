"""Files of band powers: ECSV tables, and `sacc` for cosmological likelihoods."""

from pathlib import Path

from mapmaker.cross_spectra import BandPowers, Covariance


def write_band_powers(path: str | Path, powers: BandPowers, *, monte_carlo: Covariance | None = None) -> None:
    """Write band powers, covariance and windows as an ECSV table, a row a bin."""
    raise NotImplementedError


def read_band_powers(path: str | Path) -> tuple[BandPowers, Covariance | None]:
    """Read band powers and the Monte Carlo covariance, if any, of `write_band_powers`."""
    raise NotImplementedError


def write_sacc(path: str | Path, powers: BandPowers, *, monte_carlo: Covariance | None = None) -> None:
    """Write spectrum, covariance and windows as a `sacc` file (FITS); needs the extra "spectra"."""
    raise NotImplementedError
