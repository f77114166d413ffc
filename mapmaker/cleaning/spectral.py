"""Spectral cleaning: subtraction of the atmosphere that a pixel's other bands see.

Sayers et al. (2010), "Prospects": cameras with several bands a pixel (SuZIE, MKIDCam) subtract first the spatial, then
the spectral common mode. The streams of the other bands, after the same spatial cleaning, are fitted to each detector's
stream, scan by scan, and subtracted. The coefficients include the ratio of opacities between the bands, and gains. A
band with a much brighter atmosphere has a small coefficient and adds little noise. Sky signal in the other bands is
subtracted together with their atmosphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.cleaning.scans import Cleaned, Fit, checks_streams, clean_scans, has_dead
from mapmaker.errors import InsufficientDataError
from mapmaker.validation import reals

if TYPE_CHECKING:
    from mapmaker.timestreams import FocalPlane


@dataclass(frozen=True)
class SpectralOptions:
    """Options of spectral cleaning.

    Attributes
    ----------
    others_mk : (n_band, n_det, n_samp)
        Streams of the same detectors in the other bands.
    """

    others_mk: np.ndarray

    def __post_init__(self) -> None:
        """Convert real numbers of any type; raise ValueError for others, and for no band."""
        others = reals("others_mk", self.others_mk, ("n_band", "n_det", "n_samp"), finite=False)
        object.__setattr__(self, "others_mk", others)


@checks_streams
def subtract_spectral(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: SpectralOptions
) -> Cleaned:
    """Remove the mean and the fit of each detector's other bands; arguments, result and errors as for `clean`.

    A scan in which another band has a value that is not finite or a dead detector is discarded.

    Raises
    ------
    ValueError
        For other bands' streams of another shape, and for scans of no more samples than bands.
    """
    others = options.others_mk
    if others.shape[1:] != data_mk.shape:
        n_det, n_samp = data_mk.shape
        raise ValueError(f"others_mk have the shape {others.shape}; (n_band, {n_det}, {n_samp}) is expected")
    shortest = int(np.diff(scan_bounds, axis=1).min(initial=len(others) + 1))
    if shortest <= len(others):
        raise InsufficientDataError(
            f"{len(others)} other bands need scans of {len(others) + 1} samples, got {shortest}"
        )

    def subtract(block: np.ndarray, scan: int) -> Fit:
        start, stop = scan_bounds[scan]
        bands = others[:, :, start:stop].astype(np.float64)
        if not np.isfinite(bands).all():
            return Fit(None)
        bands -= bands.mean(axis=2, keepdims=True)
        if has_dead(block) or any(has_dead(band) for band in bands):
            return Fit(None)
        # Bands that see one atmosphere are nearly alike: an orthogonal basis keeps the digits of their difference.
        basis = np.linalg.qr(bands.transpose(1, 2, 0))[0]
        block -= (basis @ (basis.transpose(0, 2, 1) @ block[..., None]))[..., 0]
        return Fit(np.ones(len(block)), removed=len(others))

    return clean_scans(data_mk, scan_bounds, subtract)
