"""Data of one file that cleaning can use: scans that move, samples that are finite, detectors that are alive."""

from dataclasses import dataclass, replace

import numpy as np

from mapmaker.geometry import MapGeometry, mean_direction, plane_offsets
from mapmaker.kernels import DEAD_POWER
from mapmaker.pipeline.config import FlagSection
from mapmaker.pipeline.dropped import (
    ALL_LOST,
    CONSTANT,
    DETECTOR,
    FLAGGED,
    MOST_DETECTORS,
    MOST_LOST,
    MOST_SCANS,
    NOT_FINITE,
    PART,
    SAMPLES,
    SCAN,
    SHORT,
    STILL,
    Dropped,
)
from mapmaker.timestreams import Timestreams


@dataclass(frozen=True)
class Usable:
    """State of one file: what is left of it.

    Attributes
    ----------
    name
        Name of the file.
    labels : (n_det,)
        Names of the detectors, or their numbers in the file.
    bounds : (n_scan, 2)
    numbers : (n_scan,)
        Numbers of the scans in the file.
    live : (n_det,) bool
    lost : (n_det, n_samp) bool
        Samples that are lost, also those of whole scans of a detector.
    left_out : (n_det, n_scan) bool
        Scans that a detector is left out of.
    dropped
    """

    name: str
    labels: np.ndarray
    bounds: np.ndarray
    numbers: np.ndarray
    live: np.ndarray
    lost: np.ndarray
    left_out: np.ndarray
    dropped: tuple[Dropped, ...]


def usable_data(name: str, streams: Timestreams, labels: np.ndarray, flags: FlagSection) -> Usable:
    """Find what cleaning can use of a file."""
    bounds, numbers, dropped = _moving_scans(name, streams, flags)
    inside = in_scans(bounds, streams.data_mk.shape[1])
    not_finite = ~np.isfinite(streams.data_mk)
    flagged = np.zeros_like(not_finite) if streams.flags is None else streams.flags
    lost = not_finite | flagged
    gone = lost[:, inside].all(axis=1) if inside.any() else np.zeros(len(lost), bool)
    dropped += [Dropped(name, DETECTOR, ALL_LOST, labels[d], samples=int(inside.sum())) for d in np.flatnonzero(gone)]
    for reason, of_reason in ((FLAGGED, flagged), (NOT_FINITE, not_finite & ~flagged)):
        counts = np.where(gone, 0, of_reason[:, inside].sum(axis=1))
        dropped += [
            Dropped(name, SAMPLES, reason, labels[d], samples=int(counts[d])) for d in np.flatnonzero(counts > 0)
        ]
    shape = (len(lost), len(bounds))
    state = Usable(name, labels, bounds, numbers, ~gone, lost, np.zeros(shape, bool), tuple(dropped))
    for reason, bad in (
        (MOST_LOST, mostly_lost(lost, bounds, flags.max_lost)),
        (CONSTANT, _constant(streams.data_mk, lost, bounds)),
    ):
        state = leave_out(state, bad, reason)
    return without_bad_scans(state)


def in_scans(bounds: np.ndarray, n_samp: int) -> np.ndarray:
    """Flags (n_samp,) of the samples within scans."""
    inside = np.zeros(n_samp, bool)
    for start, stop in bounds:
        inside[start:stop] = True
    return inside


def _moving_scans(name: str, streams: Timestreams, flags: FlagSection) -> tuple[np.ndarray, np.ndarray, list[Dropped]]:
    least = streams.focal_plane.fwhm_rad if flags.min_motion is None else flags.min_motion
    bounds, dropped = streams.scan_bounds, []
    numbers, good = streams.scan[bounds[:, 0]].astype(np.int64), np.ones(len(bounds), bool)
    step = np.median(np.diff(streams.time_s)) if len(streams.time_s) > 1 else 0.0
    for s, (start, stop) in enumerate(bounds):
        duration = streams.time_s[stop - 1] - streams.time_s[start] + step
        motion = _motion(streams.ra_rad[start:stop], streams.dec_rad[start:stop])
        short = duration < flags.min_duration * (1 - 1e-9) or stop - start < 4
        if short or motion < least:
            detail = f"{duration:.3g} s" if short else f"{np.degrees(motion) * 3600:.3g} arcsec"
            samples = int((stop - start) * len(streams.data_mk))
            dropped.append(Dropped(name, SCAN, SHORT if short else STILL, "", int(numbers[s]), samples, detail))
            good[s] = False
    return bounds[good], numbers[good], dropped


def _motion(ra_rad: np.ndarray, dec_rad: np.ndarray) -> float:
    """Extent of a track [rad]: the diagonal of the box that holds it."""
    centre = mean_direction(ra_rad, dec_rad)
    offsets = plane_offsets(MapGeometry(*centre, 1e-6, 1, 1), ra_rad, dec_rad)
    return float(np.hypot(*(np.nanmax(item) - np.nanmin(item) for item in offsets)))


def mostly_lost(lost: np.ndarray, bounds: np.ndarray, most: float) -> np.ndarray:
    """Flags (n_det, n_scan) of scans that a detector has lost more than a fraction of."""
    shares = [lost[:, start:stop].mean(axis=1) for start, stop in bounds]
    return most < np.array(shares).reshape(len(bounds), len(lost)).T


def _constant(data_mk: np.ndarray, lost: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Flags (n_det, n_scan) of scans in which a detector has next to no power about its mean."""
    found = np.zeros((len(data_mk), len(bounds)), bool)
    for s, (start, stop) in enumerate(bounds):
        block = data_mk[:, start:stop].astype(float)
        good = ~lost[:, start:stop]
        count = np.maximum(1, good.sum(axis=1))
        centre = np.where(good, block, 0).sum(axis=1) / count
        power = np.where(good, block - centre[:, None], 0.0)
        power = np.einsum("in,in->i", power, power) / count
        found[:, s] = good.any(axis=1) & (power <= DEAD_POWER * power.mean())
    return found


def leave_out(state: Usable, bad: np.ndarray, reason: str, details: dict[tuple[int, int], str] | None = None) -> Usable:
    """Leave detectors out of scans (n_det, n_scan), and out of all where they are left out of more than half.

    Parameters
    ----------
    state
    bad
    reason
    details
        Values that were found, by detector and scan.
    """
    new = bad & ~state.left_out & state.live[:, None]
    left_out = state.left_out | new
    half, lengths = len(state.bounds) / 2, np.diff(state.bounds, axis=1)[:, 0]
    mostly = new.any(axis=1) & (left_out.sum(axis=1) > half)
    lost, dropped = state.lost.copy(), list(state.dropped)
    for d, s in np.argwhere(new):
        lost[d, slice(*state.bounds[s])] = True
        if not mostly[d]:
            detail, samples = (details or {}).get((int(d), int(s)), ""), int(lengths[s])
            dropped.append(Dropped(state.name, PART, reason, state.labels[d], int(state.numbers[s]), samples, detail))
    for d in np.flatnonzero(mostly):
        why = reason if new[d].sum() > half else MOST_SCANS
        samples = int(lengths[~state.left_out[d]].sum())
        share = f"{left_out[d].sum()} of {len(lengths)} scans"
        dropped.append(Dropped(state.name, DETECTOR, why, state.labels[d], samples=samples, detail=share))
    return replace(state, live=state.live & ~mostly, lost=lost, left_out=left_out, dropped=tuple(dropped))


def without_bad_scans(state: Usable) -> Usable:
    """Drop the scans that more than half of the live detectors are left out of."""
    bad = state.left_out[state.live].sum(axis=0) > state.live.sum() / 2
    if not bad.any():
        return state
    dropped = list(state.dropped)
    for s in np.flatnonzero(bad):
        count = int((~state.left_out[state.live, s]).sum())
        samples = count * int(np.diff(state.bounds[s])[0])
        detail = f"{count} of {state.live.sum()} detectors left"
        dropped.append(Dropped(state.name, SCAN, MOST_DETECTORS, "", int(state.numbers[s]), samples, detail))
    return replace(
        state,
        bounds=state.bounds[~bad],
        numbers=state.numbers[~bad],
        left_out=state.left_out[:, ~bad],
        dropped=tuple(dropped),
    )
