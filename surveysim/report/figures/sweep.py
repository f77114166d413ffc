"""Figure of a sweep: its metric along the first axis, and the ratio to the reference point with paired errors."""

import re
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.report.figures.layout import lay_out
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.report.figures.style import plain, save
from surveysim.results.metric_tables import with_unit
from surveysim.studies.sweep.axes import Axis, numbers_of
from surveysim.studies.sweep.comparison import SIGMA_A, Compared
from surveysim.studies.sweep.point_store import PointResult
from surveysim.studies.sweep.result import SweepResult

COLOURS = ("black", "vermilion", "blue", "green", "purple", "orange", "sky")
MOST_LINES = 10  # with more, points stand in a row by their number
LOG_FROM = 5  # ratio of the largest to the smallest value from which an axis is logarithmic
LEVEL_TICKS = 40  # letters that fit below a panel
UK2_CMB = r"$\mu$K$_\mathrm{CMB}^2$"

_BARS = (
    " Bars are Monte Carlo errors; those of the ratios count that noise, weather and skies are common. Grey bars:"
    " independent runs."
)
_NO_BARS = " Errors are not known for so few observations."


def draw_sweep(path: Path, result: SweepResult) -> Path:
    """Write the figure of a sweep with at least one score as a PNG, atomically; return its path."""
    save(draw(result), path)
    return path


def draw(result: SweepResult) -> Figure:
    """Draw the figure of a sweep with at least one score."""
    figure = lay_out(sweep_figure(result))
    ticks = _ticks(result)
    if ticks:
        for axes in figure.axes:
            turned = sum(max(map(len, tick.split("\n"))) for tick in ticks) > LEVEL_TICKS
            look = {"rotation": 30, "rotation_mode": "anchor", "ha": "right", "fontsize": 8} if turned else {}
            axes.set_xticks(range(len(ticks)), ticks, **look)
    return figure


def sweep_figure(result: SweepResult) -> PaperFigure:
    """Draw two panels: the metric of the actual data with forecasts as lines, and ratios to the reference point.

    Each combination of values of the other axes has its own colour. Grey bars in the second panel are errors of
    independent runs.
    """
    sweep, comparison = result.sweep, result.comparison
    x, label, logarithmic = _positions(result)
    levels, ratios = [], []
    for colour, (name, rows) in zip(COLOURS * MOST_LINES, _lines(result), strict=False):
        rows = rows[np.argsort(x[rows], kind="stable")]
        levels += _levels(result, x, rows, name, colour)
        ratios += _ratios(result, x, rows, name, colour)
    lost = np.array([not result.comparable(number, comparison.reference) for number in range(len(x))])
    if lost.any():
        ratios.append(Series("not comparable: scans lost", "points", x[lost], comparison.ratio[lost], "orange -."))
    shown = comparison.value[np.isfinite(comparison.value)]
    wide = _wide(shown)
    title, name, level = _names(comparison.quantity)
    panels = (
        Panel(title, label, level, tuple(levels), logarithmic, wide),
        Panel("against the reference point", label, f"ratio of {name}", tuple(ratios), logarithmic, wide),
    )
    reference = plain(sweep.points[comparison.reference].label)
    caption = f"{len(sweep.points)} points with one seed; reference point: {reference}."
    if result.simulated:
        caption += (_BARS if np.isfinite(comparison.error).any() else _NO_BARS) + " Dashes or triangles: forecast."
    return PaperFigure(0, f"{sweep.name}: sweep", caption, panels, 2)


def _names(quantity: Compared) -> tuple[str, str, str]:
    """Title of the first panel, name of the metric, and label of its axis."""
    if quantity == SIGMA_A:
        return "uncertainty of a flat band power", "sigma(A)", f"sigma(A) [{UK2_CMB}]"
    name = plain(quantity.key)
    unit = UK2_CMB if quantity.unit == "uK2" else plain(with_unit("", quantity.unit).strip())
    return name, name, f"{name} [{unit}]" if unit else name


def _levels(result: SweepResult, x: np.ndarray, rows: np.ndarray, name: str, colour: str) -> list[Series]:
    comparison = result.comparison
    forecast = np.array([_forecast(result.points[row], comparison.quantity.key) for row in rows])
    series = []
    if np.isfinite(forecast).any():
        label = "" if name and result.simulated else name or "forecast"
        # Steps without a number have nothing between them.
        steps = bool(_ticks(result))
        look = f"{colour} {':' if steps else '--'}"
        series.append(Series(label, "points" if steps else "line", x[rows], forecast, look))
        if not result.simulated and not steps:
            series.append(Series("", "points", x[rows], forecast, look))
    if result.simulated:
        sigma, error = comparison.value[rows], comparison.error[rows]
        series.append(Series(name or "simulated", "points", x[rows], sigma, colour, sigma - error, sigma + error))
    return series


def _forecast(point: PointResult, key: str) -> float:
    """Forecast of a quantity at a point; NaN without one."""
    found = point.metrics.get(ACTUAL, {}).get(key)
    forecast = found.forecast if found else None
    if quantity := point.metric_forecasts.get(ACTUAL, {}).get(key):
        forecast = quantity.value
    return np.nan if forecast is None or not np.isfinite(forecast) else forecast


def _ratios(result: SweepResult, x: np.ndarray, rows: np.ndarray, name: str, colour: str) -> list[Series]:
    comparison = result.comparison
    ratio = comparison.ratio[rows]
    if not result.simulated:
        line = () if _ticks(result) else (Series("", "line", x[rows], ratio, f"{colour} --"),)
        return [*line, Series(name, "points", x[rows], ratio, f"{colour} --")]
    series = []
    for error, look in ((comparison.independent_error[rows], "grey"), (comparison.paired_error[rows], colour)):
        label = name if look == colour else ""
        series.append(Series(label, "points", x[rows], ratio, look, ratio - error, ratio + error))
    return series


def _lines(result: SweepResult) -> list[tuple[str, np.ndarray]]:
    """Label and point indices of each line: one for each combination of values of the axes after the first."""
    sweep = result.sweep
    if _in_a_row(result):
        return [("", np.arange(len(sweep.points)))]
    rows: dict[tuple[int, ...], list[int]] = {}
    for point in sweep.points:
        rows.setdefault(point.place[1:], []).append(point.number)
    return [
        (plain(", ".join(axis.at(step) for axis, step in zip(sweep.axes[1:], others, strict=True))), np.array(numbers))
        for others, numbers in rows.items()
    ]


def _in_a_row(result: SweepResult) -> bool:
    return len(result.points) > MOST_LINES * len(result.sweep.axes[0].values)


def _positions(result: SweepResult) -> tuple[np.ndarray, str, bool]:
    """Horizontal position of each point, label of the axis, and whether it is logarithmic."""
    sweep = result.sweep
    if _in_a_row(result):
        return np.arange(len(sweep.points)), "point", False
    first = sweep.axes[0]
    place = np.array([point.place[0] for point in sweep.points])
    found = _numbers(first)
    if found is None:
        return place, plain(first.name), False
    values, unit = found[0].astype(float), found[1]
    return values[place], plain(f"{first.name} [{unit}]" if unit else first.name), _wide(values)


def _numbers(axis: Axis) -> tuple[np.ndarray, str] | None:
    """Values of the first key of the axis and their unit; None unless they are numbers that distinguish its steps."""
    found = numbers_of([values[0] for values in axis.values])
    return found if found is not None and len(np.unique(found[0])) == len(axis.values) else None


def _wide(values: np.ndarray) -> bool:
    """Return whether an axis of these values is logarithmic."""
    return bool(values.min() > 0 and values.max() >= LOG_FROM * values.min())


def _ticks(result: SweepResult) -> list[str]:
    """Labels of the steps, with one line for each key, unless the position is the value."""
    first = result.sweep.axes[0]
    if _in_a_row(result) or _numbers(first) is not None:
        return []
    return ["\n".join(map(plain, re.split(r", (?=[\w.]+ = )", label))) for label in first.labels]
