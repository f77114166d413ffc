"""Figure of accuracy and cost: errors and biases against run time, with Pareto fronts."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from surveysim.report.figures.layout import lay_out
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.report.figures.style import save
from surveysim.studies.convergence import AccuracyResult, Measured

LOOKS = ("blue", "vermilion", "green", "purple", "orange")
TIME = "CPU time without start-up [s]"
HALF_DECADE = 10**0.25  # room about the points


def draw_accuracy(path: Path, result: AccuracyResult) -> Path:
    """Write the figure as a PNG, atomically; return its path."""
    save(lay_out(accuracy_figure(result)), path)
    return path


def accuracy_figure(result: AccuracyResult) -> PaperFigure:
    """Draw Monte Carlo errors of parts of the survey and of the other Monte Carlo parameters, and biases, against time.

    Grey lines are Pareto fronts: nothing is faster and as good. Diamonds are the scene's own settings.
    """
    rows = [row for row in result.rows if np.isfinite(row.sigma_ukcmb2) and row.cpu_s > 0]
    of_kind = {kind: [row for row in rows if row.setting.kind == kind] for kind in ("survey", "sampling", "numerical")}
    panels = (
        _survey_panel(of_kind["survey"], [row for row in rows if row.setting.kind == "forecast"]),
        _panel("other Monte Carlo parameters", "relative error of sigma(A)", of_kind["sampling"], _error),
        _panel("numerical parameters", "bias of sigma(A), or its error", of_kind["numerical"], _bias),
    )
    fitted = ", ".join(f"{item.name} {item.value:.2f}" for item in result.slopes if "time" in item.name)
    caption = (
        f"Left: {result.scene.observations} observations and parts of them, {result.seeds} seed(s); slopes: {fitted}."
        f" Others: {result.sub_observations} observations; biases are against the finest setting of each parameter,"
        " which has none and is left out, with paired errors; where a bias is below its error, the error is drawn"
        " (squares). Grey: Pareto front. Diamonds: the scene's own settings."
    )
    return PaperFigure(
        0, f"{result.scene.name}: accuracy and its cost", caption, tuple(panel for panel in panels if panel), 3
    )


def pareto(time: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Find the points (n,), in order of time, for which no other is faster and as good, or better and as fast."""
    order = np.lexsort((error, time))
    best = np.minimum.accumulate(error[order])
    return order[np.concatenate([[True], best[1:] < best[:-1]])]


def _survey_panel(rows: Sequence[Measured], forecast: Sequence[Measured]) -> Panel | None:
    panel = _panel("number of observations", "relative error of sigma(A)", rows, _error)
    if panel is None:
        return None
    time, error = _points([row for row in rows if _error(row) > 0], _error)  # not unknown
    ends = np.array([time.min(), time.max()])
    guide = np.exp(np.mean(np.log(error) + 0.5 * np.log(time))) * ends**-0.5
    series = [*panel.series, Series("time$^{-1/2}$", "line", ends, guide, "sky --")]
    x_range, y_range = panel.x_range, panel.y_range
    if forecast and _bias(forecast[0]) > 0:
        x, y = _points(forecast, _bias)
        series.append(Series("forecast: bias", "points", x, y, "green :"))
        x_range, y_range = _range(np.append(x, time)), _range(np.append(y, error))
    return Panel(panel.title, TIME, panel.y_label, tuple(series), True, True, False, x_range, y_range)


def _panel(title: str, y_label: str, rows: Sequence[Measured], value: Callable[[Measured], float]) -> Panel | None:
    """Panel of all parameters of some rows; None without a value above 0."""
    rows = [row for row in rows if value(row) > 0]
    if not rows:
        return None
    time, error = _points(rows, value)
    front = pareto(time, error)
    series = [Series("", "line", time[front], error[front], "grey")]
    for look, parameter in zip(LOOKS, dict.fromkeys(row.setting.parameter for row in rows), strict=False):
        marks: dict[str, list[Measured]] = {}
        for row in rows:
            if row.setting.parameter == parameter:
                marks.setdefault(_mark(row), []).append(row)
        for number, (mark, drawn) in enumerate(marks.items()):
            series.append(Series("" if number else parameter, "points", *_points(drawn, value), f"{look} {mark}"))
    return Panel(title, TIME, y_label, tuple(series), True, True, False, _range(time), _range(error))


def _points(rows: Sequence[Measured], value: Callable[[Measured], float]) -> tuple[np.ndarray, np.ndarray]:
    return np.array([row.cpu_s for row in rows]), np.array([value(row) for row in rows])


def _error(row: Measured) -> float:
    return row.relative_error


def _bias(row: Measured) -> float:
    return max(abs(row.bias), row.bias_error)


def _mark(row: Measured) -> str:
    """Marker: diamonds for the scene's own settings, squares for upper limits."""
    if row.setting.own:
        return "-."
    return "--" if row.setting.kind == "numerical" and abs(row.bias) <= row.bias_error else "-"


def _range(values: np.ndarray) -> tuple[float, float]:
    return float(values.min() / HALF_DECADE), float(values.max() * HALF_DECADE)
