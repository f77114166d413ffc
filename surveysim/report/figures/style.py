"""Common style of all figures: canvas, palette, axes, ticks, and PNG files."""

import gc
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from PIL import Image

from mapmaker.files import atomic_write
from surveysim.report.figures.margins import BEFORE, MeasuredMargins

DPI = 150
COMPRESSION = 6  # of 9, which takes ten times as long for files a tenth smaller
NEARLY_WHITE = 250
LONGEST = 80  # letters of a user's text in a figure

# The palette of Okabe and Ito, told apart by all kinds of colour vision.
BLACK, GREEN, BLUE, VERMILION, PURPLE = "#000000", "#009E73", "#0072B2", "#D55E00", "#CC79A7"
ORANGE, SKY = "#E69F00", "#56B4E9"
GREY = "#7F7F7F"

ELL = r"Multipole $\ell$"
UK_CMB = r"$\mu$K$_\mathrm{CMB}$"
UK2_CMB = r"$\mu$K$_\mathrm{CMB}^2$"

LEGEND = {"fontsize": 8.5, "frameon": False}


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure of a size [inch], drawn with Agg, with margins that fit the labels."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout=MeasuredMargins())
    FigureCanvasAgg(figure)
    figure.subplots_adjust(
        left=min(0.4, BEFORE["left"] / width),
        right=1 - min(0.4, BEFORE["right"] / width),
        bottom=min(0.4, BEFORE["bottom"] / height),
        top=1 - min(0.4, BEFORE["top"] / height),
    )
    return figure


def panels(n: int, height: float = 4.6) -> tuple[Figure, list[Axes]]:
    """Make a figure of a height [inch] with n axes in a row."""
    figure = new_figure(10 if n > 1 else 6.4, height)
    return figure, list(figure.subplots(1, n, squeeze=False, sharey=True)[0])


def finish(axes: Axes, x_label: str, y_label: str) -> None:
    """Set labels (the y label in the first column only), ticks inwards on all sides, and a light grid."""
    axes.set_xlabel(x_label, fontsize=10)
    if axes.get_subplotspec().is_first_col():
        axes.set_ylabel(y_label, fontsize=10)
    axes.tick_params(which="both", labelsize=9, direction="in", top=True, right=True)
    axes.grid(alpha=0.25, lw=0.5)


def legend(axes: Axes) -> None:
    """Add a frameless legend where it hides least."""
    axes.legend(**LEGEND)


def plain_ticks(axis: Axis, marks: tuple[float, ...] = (1, 2, 5)) -> None:
    """Label a logarithmic axis with numbers such as 0.5 and 2000, at `marks` in each decade."""
    axis.set_major_locator(LogLocator(subs=marks))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def plain(text: str) -> str:
    """Escape and shorten a text of the user: dollar signs begin no formula, and it fits the width of a figure."""
    shown = "".join(letter if letter.isprintable() else "?" for letter in text)
    return (shown if len(shown) <= LONGEST else f"{shown[: LONGEST - 3]}...").replace("$", r"\$")


def three_digits(value: float) -> str:
    """Format a number with three digits, without an exponent up to a million."""
    return f"{float(f'{value:.3g}'):g}"


def _in_few_colours(image: Image.Image) -> Image.Image:
    """Reduce an image to a palette, by the method that takes a seventh of the time of Pillow's default."""
    reduced = image.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    palette = np.array(reduced.getpalette()).reshape(-1, 3)
    palette[palette.min(axis=1) >= NEARLY_WHITE] = 255  # the mean of white and of what is almost white
    reduced.putpalette(palette.ravel().tolist())
    return reduced


def save(figure: Figure, path: Path, full_colour: bool = False) -> None:
    """Write a PNG atomically, and empty the figure; `full_colour` for figures with a colour bar."""
    figure.canvas.draw()
    image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())
    if not full_colour:
        # Lines look the same in 256 colours and take a third of the space.
        image = _in_few_colours(image)
    with atomic_write(path) as partial:
        image.save(partial, "PNG", dpi=(DPI, DPI), compress_level=COMPRESSION)
    # Parts of a figure refer to each other: megabytes of it would wait for a collection, and leave holes in memory.
    figure.clear()
    gc.collect()
