"""Transfer functions: power that a sky signal loses by beam, pixel, scans and cleaning."""

import math
from dataclasses import dataclass

import numpy as np

from mapmaker.errors import InsufficientDataError
from mapmaker.spectrum import Annuli, map_psd
from mapmaker.validation import number, pixel_side, plane_sides, reals


@dataclass(frozen=True)
class TransferFunction:
    """Transfer function in bins of multipole, measured with simulated skies.

    Attributes
    ----------
    ell : (n_bin,)
    transmission : (n_bin,)
        Power out over power in, or amplitude out over amplitude in (`measure_amplitude_transfer`).
    deviations : (n_sky, n_bin)
        Signed contribution of each sky to the error.
    """

    ell: np.ndarray
    transmission: np.ndarray
    deviations: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """Standard error of the transmission, (n_bin,): the independent deviations in quadrature."""
        return np.linalg.norm(self.deviations, axis=0)


def beam_window(ell: np.ndarray, fwhm_rad: float) -> np.ndarray:
    """Beam window function `B_ell^2 = exp(-ell^2 s^2)` of a Gaussian beam, `s = fwhm / sqrt(8 ln 2)`.

    Raises
    ------
    ValueError
        For multipoles or a beam that are not finite, and for a negative beam.
    """
    number("fwhm_rad", fwhm_rad, least=0, most=math.pi)
    return np.exp(-(reals("ell", ell, (...,), empty=True) ** 2) * fwhm_rad**2 / (8 * np.log(2)))


def pixel_window(ell: np.ndarray, pixel_rad: float) -> np.ndarray:
    """Window function of square pixels: `sinc^2(k_x p / 2) sinc^2(k_y p / 2)` averaged over azimuth, for `ell` of any
    shape.
    """
    number("pixel_rad", pixel_rad, least=0, below=math.pi / 2)
    # Equal steps over the period of a smooth function converge exponentially: 32 are exact to rounding.
    azimuth = (np.arange(32) + 0.5) * (np.pi / 2 / 32)
    cycles = reals("ell", ell, (...,), empty=True).astype(np.float64)[..., None] * pixel_rad / (2 * np.pi)
    return np.mean((np.sinc(cycles * np.cos(azimuth)) * np.sinc(cycles * np.sin(azimuth))) ** 2, axis=-1)


def mode_pixel_window(n_y: int, n_x: int, cell_rad: float, pixel_rad: float) -> np.ndarray:
    """Window function of square pixels on the half plane of `rfft2`.

    Parameters
    ----------
    n_y, n_x, cell_rad
        Cells of the grid, and their side.
    pixel_rad
        Side of a pixel.

    Returns
    -------
    (n_y, n_x // 2 + 1) array

    Raises
    ------
    ValueError
        For sides that are not positive integers, and cells or pixels that are not positive.
    """
    plane_sides(n_y, n_x)
    pixel_side("cell_rad", cell_rad)
    pixel_side("pixel_rad", pixel_rad)
    along_y = np.sinc(np.fft.fftfreq(n_y, cell_rad) * pixel_rad) ** 2
    along_x = np.sinc(np.fft.rfftfreq(n_x, cell_rad) * pixel_rad) ** 2
    return np.outer(along_y, along_x)


def measure_transfer_function(psd_cleaned: np.ndarray, psd_reference: np.ndarray, ell: np.ndarray) -> TransferFunction:
    """Transfer function from the PSDs of the same skies with and without losses.

    It is the ratio of the means over skies, which is consistent and not dominated by faint skies, unlike the mean of
    ratios. The error is the delete-one jackknife over skies, `(n - 1) / n sum_i (r_i - mean r)^2`, in which the sample
    variance common to both PSDs cancels; the deviations are `sqrt((n - 1) / n) (r_i - mean r)`.

    Parameters
    ----------
    psd_cleaned, psd_reference : (n_sky, n_bin)
        PSDs with and without losses.
    ell : (n_bin,)

    Raises
    ------
    ValueError
        For fewer than 2 skies, shapes that differ, values that are not finite, negative power, or a reference without
        power.
    """
    psd_cleaned = reals("psd_cleaned", psd_cleaned, (...,), least=0)
    psd_reference = reals("psd_reference", psd_reference, (...,), least=0)
    ell = reals("ell", ell, (...,))
    if psd_cleaned.ndim != 2 or psd_cleaned.shape != psd_reference.shape or psd_cleaned.shape[1:] != ell.shape:
        raise ValueError(
            "expected psd_cleaned and psd_reference (n_sky, n_bin) and ell (n_bin,), got "
            f"{psd_cleaned.shape}, {psd_reference.shape} and {ell.shape}"
        )
    return _ratio_of_means(psd_cleaned, psd_reference, ell)


def measure_amplitude_transfer(
    cleaned: np.ndarray, reference: np.ndarray, *, taper: np.ndarray, pixel_rad: float, rings: Annuli
) -> TransferFunction:
    """Transfer function of amplitudes from maps of the same skies with and without losses.

    It is ``Re sum c r* / sum |r|^2`` over the skies and the modes c and r of a bin: the part of the reference that
    remains, whatever else cleaning adds. Its square is at most the transfer function of power; cleaning that treats
    all directions of a bin alike and couples no modes has equality. Errors are those of `measure_transfer_function`.

    Parameters
    ----------
    cleaned, reference : (n_sky, n_y, n_x)
        Maps with and without losses.
    taper : (n_y, n_x)
    pixel_rad
    rings
        Annuli of the maps.

    Raises
    ------
    ValueError
        For fewer than 2 skies, shapes that differ, values that are not finite, or a reference without power.
    """
    reference = reals("reference", reference, ("n_sky", "n_y", "n_x"))
    cleaned = reals("cleaned", cleaned, reference.shape)
    of_map = taper, pixel_rad, rings
    cross = (map_psd(reference + cleaned, *of_map) - map_psd(reference - cleaned, *of_map)) / 4
    return _ratio_of_means(cross, map_psd(reference, *of_map), rings.ell)


def _ratio_of_means(psd_cleaned: np.ndarray, psd_reference: np.ndarray, ell: np.ndarray) -> TransferFunction:
    """Ratio of the means over skies, with the deviations of its jackknife."""
    n_sky = len(psd_cleaned)
    if n_sky < 2:
        raise InsufficientDataError(f"the error of a transfer function needs at least 2 skies, got {n_sky}")
    if not (psd_reference > 0).all():
        raise InsufficientDataError("the reference skies must have power in every bin")
    cleaned, reference = psd_cleaned.sum(axis=0), psd_reference.sum(axis=0)
    left_out = (cleaned - psd_cleaned) / (reference - psd_reference)
    deviations = np.sqrt((n_sky - 1) / n_sky) * (left_out - left_out.mean(axis=0))
    return TransferFunction(ell, cleaned / reference, deviations)
