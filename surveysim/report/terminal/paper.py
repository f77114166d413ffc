"""Tables of the paper on the terminal."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from surveysim.report.explanation import overview_table, second_layer_table
from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.survey import where_line
from surveysim.report.terminal.tables import show_table

if TYPE_CHECKING:
    from astropy.table import Table as AstropyTable


def print_paper(written: list[Path]) -> None:
    """Print the tables, the captions of the figures, and the place of the files."""
    from astropy.table import Table as AstropyTable

    console = Terminal()
    for path in written:
        if path.suffix == ".ecsv" and not path.stem.startswith("measurements"):
            made = AstropyTable.read(path, format="ascii.ecsv")
            if path.stem.startswith("figure"):
                console.say(f"\n{made.meta['title']}: {made.meta['caption']}")
            else:
                console.show(_plain_table(made))
    if written:
        console.say(f"\n{len(written)} files. {where_line(written[0].parent)}")


def _plain_table(made: "AstropyTable") -> Table:
    table = Table(title=Text(made.meta["title"]))
    for name in made.colnames:
        numbers = made[name].dtype.kind in "fi"
        table.add_column(Text(name.replace("_", " ")), justify="right" if numbers else "left")
    for row in made:
        cells = ("" if value != value else value for value in row)
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in cells))
    return table


def print_explanation(content: Mapping[str, Any], directory: Path) -> None:
    """Print the overview of an explanation, the winds with a second layer, and where the files are."""
    console = Terminal(160)
    for table in (overview_table(content), second_layer_table(content)):
        show_table(console, table)
    console.say(f"\n{where_line(directory)}")
