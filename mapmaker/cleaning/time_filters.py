"""Filters in time: a high-pass, notches and polynomials, each within one scan and for each detector alone.

Each is a symmetric linear operator F on a mean-removed scan of n samples,

    F = 1 - sum_j l_j u_j u_j^T,

with orthonormal modes u_j that are even or odd about the middle of the scan, and losses of amplitude l_j. A scan never
depends on another one. The mean of a filtered scan is 0.

- High-pass: the modes are the cosines of the discrete cosine transform, cos(pi k (i + 1/2) / n) at the frequency k / 2T
  of a scan of length T. They continue a scan by its mirror image, so that the step between its end and its beginning,
  which a Fourier transform would filter, is none. The amplitude that is left at f is that of a Butterworth filter,
  (1 + (f_c / f)^(2 order))^(-1/2), or a step at the corner f_c.
- Notch: cosines and sines at the frequencies of a band. A scan has a limited number of independent ones (Slepian 1978):
  the modes are those that hold more than a hundredth of the power of the strongest one. A wave in the band keeps less
  than 1 % of its power. A line without width has two modes.
- Polynomial: Legendre polynomials over the samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.chunks import row_chunks
from mapmaker.cleaning.scans import Cleaned, checks_streams
from mapmaker.errors import InsufficientDataError
from mapmaker.validation import argument_error, number, reals, whole

if TYPE_CHECKING:
    from mapmaker.timestreams import FocalPlane

MOST_ORDER = 20  # of polynomials and of Butterworth filters
_LEAST_LOSS = 1e-3  # of a mode in `time_modes`
_LEAST_POWER = 1e-2  # of a mode of a notch, over that of the strongest
_SAME = 1e-12  # modes of two bands that differ by less are one
_NODES_A_CYCLE = 4  # frequencies that stand for a band, times the length of a scan


@dataclass(frozen=True)
class HighpassOptions:
    """Options of a high-pass filter.

    Attributes
    ----------
    corner_hz
        Corner frequency: a Butterworth filter leaves half of the power there.
    sample_rate_hz
    order
        Order of the Butterworth filter; None for a step, which removes all below the corner and nothing above.
    """

    corner_hz: float
    sample_rate_hz: float
    order: int | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for values out of range."""
        number("sample_rate_hz", self.sample_rate_hz, above=0)
        number("corner_hz", self.corner_hz, above=0, below=self.sample_rate_hz / 2)
        if self.order is not None:
            whole("order", self.order, least=1, most=MOST_ORDER)


@dataclass(frozen=True)
class NotchOptions:
    """Options of notches.

    Attributes
    ----------
    frequencies_hz, widths_hz : (n,)
        Centres and full widths of the bands that are removed.
    sample_rate_hz
    """

    frequencies_hz: tuple[float, ...]
    widths_hz: tuple[float, ...]
    sample_rate_hz: float

    def __post_init__(self) -> None:
        """Convert to tuples; raise ValueError for values out of range, and bands that reach below 0 or above half of
        the rate.
        """
        rate = number("sample_rate_hz", self.sample_rate_hz, above=0)
        centres = reals("frequencies_hz", self.frequencies_hz, ("n",), above=0).tolist()
        widths = reals("widths_hz", self.widths_hz, (len(centres),), least=0).tolist()
        for centre, width in zip(centres, widths, strict=True):
            if not (centre - width / 2 >= 0 and centre + width / 2 <= rate / 2):
                found = f"a band from {centre - width / 2:g} to {centre + width / 2:g} Hz"
                raise argument_error("frequencies_hz", found, f"one from 0 to {rate / 2:g} Hz, half of the rate, is")
        object.__setattr__(self, "frequencies_hz", tuple(centres))
        object.__setattr__(self, "widths_hz", tuple(widths))


@dataclass(frozen=True)
class TimePolynomialOptions:
    """Order of the polynomial in time that is removed from each scan."""

    order: int

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        whole("order", self.order, least=1, most=MOST_ORDER)


TimeFilterOptions = HighpassOptions | NotchOptions | TimePolynomialOptions


@dataclass(frozen=True)
class TimeModes:
    """Modes of a filter.

    Attributes
    ----------
    modes : (n_samp, n_mode)
        Orthonormal, without a mean, even or odd about the middle of the scan.
    loss : (n_mode,)
        Fraction of the amplitude of each mode that the filter removes.
    odd : (n_mode,)
        Flags of the odd modes.
    """

    modes: np.ndarray
    loss: np.ndarray
    odd: np.ndarray


@lru_cache(maxsize=32)
def time_modes(options: TimeFilterOptions, n_samp: int) -> TimeModes:
    """Modes of a filter for scans of a number of samples; those of a high-pass that lose less than 0.1 % are omitted.

    Raises
    ------
    InsufficientDataError
        For scans of no more samples than modes and mean.
    """
    if isinstance(options, HighpassOptions):
        left = highpass_response(options, n_samp)
        degree = np.flatnonzero(left[1:] <= 1 - _LEAST_LOSS) + 1
        phase = np.pi / n_samp * (np.arange(n_samp)[:, None] + 0.5) * degree
        return TimeModes(np.sqrt(2 / n_samp) * np.cos(phase), 1 - left[degree], degree % 2 == 1)
    if isinstance(options, NotchOptions):
        modes, odd = _notch_modes(options, n_samp)
    else:
        place = (2 * np.arange(n_samp) + 1) / n_samp - 1
        modes = np.linalg.qr(np.polynomial.legendre.legvander(place, options.order))[0][:, 1:]
        odd = np.arange(1, options.order + 1) % 2 == 1
    if n_samp <= len(odd) + 1:
        raise InsufficientDataError(
            f"{len(odd)} modes in time need scans of {len(odd) + 2} samples or more, got {n_samp}"
        )
    return TimeModes(modes, np.ones(len(odd)), odd[: modes.shape[1]])


def count_time_modes(options: TimeFilterOptions, n_samp: int) -> int:
    """Count the modes of `time_modes`, those of a high-pass without making them."""
    if isinstance(options, HighpassOptions):
        return int(np.sum(highpass_response(options, n_samp)[1:] <= 1 - _LEAST_LOSS))
    return time_modes(options, n_samp).modes.shape[1]


@lru_cache(maxsize=32)
def highpass_response(options: HighpassOptions, n_samp: int) -> np.ndarray:
    """Amplitude (n_samp,) that a high-pass leaves of each cosine of a scan; 0 of the mean."""
    frequency = np.arange(n_samp) * options.sample_rate_hz / (2 * n_samp)
    if options.order is None:
        return np.where((frequency >= options.corner_hz * (1 - 1e-12)) & (frequency > 0), 1.0, 0.0)
    with np.errstate(divide="ignore", over="ignore"):  # 0 Hz, and a high order far below the corner
        return (1 + (options.corner_hz / frequency) ** (2 * options.order)) ** -0.5


def _notch_modes(options: NotchOptions, n_samp: int) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal modes (n_samp, n) of all bands, and flags of the odd ones."""
    time_s = (np.arange(n_samp) - (n_samp - 1) / 2) / options.sample_rate_hz
    bands: tuple[list[np.ndarray], ...] = ([], [])
    for centre, width in zip(options.frequencies_hz, options.widths_hz, strict=True):
        nodes = 1 + int(np.ceil(_NODES_A_CYCLE * width * n_samp / options.sample_rate_hz))
        at_hz = centre + width * (np.linspace(-0.5, 0.5, nodes) if nodes > 1 else np.zeros(1))
        phase = 2 * np.pi * np.outer(time_s, at_hz)
        even = np.cos(phase)
        for band, waves in zip(bands, (even - even.mean(axis=0), np.sin(phase)), strict=True):
            band.append(_basis(waves, _LEAST_POWER))
    found = [_basis(np.hstack(band), _SAME) for band in bands]
    return np.hstack(found), np.repeat([False, True], [item.shape[1] for item in found])


def _basis(columns: np.ndarray, least: float) -> np.ndarray:
    """Orthonormal basis of columns, without directions of less than a share of the power of the strongest one."""
    vectors, values, _ = np.linalg.svd(columns, full_matrices=False)
    return vectors[:, values > np.sqrt(least) * values[0]]


@checks_streams
def subtract_low_frequencies(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: HighpassOptions
) -> Cleaned:
    """Filter each scan by a high-pass; arguments, result and errors as for `clean`.

    `removed` is the number of cosines below the corner. Dead detectors are not checked.
    """
    from scipy.fft import dct, idct

    def apply(block: np.ndarray) -> np.ndarray:
        modes = dct(block, axis=1, norm="ortho", overwrite_x=True)
        modes *= highpass_response(options, block.shape[1])
        return idct(modes, axis=1, norm="ortho", overwrite_x=True)

    below = [_cosines_below(options, int(n)) for n in np.diff(scan_bounds, axis=1)[:, 0]]
    return _filtered(data_mk, scan_bounds, apply, below)


def _cosines_below(options: HighpassOptions, n_samp: int) -> int:
    """Count the cosines of a scan, but for the mean, that lose more than half of their power."""
    return int(np.sum(highpass_response(options, n_samp)[1:] ** 2 < 0.5 - 1e-9))


@checks_streams
def subtract_time_modes(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    focal_plane: FocalPlane,
    options: NotchOptions | TimePolynomialOptions,
) -> Cleaned:
    """Project modes in time out of each scan; arguments, result and errors as for `clean`.

    `removed` is the number of modes. Dead detectors are not checked.

    Raises
    ------
    InsufficientDataError
        For scans of no more samples than modes and mean.
    """

    def apply(block: np.ndarray) -> np.ndarray:
        modes = time_modes(options, block.shape[1]).modes
        block -= (block @ modes) @ modes.T
        return block

    lengths = np.diff(scan_bounds, axis=1)[:, 0].tolist()
    return _filtered(data_mk, scan_bounds, apply, [time_modes(options, n).modes.shape[1] for n in lengths])


def _filtered(
    data_mk: np.ndarray, scan_bounds: np.ndarray, apply: Callable[[np.ndarray], np.ndarray], removed: list[int]
) -> Cleaned:
    """Filter each scan in float64 and with means removed, some detectors at a time: memory does not grow with them."""
    from mapmaker.kernels.cleaning import remove_means

    n_det, n_scan = len(data_mk), len(scan_bounds)
    cleaned_mk, kept = np.zeros(data_mk.shape, data_mk.dtype), np.ones(n_scan, bool)
    for s, (start, stop) in enumerate(scan_bounds):
        for rows in row_chunks(n_det, 2 * int(stop - start)):
            part = data_mk[rows]
            block = np.empty((len(part), stop - start))
            if not remove_means(part, start, stop, block):
                kept[s], cleaned_mk[:, start:stop] = False, 0
                break
            cleaned_mk[rows, start:stop] = apply(block)
    responsivity = np.where(kept[:, None], np.ones((n_scan, n_det)), np.nan)
    counts = np.where(kept, np.asarray(removed, np.int64), 0).astype(np.int64)
    return Cleaned(cleaned_mk, kept, responsivity, np.zeros(n_scan, np.int64), counts)
