"""Co-added map of a run and its noise."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from mapmaker.report.figures import sky_ticks
from surveysim.reduction.setup import Setup
from surveysim.report.figures.style import (
    BLACK,
    UK_CMB,
    new_figure,
    three_digits,
)
from surveysim.survey.coadds import CoAdds

# inch: figure, images, colour bars, and the room for labels to the left of an image and below
WIDTH, HEIGHT, SIDE, BAR, LEFT, BELOW = 10.0, 4.1, 3.15, 0.15, 0.8, 0.58
DEEPEST = 4  # the map is shown where its noise is at most this many times the lowest


def coadded_map(setup: Setup, coadds: CoAdds) -> Figure:
    """Draw the co-added map of the actual data, smoothed with the beam, and its noise per pixel, both in uK_CMB.

    The noise follows from the weights: from the scored multipoles, as if white. Pixels with a noise of the smoothed
    weights above `DEEPEST` times its minimum are blank.
    """
    signal, noise = map_planes(setup, coadds)
    rows = setup.analysis.region.patch if setup.analysis.region else slice(None)
    reach = np.nanpercentile(np.abs(signal[rows, rows]), 99.5)
    lowest = np.nanmin(noise)
    side = three_digits(np.degrees(setup.analysis.geometry.pixel_rad) * 3600)
    shown = (
        (signal, "Signal smoothed with the beam", "RdBu_r", -reach, reach, "both"),
        (noise, f"Noise of {side} arcsec pixels", "cividis_r", lowest, DEEPEST * lowest, "max"),
    )
    figure = new_figure(WIDTH, HEIGHT)
    figure.set_layout_engine("none")  # images and their colour bars have one height
    for number, (image, label, colours, low, high, extend) in enumerate(shown):
        left, bottom = LEFT + number * WIDTH / 2, BELOW
        axes = figure.add_axes((left / WIDTH, bottom / HEIGHT, SIDE / WIDTH, SIDE / HEIGHT))
        drawn = axes.imshow(image, origin="lower", cmap=colours, vmin=low, vmax=high, interpolation="nearest")
        _sky_axes(axes, setup)
        beside = ((left + SIDE + BAR) / WIDTH, bottom / HEIGHT, BAR / WIDTH, SIDE / HEIGHT)
        bar = figure.colorbar(drawn, cax=figure.add_axes(beside), extend=extend)
        bar.set_label(f"{label} [{UK_CMB}]", fontsize=10)
        bar.ax.tick_params(labelsize=9)
    return figure


def map_planes(setup: Setup, coadds: CoAdds) -> tuple[np.ndarray, np.ndarray]:
    """Compute smoothed signal and noise (n_y, n_x) [uK_CMB] of the actual data, NaN where too noisy to show."""
    from scipy.ndimage import gaussian_filter

    instrument, weight = setup.scene.instrument, coadds.weight[0]
    to_ukcmb = 1e3 * instrument.cmb_per_rj
    sigma = instrument.beam_fwhm_rad / np.sqrt(8 * np.log(2)) / setup.analysis.geometry.pixel_rad
    # Sums and weights smoothed apart: noisy pixels count for less in their neighbours.
    total, spread = gaussian_filter(coadds.sums[0], sigma), gaussian_filter(weight, sigma)
    seen = spread > spread.max() / DEEPEST**2
    empty = np.full(weight.shape, np.nan)
    signal = np.divide(total, spread, out=empty.copy(), where=seen)
    noise = np.divide(1, np.sqrt(weight), out=empty, where=seen & (weight > 0))
    return to_ukcmb * signal, to_ukcmb * noise


def _sky_axes(axes: Axes, setup: Setup) -> None:
    """Label the axes of a map (in pixels), and draw the frame of the scored patch."""
    geometry = setup.analysis.geometry
    for axis, (places, labels) in zip((axes.xaxis, axes.yaxis), sky_ticks(geometry), strict=True):
        axis.set_ticks(places, labels, fontsize=9)
    axes.set_xlabel("Right ascension", fontsize=10)
    axes.set_ylabel("Declination", fontsize=10)
    if setup.scene.score is not None:
        side = setup.scene.score.size_rad / geometry.pixel_rad
        corner = [(n - side) / 2 - 0.5 for n in (geometry.n_x, geometry.n_y)]
        axes.add_patch(Rectangle(corner, side, side, fill=False, ec=BLACK, lw=1.2))
        x, y = (start + side / 40 for start in corner)
        axes.text(x, y, "scored", fontsize=8.5, bbox={"fc": "white", "ec": "none", "alpha": 0.7, "pad": 1.5})
