"""Figure of a budget: survey time from the least to the whole scene, and the cost of each stage alone."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surveysim.report.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LEGEND,
    ORANGE,
    VERMILION,
    finish,
    new_figure,
    plain,
    save,
)
from surveysim.studies.budget.costs import Estimate
from surveysim.studies.budget.result import BudgetResult

ROW, AROUND, WIDTH = 0.34, 1.7, 11.0  # height of a row, of title and axis, and width of the figure [inch]
TIME = "survey time [% of the whole scene's]"


def draw_budget(path: Path, result: BudgetResult) -> Path:
    """Write the figure of a budget as a PNG, atomically; return its path."""
    save(draw(result), path)
    return path


def draw(result: BudgetResult) -> Figure:
    """Draw the figure of a budget; raise ValueError without a score of the whole scene."""
    if not result.is_scored:
        raise ValueError("budget: found no score of the whole scene; one is expected")
    steps = _steps(result)
    figure = new_figure(WIDTH, AROUND + ROW * max(len(steps), len(result.costs)))
    fall, alone = figure.subplots(1, 2)
    _draw_waterfall(fall, steps)
    _draw_alone(alone, result)
    for axes in (fall, alone):
        finish(axes, TIME, "")
        axes.grid(axis="y", visible=False)
        axes.tick_params(axis="y", which="both", length=0)
    return figure


def _steps(result: BudgetResult) -> list[tuple[str, Estimate, str]]:
    """Label, survey time and colour of each bar: totals in grey begin at 0, other bars where the one before ends."""
    total, floor = result.total, result.budget.stages.floor
    whole = ("whole scene", Estimate(1.0), GREY)
    if not total.least.is_known:
        return [whole]
    titles = {item.row.name: item.row.title for item in result.costs}
    steps = [(f"{titles[floor]} alone", total.least, GREY)]
    for item in result.costs:
        if item.added_time.is_known and item.removed_time.is_known:
            steps.append((item.row.title, item.added_time, BLUE if item.added_time.value > 0 else GREEN))
    return [*steps, ("interactions", total.together, ORANGE), whole]


def _draw_waterfall(axes: Axes, steps: list[tuple[str, Estimate, str]]) -> None:
    level = 0.0
    for row, (_, found, colour) in enumerate(steps):
        start = 0.0 if colour == GREY else level
        ends = np.array([start, start + found.value]) * 100
        axes.barh(row, ends[1] - ends[0], left=ends[0], height=0.62, color=colour, ec=colour, lw=1)
        if np.isfinite(found.error):
            axes.errorbar(ends[1], row, xerr=100 * found.error, color=BLACK, elinewidth=1, capsize=2)
        percent = round(100 * found.value, 1) + 0.0  # without the sign of a negative zero
        beyond = max(ends) + (100 * found.error if np.isfinite(found.error) else 0)
        axes.annotate(
            f"{percent:.1f}" if colour == GREY else f"{percent:+.1f}",
            (beyond, row),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
        level = start + found.value
        if row + 1 < len(steps):
            axes.plot([100 * level] * 2, [row + 0.31, row + 0.69], color=GREY, lw=0.7)
    _name_rows(axes, [label for label, _, _ in steps])
    axes.set_xlim(right=axes.get_xlim()[1] * 1.18)
    axes.set_title("stages added alone to the least scene", fontsize=10)


def _draw_alone(axes: Axes, result: BudgetResult) -> None:
    axes.axvline(0, color=GREY, lw=0.8)
    looks = (
        ("removed_time", "removed", VERMILION, "o", -0.12),
        ("added_time", "added", BLUE, "s", 0.12),
    )
    for name, label, colour, marker, shift in looks:
        found = [getattr(item, name) for item in result.costs]
        value, error = (100 * np.array([getattr(item, key) for item in found]) for key in ("value", "error"))
        rows = np.arange(len(found)) + shift
        bars = np.where(np.isfinite(error), error, 0)
        axes.errorbar(value, rows, xerr=bars, fmt=marker, color=colour, ms=4.5, elinewidth=1, capsize=2, label=label)
    _name_rows(axes, [item.row.title for item in result.costs])
    axes.set_title("each stage removed or added alone", fontsize=10)
    axes.set_ylim(bottom=axes.get_ylim()[0] + 0.9)  # room for the legend
    axes.legend(loc="lower center", ncols=2, **LEGEND)


def _name_rows(axes: Axes, labels: list[str]) -> None:
    axes.set_yticks(range(len(labels)), [plain(label) for label in labels], fontsize=8.5)
    axes.set_ylim(len(labels) - 0.4, -0.6)
