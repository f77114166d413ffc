"""Results of a budget on the terminal: the cost of each stage, sums and interactions; points with --verbose."""

from pathlib import Path

from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.survey import print_warnings, where_line
from surveysim.report.terminal.tables import show_table
from surveysim.runtime.numbers import duration, plain
from surveysim.studies.budget.lines import (
    flag_lines,
    interaction_line,
    measure_line,
    place_line,
    reason_lines,
    small_line,
    total_lines,
)
from surveysim.studies.budget.points import Budget
from surveysim.studies.budget.result import BudgetResult
from surveysim.studies.budget.summary import budget_summary
from surveysim.studies.budget.tables import budget_table, option_table, pair_table, point_table
from surveysim.studies.sweep.plan import SweepPlan


def print_budget_plan(budget: Budget, plan: SweepPlan, workers: int) -> None:
    """Print the number of points and their predicted cost."""
    Terminal().say(
        f"{budget.name}: {len(budget.rows)} stages, {plan.n_points} points, about {plain(duration(plan.wall_s))} with"
        f" {workers} worker(s)"
    )


def print_budget(result: BudgetResult, scene: Path, directory: Path, verbose: bool = False) -> None:
    """Print a row for each stage, sums, interactions, stages that cost little, warnings and where the files are.

    With `verbose` also each point, with the command that runs it.
    """
    console, summary = Terminal(160), budget_summary(result)
    show_table(console, budget_table(summary))
    for line in (*total_lines(summary), interaction_line(summary), small_line(summary), *reason_lines(summary)):
        if line:
            console.say(plain(line))
    console.say(plain(f"{measure_line(summary)} {place_line(summary)}"))
    show_table(console, option_table(summary))
    if summary["budget"]["pairs"]:
        show_table(console, pair_table(summary))
    if verbose:
        show_table(console, point_table(summary))
        command = "run" if result.simulated else "forecast"
        console.say(f"Each point by itself: surveysim {command} {scene} and its options")
    print_warnings(console, [*result.warnings, *flag_lines(summary)])
    done = f"{len(result.points)} points in {result.wall_s:.1f} s with {result.workers} worker(s)"
    console.say(f"\n{done}\n{where_line(directory)}")
