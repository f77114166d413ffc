"""Fractions of discarded scans by data set and weather, and warnings about them.

Cleaning discards a scan if its template fit does not converge. Where responsivities are fitted to the atmosphere of
each scan, these are scans in which the atmosphere changes little: in the calmest weather, hence the best data, or when
the scan moves with the wind at about its speed. A survey that loses a fraction of its scans loses more than that
fraction of its information. Two points of a sweep with different fractions differ for that reason alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import Setup
from surveysim.survey.coadds import CoAdds, lost_scans

MOST_DISCARDED = 0.05  # largest fraction of discarded scans at which a score is trusted
MOST_APART = 0.02  # largest difference of the fractions at which two points are compared
WEATHER_GROUPS = 4  # quarters of the observations by their B2
REMEDY = 'Remedy: cleaning.responsivities = "observation" or "survey", longer scans, or cleaning by "pca"'
_ROUNDING = 1e-9  # rounding error of a difference of fractions

Shares = Mapping[str, float]  # by data set


@dataclass(frozen=True)
class Discards:
    """Fractions of discarded scans by data set, for all observations and for quarters of them.

    The noise-only sets discard the scans of the actual data. `by_weather` starts with the calmest quarter and is empty
    without an atmosphere. Each entry has its lowest and highest B2 (`b2_min_mk2`, `b2_max_mk2` [mK^2 rad^(2-b)]), its
    number of `observations`, and the fraction `discarded` by data set.
    """

    shares: dict[str, float]
    by_weather: list[dict[str, Any]]

    @property
    def warnings(self) -> list[str]:
        """One line for each data set that loses too many scans."""
        names = [name for name in listed_data_sets([self.shares]) if self.shares[name] > MOST_DISCARDED + _ROUNDING]
        return [f"{self._of(name)}; results are then for fewer scans than requested. {REMEDY}." for name in names]

    def _of(self, name: str) -> str:
        text = f"{name}: {percent(self.shares[name])} of the scans are discarded"
        if len(self.by_weather) < WEATHER_GROUPS:
            return text
        return f"{text}, {percent(self.by_weather[0]['discarded'][name])} in the calmest quarter of the observations"


def discards(setup: Setup, coadds: CoAdds) -> Discards:
    """Compute the fractions of discarded scans in the observations so far, at least one."""
    lost, b2 = lost_scans(setup.analysis, coadds), coadds.column("b2_mk2")
    order = np.zeros(0, int) if np.isnan(b2).any() else np.argsort(b2, kind="stable")
    parts = np.array_split(order, min(WEATHER_GROUPS, len(order))) if len(order) else []
    by_weather = [
        {
            "b2_min_mk2": float(b2[part].min()),
            "b2_max_mk2": float(b2[part].max()),
            "observations": len(part),
            "discarded": _shares(setup, lost[part]),
        }
        for part in parts
    ]
    return Discards(_shares(setup, lost), by_weather)


def _shares(setup: Setup, lost: np.ndarray) -> dict[str, float]:
    scans = len(lost) * setup.observing.scans.n_scans
    return dict(zip(setup.analysis.data_set_names, (lost.sum(axis=0) / scans).tolist(), strict=True))


def listed_data_sets(shares: Sequence[Shares]) -> list[str]:
    """List the data sets whose fractions deserve a column: the actual data, and sets that differ from it anywhere."""
    names = dict.fromkeys(name for item in shares for name in item)
    return [name for name in names if name == ACTUAL or any(item.get(name) != item.get(ACTUAL) for item in shares)]


def percent(share: float) -> str:
    """Format a fraction as ``18.4 %``."""
    return f"{100 * share:.1f} %"


# ---------------------------------------------------------------- points of a sweep


def competing(shares: np.ndarray) -> np.ndarray:
    """Return whether each point (n,) may have a probability of being the best, by its fraction of discarded scans.

    Such points lose at most `MOST_DISCARDED`, and at most `MOST_APART` more than the point that loses least.
    """
    return (shares <= MOST_DISCARDED + _ROUNDING) & (shares <= min(shares, default=0.0) + MOST_APART + _ROUNDING)


def why_withheld(share: float, least: float) -> str:
    """Explain why a point of a sweep has no probability of being the best."""
    if share > MOST_DISCARDED + _ROUNDING:
        return f"{percent(share)} of its scans are discarded, more than {100 * MOST_DISCARDED:g} %"
    if share > least + MOST_APART + _ROUNDING:
        return f"{percent(share)} of its scans are discarded, at another point {percent(least)}"
    return f"other points can't be compared with it (it loses {percent(share)} of its scans)"


def sweep_warnings(labels: Sequence[str], shares: Sequence[Shares], things: str = "points") -> list[str]:
    """Return one line for each data set with too many discarded scans at some points, or with too different fractions.

    Parameters
    ----------
    labels, shares
        Label, and fraction of discarded scans by data set, of each point.
    things
        Word for the points.
    """
    found = []
    for name in listed_data_sets(shares):
        known = [(item[name], label) for label, item in zip(labels, shares, strict=True) if name in item]
        if lines := [line for line in (_too_many(known, things), _too_different(known, things)) if line]:
            found.append(f"{name}: {'; '.join(lines)}. {REMEDY}.")
    return found


def _too_many(known: list[tuple[float, str]], things: str) -> str:
    wrong = [share for share, _ in known if share > MOST_DISCARDED + _ROUNDING]
    if not wrong:
        return ""
    points = f"{len(wrong)} of {len(known)} {things}"
    worst, label = max(known, key=_share)
    return f"more than {100 * MOST_DISCARDED:g} % of the scans are discarded at {points}, {percent(worst)} at {label}"


def _too_different(known: list[tuple[float, str]], things: str) -> str:
    (least, few), (most, many) = min(known, key=_share), max(known, key=_share)
    if most <= least + MOST_APART + _ROUNDING:
        return ""
    return (
        f"the share of discarded scans differs by more than {100 * MOST_APART:g} % between {things}, from "
        f"{percent(least)} at {few} to {percent(most)} at {many}, so that ratios of such {things} mislead"
    )


def _share(known: tuple[float, str]) -> float:
    return known[0]
