"""Factors of strips with hundreds of lanes, for rectangles that hold curved tracks.

The matrices of `surveysim.atmosphere.strip_factors` take a time that grows with the cube of the number of lanes. A
Fourier transform across replaces most of them. At the frequency k along x the covariance C(k, dy) decays over 1 / k; it
is continued with a period of 8/3 widths, smooth and even about the seam (as along x), so that it is exact for all lags
in the strip. Its transform is positive, but for the lowest frequencies, whose covariance goes on beyond the period.
These keep their matrices: as many as it takes for negative power to be negligible. Both seams are smoother than those
of narrow strips, as the power of waves between the diffraction rings of the beam is nearly 0.
"""

from dataclasses import replace
from math import ceil

import numpy as np

from surveysim.atmosphere import strip_factors as factors
from surveysim.atmosphere.strip_factors import Seam, Strip
from surveysim.atmosphere.thin_screen import LAG_MAX, Screen, structure_function
from surveysim.runtime.errors import OutOfRangeError

# Negative power of the transforms, as a fraction of the variance of neighbour differences, and power that is omitted
# along and across: it is also that of the residual of a quadratic in a small field of view.
_CLIPPED, _OMITTED = 0.5 * factors.CLIPPED_MAX, 1e-5
# Power across that the lowest frequencies without matrices may have beyond that of the spectrum.
_BEYOND = 1e-4
# Most lanes, whose factors take some five seconds.
_MOST_LANES = 2048
# Operations for matrices that take a second, and the number of frequencies that may take longer, over that of the
# periods along in one across.
_MOST_WORK, _FEW = 3e9, 2.5


def factorize_wide(screen: Screen, *, n_x: int, n_lane: int, step_rad: float, precision: str) -> Strip:
    """Build a strip of a given size, whatever its clipped fraction; raises ValueError for one too large to hold."""
    from scipy.fft import dct
    from scipy.special import betainc

    check_wide(n_x, n_lane, step_rad, screen)
    n_y, seam = _period(n_lane), Seam(5, lambda place: betainc(8, 8, place))
    ramp_variance, density = factors.lane_spectra(screen, n_x, n_y // 2 + 1, step_rad, seam)
    used = factors.used_modes(screen, density[:, :n_lane], n_x, step_rad, _OMITTED)
    across = dct(factors.smooth_seam(density[:used].T, seam).T, type=1, axis=1)
    total = 2.0 * float(structure_function(screen, step_rad))
    share = _shares(across, n_x, n_y) / total
    # The spectrum is isotropic: it ends across where it ends along.
    n_half = min(n_y // 2 + 1, ceil(used * n_y / n_x) + 1)
    n_dense = min(_dense_frequencies(share, n_half), int(max(_FEW * max(n_x / n_y, 2), _MOST_WORK / n_lane**3)))
    dense = factors.dense_strip(
        screen, density[:, :n_lane], n_x=n_x, step_rad=step_rad, used=n_dense, precision=precision
    )
    kept, half = slice(n_dense, used), slice(0, n_half)
    amplitude = np.sqrt(np.maximum(across[kept, half], 0.0) * factors.mode_parts(n_x)[kept, None] / n_y)
    clipped = dense.clipped_fraction - float(np.minimum(share[kept, half], 0.0).sum())
    return replace(
        dense,
        ramp_std=ramp_variance**0.5,
        n_y=n_y,
        amplitude=amplitude.astype(precision),
        clipped_fraction=clipped,
    )


def check_wide(n_x: int, n_lane: int, step_rad: float, screen: Screen) -> None:
    """Raise ValueError for strips with too many points or lanes, or longer than the structure function's table."""
    long = n_x * step_rad > 2.0 * LAG_MAX * screen.beam_rad
    if n_x * n_lane > factors.MOST_POINTS or n_lane > _MOST_LANES or long:
        raise OutOfRangeError(
            f"found a rectangle of the layer with {n_x} by {n_lane} points {step_rad:.3g} rad apart; up to"
            f" {factors.MOST_POINTS:.3g} points, {_MOST_LANES} across and {LAG_MAX:g} beams of length are allowed, by"
            " shorter scans, a smaller throw, a slower wind, a smaller camera or a larger numerics.screen_step"
        )


def _period(n_lane: int) -> int:
    """Even number of lanes with quick transforms whose half, without the seam, has all lags of the strip."""
    from scipy.fft import next_fast_len

    return 2 * next_fast_len(ceil((n_lane - 1) / (1.0 - factors.SEAM)) + 1)


def _shares(across: np.ndarray, n_x: int, n_y: int) -> np.ndarray:
    """Contributions of modes (used, n_y/2 + 1) to the variance of neighbour differences along x plus across."""
    (weight_x, along), (weight_y, aside) = factors.difference_weights(n_x), factors.difference_weights(n_y)
    used = len(across)
    return across * (along[:used, None] * weight_y + weight_x[:used, None] * aside)


def _dense_frequencies(share: np.ndarray, n_half: int) -> int:
    """Count the lowest frequencies that keep their matrices."""
    negative = -np.minimum(share[:, :n_half], 0.0).sum(axis=1)
    omitted = np.abs(share[:, n_half:]).sum(axis=1)
    bad = (np.cumsum(negative[::-1])[::-1] > _CLIPPED) | (np.cumsum(omitted[::-1])[::-1] > _BEYOND)
    return max(1, int(np.flatnonzero(bad).max(initial=-1)) + 1)


def across_modes(strip: Strip, normals: np.ndarray) -> np.ndarray:
    """Modes of the frequencies without matrices, (n_strip, n_lane, n_more), from normals (n_strip, 2 n_more n_mode)."""
    from scipy.fft import ifft

    n_more, n_half = strip.amplitude.shape
    complex_type = np.result_type(strip.amplitude.dtype, np.complex64)
    drawn = np.ascontiguousarray(normals).view(np.complex64).reshape(len(normals), n_more, 2 * n_half - 1)
    spectrum = np.zeros((len(normals), n_more, strip.n_y), complex_type)
    spectrum[..., strip.n_y - n_half + 1 :] = drawn[..., n_half:] * strip.amplitude[:, :0:-1]
    spectrum[..., :n_half] = drawn[..., :n_half] * strip.amplitude
    return ifft(spectrum, axis=-1, norm="forward", overwrite_x=True)[..., : strip.n_lane].transpose(0, 2, 1)
