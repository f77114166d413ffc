"""Cleaning of a layer that moves with the wind: average subtraction of aligned streams.

Sayers et al. (2010), "Wind Model" and "Appendix Material". A frozen layer reaches a detector at r later by r . s, with
the slowness s of `slowness`. The streams are shifted by these delays, and the average template is fitted to them; the
template is shifted back by each detector's delay, and c_i T(t - r_i . s) is subtracted.

The shift is the appendix's: a linear interpolation, S in frequency, divided by |S|. Power spectra are unchanged because
S / |S| has modulus 1. Its phase is that of the delay at low frequencies, and differs by half a sample at most.

Beyond its ends a scan continues as its mirror image. Neither c nor the template depends on these samples: c is fitted
where every stream is within the scan, and the template is at each time the mean of the detectors that have data.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.chunks import row_chunks
from mapmaker.cleaning.responsivity import SCAN, Region, Responsivities, TemplateModel, check_fit, clean_templates
from mapmaker.cleaning.scans import Cleaned, checks_streams
from mapmaker.cleaning.templates import AVERAGE, template_basis
from mapmaker.errors import OutOfRangeError
from mapmaker.validation import number, reals

if TYPE_CHECKING:
    from mapmaker.timestreams import FocalPlane

# Longest delay from the array's centre, as a fraction of the scan: all detectors have at least half of the samples.
_LONGEST = 0.25
# Rounding by which a delay may pass the end of a scan, in samples.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class WindOptions:
    """Options of wind cleaning.

    Attributes
    ----------
    slowness_s_rad : (n_scan, 2)
        Time that the layer takes per angle, along the array's x and y [s/rad].
    sample_rate_hz
    tolerance, max_iterations, responsivities, first_guess
        As in `TemplateOptions`.
    """

    slowness_s_rad: np.ndarray
    sample_rate_hz: float
    tolerance: float
    max_iterations: int
    responsivities: Responsivities = SCAN
    first_guess: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for values out of range."""
        reals("slowness_s_rad", self.slowness_s_rad, ("n_scan", 2), empty=True)
        number("sample_rate_hz", self.sample_rate_hz, above=0)
        check_fit(self.tolerance, self.max_iterations, self.responsivities, self.first_guess)


def slowness(wind_rad_s: np.ndarray, scan_velocity_rad_s: np.ndarray) -> np.ndarray:
    """Slowness u / |u|^2 of a layer, with u = wind - scan velocity in the array frame.

    Parameters
    ----------
    wind_rad_s : (2,)
        `mapmaker.wind.WindFit.velocity_rad_s`.
    scan_velocity_rad_s : (n_scan, 2)
        `mapmaker.wind.scan_velocities`.

    Returns
    -------
    (n_scan, 2) array
        [s/rad].

    Raises
    ------
    ValueError
        For a layer at rest, and for values that are not finite, such as a wind that could not be measured.
    """
    wind = reals("wind_rad_s", wind_rad_s, (2,), finite=False)
    u = wind.astype(float) - reals("scan_velocity_rad_s", scan_velocity_rad_s, ("n_scan", 2), finite=False, empty=True)
    square = np.sum(u**2, axis=-1, keepdims=True)
    if not (np.isfinite(u).all() and square.all()):
        raise OutOfRangeError(
            "wind less scan velocity is zero or not finite; a finite velocity other than zero is allowed"
        )
    return u / square


@checks_streams
def subtract_wind(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: WindOptions
) -> Cleaned:
    """Remove the mean and the common signal that moves with the wind; arguments, result and errors as for `clean`.

    With zero slowness it is average subtraction. Source: Sayers et al. (2010), "Wind Model".

    Raises
    ------
    ValueError
        For slownesses of another number of scans, and delays from the array's centre above a quarter of a scan.
    """
    if len(options.slowness_s_rad) != len(scan_bounds):
        raise ValueError(f"{len(options.slowness_s_rad)} slownesses found for {len(scan_bounds)} scans; one a scan")
    regions = (Region(slice(None), template_basis(focal_plane, AVERAGE)),)
    r_rad = np.stack([focal_plane.x_rad - np.mean(focal_plane.x_rad), focal_plane.y_rad - np.mean(focal_plane.y_rad)])
    delays = options.sample_rate_hz * (np.asarray(options.slowness_s_rad, dtype=np.float64) @ r_rad)
    model = TemplateModel(regions, lambda block, scan: _view(block, delays[scan]))
    return clean_templates(data_mk, scan_bounds, model, options)


def _view(block: np.ndarray, delay: np.ndarray) -> tuple[np.ndarray, Callable[[np.ndarray], None]]:
    """Align one mean-removed scan, for `TemplateModel`: its streams where all are within the scan."""
    n_samp = block.shape[1]
    longest = np.abs(delay).max()
    if longest > _LONGEST * n_samp:
        raise OutOfRangeError(
            f"delays of up to {longest:.4g} samples found in a scan of {n_samp}; a quarter is allowed"
        )
    pad = ceil(longest)
    n_det, n_padded = len(block), n_samp + 2 * pad
    turn, rest = np.empty((n_det, n_padded + 1), np.complex128), np.empty((n_det, n_padded))
    within = np.empty((n_det, n_padded), bool)
    # Transforms take twenty times the memory of their streams.
    chunks = tuple(row_chunks(n_det, n_padded))
    for rows in chunks:
        turn[rows] = delay_phases(delay[rows], n_padded)
        rest[rows] = phase_shifted(np.pad(block[rows], ((0, 0), (pad, pad)), mode="symmetric"), turn[rows])
        instant = np.arange(-pad, n_samp + pad) + delay[rows, None]
        within[rows] = (instant >= -_ROUNDING) & (instant <= n_samp - 1 + _ROUNDING)
    common = rest[:, within.all(axis=0)]
    mean = common.mean(axis=1, keepdims=True)
    rest -= mean
    common -= mean

    def subtract(responsivity: np.ndarray) -> None:
        template = _mean_within(rest / responsivity[:, None], within)[None]
        for rows in chunks:
            seen = phase_shifted(template, turn[rows].conj())[:, pad : pad + n_samp]
            block[rows] -= responsivity[rows, None] * seen
        np.subtract(block, block.mean(axis=1, keepdims=True), out=block)

    return common, subtract


def delay_phases(delay: np.ndarray, n_samp: int) -> np.ndarray:
    """Phase factors S / |S| that advance streams by some delays.

    Parameters
    ----------
    delay : (n_det,)
        In samples.
    n_samp
        Samples of a scan without its mirror image.

    Returns
    -------
    (n_det, n_samp + 1) array
        Factors for the transform of a scan with its mirror image.
    """
    circle = np.exp(1j * np.pi * np.arange(2 * n_samp) / n_samp)
    whole = np.floor(delay).astype(np.int64)
    fraction = (delay - whole)[:, None]
    s = (1 - fraction) + fraction * circle[: n_samp + 1]
    # S is zero at the Nyquist frequency for half a sample, where a scan with its mirror image has no power.
    s[:, -1] = 1.0
    s /= np.abs(s)
    return s * circle[whole[:, None] * np.arange(n_samp + 1) % (2 * n_samp)]


def phase_shifted(streams: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Shift streams (n_det, n_samp), mirrored at their ends, by `delay_phases` (n_det, n_samp + 1)."""
    n_samp = streams.shape[1]
    spectrum = np.fft.rfft(np.concatenate([streams, streams[:, ::-1]], axis=1))
    return np.fft.irfft(spectrum * turn, 2 * n_samp)[:, :n_samp]


def _mean_within(streams: np.ndarray, within: np.ndarray) -> np.ndarray:
    """Mean over the detectors that are within the scan; the nearest mean where none is."""
    count = within.sum(axis=0)
    some = np.flatnonzero(count)
    total = np.einsum("in,in->n", streams, within)[some[0] : some[-1] + 1]
    mean = total / count[some[0] : some[-1] + 1]
    return np.pad(mean, (some[0], len(count) - 1 - some[-1]), mode="edge")
