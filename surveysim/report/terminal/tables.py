"""Tables of results on a terminal."""

from rich.table import Table as RichTable
from rich.text import Text

from surveysim.report.terminal.layout import Terminal
from surveysim.runtime.numbers import plain
from surveysim.runtime.table import Table


def show_table(console: Terminal, table: Table, *, title: str = "", marked: str = "") -> None:
    """Show a table, its numbers in ASCII.

    Parameters
    ----------
    console : Terminal
        Terminal to print on.
    table : Table
        Table to show.
    title : str
        Title in place of the table's own.
    marked : str
        Meaning of the `best` rows, which are marked with * where it is given.
    """
    legend = f" (* {marked})" if marked and table.best else ""
    made = RichTable(title=Text(f"{title or table.title}{legend}"))
    # As Text: a plain string's square brackets would be taken for markup.
    for column in table.shown:
        made.add_column(Text(column.heading), justify="right" if column.is_numeric else "left")
    for place, row in enumerate(table.rows):
        first, *others = map(plain, row)
        made.add_row(Text(first + " *" * (bool(legend) and place in table.best)), *map(Text, others))
    console.show(made)
