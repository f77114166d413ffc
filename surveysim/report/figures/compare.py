"""Figures of a comparison of runs: spectra of their maps and time-streams over each other."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.report.figures.style import (
    BLACK,
    BLUE,
    ELL,
    GREEN,
    LEGEND,
    ORANGE,
    PURPLE,
    SKY,
    UK2_CMB,
    VERMILION,
    finish,
    panels,
    plain,
    plain_ticks,
    save,
)
from surveysim.studies.compare.comparison import RunComparison
from surveysim.studies.compare.finished_run import SPECTRA, STREAMS

_COLOURS = (BLACK, VERMILION, BLUE, GREEN, PURPLE, ORANGE, SKY)
_DASHES = ("-", "--", "-.", ":")  # a new kind each time that the colours are used up
_WIDEST, _NARROWEST = 3.0, 1.3  # widths of the first and the last line: lines that coincide all show
Columns = Mapping[str, np.ndarray]


def drawings(result: RunComparison) -> dict[str, Callable[[Path], None]]:
    """Return the function that draws each figure as a PNG, by name."""
    kinds = {"map_psd": map_psd, "transfer_function": transfer_function, "timestream_psd": timestream_psd}
    return {name: partial(_draw, draw, result) for name, draw in kinds.items()}


def _draw(draw: Callable[[RunComparison], Figure], result: RunComparison, path: Path) -> None:
    save(draw(result), path)


def map_psd(result: RunComparison) -> Figure:
    """Draw the noise PSD of each run's map of the actual data, with its error."""
    figure, (axes,) = panels(1)
    for columns, label, look in _runs(result, SPECTRA):
        ell, noise, error = (columns[name] for name in ("ell", f"noise_{ACTUAL}", f"noise_error_{ACTUAL}"))
        axes.plot(ell, noise, label=label, **look)
        axes.fill_between(ell, np.maximum(noise - error, noise / 10), noise + error, color=look["color"], alpha=0.15)
    axes.set(xscale="log", yscale="log")
    _finish(figure, axes, ELL, f"Map noise PSD [{UK2_CMB} sr]")
    plain_ticks(axes.xaxis)
    return figure


def transfer_function(result: RunComparison) -> Figure:
    """Draw the transfer function of each run's cleaning, with its error."""
    figure, (axes,) = panels(1)
    for columns, label, look in _runs(result, SPECTRA):
        names = (f"transfer_function_{ACTUAL}", f"transfer_function_error_{ACTUAL}")
        axes.errorbar(columns["ell"], *(columns[name] for name in names), label=label, capsize=2, **look)
    axes.set_ylim(bottom=0)
    axes.set_xlim(left=0)
    _finish(figure, axes, ELL, "Power transmission")
    return figure


def timestream_psd(result: RunComparison) -> Figure:
    """Draw the median PSD of each run's time-streams, before (thin) and after cleaning."""
    figure, (axes,) = panels(1)
    for columns, label, look in _runs(result, STREAMS):
        used = columns["frequency"] > 0
        axes.plot(columns["frequency"][used], columns["raw_median"][used], **look | {"lw": look["lw"] / 2})
        axes.plot(columns["frequency"][used], columns["clean_median"][used], label=label, **look)
    axes.set(xscale="log", yscale="log")
    _finish(figure, axes, "Frequency [Hz]", r"PSD [mK$^2$/Hz]; thin: before cleaning")
    plain_ticks(axes.xaxis)
    return figure


def _runs(result: RunComparison, table: str) -> Iterator[tuple[Columns, str, dict]]:
    """Yield the columns of a table of each run that has it, with label and look."""
    for number, run in enumerate(result.runs):
        columns = run.table(table)
        if columns:
            turn, place = divmod(number, len(_COLOURS))
            width = _WIDEST - (_WIDEST - _NARROWEST) * number / (len(result.runs) - 1)
            look = {"color": _COLOURS[place], "ls": _DASHES[turn % len(_DASHES)], "lw": width}
            yield columns, plain(run.label), look


def _finish(figure: Figure, axes: Axes, x_label: str, y_label: str) -> None:
    """Set labels, and a legend below the axes, as labels may be long."""
    finish(axes, x_label, y_label)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=1, **LEGEND)
