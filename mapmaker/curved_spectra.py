"""Mode coupling on the sphere, for fields too large for a plane: maps and weights in HEALPix pixels."""

from collections.abc import Callable

import numpy as np

from mapmaker.mode_coupling import ModeCoupling


def plane_distortion(taper: np.ndarray, pixel_rad: float) -> float:
    """Relative shift of multipoles in a gnomonic map: the mean stretch of lengths under the squared taper."""
    raise NotImplementedError


def curved_coupling(
    taper: np.ndarray,
    *,
    edges_ell: np.ndarray,
    beam: Callable[[np.ndarray], np.ndarray],
    transfer: np.ndarray | None = None,
) -> ModeCoupling:
    """Mode coupling of a taper (n_pixel,) on HEALPix pixels in ring order; else as `flat_coupling`."""
    raise NotImplementedError
