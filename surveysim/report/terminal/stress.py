"""Extreme cases on the terminal."""

from collections.abc import Sequence
from pathlib import Path

from surveysim.report.tables import extreme_table
from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.tables import show_table
from surveysim.studies.stress import Case, Outcome


def print_extremes(cases: Sequence[Case], outcomes: Sequence[Outcome], directory: Path) -> None:
    """Print a row for each case, failed cases first, and the number of passed cases."""
    console = Terminal(160)
    pairs = sorted(zip(cases, outcomes, strict=True), key=lambda pair: pair[1].ok)
    show_table(console, extreme_table(*zip(*pairs, strict=True)))
    good = sum(outcome.ok for outcome in outcomes)
    console.say(f"{good} of {len(outcomes)} as expected\nResults in {directory}")
