"""Null tests: power in the difference of two splits, its chi-squared, and the probability to exceed it."""

from dataclasses import dataclass

import numpy as np

from mapmaker.cross_spectra import Covariance
from mapmaker.mode_coupling import ModeCoupling


@dataclass(frozen=True)
class ChiSquared:
    """Chi-squared of band powers about their expectation.

    Attributes
    ----------
    value
    n_bin
        Bins that count.
    pte
        Probability to exceed the value; NaN where the realizations do not suffice.
    distribution
        "chi-squared", or "Hotelling" where realizations measured the covariance.
    flags
    """

    value: float
    n_bin: int
    pte: float
    distribution: str
    flags: tuple[str, ...]


@dataclass(frozen=True)
class NullTest:
    """Power of a difference of splits less that of noise realizations, (n_bin,) [uK^2], and its chi-squared."""

    power_uk2: np.ndarray
    error_uk2: np.ndarray
    chi_squared: ChiSquared


def chi_squared(residual_uk2: np.ndarray, covariance: Covariance, *, mask: np.ndarray | None = None) -> ChiSquared:
    """Chi-squared of a residual (n_bin,) with the covariance of independent realizations or an analytic one.

    Parameters
    ----------
    residual_uk2 : (n_bin,)
        Band powers less their expectation.
    covariance
    mask : (n_bin,), optional
        Bins that count; by default all that are finite.
    """
    raise NotImplementedError


def null_power(pair_uk: np.ndarray, coupling: ModeCoupling) -> np.ndarray:
    """Band power (..., n_bin) [uK^2] of half the difference of two maps (..., 2, *shape): of noise alone."""
    raise NotImplementedError


def null_test(power_uk2: np.ndarray, realized_uk2: np.ndarray, *, mask: np.ndarray | None = None) -> NullTest:
    """Compare a null power (n_bin,) with those of realizations of the noise (n_realization, n_bin)."""
    raise NotImplementedError
