"""Findings of the surveys of all ingredients beside the paper, with paired differences to one layer."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surveysim.paper.explain.findings import Finding, bootstrapped
from surveysim.paper.explain.values import Values
from surveysim.report.explanation import EXPLAINS, HELPS, WORSENS

SIGMAS, SHARE = 2.0, 0.2  # agreement with the paper: within so many errors, or so large a part of its value
CERTAIN, LEAST = 3.0, 0.1  # a change that counts: more than so many errors, and such a part of the gap to the paper
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
        "explains" for agreement with the paper that one layer lacks; "helps" and "worsens" for a change, by more than
        `CERTAIN` errors and `LEAST` of the gap, towards the paper or away from it; "" otherwise, and where both agree
        with the paper.
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
        error, moved = float(np.nanstd(samples[1:])), float(np.nanstd((samples - base)[1:]))
        verdict = _verdict(finding, value, error, base=(float(base[0]), float(base[1:].std())), moved=moved)
        entries.append(Entry(value, error, difference, moved, verdict))
    return entries


def agrees(finding: Finding, value: float, error: float) -> bool:
    """Return whether a value is within two errors of the paper's, or a fifth of it where the paper gives no error."""
    if math.isfinite(finding.paper_error):
        return finding.gap(value) <= SIGMAS * math.hypot(error, finding.paper_error)
    nearest = min(max(value, finding.paper[0]), finding.paper[1])
    return finding.gap(value) <= max(SIGMAS * error, SHARE * abs(nearest))


def _verdict(finding: Finding, value: float, error: float, *, base: tuple[float, float], moved: float) -> str:
    """Judge a value; `base` is that of one layer with its error, `moved` the error of the difference."""
    change, gap = abs(value - base[0]), finding.gap(base[0])
    before, after = agrees(finding, *base), agrees(finding, value, error)
    if not (change > CERTAIN * moved and change > LEAST * gap) or (before and after):
        return NOTHING
    if after:
        return EXPLAINS
    return HELPS if finding.gap(value) < gap else WORSENS
