"""Findings of the surveys of all ingredients beside the paper, with paired differences to one layer."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from surveysim.paper.explain.findings import Finding, bootstrapped
from surveysim.paper.explain.ingredients import ONE_LAYER
from surveysim.paper.explain.values import Values

SIGMAS, SHARE = 2.0, 0.2  # agreement with the paper: within so many errors, or so large a part of its value
EXPLAINS, HELPS, WORSENS, NOTHING = "explains", "helps", "worsens", ""


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


def compared(findings: tuple[Finding, ...], surveys: Mapping[str, Values]) -> dict[tuple[str, str], Entry]:
    """Compare all surveys with one layer and with the paper.

    Parameters
    ----------
    findings
        Findings of the paper.
    surveys
        Values of the surveys by ingredient, with `ONE_LAYER`.

    Returns
    -------
    Entries by names of finding and ingredient.
    """
    entries = {}
    for finding in findings:
        drawn = {name: bootstrapped(finding, values) for name, values in surveys.items()}
        base = drawn[ONE_LAYER]
        for name, samples in drawn.items():
            value, difference = float(samples[0]), float(samples[0] - base[0])
            error, difference_error = float(samples[1:].std()), float((samples - base)[1:].std())
            verdict = _verdict(finding, value, error, base=(float(base[0]), float(base[1:].std())), moved=difference_error)
            entries[finding.name, name] = Entry(value, error, difference, difference_error, verdict)
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
