"""The scene's own sky, the map that comes back of it, and the transfer function between them."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surveysim.report.figures.sky_map import sky_ticks
from surveysim.report.figures.style import UK_CMB, new_figure
from surveysim.results.sky_recovery import SkyRecovery

# inch: figure, panels and their left edges, colour bars, the room for labels below
WIDTH, HEIGHT, SIDE, BAR, BELOW = 12.4, 4.0, 2.75, 0.13, 0.58
LEFT = (0.8, 4.5, 8.95)


def sky_in_and_out(item: SkyRecovery, cmb_per_rj: float) -> Figure:
    """Draw the sky that goes in and the one that comes out, in uK_CMB on one scale, and the transfer of modes.

    Each is less its median, as cleaning removes the mean. The scale is that of the output, 99.9 % of its pixels.
    """
    figure = new_figure(WIDTH, HEIGHT)
    figure.set_layout_engine("none")
    skies = [1e3 * cmb_per_rj * np.where(item.weight > 0, plane, np.nan) for plane in (item.input_mk, item.output_mk)]
    skies = [sky - np.nanmedian(sky) for sky in skies]
    # Long waves of the input can be far brighter than all that comes back.
    reach = float(np.nanpercentile(np.abs(skies[1]), 99.9)) or 1.0
    style = {"cmap": "RdBu_r", "vmin": -reach, "vmax": reach, "interpolation": "nearest"}
    x_ticks, y_ticks = sky_ticks(item.geometry)
    for number, (sky, label) in enumerate(zip(skies, ("Input sky", "Output map"), strict=True)):
        axes = _panel(figure, number)
        drawn = axes.imshow(sky, origin="lower", **style)
        for axis, (places, labels) in zip((axes.xaxis, axes.yaxis), (x_ticks, y_ticks), strict=True):
            axis.set_ticks(places, labels, fontsize=8.5)
        axes.set_xlabel("Right ascension", fontsize=10)
        axes.set_title(f"{label} less its median [{UK_CMB}]", fontsize=10)
    figure.axes[0].set_ylabel("Declination", fontsize=10)
    figure.colorbar(drawn, cax=_beside(figure, 1), extend="both").ax.tick_params(labelsize=8.5)
    _draw_transfer(figure, item)
    return figure


def _draw_transfer(figure: Figure, item: SkyRecovery) -> None:
    axes = _panel(figure, 2)
    n = item.transfer_plane.shape[1]
    both = np.concatenate([item.transfer_plane[::-1, ::-1], item.transfer_plane], axis=1)  # of real maps
    most = n * item.bin_width
    style = {"cmap": "cividis", "vmin": 0, "vmax": 1, "interpolation": "nearest"}
    drawn = axes.imshow(both, origin="lower", extent=(-most, most, -most, most), **style)
    axes.set_xlabel(r"Multipole $\ell_x$", fontsize=10)
    axes.set_ylabel(r"Multipole $\ell_y$", fontsize=10)
    axes.tick_params(labelsize=8.5)
    axes.set_title("Transfer function (amplitude)", fontsize=10)
    figure.colorbar(drawn, cax=_beside(figure, 2)).ax.tick_params(labelsize=8.5)


def _panel(figure: Figure, number: int) -> Axes:
    return figure.add_axes((LEFT[number] / WIDTH, BELOW / HEIGHT, SIDE / WIDTH, SIDE / HEIGHT))


def _beside(figure: Figure, number: int) -> Axes:
    """Axes for the colour bar of a panel."""
    return figure.add_axes(((LEFT[number] + SIDE + 0.12) / WIDTH, BELOW / HEIGHT, BAR / WIDTH, SIDE / HEIGHT))
