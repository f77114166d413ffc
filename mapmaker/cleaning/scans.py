"""What every cleaning algorithm shares: one observation taken scan by scan, and its result."""

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
    """One observation after cleaning."""

    data_mk: np.ndarray  # (n_det, n_samp), type of the input; 0 in discarded scans and outside scans
    kept: np.ndarray  # (n_scan,) bool; False: not converged, not finite, or a dead detector
    responsivity: np.ndarray  # (n_scan, n_det) c_i, fitted or given, 1 where none is used; nan where discarded
    iterations: np.ndarray  # (n_scan,) int64; 0 where none was made, all alike where all scans share one fit
    removed: np.ndarray  # (n_scan,) int64, templates or modes taken from each stream; 0 where discarded


class Fit(NamedTuple):
    """What was taken from one scan: c_i (n_det,), or None to discard it; iterations; number of templates."""

    responsivity: np.ndarray | None
    iterations: int = 0
    removed: int = 0


def clean_scans(data_mk: np.ndarray, scan_bounds: np.ndarray, subtract: Callable[[np.ndarray, int], Fit]) -> Cleaned:
    """Apply `subtract`, (block, scan number) -> Fit, in place to each scan, in float64 and with means removed.

    Other arguments, which fit each other, and result as for `mapmaker.cleaning.clean`.
    """
    n_det, n_scan = len(data_mk), len(scan_bounds)
    cleaned_mk = np.zeros_like(data_mk, order="C")
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
    n_det = len(data_mk)
    # One scan's room for all: large arrays are slow to come by.
    room = np.empty(n_det * int(np.diff(scan_bounds, axis=1).max(initial=0)))
    for s, (start, stop) in enumerate(scan_bounds):
        block = room[: n_det * (stop - start)].reshape(n_det, stop - start)
        block[:] = data_mk[:, start:stop]
        if not np.isfinite((block.min(), block.max())).all():
            continue
        block -= block.mean(axis=1, keepdims=True)
        yield s, block


def has_dead(block: np.ndarray) -> bool:
    """Whether a detector of the mean-removed scan (n_det, n_samp) has next to no power."""
    power = np.einsum("in,in->i", block, block)
    return bool(power.min() <= DEAD_POWER * power.mean())


Subtract = Callable[[np.ndarray, np.ndarray, "FocalPlane", Any], Cleaned]


def checks_streams(subtract: Subtract) -> Subtract:
    """A cleaning whose arguments are checked first, as `mapmaker.cleaning.clean` says."""

    @wraps(subtract)
    def checked(data_mk, scan_bounds, focal_plane: FocalPlane, options: Any) -> Cleaned:
        return subtract(*check_streams(data_mk, scan_bounds, focal_plane), focal_plane, options)

    return checked


def check_streams(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane
) -> tuple[np.ndarray, np.ndarray]:
    """Streams in float32 or float64 and bounds in int64; raises ValueError for those that do not fit each other."""
    data = reals("data_mk", data_mk, (len(focal_plane.x_rad), "n_samp"), finite=False)
    return data, bounds_of_scans(scan_bounds, data.shape[1])


def live_detectors(data_mk: np.ndarray, scan_bounds: np.ndarray) -> np.ndarray:
    """Detectors (n_det,) bool that are of use: finite, and not dead, in more than half of the scans.

    One dead detector is enough for most cleanings to discard a scan. Dead is one with next to no power about its mean.
    Raises ValueError for streams (n_det, n_samp) and scans (n_scan, 2) that do not fit each other.
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
