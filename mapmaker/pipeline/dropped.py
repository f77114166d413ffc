"""Data that are left out of maps, each with its reason."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmaker.errors import InsufficientDataError

FILE, SCAN, DETECTOR, PART, SAMPLES = "file", "scan", "detector", "detector in scan", "samples"

# Reasons, in the order in which they are looked for.
UNREADABLE = "unreadable"
NAMES = "detector names are not unique"
NO_SCAN = "no usable scan"
UNITS = "noise out of range"
CLEANING = "cleaning impossible"
SHORT = "too short"
STILL = "does not move"
FLAGGED = "flagged in the file"
NOT_FINITE = "not a finite number"
ALL_LOST = "no finite sample"
CONSTANT = "constant"
MOST_LOST = "too many lost samples"
MOST_DETECTORS = "most detectors lost"
JUMP = "jump"
GLITCH = "glitch"
NOISY = "noisy"
QUIET = "too little noise"
STRANGER = "without the common signal"
MOST_SCANS = "left out of most scans"
DISCARDED = "discarded by cleaning"
OFF_MAP = "off the map"

EXPLANATIONS = {
    UNREADABLE: "the file cannot be read, or has other content than time-streams",
    NAMES: "two detectors of the file have one name",
    NO_SCAN: "nothing is left of the file",
    UNITS: "the cleaned streams have an rms below 1e-8 mK or above 1e8 mK, as in other units",
    CLEANING: "too few detectors are left for the cleaning, or for the noise of the map-maker",
    SHORT: "the scan is shorter than flags.min_duration",
    STILL: "the boresight moves by less than flags.min_motion",
    FLAGGED: "the file has flags of lost samples",
    NOT_FINITE: "NaN or infinity",
    ALL_LOST: "all samples within scans are flagged, NaN or infinity",
    CONSTANT: "the detector is dead, or stuck at one value",
    MOST_LOST: "more than flags.max_lost of the samples are lost",
    MOST_DETECTORS: "more than half of the detectors are left out of the scan",
    JUMP: "a step above flags.jump_sigma in the cleaned streams",
    GLITCH: "a sample above flags.glitch_sigma in the cleaned streams, with its neighbours",
    NOISY: "white noise above the median times flags.noise_ratio",
    QUIET: "white noise below the median over flags.noise_ratio: the detector may be disconnected",
    STRANGER: "the other detectors have a signal in common, which this one does not follow: it may read noise alone",
    MOST_SCANS: "the detector is left out of more than half of the scans",
    DISCARDED: "the cleaning did not converge, or met a dead detector",
    OFF_MAP: "the detector looks beyond the edge of the map",
}


@dataclass(frozen=True)
class Dropped:
    """Something that is left out of the map.

    Attributes
    ----------
    file
    what
        "file", "scan", "detector", "detector in scan" or "samples".
    reason
        A key of `EXPLANATIONS`.
    detector
        Name, or number in the file; empty for all.
    scan
        Number of the scan in the file; -1 for all.
    samples
        Number of samples within scans that are lost by this.
    detail
        Value that was found, or the error.
    """

    file: str
    what: str
    reason: str
    detector: str = ""
    scan: int = -1
    samples: int = 0
    detail: str = ""


class UnusableFileError(InsufficientDataError):
    """A file that nothing is left of; `dropped` has the reason, and what was left out before."""

    def __init__(self, dropped: tuple[Dropped, ...]) -> None:
        super().__init__(f"{dropped[-1].file}: {dropped[-1].reason} ({dropped[-1].detail})")
        self.dropped = dropped


def dropped_columns(items: Sequence[Dropped]) -> dict[str, np.ndarray]:
    """Return the columns of dropped.ecsv."""
    kinds = {"file": str, "what": str, "reason": str, "detector": str, "scan": int, "samples": int, "detail": str}
    return {name: np.array([getattr(item, name) for item in items], kind) for name, kind in kinds.items()}
