"""A convergence study on the terminal: the table of all settings, slopes and recommendations."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from surveysim.report.tables import MEMORY, could_run, setting_rows, setting_table
from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.survey import where_line
from surveysim.report.terminal.tables import show_table
from surveysim.studies.convergence import AccuracyResult


def print_accuracy(result: AccuracyResult, directory: Path) -> None:
    """Print a row for each setting, settings that could not be run, slopes, recommendations and where the files are."""
    console, rows = Terminal(140), setting_rows(result)
    table = setting_table([row for row in rows if could_run(row)])
    show_table(console, table, title=f"{result.scene.title}: accuracy and its cost", marked="the scene's own settings")
    for line in (*_refused(rows), *reference_lines(result), *slope_lines(result), *recommended_lines(result)):
        console.say(line)
    done = f"{len(result.rows)} settings in {result.wall_s:.1f} s with {result.workers} worker(s)"
    console.say(f"\n{done}; {MEMORY}\n{where_line(directory)}")


def _refused(rows: Sequence[dict[str, Any]]) -> list[str]:
    return [f"{row['parameter']} {row['setting']}: {row['note']}" for row in rows if not could_run(row)]


def reference_lines(result: AccuracyResult) -> list[str]:
    """Return lines on the reference of the biases and its error."""
    n_obs, sub = result.scene.observations, result.sub_observations
    reached, wanted = 100 * result.reference_error, 100 * result.wanted_error
    short = "" if result.reference_error <= result.wanted_error else f", short of the {wanted:g} % wanted"
    seeds = "1 seed" if result.seeds == 1 else f"{result.seeds} seeds"
    lines = [
        f"Reference of observations and forecast: {seeds} of {n_obs} observations, known to {reached:.2g} %{short}"
    ]
    if result.seeds > 1:
        lines.append(f"  its seeds scatter by {result.scatter:.2f} of the error that each claims")
    return [
        *lines,
        f"Reference of another parameter: the finest of its settings, each with {sub} observations of one seed",
    ]


def slope_lines(result: AccuracyResult) -> list[str]:
    """Return lines on the slopes of errors in logarithms; a Monte Carlo error has -0.5."""
    lines = []
    for item in result.slopes:
        error = f" +- {item.error:.2f}" if np.isfinite(item.error) else ""
        lines.append(f"  slope of {item.name}: {item.value:.2f}{error}")
    return lines


def recommended_lines(result: AccuracyResult) -> list[str]:
    """Return lines on the fastest setting of each parameter that is good enough, and whether the scene has it."""
    tolerated = 100 * result.own_error / 3
    lines = [f"Recommended, with a bias below {tolerated:.2g} % (a third of the scene's Monte Carlo error):"]
    for item in result.recommended:
        has = "as the scene has it" if item.is_own else "not the scene's"
        doubt = "" if item.resolved else "; its bias is smaller than its error, but the error is larger than this limit"
        lines.append(f"  {item.parameter} {item.label}: {has}{doubt}")
    return lines
