"""Figures of a report page, as PNG files: maps with sky coordinates, and noise PSDs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, StrMethodFormatter

from mapmaker.files import atomic_write
from mapmaker.geometry import MapGeometry, plane_directions

DPI = 150
# The palette of Okabe and Ito, told apart by all kinds of colour vision.
COLOURS = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MARKERS = "osD^v<>"

Ticks = tuple[list[float], list[str]]  # places and labels


@dataclass(frozen=True)
class MapImage:
    """A map to draw: image (n_y, n_x), NaN where there is nothing; label, colours, and their range."""

    image: np.ndarray
    label: str
    colours: str
    low: float
    high: float


@dataclass(frozen=True)
class Curve:
    """A PSD to draw: multipole, value and error (n,), and its name."""

    ell: np.ndarray
    psd: np.ndarray
    error: np.ndarray
    name: str


def draw_maps(path: Path, geometry: MapGeometry, images: Sequence[MapImage]) -> None:
    """Draw maps side by side."""
    figure = _figure(10.0, 4.1 if len(images) == 2 else 4.6)
    for axes, item in zip(figure.subplots(1, len(images), squeeze=False)[0], images, strict=True):
        drawn = axes.imshow(
            item.image, origin="lower", cmap=item.colours, vmin=item.low, vmax=item.high, interpolation="nearest"
        )
        for axis, (places, labels) in zip((axes.xaxis, axes.yaxis), sky_ticks(geometry), strict=True):
            axis.set_ticks(places, labels, fontsize=9)
        axes.set_xlabel("Right ascension", fontsize=10)
        axes.set_ylabel("Declination", fontsize=10)
        bar = figure.colorbar(drawn, ax=axes, shrink=0.85)
        bar.set_label(item.label, fontsize=10)
        bar.ax.tick_params(labelsize=9)
    _save(figure, path)


def draw_spectra(path: Path, curves: Sequence[Curve]) -> None:
    """Draw noise PSDs over multipole."""
    figure = _figure(7.0, 4.6)
    axes: Axes = figure.subplots()
    for k, item in enumerate(curves):
        style = {"color": COLOURS[k % len(COLOURS)], "marker": _MARKERS[k % len(_MARKERS)]}
        axes.errorbar(item.ell, item.psd, item.error, label=item.name, ms=3, lw=1, elinewidth=0.7, **style)
    axes.set_yscale("log")
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_xlabel(r"Multipole $\ell$", fontsize=10)
    axes.set_ylabel(r"Noise PSD [mK$^2$ sr]", fontsize=10)
    axes.tick_params(which="both", labelsize=9, direction="in", top=True, right=True)
    axes.grid(alpha=0.25, lw=0.5)
    axes.legend(fontsize=8.5, frameon=False)
    _save(figure, path)


def _figure(width: float, height: float) -> Figure:
    """Make an empty figure of a size [inch], drawn with Agg."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: Path) -> None:
    with atomic_write(path) as partial:
        figure.savefig(partial, format="png")
    figure.clear()


def sky_ticks(geometry: MapGeometry) -> tuple[Ticks, Ticks]:
    """Find ticks at the lower edge of a map by right ascension, and at its left edge by declination.

    Their places are in pixels, 0 at the centre of the first.
    """
    column, row = np.arange(geometry.n_x + 1) - 0.5, np.arange(geometry.n_y + 1) - 0.5
    east, north = (
        (n / 2 - 0.5 - place) * geometry.pixel_rad for n, place in ((geometry.n_x, column), (geometry.n_y, row))
    )
    ra, _ = plane_directions(geometry, east, np.full_like(east, -north[0]))
    _, dec = plane_directions(geometry, np.full_like(north, east[0]), -north)
    return _ticks(column, np.degrees(np.unwrap(ra)), 0.0), _ticks(row, np.degrees(dec), -180.0)


def _ticks(place: np.ndarray, degrees: np.ndarray, least: float) -> Ticks:
    """Find where an angle along an edge is a multiple of a round step; labels start at `least`."""
    values = MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]).tick_values(degrees.min(), degrees.max())
    digits = max(0, *(len(f"{value:.6g}".partition(".")[2]) for value in values))
    places, labels = [], []
    for value in values:
        for at in np.flatnonzero(np.diff(degrees >= value)):
            share = (value - degrees[at]) / (degrees[at + 1] - degrees[at])
            places.append(float(place[at] + share))
            labels.append(f"{(value - least) % 360 + least:.{digits}f}\N{DEGREE SIGN}")
    return places, labels
