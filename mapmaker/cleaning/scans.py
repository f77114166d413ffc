"""Scan-by-scan cleaning of one observation, common to all algorithms, and its result."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mapmaker.kernels import DEAD_POWER
from mapmaker.validation import bounds_of_scans, reals

if TYPE_CHECKING:
    from mapmaker.timestreams import FocalPlane


@dataclass(frozen=True)
class Cleaned:
    """One observation after cleaning.

    Attributes
    ----------
    data_mk : (n_det, n_samp)
        In the type of the input; 0 in discarded scans and outside scans.
    kept : (n_scan,)
        Flags; False for scans that did not converge, are not finite or have a dead detector.
    responsivity : (n_scan, n_det)
        c_i, fitted or given; 1 where none is used, NaN in discarded scans.
    iterations : (n_scan,)
        0 where there are none, equal where all scans share one fit.
    removed : (n_scan,)
        Templates or modes removed from each stream; 0 in discarded scans.
    """

    data_mk: np.ndarray
    kept: np.ndarray
    responsivity: np.ndarray
    iterations: np.ndarray
    removed: np.ndarray


class Fit(NamedTuple):
    """Result of one scan: c_i (n_det,), or None to discard it; iterations; number of removed templates."""

    responsivity: np.ndarray | None
    iterations: int = 0
    removed: int = 0


def clean_scans(data_mk: np.ndarray, scan_bounds: np.ndarray, subtract: Callable[[np.ndarray, int], Fit]) -> Cleaned:
    """Apply `subtract` in place to each scan, in float64 and with means removed.

    Parameters
    ----------
    data_mk, scan_bounds
        Checked arguments of `mapmaker.cleaning.clean`.
    subtract
        Function of a block (n_det, n) and the number of the scan.

    Returns
    -------
    Cleaned
    """
    n_det, n_scan = len(data_mk), len(scan_bounds)
    cleaned_mk = np.zeros(data_mk.shape, data_mk.dtype)
    responsivity = np.full((n_scan, n_det), np.nan)
    iterations, removed = np.zeros((2, n_scan), dtype=np.int64)
    for s, block in finite_scans(data_mk, scan_bounds):
        fit = subtract(block, s)
        iterations[s] = fit.iterations
        if fit.responsivity is not None:
            responsivity[s], removed[s] = fit.responsivity, fit.removed
            start, stop = scan_bounds[s]
            cleaned_mk[:, start:stop] = block
    kept = np.isfinite(responsivity).all(axis=1)
    return Cleaned(cleaned_mk, kept, responsivity, iterations, removed)


def finite_scans(data_mk: np.ndarray, scan_bounds: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Number and block (n_det, n) of each scan whose values are finite, in float64 and with means removed.

    All blocks share their memory: a block is good until the next one is asked for.
    """
    from mapmaker.kernels.cleaning import remove_means

    n_det = len(data_mk)
    # One buffer for all scans: the allocation of large arrays is slow.
    room = np.empty(n_det * int(np.diff(scan_bounds, axis=1).max(initial=0)))
    for s, (start, stop) in enumerate(scan_bounds):
        block = room[: n_det * (stop - start)].reshape(n_det, stop - start)
        if remove_means(data_mk, start, stop, block):
            yield s, block


def has_dead(block: np.ndarray) -> bool:
    """Tell whether a detector of the mean-removed scan (n_det, n_samp) has next to no power."""
    return is_dead(np.einsum("in,in->i", block, block))


def is_dead(power: np.ndarray) -> bool:
    """Tell whether one of some detectors (n_det,) has next to no power."""
    return bool(power.min() <= DEAD_POWER * power.mean())


Subtract = Callable[[np.ndarray, np.ndarray, "FocalPlane", Any], Cleaned]


def checks_streams(subtract: Subtract) -> Subtract:
    """Decorate a cleaning algorithm so that its arguments are checked first, as for `mapmaker.cleaning.clean`."""

    @wraps(subtract)
    def checked(data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: Any) -> Cleaned:
        return subtract(*check_streams(data_mk, scan_bounds, focal_plane), focal_plane, options)

    return checked


def check_streams(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane
) -> tuple[np.ndarray, np.ndarray]:
    """Convert streams to float32 or float64 and bounds to int64; raises ValueError for those that do not match."""
    data = reals("data_mk", data_mk, (len(focal_plane.x_rad), "n_samp"), finite=False)
    return data, bounds_of_scans(scan_bounds, data.shape[1])


def live_detectors(data_mk: np.ndarray, scan_bounds: np.ndarray) -> np.ndarray:
    """Find the detectors that are finite and not dead in more than half of the scans.

    A dead detector has next to no power about its mean; one is enough for most algorithms to discard a scan.

    Parameters
    ----------
    data_mk : (n_det, n_samp)
    scan_bounds : (n_scan, 2)

    Returns
    -------
    (n_det,) bool array

    Raises
    ------
    ValueError
        For arrays that do not match.
    """
    data = reals("data_mk", data_mk, ("n_det", "n_samp"), finite=False)
    bounds = bounds_of_scans(scan_bounds, data.shape[1])
    lively = np.zeros(len(data), int)
    for start, stop in bounds:
        block = data[:, start:stop].astype(float)
        finite = np.isfinite(block).all(axis=1)
        power = np.var(block[finite], axis=1)
        lively[finite] += power > DEAD_POWER * power.mean() if len(power) else 0
    return lively > len(bounds) / 2
