"""Beams of a camera whose detectors differ in width."""

from dataclasses import dataclass

import numpy as np

from mapmaker.transfer_function import beam_window


@dataclass(frozen=True, eq=False)
class Beams:
    """Gaussian beams of the detectors of a camera.

    Attributes
    ----------
    fwhm_rad : (n_beam,)
        Different widths.
    of_detector : (n_det,)
        Index of the beam of each detector.
    share : (n_beam,)
        Weight of each beam in a map: the sum of its detectors' responsivities over that of all.
    """

    fwhm_rad: np.ndarray
    of_detector: np.ndarray
    share: np.ndarray

    def window(self, ell: np.ndarray) -> np.ndarray:
        """Window function (power) of a map that all detectors cover alike: the square of the mean beam."""
        if len(self.fwhm_rad) == 1:
            return beam_window(ell, float(self.fwhm_rad[0]))
        beams = (np.sqrt(beam_window(ell, width)) for width in self.fwhm_rad.tolist())
        return np.sum([share * beam for share, beam in zip(self.share, beams, strict=True)], axis=0) ** 2


def beams_of(fwhm_rad: float | np.ndarray, responsivity: np.ndarray) -> Beams:
    """Collect the beams of detectors: one width for all, or one for each (n_det,)."""
    each = np.broadcast_to(fwhm_rad, len(responsivity))
    widths, place = np.unique(each, return_inverse=True)
    return Beams(widths, place, np.bincount(place, responsivity) / responsivity.sum())
