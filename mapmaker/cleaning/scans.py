"""What every cleaning algorithm shares: one observation taken scan by scan, and its result."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mapmaker.kernels.cleaning import DEAD_POWER

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


def check_streams(data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane) -> None:
    """Raise ValueError for shapes, types or bounds that do not fit each other."""
    if data_mk.ndim != 2 or data_mk.dtype not in (np.float32, np.float64):
        raise ValueError(f"expected (n_det, n_samp) float32 or float64, got {data_mk.shape} {data_mk.dtype}")
    n_det, n_samp = data_mk.shape
    if len(focal_plane.x_rad) != n_det:
        raise ValueError(f"data have {n_det} detectors, the focal plane has {len(focal_plane.x_rad)}")
    bounds = np.asarray(scan_bounds)
    if bounds.ndim != 2 or bounds.shape[1] != 2:
        raise ValueError(f"expected scan bounds (n_scan, 2), got {bounds.shape}")
    wrong = (bounds[:, 0] < 0) | (bounds[:, 0] >= bounds[:, 1]) | (bounds[:, 1] > n_samp)
    if wrong.any():
        raise ValueError(f"scan {bounds[wrong][0].tolist()} is empty or outside the {n_samp} samples")
