"""Scores of finished runs beside each other, with paired errors where their random numbers are common."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.studies.compare.differences import differences
from surveysim.studies.compare.finished_run import FinishedRun
from surveysim.studies.sweep.comparison import (
    SIGMA_A,
    Compared,
    Comparison,
    compare,
    compared_quantity,
    of_one_kind,
    run_estimates,
)
from surveysim.studies.sweep.point_store import PointResult

if TYPE_CHECKING:
    from astropy.table import QTable

_DRAWS_SEED = 0  # for probabilities of being the best


@dataclass(frozen=True)
class RunComparison:
    """Finished runs beside each other; ratios are to the first.

    Attributes
    ----------
    differences
        Settings that differ: text of each run's value by key.
    quantities
        Comparisons by data set and key of the quantity, such as "flat_band_power.sigma".
    groups
        Numbers of runs whose random numbers are common: their ratios have paired errors. Other ratios have errors of
        independent runs.
    plain
        Whether runs that have a forecast are quoted without it, as one of their group has none.
    """

    runs: tuple[FinishedRun, ...]
    differences: dict[str, list[str]]
    quantities: dict[tuple[str, str], Comparison]
    groups: tuple[tuple[int, ...], ...]
    plain: bool

    def paired(self, number: int) -> bool:
        """Return whether the ratio of a run to the first has a paired error."""
        return any(0 in group and number in group for group in self.groups)

    def unpaired(self, number: int) -> str:
        """Return the reason why the ratio of a run to the first has no paired error; empty if it has one."""
        first, run = self.runs[0], self.runs[number]
        if self.paired(number):
            return ""
        if run.without:
            return run.without
        if first.without:
            return f"{first.label}: {first.without}"
        if first.summary["seed"] != run.summary["seed"]:
            return f"seeds {first.summary['seed']} and {run.summary['seed']}"
        return f"versions {first.summary['surveysim']} and {run.summary['surveysim']}, whose random numbers may differ"

    def table(self) -> "QTable":
        """Return the scores as tables/compare.ecsv has them, a row for each quantity and run."""
        from surveysim.studies.compare.summary import comparison_summary
        from surveysim.studies.compare.tables import score_rows

        return score_rows(comparison_summary(self)["compared"]).quantities()

    def __repr__(self) -> str:
        """Number of runs above the table of their scores."""
        from surveysim.studies.compare.summary import comparison_summary
        from surveysim.studies.compare.tables import score_rows

        table = score_rows(comparison_summary(self)["compared"])
        return f"RunComparison of {len(self.runs)} runs\n{table.text()}"


def compare_finished(runs: Sequence[FinishedRun]) -> RunComparison:
    """Compare finished runs with the first of them."""
    groups = _groups(runs)
    results = [run.result for run in runs]
    plain = False
    for group in groups:
        stored = [results[number] for number in group]
        if None in stored:
            continue
        for number, item in zip(group, of_one_kind(tuple(stored)), strict=True):
            plain |= item is not results[number]
            results[number] = item
    names = {name: None for run in runs for name in run.summary["scores"]}
    found = {}
    for name in names:
        for key in _keys(results, name):
            comparison = _comparison(runs, results, groups, name, key)
            if np.isfinite(comparison.value).sum() > 1:
                found[name, key] = comparison
    told = differences([run.scene for run in runs], [run.settings for run in runs])
    return RunComparison(tuple(runs), told, found, groups, plain)


def _groups(runs: Sequence[FinishedRun]) -> tuple[tuple[int, ...], ...]:
    """Numbers of runs with one seed and version; runs without scores.npz stand alone."""
    groups: dict[object, list[int]] = {}
    for number, run in enumerate(runs):
        groups.setdefault(number if run.origin is None else run.origin, []).append(number)
    return tuple(map(tuple, groups.values()))


def _keys(results: Sequence[PointResult | None], name: str) -> list[str]:
    """Keys of the quantities of a data set: all of the actual data, sigma(A) of others."""
    if name != ACTUAL:
        return [SIGMA_KEY]
    return list(dict.fromkeys([SIGMA_KEY, *(key for item in results if item for key in item.metrics.get(name, {}))]))


def _comparison(
    runs: Sequence[FinishedRun],
    results: Sequence[PointResult | None],
    groups: Sequence[tuple[int, ...]],
    name: str,
    key: str,
) -> Comparison:
    value, relative = np.full((2, len(runs)), np.nan)
    columns = []
    for group in groups:
        numbers = list(group)
        stored = [results[number] for number in numbers]
        if None in stored:
            value[numbers], relative[numbers] = _from_summary(runs[group[0]], name, key)
            rows = relative[numbers][:, None]
        else:
            value[numbers], relative[numbers], rows = run_estimates(stored, name, key)
        own = np.zeros((len(runs), rows.shape[1]))
        own[numbers] = rows
        columns.append(own)
    shares = np.array([run.discarded.get(name, 0.0) for run in runs])
    rng = np.random.default_rng(_DRAWS_SEED)
    quantity = _quantity(results, name, key)
    return compare(value, np.hstack(columns), rng, discarded=shares, relative=relative, quantity=quantity)


def _quantity(results: Sequence[PointResult | None], name: str, key: str) -> Compared:
    items = [item.metrics[name][key] for item in results if item and key in item.metrics.get(name, {})]
    return compared_quantity(key, items) if items else SIGMA_A


def _from_summary(run: FinishedRun, name: str, key: str) -> tuple[float, float]:
    """Value and relative error of sigma(A) of a run without scores.npz; NaN for other quantities."""
    entry = run.summary["scores"].get(name)
    if entry is None or key != SIGMA_KEY:
        return np.nan, np.nan
    error = entry["error_ukcmb2"]
    return entry["sigma_ukcmb2"], np.nan if error is None else error / entry["sigma_ukcmb2"]
