"""Null tests: power in the difference of two splits, its chi-squared, and the probability to exceed it."""

import math
from dataclasses import dataclass

import numpy as np

from mapmaker.cross_spectra import Covariance, monte_carlo_covariance
from mapmaker.errors import InsufficientDataError
from mapmaker.mode_coupling import ModeCoupling
from mapmaker.validation import flags as truths
from mapmaker.validation import number, reals


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
        Its excess over the mean of the realizations, as band power of the sky; NaN in bins that are not usable.
    error_uk2 : (n_bin,)
        Standard error of the excess.
    chi_squared
        Of the logarithm of the power about that of the realizations.
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
    if not counted.any():
        raise InsufficientDataError("a chi-squared needs at least one bin with a band power")
    return _chi_squared(
        residual[counted], matrix[np.ix_(counted, counted)], covariance.n_realizations, covariance.flags
    )


def _chi_squared(residual: np.ndarray, matrix: np.ndarray, n_realization: int, flags: tuple[str, ...]) -> ChiSquared:
    """Chi-squared of a residual (n_bin,) with a covariance (n_bin, n_bin) of realizations, or of none."""
    n_bin, free = residual.size, n_realization - residual.size
    if n_realization and free <= 2:
        return ChiSquared(math.nan, n_bin, math.nan, "Hotelling", flags)
    value = float(residual @ np.linalg.solve(matrix, residual))
    if not n_realization:
        return ChiSquared(value, n_bin, _chi_squared_tail(value, n_bin), "chi-squared", flags)
    pte = _f_tail(value * free / ((n_realization - 1) * n_bin), n_bin, free)
    return ChiSquared(value * (free - 2) / (n_realization - 1), n_bin, pte, "Hotelling", flags)


def null_power(pair_uk: np.ndarray, coupling: ModeCoupling) -> np.ndarray:
    """Binned pseudo-power of half the difference of two maps of one sky: of noise alone.

    Parameters
    ----------
    pair_uk : (..., 2, *shape of the coupling's field)
        Maps [uK_CMB], 0 where unobserved.
    coupling

    Returns
    -------
    (..., n_bin) array
        [uK^2 sr], for `null_test`.

    Raises
    ------
    ValueError
        For another shape, and values that are not finite.
    """
    shape = coupling.field.shape
    pair_uk = reals("pair_uk", pair_uk, (..., 2, *shape))
    first, second = np.moveaxis(pair_uk, -1 - len(shape), 0)
    return coupling.field.pseudo_power((first - second) / 2)


def null_test(
    power: np.ndarray,
    realized: np.ndarray,
    coupling: ModeCoupling,
    *,
    mask: np.ndarray | None = None,
    common: float = 0.0,
) -> NullTest:
    """Compare the power of a difference of splits with that of realizations of its noise.

    The power of Gaussian noise in a bin of few modes is far from Gaussian, and its logarithm nearly is. So the
    chi-squared is that of logarithms, about their mean over the realizations and with their covariance.

    Parameters
    ----------
    power : (n_bin,)
        `null_power` of the splits.
    realized : (n_realization, n_bin)
        That of realizations of their noise.
    coupling
    mask : (n_bin,), optional
        Bins that count; by default all that are usable.
    common
        Correlation of the powers of the realizations with each other, as of sign flips of the same few observations.
        Their mean scatters more, and they scatter less, than independent ones.

    Raises
    ------
    ValueError
        For shapes that differ, power that is not positive, fewer than 2 realizations, and if no bin is left.
    """
    power = reals("power", power, (coupling.ell.size,), above=0)
    realized = reals("realized", realized, ("n_realization", power.size), above=0)
    number("common", common, least=0, below=1)
    counted = coupling.usable if mask is None else coupling.usable & truths("mask", mask, power.shape)
    if not counted.any():
        raise InsufficientDataError("a null test needs at least one bin with a band power")
    logarithms = np.log(realized[:, counted])
    covariance = monte_carlo_covariance(logarithms)
    # The covariance about the mean of the realizations, over that of the realizations.
    factor = (1 + common + (1 - common) / len(realized)) / (1 - common)
    residual = np.log(power[counted]) - logarithms.mean(axis=0)
    band_powers = coupling.decouple(realized)
    return NullTest(
        coupling.decouple(power) - band_powers.mean(axis=0),
        band_powers.std(axis=0, ddof=1) * np.sqrt(factor),
        _chi_squared(residual, covariance.matrix_uk4 * factor, len(realized), covariance.flags),
    )


def _chi_squared_tail(value: float, degrees: int) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(degrees, value))


def _f_tail(value: float, numerator: int, denominator: int) -> float:
    from scipy.special import fdtrc

    return float(fdtrc(numerator, denominator, value))
