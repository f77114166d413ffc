"""Findings of the surveys of all ingredients beside the paper, with paired differences to one layer."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from surveysim.paper.explain.findings import Finding, bootstrapped
from surveysim.paper.explain.values import Values
from surveysim.report.explanation import EXPLAINS, HELPS, WORSENS

SIGMAS, SHARE = 2.0, 0.2  # agreement with the paper: within so many errors, or so large a part of its value
NOTHING = ""  # no verdict


@dataclass(frozen=True)
class Entry:
    """A finding of the survey of one ingredient.

    Attributes
    ----------
    value, error
        Its value, with the bootstrap error over the observations.
    difference, difference_error
        Its paired difference to one layer; 0 for one layer itself.
    verdict
        "explains" for agreement with the paper that one layer lacks; "helps" and "worsens" for a significant change
        towards the paper or away from it; "" otherwise and without a published value.
    """

    value: float
    error: float
    difference: float
    difference_error: float
    verdict: str


def compared(finding: Finding, surveys: Sequence[Values]) -> list[Entry]:
    """Compare a finding of some surveys, the first of them with one layer, with that one and with the paper."""
    drawn = [bootstrapped(finding, values) for values in surveys]
    base = drawn[0]
    entries = []
    for samples in drawn:
        value, difference = float(samples[0]), float(samples[0] - base[0])
        error, moved = float(samples[1:].std()), float((samples - base)[1:].std())
        verdict = _verdict(finding, value, error, base=(float(base[0]), float(base[1:].std())), moved=moved)
        entries.append(Entry(value, error, difference, moved, verdict))
    return entries


def agrees(finding: Finding, value: float, error: float) -> bool:
    """Return whether a value is within two errors, or a fifth, of the paper's."""
    known = [item for item in (error, finding.paper_error) if math.isfinite(item)]
    return abs(value - finding.paper) <= max(SIGMAS * math.hypot(*known), SHARE * abs(finding.paper))


def _verdict(finding: Finding, value: float, error: float, *, base: tuple[float, float], moved: float) -> str:
    """Judge a value; `base` is that of one layer with its error, `moved` the error of the difference."""
    if not math.isfinite(finding.paper) or not abs(value - base[0]) > SIGMAS * moved:
        return NOTHING
    if agrees(finding, value, error) and not agrees(finding, *base):
        return EXPLAINS
    return HELPS if abs(value - finding.paper) < abs(base[0] - finding.paper) else WORSENS
