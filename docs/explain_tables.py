"""Tables of the page on what explains the paper's findings: `python docs/explain_tables.py` writes them to the page.

They are from the run of `surveysim paper --explain` in `outputs/reference/explain/`.
"""

import json
from pathlib import Path

from surveysim.report.explanation import (
    difference_table,
    ingredient_table,
    overview_table,
    second_layer_table,
)
from surveysim.runtime.table import Column, Table

ROOT = Path(__file__).parent.parent
PAGE, RUN = ROOT / "docs" / "validation" / "explain.md", ROOT / "outputs" / "reference" / "explain"
BEGIN, END = "<!-- {}, made by docs/explain_tables.py -->\n", "<!-- end of {} -->\n"
OF_THE_ATMOSPHERE = ("outer_scale", "wind_b2", "two_layers", "three_layers", "evolution", "wind_drift")


def tables() -> dict[str, str]:
    """Tables in Markdown, by name."""
    content = json.loads((RUN / "summary.json").read_text(encoding="utf-8"))["explained"]
    moved = difference_table(content)
    first, *others = moved.columns
    atmosphere = [column for column in others if column.name in OF_THE_ATMOSPHERE]
    instrument = [column for column in others if column.name not in OF_THE_ATMOSPHERE]
    return {
        "overview": markdown(overview_table(content).shown),
        "atmosphere": markdown([first, *atmosphere]),
        "instrument": markdown([first, *instrument]),
        "second layer": markdown(second_layer_table(content).shown),
        "ingredients": markdown(_coded(ingredient_table(content))),
    }


def _coded(table: Table) -> list[Column]:
    """Columns with the settings as code."""
    *others, options = table.shown
    cells = tuple(f"`{cell}`" if cell else "" for cell in options.cells)
    return [*others, Column(options.name, cells, heading=options.heading, cells=cells)]


def markdown(columns: list[Column] | tuple[Column, ...]) -> str:
    """Write columns as a table in Markdown."""
    lines = [f"| {' | '.join(column.heading for column in columns)} |", f"|{'---|' * len(columns)}"]
    lines += [f"| {' | '.join(row)} |" for row in zip(*(column.cells for column in columns), strict=True)]
    return "\n".join(lines)


def with_tables(text: str) -> str:
    """Put the tables into the page."""
    for name, table in tables().items():
        begin, end = BEGIN.format(name), END.format(name)
        before, rest = text.split(begin)
        text = f"{before}{begin}\n{table}\n\n{end}{rest.split(end)[1]}"
    return text


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
