"""Mode coupling of a taper: binned pseudo-power of a map per band power of the sky, on the plane or the sphere."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from mapmaker.errors import InsufficientDataError
from mapmaker.validation import reals

LEAST_TRANSFER = 1e-3  # of the power of a bin: with less, its band power is not defined
LEAST_WINDOW = 1e-6  # the same of beam and pixels, beside the best bin
MOST_CONDITION = 100.0  # condition number of the coupling matrix from which errors of band powers are amplified
LARGEST_CONDITION = 1e10  # beyond, rounding errors of the inverse matter
FEWEST_MODES = 10.0  # degrees of freedom of a bin whose errors are about Gaussian


class Field(Protocol):
    """Tapered area of the sky whose maps have pseudo-power in bins of multipole."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a map."""
        ...

    def pseudo_power(self, maps_uk: np.ndarray) -> np.ndarray:
        """Binned power (..., n_bin) [uK^2 sr] of tapered maps (..., *shape)."""
        ...

    def unevenness(self, map_uk: np.ndarray) -> np.ndarray:
        """Variance of the modes' power in each bin over that of modes of one variance, (n_bin,)."""
        ...


@dataclass(frozen=True)
class ModeCoupling:
    """Pseudo-power of a field's maps per band power of the sky.

    Attributes
    ----------
    edges_ell : (n_bin + 1,)
    ell : (n_bin,)
        Mean over the modes of each bin.
    transfer : (n_bin,)
        Power that scans and cleaning leave of the pseudo-power; 1 without.
    usable : (n_bin,)
        Bins whose band power is defined; others are NaN.
    response : (n_bin, n_ell)
        Pseudo-power [sr] from unit band power l(l+1) C_l / 2 pi in narrow bins of multipole: taper, beam and pixels
        included, the transfer function not.
    window_ell : (n_ell,)
        Mean multipole of each narrow bin, in power.
    scatter : (n_bin, n_bin)
        Covariance of the pseudo-power of white noise between bins, over twice its square.
    resolution_ell
        Width in multipoles of a square as large as the power spectrum of the taper.
    field
        Measures the pseudo-power of maps.
    flags
        Reasons to distrust the band powers, a sentence each.
    """

    edges_ell: np.ndarray
    ell: np.ndarray
    transfer: np.ndarray
    usable: np.ndarray
    response: np.ndarray
    window_ell: np.ndarray
    scatter: np.ndarray
    resolution_ell: float
    field: Field
    flags: tuple[str, ...]

    @property
    def n_modes(self) -> np.ndarray:
        """Independent real degrees of freedom of each bin, (n_bin,)."""
        return 1 / np.diag(self.scatter)

    @cached_property
    def matrix(self) -> np.ndarray:
        """Pseudo-power [sr] in each bin (row) from a unit band power in each bin (column), (n_bin, n_bin).

        A usable band power extends over the bins next to it that are not usable, the first and the last over all
        multipoles below and above. Columns of other bins are 0.
        """
        matrix = np.zeros((self.ell.size, self.ell.size))
        np.add.at(matrix.T, _usable_bin(self.window_ell, self.edges_ell, self.usable), self.response.T)
        return matrix

    @cached_property
    def inverse(self) -> np.ndarray:
        """Band power per pseudo-power [1/sr], transfer function included, (n_bin, n_bin); 0 if not usable."""
        inverse = np.zeros_like(self.matrix)
        used = np.ix_(self.usable, self.usable)
        inverse[used] = np.linalg.inv(self.matrix[used]) / self.transfer[self.usable]
        return inverse

    @cached_property
    def windows(self) -> np.ndarray:
        """Weight of the multipoles `window_ell` of a spectrum l(l+1) C_l / 2 pi in each band power, (n_bin, n_ell).

        Rows of usable bins sum to 1, others are 0. Expected band powers are ``windows @ spectrum(window_ell)``.
        """
        return self.inverse @ (np.where(self.usable, self.transfer, 0)[:, None] * self.response)

    def decouple(self, pseudo_power: np.ndarray) -> np.ndarray:
        """Band powers (..., n_bin) [uK^2] of pseudo-power (..., n_bin) [uK^2 sr]; NaN in bins that are not usable."""
        pseudo_power = reals("pseudo_power", pseudo_power, (..., self.ell.size))
        return np.where(self.usable, pseudo_power @ self.inverse.T, np.nan)

    def expected_pseudo_power(self, power_uk2: np.ndarray) -> np.ndarray:
        """Pseudo-power (n_bin,) [uK^2 sr] of band powers (n_bin,) [uK^2]; 0 in bins that are not usable."""
        return np.where(self.usable, self.transfer, 0) * (self.matrix @ np.where(self.usable, power_uk2, 0))

    def distant_pseudo_power(self, power_uk2: np.ndarray) -> np.ndarray:
        """Part of `expected_pseudo_power` from multipoles farther from a bin than the field's resolution."""
        powers = power_uk2[_usable_bin(self.window_ell, self.edges_ell, self.usable)]
        below = self.window_ell < self.edges_ell[:-1, None] - self.resolution_ell
        above = self.window_ell > self.edges_ell[1:, None] + self.resolution_ell
        return np.where(self.usable, self.transfer, 0) * ((self.response * (below | above)) @ powers)


def unevenness(power: np.ndarray, place: np.ndarray, n_bin: int) -> np.ndarray:
    """Mean square of the power of complex Gaussian modes over twice its squared mean, in each bin, (n_bin,).

    It is about 1 if the modes of a bin have one variance, else the mean of their squared variances over their squared
    mean.

    Parameters
    ----------
    power : (n_mode,)
    place : (n_mode,)
        Bin of each mode; `n_bin` for modes outside.
    n_bin
    """
    count, first, second = (np.bincount(place, power**order, n_bin + 1)[:n_bin] for order in range(3))
    return np.divide(count * second, 2 * first**2, out=np.ones(n_bin), where=first > 0)


def narrow_edges(edges_ell: np.ndarray, step: float, top: float) -> np.ndarray:
    """Edges of narrow bins of about `step`, from 0 to beyond `top`, that subdivide the bins."""
    whole = np.concatenate(([0.0] if edges_ell[0] > 0 else [], edges_ell, [top + step] if top >= edges_ell[-1] else []))
    parts = np.maximum(np.diff(whole) // step, 1).astype(int)
    inside = [np.linspace(low, high, n + 1)[:-1] for low, high, n in zip(whole[:-1], whole[1:], parts, strict=True)]
    return np.append(np.concatenate(inside), whole[-1])


def beam_power(beam: Callable[[np.ndarray], np.ndarray], ell: np.ndarray) -> np.ndarray:
    """Power window of a beam at multipoles; raises ValueError where it is negative or not finite."""
    return reals("beam(ell)", beam(ell), ell.shape, least=0)


def usable_bins(window: np.ndarray, transfer: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Transfer function (n_bin,), 1 by default, and the bins that it and the power window (n_bin,) leave.

    Raises
    ------
    ValueError
        For a transfer function of other bins, and if no bin is left.
    """
    transfer = np.ones(window.size) if transfer is None else reals("transfer", transfer, window.shape, finite=False)
    usable = (transfer >= LEAST_TRANSFER) & (window > 0) & (window >= LEAST_WINDOW * window.max())
    if not usable.any():
        raise InsufficientDataError("beam, pixels, scans and cleaning leave no power in any bin of multipole")
    return transfer, usable


def coupling_flags(coupling: ModeCoupling) -> tuple[str, ...]:
    """Reasons to distrust band powers: lost bins, narrow bins, few modes, errors that decoupling amplifies.

    Raises
    ------
    ValueError
        For a coupling that has no inverse.
    """
    flags = []
    usable, widths = coupling.usable, np.diff(coupling.edges_ell)
    if not usable.all():
        flags.append(
            f"{np.sum(~usable)} of {usable.size} bins: no band power, because beam, scans or cleaning remove it"
        )
    if widths.min() < coupling.resolution_ell:
        flags.append(
            f"bins {widths.min():.0f} wide in ell: the taper resolves {coupling.resolution_ell:.0f}, and wider bins "
            "are better"
        )
    few = usable & (coupling.n_modes < FEWEST_MODES)
    if few.any():
        flags.append(
            f"{few.sum()} of {few.size} bins: fewer than {FEWEST_MODES:.0f} modes, and errors that are not Gaussian"
        )
    condition = _condition(coupling.matrix[np.ix_(usable, usable)])
    if not condition < LARGEST_CONDITION:
        raise InsufficientDataError(
            f"the taper resolves {coupling.resolution_ell:.0f} in ell, and a coupling of bins {widths.min():.0f} wide "
            "has no inverse: wider bins are expected"
        )
    if condition > MOST_CONDITION:
        flags.append(f"a coupling matrix of the condition number {condition:.2g}: decoupling amplifies errors")
    return tuple(flags)


def _condition(matrix: np.ndarray) -> float:
    """Condition number of a matrix whose rows and columns are scaled to a diagonal of 1."""
    scale = np.sqrt(np.diag(matrix))
    return float(np.linalg.cond(matrix / np.outer(scale, scale)))


def _usable_bin(ell: np.ndarray, edges_ell: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Index of the usable bin that multipoles are in, or are next to."""
    at = np.clip(np.searchsorted(edges_ell, ell, side="right") - 1, 0, usable.size - 1)
    places = np.flatnonzero(usable)
    return places[np.argmin(np.abs(at[:, None] - places), axis=1)]
