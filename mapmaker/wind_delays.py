"""Delays of a frozen layer between the detectors of an array, from the transforms of tapered scans.

`mapmaker.wind` states the model.
"""

from dataclasses import dataclass
from math import pi

import numpy as np

LOWEST_BIN = 2  # the removed mean of a scan reaches the first bin of a Hann taper, and no other
MIN_BINS = 2
_COHERENT = 0.2  # least mean relative cross-PSD: a quarter as much signal as noise
_START_COHERENT = 0.5  # the same before delays are known: keeps phases from wrapping
ROUNDS = 5
_ROUNDING = 1e-14  # power of rounding in the residual of a fit, relative to the whole


@dataclass(frozen=True)
class ScanSpectra:
    """Relative transforms of tapered scans.

    Attributes
    ----------
    d, e : (n_freq, n_scan, n_det)
        Transforms under the Hann taper and under its derivative; each detector has the mean power 1 over the scans.
    f_hz : (n_freq,)
    r_rad : (2, n_det)
        Positions relative to the detectors' centre.
    """

    d: np.ndarray
    e: np.ndarray
    f_hz: np.ndarray
    r_rad: np.ndarray


@dataclass(frozen=True)
class AlignedSpectra:
    """Spectra without the delays of the slowness found so far.

    Attributes
    ----------
    d : (n_freq, n_scan, n_det)
    mean, rate : (n_freq, n_scan)
        Means over the array of the stream's transform and of its derivative's.
    f_hz, turn_hz : (n_freq,)
        Effective frequencies, and those used to remove the delays.
    coherence : (n_freq,)
        Mean relative cross-PSD.
    """

    d: np.ndarray
    mean: np.ndarray
    rate: np.ndarray
    f_hz: np.ndarray
    turn_hz: np.ndarray
    coherence: np.ndarray


@dataclass(frozen=True)
class Delays:
    """Aligned spectra and their slowness.

    Attributes
    ----------
    aligned
    n_freq
        Number of frequencies used.
    slowness, left_out : (n_scan, 2)
        Slowness of each scan's group, with and without the scan [s/rad].
    """

    aligned: AlignedSpectra
    n_freq: int
    slowness: np.ndarray
    left_out: np.ndarray


def scan_transforms(data: np.ndarray, bounds: np.ndarray, *, rate: float, highest_hz: float) -> np.ndarray:
    """Transform scans at the lowest frequencies under a Hann taper and its derivative.

    Parameters
    ----------
    data : (n_det, n_samp)
    bounds : (n_scan, 2)
        Scans of equal length.
    rate, highest_hz
        Sample rate, and highest frequency [Hz].

    Returns
    -------
    (n_scan, n_det, 4 n_freq) array
        Real parts under the taper and under its derivative, then the imaginary parts.
    """
    n = int(bounds[0, 1] - bounds[0, 0])
    scans = np.stack([data[:, start:stop] for start, stop in bounds]).astype(np.float64)
    scans -= scans.mean(axis=2, keepdims=True)
    cycles = np.arange(LOWEST_BIN, int(highest_hz * n / rate * (1 + 1e-9)) + 1)
    turn = 2 * pi * (np.arange(n) + 0.5) / n
    wave = np.exp(-1j * turn[:, None] * cycles)
    taper, slope = 0.5 * (1 - np.cos(turn)), (pi * rate / n) * np.sin(turn)
    # A few bins only, so a product is faster than whole transforms.
    basis = np.hstack([taper[:, None] * wave, slope[:, None] * wave])
    return scans @ np.hstack([basis.real, basis.imag])


def scan_spectra(transforms: np.ndarray, *, places_rad: np.ndarray, bin_hz: float) -> ScanSpectra:
    """Convert the transforms of all scans of an observation, `scan_transforms`, to relative spectra.

    Parameters
    ----------
    transforms : (n_scan, n_det, 4 n_freq)
        Of detectors that are not constant.
    places_rad : (2, n_det)
        Detector positions.
    bin_hz
        One cycle a scan.
    """
    n_freq = transforms.shape[2] // 4
    both = (transforms[..., : 2 * n_freq] + 1j * transforms[..., 2 * n_freq :]).transpose(2, 0, 1)
    d, e = both.reshape(2, n_freq, *both.shape[1:])
    scale = 1 / np.sqrt(np.mean(np.abs(d) ** 2, axis=1, keepdims=True))
    r = places_rad - places_rad.mean(axis=1, keepdims=True)
    return ScanSpectra(d * scale, e * scale, np.arange(LOWEST_BIN, LOWEST_BIN + n_freq) * bin_hz, r)


def _align(spectra: ScanSpectra, slowness: np.ndarray, f_hz: np.ndarray) -> AlignedSpectra:
    """Remove the delays of `slowness` (n_scan, 2), with the phases at `f_hz` (n_freq,)."""
    n_det = spectra.d.shape[2]
    turn = np.exp(2j * pi * f_hz[:, None, None] * (slowness @ spectra.r_rad))
    d = spectra.d * turn
    mean = d.mean(axis=2)
    rate = 2j * pi * spectra.f_hz[:, None] * mean - np.einsum("ksi,ksi->ks", spectra.e, turn) / n_det
    power = np.sum(np.abs(mean) ** 2, axis=1)
    effective = np.sum((mean.conj() * rate).imag, axis=1) / (2 * pi * power)
    coherence = (n_det * power / d.shape[1] - 1) / (n_det - 1)
    return AlignedSpectra(d, mean, rate, effective, f_hz, coherence)


def _band(aligned: AlignedSpectra, least: float) -> int:
    """Count the frequencies, from the first on, that are coherent over the array."""
    return int(np.argmin(np.append(aligned.coherence >= least, False)))


def measure_slowness(spectra: ScanSpectra, groups: list[np.ndarray]) -> Delays | None:
    """Measure the slowness of each group of scans; None where too few frequencies are coherent."""
    slowness = np.zeros((spectra.d.shape[1], 2))
    aligned = _align(spectra, slowness, spectra.f_hz)
    for least in (_START_COHERENT, *[_COHERENT] * (ROUNDS - 1)):
        if _band(aligned, _COHERENT) < MIN_BINS:
            return None
        n_freq = max(_band(aligned, least), MIN_BINS)
        slowness, left_out = _regress(spectra.r_rad, aligned, slowness=slowness, groups=groups, n_freq=n_freq)
        aligned = _align(spectra, slowness, aligned.f_hz)
    return Delays(aligned, n_freq, slowness, left_out)


def _regress(
    r_rad: np.ndarray, aligned: AlignedSpectra, *, slowness: np.ndarray, groups: list[np.ndarray], n_freq: int
) -> tuple[np.ndarray, np.ndarray]:
    """Fit the slowness of each scan's group, and the same without that scan, (n_scan, 2), from gradient against rate.

    The array's gradient is ``-s F`` plus a part independent of the wind, whose 2 x 2 covariances, one a frequency, are
    the weights of a generalised least-squares fit.
    """
    mean, rate = aligned.mean[:n_freq], aligned.rate[:n_freq]
    gradient = np.moveaxis(aligned.d[:n_freq] @ np.linalg.pinv(r_rad), 2, 0)
    gradient -= 2j * pi * aligned.turn_hz[:n_freq, None] * mean * slowness.T[:, None, :]
    product, power = -(rate.conj() * gradient).real, np.abs(rate) ** 2
    least = _ROUNDING * np.sum(np.abs(mean) ** 2, axis=1) / np.max(np.abs(r_rad)) ** 2
    weight = np.eye(2) / np.sum(power, axis=1)[:, None, None]
    fitted, left_out = np.empty((2, *slowness.shape))
    for _ in range(3):
        normal = np.einsum("kab,ks->sab", weight, power)
        right = np.einsum("kab,bks->sa", weight, product)
        for scans in groups:
            a, b = normal[scans].sum(axis=0), right[scans].sum(axis=0)
            fitted[scans] = np.linalg.solve(a, b)
            left_out[scans] = np.linalg.solve(a - normal[scans], (b - right[scans])[..., None])[..., 0]
        rest = gradient + rate * fitted.T[:, None, :]
        covariance = np.einsum("aks,bks->kab", rest.conj(), rest).real
        weight = np.linalg.inv(covariance + least[:, None, None] * np.eye(2))
    return fitted, left_out
