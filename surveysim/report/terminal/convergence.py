"""What accuracy costs as text: the table of all settings, slopes and recommendations."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table
from rich.text import Text

from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.survey import where_line, with_unknown
from surveysim.studies.convergence import AccuracyResult, Measured

if TYPE_CHECKING:
    from astropy.table import Table as AstropyTable

COLUMNS = ("sigma_ukcmb2", "error_ukcmb2", "bias", "bias_error", "wall_s", "cpu_s", "start_s", "peak_mb", "raised_mb")
PARTS = ("noise", "weather", "window", "population")
UNITS = {"ukcmb2": "uK2", "s": "s", "mb": "MB"}
MEMORY = "peak_mb is the most that a process held since it began, other settings before included; raised_mb its rise"


def accuracy_table(result: AccuracyResult) -> "AstropyTable":
    """A row for each setting; errors, bias and the parts of the error as in
    `surveysim.studies.convergence.Measured`.
    """
    from astropy.table import Table as AstropyTable

    rows = result.rows
    table = AstropyTable()
    table["knob"] = [row.setting.knob for row in rows]
    table["setting"] = [row.setting.label for row in rows]
    table["kind"] = [row.setting.kind for row in rows]
    table["own"] = [row.setting.own for row in rows]
    table["observations"] = [row.observations for row in rows]
    for name in COLUMNS:
        table[name] = np.array([getattr(row, name) for row in rows], float)
        table[name].unit = UNITS.get(name.rpartition("_")[2])
    for part in PARTS:
        table[f"{part}_error"] = [np.nan if row.budget is None else getattr(row.budget, part) for row in rows]
    table["note"] = [row.note for row in rows]
    table.meta = {
        "scene": result.scene.name,
        "seed": result.scene.seed,
        "reference_ukcmb2": result.reference_ukcmb2,
        "reference_error": result.reference_error,
        "reference_seeds": result.seeds,
        "slopes": {item.name: [item.value, item.error] for item in result.slopes},
        "recommended": {item.knob: item.label for item in result.recommended},
        "memory": MEMORY,
        "wall_s": result.wall_s,
        "workers": result.workers,
    }
    return table


def print_accuracy(result: AccuracyResult, directory: Path) -> None:
    """A row for each setting, what could not be run and why, slopes, recommendations and where the files are."""
    console = Terminal(140)
    console.show(_table(result))
    for line in (*_refused(result), *reference_lines(result), *slope_lines(result), *recommended_lines(result)):
        console.say(line)
    done = f"{len(result.rows)} settings in {result.wall_s:.1f} s with {result.workers} worker(s)"
    console.say(f"\n{done}; {MEMORY}\n{where_line(directory)}")


def _table(result: AccuracyResult) -> Table:
    table = Table(title=Text(f"{result.scene.title}: what accuracy costs (* the scene's own settings)"))
    for heading in ("knob", "setting"):
        table.add_column(heading)
    for heading in ("n", "sigma(A) [uK_CMB^2]", "bias [%]", "wall [s]", "CPU [s]", "start [s]", "peak [MB]"):
        table.add_column(Text(heading), justify="right")
    knob = ""
    for row in result.rows:
        if np.isfinite(row.sigma_ukcmb2):
            if knob and row.setting.knob != knob:
                table.add_section()
            knob = row.setting.knob
            table.add_row(*_cells(row))
    return table


def _cells(row: Measured) -> list[str]:
    setting = row.setting
    # No error: it is the reference, or a survey equal to the last bit.
    error = "unknown" if math.isnan(row.bias_error) else f"{100 * row.bias_error:.1g}"
    bias = "0" if row.bias_error == 0 else f"{100 * row.bias:.2g} +- {error}"
    spent = [f"{value:.3g}" for value in (row.wall_s, row.cpu_s, row.start_s, row.peak_mb)]
    level = with_unknown(row.sigma_ukcmb2, row.error_ukcmb2)
    return [setting.knob, setting.label + " *" * setting.own, str(row.observations), level, bias, *spent]


def _refused(result: AccuracyResult) -> list[str]:
    lines = [row for row in result.rows if not np.isfinite(row.sigma_ukcmb2)]
    return [f"{row.setting.knob} {row.setting.label}: {row.note}" for row in lines]


def reference_lines(result: AccuracyResult) -> list[str]:
    """What the biases are against, and how well that is known."""
    n_obs, sub = result.scene.observations, result.sub_observations
    reached, wanted = 100 * result.reference_error, 100 * result.wanted_error
    short = "" if result.reference_error <= result.wanted_error else f", short of the {wanted:g} % wanted"
    seeds = "1 seed" if result.seeds == 1 else f"{result.seeds} seeds"
    lines = [
        f"Reference of observations and forecast: {seeds} of {n_obs} observations, known to {reached:.2g} %{short}"
    ]
    if result.seeds > 1:
        lines.append(f"  its seeds scatter by {result.scatter:.2f} of the error that each claims")
    return [*lines, f"Reference of another knob: the finest of its settings, each with {sub} observations of one seed"]


def slope_lines(result: AccuracyResult) -> list[str]:
    """Slopes of errors in logarithms, where -0.5 is a Monte Carlo's."""
    lines = []
    for item in result.slopes:
        error = f" +- {item.error:.2f}" if np.isfinite(item.error) else ""
        lines.append(f"  slope of {item.name}: {item.value:.2f}{error}")
    return lines


def recommended_lines(result: AccuracyResult) -> list[str]:
    """The fastest setting of each knob that is good enough, and whether the scene has it."""
    tolerated = 100 * result.own_error / 3
    lines = [f"Recommended, with a bias below {tolerated:.2g} % (a third of the scene's Monte Carlo error):"]
    for item in result.recommended:
        has = "as the scene has it" if item.is_own else "not the scene's"
        doubt = "" if item.resolved else "; its bias is not known to that, only not told from none"
        lines.append(f"  {item.knob} {item.label}: {has}{doubt}")
    return lines
