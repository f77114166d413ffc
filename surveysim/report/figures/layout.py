"""PNG files of figures given by their points: title, panels, legends that avoid the data, caption."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter
from matplotlib.transforms import ScaledTranslation

from surveysim.report.figures import style as drawing
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.report.figures.style import LEGEND

COLOURS = {
    "black": drawing.BLACK,
    "green": drawing.GREEN,
    "blue": drawing.BLUE,
    "vermilion": drawing.VERMILION,
    "purple": drawing.PURPLE,
    "orange": drawing.ORANGE,
    "sky": drawing.SKY,
    "grey": drawing.GREY,
}
MARKERS = {"-": "o", "--": "s", ":": "^", "-.": "D"}  # by dashes

# Of one, two, and three or more columns: width of the figure and height of a row [inch].
_SIZES = ((6.4, 4.2), (10.0, 3.7), (12.6, 3.5))
_CAPTION_PT, _LEGEND_PT, _PANEL_PT, _TITLE_PT = 8, LEGEND["fontsize"], 10, 11
_MARGIN = 0.12  # inch, around the caption
_HANDLE = 0.5  # inch, width of a legend entry without its text
_CROWD = 60  # smallest number of points with small, pale markers
_BETWEEN = np.linspace(0, 1, 40)  # positions on a line between points that legends must not hide


def draw_figure(figure: PaperFigure, path: Path) -> None:
    """Draw a figure as a PNG file, atomically.

    Raises ValueError for a look that is not one of `Series`, and for a figure without panels.
    """
    drawing.save(lay_out(figure), path)


def lay_out(figure: PaperFigure) -> Figure:
    """Draw the panels and fit title, legends and caption; errors as `draw_figure`."""
    if not figure.panels:
        raise ValueError(f"figure {figure.number}: found no panel; at least one is expected")
    columns = min(figure.columns, len(figure.panels))
    rows = -(-len(figure.panels) // columns)
    width, row_height = _SIZES[min(columns, len(_SIZES)) - 1]
    canvas = drawing.new_figure(width, rows * row_height)
    canvas.get_layout_engine().pad = _MARGIN / 2
    for place, panel in enumerate(figure.panels, start=1):
        _draw_panel(canvas.add_subplot(rows, columns, place), panel, width / columns)
    title = canvas.suptitle(_wrapped(canvas, figure.title, width - 4 * _MARGIN, _TITLE_PT), fontsize=_TITLE_PT)
    caption = _caption(canvas, figure.caption)
    common = _common_legend(canvas, figure.panels)
    height = rows * row_height + _size(title)[1] + _size(caption)[1] + common
    _resize(canvas, height, caption, common)
    if not common:
        _resize(canvas, height + _add_legends(canvas, figure.panels), caption, common)
    return canvas


def _draw_panel(axes: Axes, panel: Panel, width: float) -> None:
    # Scales first: margins about the data depend on them.
    axes.set(xscale="log" if panel.x_log else "linear", yscale="log" if panel.y_log else "linear")
    for series in panel.series:
        _DRAWN_AS[series.kind](axes, series)
    _open_limits(axes, panel)
    if panel.x_range:
        axes.set_xlim(panel.x_range)
    if panel.y_range:
        axes.set_ylim(panel.y_range)
    if panel.square:
        axes.set_aspect("equal")
    drawing.finish(axes, panel.x_label, panel.y_label)
    axes.set_ylabel(panel.y_label, fontsize=10)  # in every column: panels have different axes
    for is_log, axis, ends in ((panel.x_log, axes.xaxis, axes.get_xlim()), (panel.y_log, axes.yaxis, axes.get_ylim())):
        if is_log:
            _log_ticks(axis, abs(np.log10(ends[1] / ends[0])))
    axes.set_title(_wrapped(axes.figure, panel.title, 0.75 * width, _PANEL_PT), fontsize=_PANEL_PT)
    for x, y, note in panel.notes:
        behind = {"fc": "white", "ec": "none", "alpha": 0.7, "pad": 1.0}
        axes.text(x, y, note, fontsize=_LEGEND_PT, ha="center", va="center", bbox=behind)


def _open_limits(axes: Axes, panel: Panel) -> None:
    """Widen the limits of nearly constant data, which matplotlib leaves without a range on a logarithmic axis."""
    for is_log, (low, high), setter in (
        (panel.x_log, axes.get_xlim(), axes.set_xlim),
        (panel.y_log, axes.get_ylim(), axes.set_ylim),
    ):
        if is_log and abs(high / low - 1) < 1e-9:
            setter(low / 2, high * 2)


# ---------------------------------------------------------------- series


def _look(series: Series) -> tuple[str, str]:
    """Parse colour and dashes; raises ValueError for others than those of `Series`."""
    colour, dashes = (*series.look.split(), "-")[:2]
    if colour not in COLOURS or dashes not in MARKERS:
        allowed = f"{', '.join(COLOURS)} and {' '.join(MARKERS)} are allowed"
        raise ValueError(f"series {series.label!r}: found look {series.look!r}; {allowed}")
    return COLOURS[colour], dashes


def _line(axes: Axes, series: Series) -> None:
    colour, dashes = _look(series)
    axes.plot(series.x, series.y, color=colour, ls=dashes, lw=1.6, label=_entry(series))


def _points(axes: Axes, series: Series) -> None:
    colour, dashes = _look(series)
    many = len(series.x) >= _CROWD
    style = {"ms": 2.5 if many else 4.5, "alpha": 0.6 if many else 1.0, "mew": 0, "elinewidth": 1, "capsize": 2}
    bars = None if series.low is None else (series.y - series.low, series.high - series.y)
    axes.errorbar(series.x, series.y, bars, fmt=MARKERS[dashes], color=colour, label=_entry(series), **style)


def _band(axes: Axes, series: Series) -> None:
    axes.fill_between(series.x, series.low, series.high, color=_look(series)[0], alpha=0.2, lw=0, label=_entry(series))


def _steps(axes: Axes, series: Series) -> None:
    colour, dashes = _look(series)
    axes.stairs(series.y[:-1], series.x, color=colour, ls=dashes, lw=1.6, label=_entry(series))


_DRAWN_AS: dict[str, Callable[[Axes, Series], None]] = {
    "line": _line,
    "points": _points,
    "band": _band,
    "steps": _steps,
}


def _entry(series: Series) -> str:
    return series.label or "_nolegend_"


def _log_ticks(axis: Axis, decades: float) -> None:
    """Format ticks as plain numbers below three decades, and as powers of ten above."""
    if decades >= 3:
        axis.set_major_locator(LogLocator(numticks=10))
        axis.set_major_formatter(LogFormatterSciNotation())
        axis.set_minor_formatter(NullFormatter())
        return
    drawing.plain_ticks(axis, (1, 2, 5) if decades < 2 else (1, 3))
    if decades < 1:  # too few of them, perhaps none
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))


# ---------------------------------------------------------------- legends


def _common_legend(canvas: Figure, panels: tuple[Panel, ...]) -> float:
    """Draw one legend if all panels have the same; returns its height [inch], else 0."""
    first, *others = [[(series.label, series.look) for series in panel.series if series.label] for panel in panels]
    if not (first and others and all(entries == first for entries in others)):
        return 0.0
    handles, labels = _entries(canvas.axes[0], panels[0])
    room = canvas.get_figwidth() - 4 * _MARGIN
    return _fit(lambda n: canvas.legend(handles, labels, ncols=n, loc="lower center", **LEGEND), len(labels), room)


def _add_legends(canvas: Figure, panels: tuple[Panel, ...]) -> float:
    """Draw legends inside the panels where they hide no data, else below; returns the height [inch] below."""
    for axes, panel in zip(canvas.axes, panels, strict=True):
        handles, labels = _entries(axes, panel)
        if handles:
            axes.legend(handles, labels, **LEGEND)
    canvas.draw_without_rendering()
    needed: dict[int, float] = {}
    for axes, panel in zip(canvas.axes, panels, strict=True):
        if axes.get_legend() and _hides(axes, panel):
            row = axes.get_subplotspec().rowspan.start
            needed[row] = max(needed.get(row, 0.0), _legend_below(axes, panel))
    return sum(needed.values())


def _legend_below(axes: Axes, panel: Panel) -> float:
    """Draw the legend of a panel below its label; returns its height [inch]."""
    handles, labels = _entries(axes, panel)
    room = 1.1 * axes.get_window_extent().width / drawing.DPI
    labels = [_wrapped(axes.figure, label, room - _HANDLE, _LEGEND_PT) for label in labels]
    drop = (axes.get_window_extent().y0 - axes.xaxis.label.get_window_extent().y0) / drawing.DPI
    under = axes.transAxes + ScaledTranslation(0, -drop, axes.figure.dpi_scale_trans)
    style = {"loc": "upper center", "bbox_to_anchor": (0.5, 0), "bbox_transform": under, **LEGEND}
    return _fit(lambda n: axes.legend(handles, labels, ncols=n, **style), len(labels), room)


def _entries(axes: Axes, panel: Panel) -> tuple[list, list[str]]:
    """Handles and labels of the legend in the order of the series, which matplotlib does not keep."""
    handles, labels = axes.get_legend_handles_labels()
    order = [series.label for series in panel.series]
    pairs = sorted(zip(handles, labels, strict=True), key=lambda pair: order.index(pair[1]))
    return [handle for handle, _ in pairs], [label for _, label in pairs]


def _fit(legend: Callable[[int], Legend], most: int, room: float) -> float:
    """Draw a legend with as many columns as fit into a width [inch]; returns its height [inch]."""
    for columns in range(most, 0, -1):
        drawn = legend(columns)
        size = drawn.get_window_extent()
        if size.width / drawing.DPI <= room or columns == 1:
            break
        drawn.remove()
    return size.height / drawing.DPI


def _hides(axes: Axes, panel: Panel) -> bool:
    """Return whether the legend lies on data or a note."""
    box = axes.get_legend().get_window_extent()
    on_note = any(box.overlaps(text.get_window_extent()) for text in axes.texts)
    return on_note or any(box.count_contains(_ink(axes, series)) for series in panel.series)


def _ink(axes: Axes, series: Series) -> np.ndarray:
    """Pixels (n, 2) along everything that a series draws."""
    if series.kind == "steps":
        starts = np.column_stack([np.repeat(series.x, 2)[1:-1], np.repeat(series.y[:-1], 2)])
        return _along(axes.transData.transform(starts))
    corners = [np.column_stack([series.x, y]) for y in (series.low, series.y, series.high) if y is not None]
    # On a logarithmic axis the end of a bar may have no place: it gives NaN, which lies in no box.
    with np.errstate(invalid="ignore", divide="ignore"):
        pixels = np.array([axes.transData.transform(item) for item in corners])
    if series.kind == "line":
        return _along(pixels[0])
    across = _between(pixels[0], pixels[-1])
    return np.concatenate([across, *map(_along, pixels)]) if series.kind == "band" else across


def _along(pixels: np.ndarray) -> np.ndarray:
    return _between(pixels[:-1], pixels[1:])


def _between(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    return (first + _BETWEEN[:, None, None] * (last - first)).reshape(-1, 2)


# ---------------------------------------------------------------- text and room for it


def _caption(canvas: Figure, caption: str) -> Text:
    width = canvas.get_figwidth()
    text = _wrapped(canvas, caption, width - 4 * _MARGIN, _CAPTION_PT)
    written = canvas.text(2 * _MARGIN / width, 0, text, fontsize=_CAPTION_PT, va="bottom", linespacing=1.3)
    written.set_in_layout(False)
    return written


def _resize(canvas: Figure, height: float, caption: Text, common: float) -> None:
    """Set the height of the figure [inch]; the caption is at the bottom, the common legend above it."""
    canvas.set_figheight(height)
    caption.set_y(_MARGIN / height)
    top = (_size(caption)[1] + 2 * _MARGIN) / height
    canvas.get_layout_engine().below = top * height + common
    for legend in canvas.legends:
        legend.set_in_layout(False)
        legend.set_bbox_to_anchor((0, top, 1, 1), canvas.transFigure)


def _wrapped(canvas: Figure, text: str, width: float, size: float) -> str:
    """Break a text into lines of at most a width [inch], but not inside formulas.

    Each word is measured once, after a letter and a space: formulas of a whole line are slow to lay out.
    """
    letter = _width(canvas, "n", size)
    lines: list[str] = []
    taken = 0.0
    for word in re.findall(r"(?:\$[^$]*\$|\S)+", text):
        step = _width(canvas, f"n {word}", size) - letter
        if lines and taken + step <= width:
            lines[-1] += f" {word}"
            taken += step
        else:
            lines.append(word)
            taken = step
    return "\n".join(lines)


def _width(canvas: Figure, text: str, size: float) -> float:
    return _size(Text(0, 0, text, fontsize=size, figure=canvas))[0]


def _size(text: Text) -> tuple[float, float]:
    """Width and height [inch]."""
    box = text.get_window_extent()
    return box.width / drawing.DPI, box.height / drawing.DPI
