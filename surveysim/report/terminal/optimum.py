"""An optimisation on the terminal: knobs, designs, the simulated ones, warnings; the front with two metrics."""

from collections.abc import Iterator
from pathlib import Path

from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.survey import print_warnings, where_line
from surveysim.report.terminal.sweep import best_line
from surveysim.report.terminal.tables import show_table
from surveysim.runtime.numbers import plural
from surveysim.studies.optimise.result import OptimiseResult
from surveysim.studies.optimise.summary import optimum_summary
from surveysim.studies.optimise.tables import design_table, front_table, optimum_table, simulated_table

MOST_REASONS = 3  # why designs are not allowed


def print_optimum(result: OptimiseResult, directory: Path, verbose: bool = False) -> None:
    """Print the best design, how flat it is, the simulated designs, warnings and where the files are.

    Parameters
    ----------
    result
        The search.
    directory
        Folder of its files.
    verbose
        Print all reasons why designs are not allowed.
    """
    console, content = Terminal(160), optimum_summary(result)
    show_table(console, optimum_table(content))
    if (front := front_table(content)) is not None:
        show_table(console, front, marked="closest to the best of both")
    if result.simulated is None:
        show_table(console, design_table(content), marked="best")
    else:
        show_table(console, simulated_table(content), marked="lowest")
        console.say("Ratios are to the first design, with paired errors.")
        if result.simulated.comparison.reference is not None:
            console.say(best_line(result.simulated))
    for line in _search_lines(content["optimum"], verbose):
        console.say(line)
    print_warnings(console, result.warnings)
    console.say(f"\nin {result.wall_s:.1f} s\n{where_line(directory)}")


def _search_lines(found: dict, verbose: bool) -> Iterator[str]:
    reasons = list(found["refused"].items())
    shown = reasons if verbose else reasons[:MOST_REASONS]
    forecast, refused = plural(found["evaluations"], "design"), sum(found["refused"].values())
    yield f"{forecast} were forecast; {refused} are not allowed{':' if shown else ''}"
    yield from (f"  {reason}: {plural(n, 'design')}" for reason, n in shown)
    if len(shown) < len(reasons):
        yield f"  {plural(len(reasons) - len(shown), 'other reason')}: --verbose shows all"
