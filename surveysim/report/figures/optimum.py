"""Figure of an optimisation: the metric along each knob with the range within 1 %, or the Pareto front."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surveysim.report.figures.layout import lay_out
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.report.figures.style import UK2_CMB, plain, save
from surveysim.studies.optimise.ranges import KnobRange
from surveysim.studies.optimise.result import OptimiseResult
from surveysim.studies.optimise.tables import value_shown
from surveysim.studies.sweep.axes import value_text

HIGHEST = 1.6  # of a panel, over the best metric
BELOW = 0.05  # of its height, under the best metric
COLUMNS = 3


def draw_optimum(path: Path, result: OptimiseResult) -> Path:
    """Write the figure of an optimisation as a PNG, atomically; return its path."""
    save(draw(result), path)
    return path


def draw(result: OptimiseResult) -> Figure:
    """Draw the figure of an optimisation."""
    figure = lay_out(optimum_figure(result))
    if len(result.problem.options.metrics) == 1:
        for axes, knob in zip(figure.axes, result.problem.knobs, strict=False):
            if knob.choices:
                texts = [plain(value_text(knob.value(place))) for place in knob.steps()]
                axes.set_xticks(range(len(texts)), texts)
    return figure


def optimum_figure(result: OptimiseResult) -> PaperFigure:
    """Draw a panel for each knob with one metric, or the front of two."""
    metrics = result.problem.options.metrics
    if len(metrics) == 2:
        caption = "Designs that were forecast; the front has those that no other is better than in both metrics."
        return PaperFigure(0, f"{result.problem.scene.name}: Pareto front", caption, (_front(result),), 1)
    panels = tuple(_knob(result, number) for number in range(len(result.problem.knobs)))
    caption = "Forecasts along each knob, with the others at the best design. Shaded: within 1 % of the best."
    return PaperFigure(0, f"{result.problem.scene.name}: optimum", caption, panels, min(COLUMNS, len(panels)))


def _label(result: OptimiseResult, key: str) -> str:
    unit = result.unit(key)
    return f"{plain(key)} [{UK2_CMB if unit == 'uK2' else plain(unit)}]" if unit else plain(key)


def _front(result: OptimiseResult) -> Panel:
    found, keys = result.found, result.problem.options.metrics
    allowed = [item for item in found.evaluations if item.allowed]
    points = [np.array([item.metrics[key] for item in allowed]) for key in keys]
    front = [np.array([found.evaluations[number].metrics[key] for number in found.front]) for key in keys]
    best = [np.array([found.evaluations[found.best].metrics[key]]) for key in keys]
    series = [
        Series("designs", "points", points[0], points[1], "grey"),
        Series("front", "line", front[0], front[1], "blue"),
        Series("", "points", front[0], front[1], "blue"),
        Series("closest to the best of both", "points", best[0], best[1], "vermilion -."),
    ]
    if found.evaluations[0].allowed:
        present = [np.array([found.evaluations[0].metrics[key]]) for key in keys]
        series.append(Series("as it is", "points", present[0], present[1], "black --"))
    logs = [values.max() > 5 * values.min() > 0 for values in points]
    return Panel(
        "Pareto front", _label(result, keys[0]), _label(result, keys[1]), tuple(series), bool(logs[0]), bool(logs[1])
    )


def _knob(result: OptimiseResult, number: int) -> Panel:
    problem, found, key = result.problem, result.found, result.problem.options.metrics[0]
    knob, best = problem.knobs[number], found.evaluations[found.best]
    sign = 1 if result.lower_is_better(key) else -1
    top = best.metrics[key] * HIGHEST**sign
    low, high = sorted((best.metrics[key], top))
    room = BELOW * (high - low)
    y_range = (low - room, high) if sign > 0 else (low, high + room)
    others = [item for item in found.evaluations if item.allowed and item.settings]
    series = [
        Series(
            "allowed designs",
            "points",
            np.array([knob.number_of(item.settings[knob.key]) for item in others]),
            np.array([item.metrics[key] for item in others]),
            "grey",
        )
    ]
    if found.ranges:
        series += _range(result, number, found.ranges[number], y_range)
    at = np.array([knob.number_of(best.settings[knob.key])])
    series.append(Series("best", "points", at, np.array([best.metrics[key]]), "vermilion -."))
    unit = f" [{knob.unit}]" if knob.unit else ""
    x_range = (-0.5, knob.high + 0.5) if knob.choices else None
    label = plain(f"{knob.key}{unit}")
    return Panel(
        plain(f"best: {value_shown(best.settings[knob.key])}"),
        label,
        _label(result, key),
        tuple(series),
        knob.log,
        False,
        False,
        x_range,
        y_range,
    )


def _range(result: OptimiseResult, number: int, item: KnobRange, y_range: tuple[float, float]) -> list[Series]:
    knob, key = result.problem.knobs[number], result.problem.options.metrics[0]
    sign = 1 if result.lower_is_better(key) else -1
    there = np.isfinite(item.values)
    x = np.array([knob.number(place) for place in item.places[there]])
    series = [Series("along this knob", "points", x, np.exp(sign * item.values[there]), "blue")]
    if item.curve.size:
        x = np.array([knob.number(place) for place in item.curve[0]])
        series.append(Series("", "line", x, np.exp(sign * item.curve[1]), "blue"))
    if item.high > item.low:
        ends = np.array([knob.number(item.low), knob.number(item.high)])
        low, high = (np.full(2, end) for end in y_range)
        series.insert(0, Series("within 1 %", "band", ends, (low + high) / 2, "orange", low, high))
    return series
