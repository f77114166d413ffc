"""Shares of discarded scans, by data set and by weather, and the warnings that they call for.

Cleaning discards a scan whose templates it can't fit. Where responsivities are fitted on the atmosphere of the scan,
these are scans that see it change little: in the calmest weather, hence the best data, or while they go along with the
wind at about its speed. A survey that loses a share of them loses more than that share of its information, and two
points of a sweep that lose different shares differ for that reason alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import Setup
from surveysim.survey.coadds import CoAdds, lost_scans

MOST_DISCARDED = 0.05  # share of the scans from which a score is not to be trusted
MOST_APART = 0.02  # difference of these shares from which two points are not to be compared
WEATHER_GROUPS = 4  # quarters of the observations by their B2
REMEDY = 'Remedy: cleaning.responsivities = "observation" or "survey", longer scans, or cleaning by "pca"'
_ROUNDING = 1e-9  # of a difference of shares

Shares = Mapping[str, float]  # by data set


@dataclass(frozen=True)
class Discards:
    """Share of discarded scans by data set, of all observations and of quarters of them.

    The simulated sets lose the scans of the actual data. `by_weather` has the calmest quarter first, and is empty
    without an atmosphere: each has its lowest and highest B2 (`b2_min_mk2`, `b2_max_mk2` [mK^2 rad^(2-b)]), how many
    `observations` it has, and the share `discarded` by data set.
    """

    shares: dict[str, float]
    by_weather: list[dict[str, Any]]

    @property
    def warnings(self) -> list[str]:
        """A line for each data set that loses too many scans."""
        names = [name for name in telling([self.shares]) if self.shares[name] > MOST_DISCARDED + _ROUNDING]
        return [f"{self._of(name)}; such a survey is not the one that was asked for. {REMEDY}." for name in names]

    def _of(self, name: str) -> str:
        text = f"{name}: {percent(self.shares[name])} of the scans are discarded"
        if len(self.by_weather) < WEATHER_GROUPS:
            return text
        return f"{text}, {percent(self.by_weather[0]['discarded'][name])} in the calmest quarter of the observations"


def discards(setup: Setup, coadds: CoAdds) -> Discards:
    """Shares of discarded scans in the observations so far, of which there is at least one."""
    lost, b2 = lost_scans(setup, coadds), coadds.column("b2_mk2")
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


def telling(shares: Sequence[Shares]) -> list[str]:
    """Data sets whose shares are worth a column: the actual one, and those that differ from it anywhere."""
    names = dict.fromkeys(name for item in shares for name in item)
    return [name for name in names if name == ACTUAL or any(item.get(name) != item.get(ACTUAL) for item in shares)]


def percent(share: float) -> str:
    """``18.4 %``."""
    return f"{100 * share:.1f} %"


# ---------------------------------------------------------------- points of a sweep


def competing(shares: np.ndarray) -> np.ndarray:
    """Return whether each point (n,) may be called the best with a probability, by its share of discarded scans.

    Those that lose no more than `MOST_DISCARDED`, and no more than `MOST_APART` above the one that loses least.
    """
    return (shares <= MOST_DISCARDED + _ROUNDING) & (shares <= min(shares, default=0.0) + MOST_APART + _ROUNDING)


def why_withheld(share: float, least: float) -> str:
    """Why a point of a sweep that loses a share of its scans has no probability of being the best."""
    if share > MOST_DISCARDED + _ROUNDING:
        return f"{percent(share)} of its scans are discarded, more than {100 * MOST_DISCARDED:g} %"
    if share > least + MOST_APART + _ROUNDING:
        return f"{percent(share)} of its scans are discarded, at another point {percent(least)}"
    return f"other points can't be compared with it (it loses {percent(share)} of its scans)"


def sweep_warnings(labels: Sequence[str], shares: Sequence[Shares]) -> list[str]:
    """A line for each data set that loses too many scans at some points, or shares that differ too much between points.

    `labels` and `shares` are those of the points.
    """
    found = []
    for name in telling(shares):
        known = [(item[name], label) for label, item in zip(labels, shares, strict=True) if name in item]
        if lines := [line for line in (_too_many(known), _too_different(known)) if line]:
            found.append(f"{name}: {'; '.join(lines)}. {REMEDY}.")
    return found


def _too_many(known: list[tuple[float, str]]) -> str:
    wrong = [share for share, _ in known if share > MOST_DISCARDED + _ROUNDING]
    if not wrong:
        return ""
    points = f"{len(wrong)} of {len(known)} points"
    worst, label = max(known, key=_share)
    return f"more than {100 * MOST_DISCARDED:g} % of the scans are discarded at {points}, {percent(worst)} at {label}"


def _too_different(known: list[tuple[float, str]]) -> str:
    (least, few), (most, many) = min(known, key=_share), max(known, key=_share)
    if most <= least + MOST_APART + _ROUNDING:
        return ""
    return (
        f"the share of discarded scans differs by more than {100 * MOST_APART:g} % between points, from "
        f"{percent(least)} at {few} to {percent(most)} at {many}, so that ratios of such points mislead"
    )


def _share(known: tuple[float, str]) -> float:
    return known[0]
