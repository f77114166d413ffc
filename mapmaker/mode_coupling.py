"""Mode coupling of a taper on the flat sky: binned pseudo-power of a map per band power of the sky."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Field(Protocol):
    """Tapered area of the sky whose maps have pseudo-power in bins of multipole."""

    def pseudo_power(self, maps_uk: np.ndarray) -> np.ndarray:
        """Binned power (..., n_bin) [uK^2 sr] of tapered maps (..., *shape of the taper)."""
        ...


@dataclass(frozen=True)
class ModeCoupling:
    """Pseudo-power of a field's maps per band power of the sky.

    Attributes
    ----------
    edges_ell : (n_bin + 1,)
    ell : (n_bin,)
        Mean over the modes of each bin.
    n_modes : (n_bin,)
        Independent real degrees of freedom.
    matrix : (n_bin, n_bin)
        Pseudo-power [sr] in the bins of rows from a unit band power in the bins of columns: taper, beam and pixels
        included. The first and last band powers extend over all multipoles below and above the bins.
    transfer : (n_bin,)
        Power that scans and cleaning leave of the pseudo-power; 1 without.
    scatter : (n_bin, n_bin)
        Covariance of the pseudo-power of white noise between bins, over twice its square; 1 / n on the diagonal for
        wide bins of n modes.
    window_ell : (n_ell,)
    windows : (n_bin, n_ell)
        Weight of the multipoles of a spectrum l(l+1) C_l / 2 pi in each decoupled band power; rows sum to 1.
    usable : (n_bin,)
        Bins whose band power is defined; others are NaN.
    field
        Measures the pseudo-power of maps.
    flags
        Reasons to distrust the band powers, a sentence each.
    """

    edges_ell: np.ndarray
    ell: np.ndarray
    n_modes: np.ndarray
    matrix: np.ndarray
    transfer: np.ndarray
    scatter: np.ndarray
    window_ell: np.ndarray
    windows: np.ndarray
    usable: np.ndarray
    field: Field
    flags: tuple[str, ...]

    def decouple(self, pseudo_power: np.ndarray) -> np.ndarray:
        """Band powers l(l+1) C_l / 2 pi (..., n_bin) [uK^2] of binned pseudo-power (..., n_bin) [uK^2 sr]."""
        raise NotImplementedError


def flat_coupling(
    taper: np.ndarray,
    pixel_rad: float,
    *,
    edges_ell: np.ndarray,
    beam: Callable[[np.ndarray], np.ndarray],
    transfer: np.ndarray | None = None,
    sky_shape: tuple[int, int] | None = None,
    cells_per_pixel: int = 1,
) -> ModeCoupling:
    """Mode coupling of a taper on the flat sky.

    Parameters
    ----------
    taper : (n_y, n_x)
        Zero-padded to resolve narrow bins.
    pixel_rad
    edges_ell : (n_bin + 1,)
    beam
        Power window B_l^2 of multipoles of any shape; pixels are added by the function.
    transfer : (n_bin,), optional
        Power transfer function in these bins, `measure_transfer_function`.
    sky_shape, cells_per_pixel
        Grid of the modes of the sky, as for `coupled_psd`; by default four times as large as the taper. With a
        transfer function: the grid of the skies that measured it.
    """
    raise NotImplementedError
