"""Points of a figure as a table: everything that its panels draw."""

from typing import TYPE_CHECKING

import numpy as np

from surveysim.report.figures.spec import PaperFigure, Series

if TYPE_CHECKING:
    from astropy.table import Table


def points_table(figure: PaperFigure) -> "Table":
    """Return a row for each point of each series, in the order of the panels.

    `panel` counts from 1, `series` and `kind` are fields of the record, `low` and `high` are NaN without ends.
    Metadata: number, title and caption of the figure, title and labels of each panel.
    """
    from astropy.table import Table, vstack

    parts = [
        Table({"panel": np.full(len(series.x), number), **_columns(series)})
        for number, panel in enumerate(figure.panels, start=1)
        for series in panel.series
    ]
    table = vstack(parts, metadata_conflicts="silent")
    panels = [{"title": panel.title, "x": panel.x_label, "y": panel.y_label} for panel in figure.panels]
    table.meta = {"figure": figure.number, "title": figure.title, "caption": figure.caption, "panels": panels}
    return table


def _columns(series: Series) -> dict[str, np.ndarray]:
    n = len(series.x)
    named = {"series": np.full(n, series.label), "kind": np.full(n, series.kind)}
    ends = {"x": series.x, "y": series.y, "low": series.low, "high": series.high}
    nowhere = np.full(n, np.nan)
    return named | {name: nowhere if values is None else np.asarray(values, float) for name, values in ends.items()}
