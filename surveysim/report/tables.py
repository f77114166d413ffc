"""Tables of studies, from their records: settings of a convergence study, extreme cases, forecasts."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from surveysim.runtime.numbers import count, number, quoted_share
from surveysim.runtime.table import SIGMA, Column, Table, column, file_column, quoted_columns
from surveysim.studies.convergence import AccuracyResult
from surveysim.studies.stress import Case, Outcome

MEMORY = "peak_mb is the most that a process held since it began, other settings before included; raised_mb its rise"
LONGEST_CELL = 60  # letters of an extreme case's value on the terminal
_PARTS = ("noise", "weather", "transfer_function", "population")


def setting_rows(result: AccuracyResult) -> list[dict[str, Any]]:
    """Return a row for each setting of a convergence study, by the columns of accuracy.ecsv."""
    rows = []
    for item in result.rows:
        row = {name: vars(item.setting)[name] for name in ("parameter", "label", "kind", "own")}
        row["setting"] = row.pop("label")
        row |= {name: value for name, value in vars(item).items() if name not in ("setting", "budget")}
        for part in _PARTS:
            row[f"{part}_error"] = math.nan if item.budget is None else vars(item.budget)[part]
        rows.append(row)
    return rows


def setting_meta(result: AccuracyResult) -> dict[str, Any]:
    """Return the header of accuracy.ecsv."""
    return {
        "scene": result.scene.name,
        "seed": result.scene.seed,
        "reference_ukcmb2": result.reference_ukcmb2,
        "reference_error": result.reference_error,
        "reference_seeds": result.seeds,
        "slopes": [f"{item.name}: {item.value:.4g} +- {item.error:.2g}" for item in result.slopes],
        "recommended": [f"{item.parameter}: {item.label}" for item in result.recommended],
        "memory": MEMORY,
        "wall_s": result.wall_s,
        "workers": result.workers,
    }


def setting_table(rows: Sequence[Mapping[str, Any]], meta: Mapping[str, Any] | None = None) -> Table:
    """Return a row for each setting: sigma(A), its bias against the reference, time and memory.

    Parameters
    ----------
    rows : sequence of mapping
        Rows as `setting_rows` gives them or accuracy.ecsv has them.
    meta : mapping, optional
        Header of the file.
    """
    of = {name: [row[name] for row in rows] for name in rows[0]} if rows else {}
    biases = tuple(_bias_text(*pair) for pair in zip(of["bias"], of["bias_error"], strict=True))
    columns = (
        column("parameter", of["parameter"], "parameter"),
        column("setting", of["setting"], "setting"),
        file_column("kind", of["kind"]),
        file_column("own", of["own"]),
        column("observations", of["observations"], "observations", count),
        *quoted_columns(("sigma_ukcmb2", "error_ukcmb2"), of["sigma_ukcmb2"], of["error_ukcmb2"], SIGMA, unit="uK2"),
        Column("bias", of["bias"], "", "bias", biases),
        file_column("bias_error", of["bias_error"]),
        column("wall_s", of["wall_s"], "wall [s]", number, unit="s"),
        column("cpu_s", of["cpu_s"], "CPU [s]", number, unit="s"),
        column("start_s", of["start_s"], "start [s]", number, unit="s"),
        column("peak_mb", of["peak_mb"], "peak [MB]", number, unit="Mbyte"),
        file_column("raised_mb", of["raised_mb"], "Mbyte"),
        *(file_column(f"{name}_error", of[f"{name}_error"]) for name in _PARTS),
        file_column("note", of["note"]),
    )
    own = tuple(place for place, is_own in enumerate(of["own"]) if is_own)
    return Table("setting", "All settings that could be run", columns, own, meta or {})


def could_run(row: Mapping[str, Any]) -> bool:
    """Return whether a setting has a score."""
    return math.isfinite(row["sigma_ukcmb2"])


def _bias_text(bias: float, error: float) -> str:
    """A bias with its error; 0 for the reference itself, or one equal to it."""
    return "0" if error == 0 else quoted_share(bias, error)


def extreme_table(cases: Sequence[Case], outcomes: Sequence[Outcome]) -> Table:
    """Return a row for each extreme case: expected and found, numbers or words."""
    columns = (
        column("case", [case.name for case in cases], "case"),
        file_column("why", [case.why for case in cases]),
        column("expected", [_line(item.expected) for item in outcomes], "expected", _shortened),
        column("found", [_line(item.found) for item in outcomes], "found", _shortened),
        column("tolerance", [float(item.tolerance) for item in outcomes], "tolerance", number),
        Column(
            "ok",
            [item.ok for item in outcomes],
            "",
            "as expected",
            tuple("yes" if item.ok else "NO" for item in outcomes),
        ),
        file_column("note", [_line(item.note) for item in outcomes]),
    )
    return Table("extreme", "Extreme cases", columns)


def _line(value: float | str) -> str:
    return " ".join(str(value).split())


def _shortened(text: str) -> str:
    """A number to four digits, words to a line."""
    try:
        return f"{float(text):.4g}"
    except ValueError:
        return text if len(text) <= LONGEST_CELL else f"{text[: LONGEST_CELL - 3]}..."
