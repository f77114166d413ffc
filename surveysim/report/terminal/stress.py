"""What came out of extreme cases: a table on the terminal and in a file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from mapmaker.files import write_ecsv
from surveysim.report.terminal.layout import Terminal
from surveysim.studies.stress import Case, Outcome


def write_extremes(path: Path, cases: Sequence[Case], outcomes: Sequence[Outcome]) -> None:
    """Write a row a case as ECSV: why its answer is known, what was expected and found, numbers or words."""
    columns: dict[str, list[Any]] = {
        "case": [case.name for case in cases],
        "why": [case.why for case in cases],
        "expected": [_line(outcome.expected) for outcome in outcomes],
        "found": [_line(outcome.found) for outcome in outcomes],
        "tolerance": [float(outcome.tolerance) for outcome in outcomes],
        "ok": [outcome.ok for outcome in outcomes],
        "note": [_line(outcome.note) for outcome in outcomes],
    }
    write_ecsv(path, columns, {}, {})


def print_extremes(cases: Sequence[Case], outcomes: Sequence[Outcome], directory: Path) -> None:
    """A line a case, those first that are not as expected, and how many are."""
    console = Terminal(160)
    table = Table(title=Text("Extreme cases"))
    for heading in ("case", "expected", "found", "tolerance", "as expected"):
        table.add_column(heading)
    for case, outcome in sorted(zip(cases, outcomes, strict=True), key=lambda pair: pair[1].ok):
        cells = (case.name, _shown(outcome.expected), _shown(outcome.found), _shown(outcome.tolerance))
        table.add_row(*map(Text, cells), "yes" if outcome.ok else "NO")
    console.show(table)
    good = sum(outcome.ok for outcome in outcomes)
    console.say(f"{good} of {len(outcomes)} as expected\nResults in {directory}")


def _line(value: float | str) -> str:
    return " ".join(str(value).split())


def _shown(value: float | str) -> str:
    text = f"{value:.4g}" if isinstance(value, float) else _line(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
