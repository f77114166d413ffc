"""Cleaning of one file: usable data, cleaning, tests of the cleaned streams, and weights."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mapmaker.cleaning import Cleaned, clean_in_order
from mapmaker.errors import ArgumentError, InsufficientDataError
from mapmaker.files import one_line
from mapmaker.pipeline.cleaned_tests import CleanedBlock, find_glitches, find_jumps, mean_square, white_noise
from mapmaker.pipeline.common_signal import compare_with_others, strangers
from mapmaker.pipeline.config import Config, FlagSection
from mapmaker.pipeline.dropped import (
    CLEANING,
    DETECTOR,
    DISCARDED,
    FILE,
    GLITCH,
    JUMP,
    MOST_LOST,
    NAMES,
    NO_SCAN,
    NOISY,
    QUIET,
    SAMPLES,
    SCAN,
    STRANGER,
    UNITS,
    Dropped,
    UnusableFileError,
)
from mapmaker.pipeline.places import Circles, Places, circles, half_beams
from mapmaker.pipeline.usable import Usable, in_scans, leave_out, mostly_lost, usable_data, without_bad_scans
from mapmaker.timestreams import Timestreams

_RMS_MK = 1e-8, 1e8  # of cleaned streams: beyond it they are hardly in mK


@dataclass(frozen=True)
class CleanedFile:
    """One file after cleaning.

    Attributes
    ----------
    name
    labels : (n_det,)
        Names of the detectors, or their numbers in the file.
    streams
        Streams of the detectors that are used, with lost samples filled; flags are all lost samples.
    cleaned_mk : (n_det, n_samp)
        Cleaned streams.
    bounds : (n_scan, 2)
        Scans that are used.
    used : (n_det, n_scan) bool
        Scans of each detector that are in the map.
    variance_mk2, white_mk : (n_det,)
        Mean square of the cleaned samples, and white noise a sample.
    found : (int, int)
        Detectors and scans of the file.
    dropped
    """

    name: str
    labels: np.ndarray
    streams: Timestreams
    cleaned_mk: np.ndarray
    bounds: np.ndarray
    used: np.ndarray
    variance_mk2: np.ndarray
    white_mk: np.ndarray
    found: tuple[int, int]
    dropped: tuple[Dropped, ...]


def detector_labels(streams: Timestreams) -> np.ndarray:
    """Names (n_det,) of the detectors, or their numbers in the file: detectors of several files are matched by them."""
    names = streams.focal_plane.names
    return np.arange(len(streams.data_mk)).astype(str) if names is None else names


def clean_file(name: str, streams: Timestreams, config: Config) -> CleanedFile:
    """Clean one file.

    Raises
    ------
    UnusableFileError
        For a file that nothing is left of.
    """
    labels = detector_labels(streams)
    values, counts = np.unique(labels, return_counts=True)
    if (counts > 1).any():
        raise UnusableFileError((Dropped(name, FILE, NAMES, detail=str(values[counts > 1][0])),))
    state = usable_data(name, streams, labels, config.flags)
    cleaned = _clean(streams, state, config)
    spared, places = circles(config.flags.spare, streams), half_beams(streams)
    glitches = np.zeros(streams.data_mk.shape, bool)
    for _ in range(config.flags.passes):
        after, new = _tested(cleaned, streams, state, spared=spared, places=places, flags=config.flags)
        if after is state:
            break
        glitches |= new
        state = without_bad_scans(after)
        del cleaned  # one copy less beside the next
        cleaned = _clean(streams, state, config)
    return _result(streams, state, cleaned, glitches)


def _clean(streams: Timestreams, state: Usable, config: Config) -> Cleaned:
    """Clean the live detectors; result and scans are those of `state`."""
    if not len(state.bounds) or not state.live.any():
        found = "no scan" if state.live.any() else "no detector"
        raise UnusableFileError((*state.dropped, Dropped(state.name, FILE, NO_SCAN, detail=f"{found} is left")))
    plane = streams.focal_plane.subset(state.live)
    try:
        steps = cleaning_steps(streams, config)
    except ArgumentError as error:  # a frequency beyond what the file has
        raise _uncleanable(state, error) from None
    try:
        return clean_in_order(steps, _filled(streams, state.live, state.bounds, state.lost), state.bounds, plane)
    except InsufficientDataError as error:
        raise _uncleanable(state, error) from None


def _filled(streams: Timestreams, rows: np.ndarray, bounds: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Copy of some detectors' streams, with their lost samples filled as by `mapmaker.fill_flagged`."""
    from mapmaker.kernels.lost_samples import fill_gaps

    data = streams.data_mk[rows]
    fill_gaps(data, bounds, lost[rows])
    return data


def cleaning_steps(streams: Timestreams, config: Config) -> list[tuple[str, Any]]:
    """Names and options of the cleaning steps; raises ValueError for a frequency beyond what the streams have."""
    rate_hz = 1 / float(np.median(np.diff(streams.time_s)))
    return [(step.algorithm, step.options(rate_hz)) for step in config.cleaning]


def _uncleanable(state: Usable, error: Exception) -> UnusableFileError:
    return UnusableFileError((*state.dropped, Dropped(state.name, FILE, CLEANING, detail=one_line(error))))


def _tested(
    cleaned: Cleaned, streams: Timestreams, state: Usable, *, spared: Circles, places: Places, flags: FlagSection
) -> tuple[Usable, np.ndarray]:
    """Test the cleaned streams of the live detectors; returns the state itself if nothing new is found, and glitches
    (n_det, n_samp).
    """
    rows, after, glitches = np.flatnonzero(state.live), state, np.zeros(state.lost.shape, bool)
    n_samp = len(streams.time_s)
    block = CleanedBlock(
        data_mk=cleaned.data_mk,
        lost=state.lost[rows],
        bounds=state.bounds[cleaned.kept],
        spared=lambda d: spared.hold(rows[d], n_samp),
        place=lambda d: places.of(rows[d]),
        n_place=places.geometry.n_x * places.geometry.n_y,
    )
    if "jumps" in flags.find:
        at = find_jumps(block, _window(streams, state.bounds, flags.jump_window), flags.jump_sigma)
        after = _without_jumps(at, after, rows, np.flatnonzero(cleaned.kept))
    if "glitches" in flags.find:
        glitches[rows] = find_glitches(replace(block, lost=after.lost[rows]), flags.glitch_sigma)
        if glitches.any():
            after = replace(after, lost=after.lost | glitches)
            after = leave_out(after, mostly_lost(after.lost, after.bounds, flags.max_lost), MOST_LOST)
    if "noise" in flags.find and after is state:
        after = _without_outlying_noise(cleaned, after, rows, flags.noise_ratio)
    if "common" in flags.find and after is state:
        after = _without_strangers(streams, after, rows)
    return after, glitches


def _window(streams: Timestreams, bounds: np.ndarray, window_s: float) -> int:
    """Samples before and after a jump: of a window, or of two beams where these are longer."""
    step_s = float(np.median(np.diff(streams.time_s)))
    crossings = []
    for start, stop in bounds:
        steps = np.diff(streams.dec_rad[start:stop]), np.diff(streams.ra_rad[start:stop])
        speed = np.median(np.hypot(steps[0], steps[1] * np.cos(streams.dec_rad[start + 1 : stop]))) / step_s
        crossings.append(streams.focal_plane.fwhm_rad / speed if speed > 0 else 0.0)
    return max(4, round(max(window_s, 2 * float(np.median(crossings))) / step_s))


def _without_jumps(at: dict[tuple[int, int], str], state: Usable, rows: np.ndarray, scans: np.ndarray) -> Usable:
    """Leave out detectors with jumps, which are given by the index of the row and of the scan."""
    if not at:
        return state
    details = {(int(rows[d]), int(scans[s])): text for (d, s), text in at.items()}
    bad = np.zeros(state.left_out.shape, bool)
    bad[tuple(np.array(list(details)).T)] = True
    return leave_out(state, bad, JUMP, details)


def _without_outlying_noise(cleaned: Cleaned, state: Usable, rows: np.ndarray, ratio: float) -> Usable:
    noise = white_noise(cleaned.data_mk, state.lost[rows], state.bounds[cleaned.kept])
    if not noise.any():
        return state
    middle, found = np.median(noise[noise > 0]), []
    for d in np.flatnonzero((noise > ratio * middle) | (noise < middle / ratio)):
        found.append((rows[d], NOISY if noise[d] > middle else QUIET, f"{noise[d] / middle:.3g} times the median"))
    return _without_detectors(state, found)


def _without_strangers(streams: Timestreams, state: Usable, rows: np.ndarray) -> Usable:
    correlations, gains = compare_with_others(streams.data_mk, state.lost, state.bounds, rows)
    found = np.flatnonzero(strangers(correlations, gains))
    detail = f"%.2g, median {np.median(correlations):.2g}"
    return _without_detectors(state, [(rows[d], STRANGER, f"correlation {detail % correlations[d]}") for d in found])


def _without_detectors(state: Usable, found: list[tuple[int, str, str]]) -> Usable:
    """Leave out detectors, each with its reason and detail; returns the state itself for none."""
    if not found:
        return state
    live, dropped = state.live.copy(), list(state.dropped)
    samples = int(np.diff(state.bounds, axis=1).sum())
    for d, reason, detail in found:
        live[d] = False
        dropped.append(Dropped(state.name, DETECTOR, reason, state.labels[d], samples=samples, detail=detail))
    return replace(state, live=live, dropped=tuple(dropped))


def _result(streams: Timestreams, state: Usable, cleaned: Cleaned, glitches: np.ndarray) -> CleanedFile:
    """Collect what is left of a file; raises UnusableFileError for no scan."""
    rows, kept, dropped = np.flatnonzero(state.live), cleaned.kept, list(state.dropped)
    lengths = np.diff(state.bounds, axis=1)[:, 0]
    inside = in_scans(state.bounds, streams.data_mk.shape[1])
    counts = glitches[:, inside].sum(axis=1)
    dropped += [
        Dropped(state.name, SAMPLES, GLITCH, state.labels[d], samples=int(counts[d])) for d in rows[counts[rows] > 0]
    ]
    dropped += [
        Dropped(state.name, SCAN, DISCARDED, "", int(state.numbers[s]), int(lengths[s]) * len(rows))
        for s in np.flatnonzero(~kept)
    ]
    if not kept.any():
        raise UnusableFileError((*dropped, Dropped(state.name, FILE, NO_SCAN, detail="cleaning discarded all scans")))
    lost, bounds = state.lost[rows], state.bounds[kept]
    variance = mean_square(cleaned.data_mk, lost, bounds)
    rms = float(np.sqrt(np.median(variance)))
    if not _RMS_MK[0] <= rms <= _RMS_MK[1]:
        raise UnusableFileError((*dropped, Dropped(state.name, FILE, UNITS, detail=f"{rms:.2g} mK")))
    filled = _filled(streams, rows, bounds, state.lost)
    some = replace(streams, data_mk=filled, focal_plane=streams.focal_plane.subset(rows), flags=lost)
    return CleanedFile(
        name=state.name,
        labels=state.labels[rows],
        streams=some,
        cleaned_mk=cleaned.data_mk,
        bounds=bounds,
        used=~state.left_out[rows][:, kept],
        variance_mk2=variance,
        white_mk=white_noise(cleaned.data_mk, lost, bounds),
        found=(len(state.labels), len(streams.scan_bounds)),
        dropped=tuple(dropped),
    )
