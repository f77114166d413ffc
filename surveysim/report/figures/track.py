"""Track of the boresight in one observation, and hits of all observations."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from mapmaker.geometry import sky_offsets
from surveysim.reduction.setup import Setup
from surveysim.report.figures.style import BLACK, GREY, LEGEND, VERMILION, finish, new_figure
from surveysim.survey.coadds import CoAdds
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.simulation import observation_path

MOST_POINTS = 6000  # of a track: more look the same
STEADY = 0.02  # of the speed: a smaller range is drawn as time
_UNITS = {"arcsec": np.pi / 648_000, "arcmin": np.pi / 10_800, "deg": np.pi / 180}


def track_and_hits(setup: Setup, coadds: CoAdds) -> Figure:
    """Draw the boresight of the first observation with the detectors at its start, and samples in pixels of the map.

    The track is coloured by its speed on the sky, or by time where the speed is constant. Offsets are from the centre
    of the field, east to the left.
    """
    figure = new_figure(10.0, 4.6)
    left, right = figure.subplots(1, 2, gridspec_kw={"wspace": 0.45})
    _draw_track(left, setup)
    _draw_hits(right, setup, coadds)
    entries = left.get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=len(entries[1]), markerscale=4, **LEGEND)
    return figure


def _draw_track(axes: Axes, setup: Setup) -> None:
    pointing = observation_path(setup.observing, 0)[1]
    place, lost, colour, label = track_segments(pointing)
    array = np.stack(sky_offsets(setup.camera.focal_plane, pointing.array_angle_rad[:1]), axis=-1)[0] + place[0, 0]
    unit, scale = _unit(max(np.abs(place).max(), np.abs(array).max()))
    axes.plot(*array.T / scale, ".", ms=2, mew=0, color=GREY, label="detectors at the start")
    seen = axes.add_collection(LineCollection(place[~lost] / scale, array=colour[~lost], cmap="viridis", lw=0.9))
    if lost.any():
        axes.add_collection(
            LineCollection(place[lost] / scale, colors=VERMILION, lw=0.9, label="turnarounds, in no map")
        )
    _frame(axes, setup, unit)
    axes.set_title("Boresight of the first observation", fontsize=10)
    _colour_bar(axes, seen, label)


def _draw_hits(axes: Axes, setup: Setup, coadds: CoAdds) -> None:
    geometry = setup.analysis.geometry
    x, y = (n * geometry.pixel_rad / 2 for n in (geometry.n_x, geometry.n_y))
    unit, scale = _unit(max(x, y))
    extent = (x / scale, -x / scale, -y / scale, y / scale)
    hits = np.where(coadds.hits[0] > 0, coadds.hits[0], np.nan)
    drawn = axes.imshow(hits, origin="lower", extent=extent, cmap="cividis", vmin=0, interpolation="nearest")
    _frame(axes, setup, unit)
    axes.set_title("Samples of all observations", fontsize=10)
    _colour_bar(axes, drawn, "Samples in a pixel")


def track_segments(pointing: Pointing) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Divide a track into segments between samples that follow each other.

    Returns
    -------
    place : (n, 2, 2)
        Ends (xi, eta) of the segments [rad].
    lost : (n,) bool
        Segments of samples that no map has.
    colour : (n,)
        Speed on the sky, or time.
    label
        Quantity and unit of `colour`.
    """
    step = -(-len(pointing.time_s) // MOST_POINTS)
    time, track = pointing.time_s[::step], np.column_stack([pointing.xi_rad, pointing.eta_rad])[::step]
    flagged = np.zeros(len(pointing.time_s), bool) if pointing.flagged is None else pointing.flagged
    after = np.diff(time)
    joined = after < 1.5 * np.median(after)  # not over a turnaround that is left out
    place = np.stack([track[:-1], track[1:]], axis=1)[joined]
    lost = (flagged[::step][:-1] | flagged[::step][1:])[joined]
    speed = np.linalg.norm(place[:, 1] - place[:, 0], axis=1) / after[joined]
    if np.ptp(speed[~lost]) > STEADY * speed[~lost].mean():
        unit, scale = _unit(speed[~lost].max())
        return place, lost, speed / scale, f"Speed on the sky [{unit}/s]"
    return place, lost, time[:-1][joined] / 60, "Time [min]"


def _unit(largest_rad: float) -> tuple[str, float]:
    """Name and size of the unit of angles that gives numbers from about 2 on."""
    return next((name, size) for name, size in reversed(_UNITS.items()) if largest_rad > 2 * size or name == "arcsec")


def _frame(axes: Axes, setup: Setup, unit: str) -> None:
    """Label the axes, draw the scored square, and put east to the left."""
    if setup.scene.score is not None:
        side = setup.scene.score.size_rad / _UNITS[unit]
        axes.add_patch(Rectangle((-side / 2, -side / 2), side, side, fill=False, ec=BLACK, lw=1.2, label="scored"))
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.xaxis.set_inverted(True)
    finish(axes, f"Offset east [{unit}]", f"Offset north [{unit}]")
    axes.set_ylabel(f"Offset north [{unit}]", fontsize=10)


def _colour_bar(axes: Axes, drawn: ScalarMappable, label: str) -> None:
    bar = axes.figure.colorbar(drawn, ax=axes, fraction=0.046, pad=0.03, aspect=24)
    bar.set_label(label, fontsize=10)
    bar.ax.tick_params(labelsize=9)
