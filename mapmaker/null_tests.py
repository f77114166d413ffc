"""Null tests: power in the difference of two splits, its chi-squared, and the probability to exceed it."""

import math
from dataclasses import dataclass, replace

import numpy as np

from mapmaker.cross_spectra import Covariance, monte_carlo_covariance
from mapmaker.errors import InsufficientDataError
from mapmaker.mode_coupling import ModeCoupling
from mapmaker.validation import flags as truths
from mapmaker.validation import reals


@dataclass(frozen=True)
class ChiSquared:
    """Chi-squared of band powers about their expectation.

    Attributes
    ----------
    value
        Its mean over data that meet the expectation is `n_bin`: with a measured covariance of n realizations, its
        inverse is multiplied by (n - n_bin - 2) / (n - 1) (Hartlap et al. 2007, A&A 464, 399).
    n_bin
        Bins that count.
    pte
        Probability to exceed the value; NaN where the realizations do not suffice.
    distribution
        "chi-squared" for an analytic covariance; "Hotelling" for a measured one.
    flags
        Reasons to distrust it, a sentence each.
    """

    value: float
    n_bin: int
    pte: float
    distribution: str
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class NullTest:
    """Power of a difference of splits beside that of noise realizations.

    Attributes
    ----------
    power_uk2 : (n_bin,)
        Its excess over the mean of the realizations.
    error_uk2 : (n_bin,)
        Standard error of the excess.
    chi_squared
    """

    power_uk2: np.ndarray
    error_uk2: np.ndarray
    chi_squared: ChiSquared


def chi_squared(residual_uk2: np.ndarray, covariance: Covariance, *, mask: np.ndarray | None = None) -> ChiSquared:
    """Chi-squared of a residual with an analytic covariance or that of independent realizations.

    A Gaussian residual of p bins has a chi-squared distribution with p degrees of freedom if its covariance is known.
    With the covariance of n realizations, ``T^2 (n - p) / ((n - 1) p)`` has the F distribution of p and n - p degrees
    of freedom (Hotelling 1931), which gives the PTE exactly for any n > p.

    Parameters
    ----------
    residual_uk2 : (n_bin,)
        Band powers less their expectation.
    covariance
    mask : (n_bin,), optional
        Bins that count; by default all. Bins without a band power (NaN) never count.

    Raises
    ------
    ValueError
        For shapes that differ, and if no bin is left.
    """
    residual = reals("residual_uk2", residual_uk2, ("n_bin",), finite=False)
    matrix = reals("covariance.matrix_uk4", covariance.matrix_uk4, (residual.size,) * 2, finite=False)
    counted = np.isfinite(residual) & np.isfinite(np.diag(matrix))
    if mask is not None:
        counted &= truths("mask", mask, residual.shape)
    n_bin, n_realization = int(counted.sum()), covariance.n_realizations
    if n_bin == 0:
        raise InsufficientDataError("a chi-squared needs at least one bin with a band power")
    if n_realization and n_realization <= n_bin + 2:
        return ChiSquared(math.nan, n_bin, math.nan, "Hotelling", covariance.flags)
    part = residual[counted]
    value = float(part @ np.linalg.solve(matrix[np.ix_(counted, counted)], part))
    if not n_realization:
        return ChiSquared(value, n_bin, _chi_squared_tail(value, n_bin), "chi-squared", covariance.flags)
    free = n_realization - n_bin
    pte = _f_tail(value * free / ((n_realization - 1) * n_bin), n_bin, free)
    return ChiSquared(value * (free - 2) / (n_realization - 1), n_bin, pte, "Hotelling", covariance.flags)


def null_power(pair_uk: np.ndarray, coupling: ModeCoupling) -> np.ndarray:
    """Band power of half the difference of two maps of one sky: of noise alone.

    Parameters
    ----------
    pair_uk : (..., 2, *shape of the coupling's field)
        Maps [uK_CMB], 0 where unobserved.
    coupling

    Returns
    -------
    (..., n_bin) array
        [uK^2], in the unit of the sky's band powers; NaN in bins that are not usable.

    Raises
    ------
    ValueError
        For another shape, and values that are not finite.
    """
    shape = coupling.field.shape
    pair_uk = reals("pair_uk", pair_uk, (..., 2, *shape))
    first, second = np.moveaxis(pair_uk, -1 - len(shape), 0)
    return coupling.decouple(coupling.field.pseudo_power((first - second) / 2))


def null_test(power_uk2: np.ndarray, realized_uk2: np.ndarray, *, mask: np.ndarray | None = None) -> NullTest:
    """Compare the power of a difference of splits with that of realizations of its noise.

    Parameters
    ----------
    power_uk2 : (n_bin,)
        `null_power` of the splits.
    realized_uk2 : (n_realization, n_bin)
        That of independent realizations of their noise, which measure the mean and the covariance.
    mask : (n_bin,), optional
        Bins that count; by default all.

    Raises
    ------
    ValueError
        As `chi_squared`, and for fewer than 2 realizations.
    """
    power = reals("power_uk2", power_uk2, ("n_bin",), finite=False)
    realized = reals("realized_uk2", realized_uk2, ("n_realization", power.size), finite=False)
    covariance = monte_carlo_covariance(realized)
    # The mean of the realizations scatters, too.
    of_excess = replace(covariance, matrix_uk4=covariance.matrix_uk4 * (1 + 1 / len(realized)))
    excess = power - realized.mean(axis=0)
    return NullTest(excess, of_excess.error_uk2, chi_squared(excess, of_excess, mask=mask))


def _chi_squared_tail(value: float, degrees: int) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(degrees, value))


def _f_tail(value: float, numerator: int, denominator: int) -> float:
    from scipy.special import fdtrc

    return float(fdtrc(numerator, denominator, value))
