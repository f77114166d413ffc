"""Draw the guide's picture of the scan patterns: `python docs/scan_pictures.py`."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image

import surveysim
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import Scene
from surveysim.timestreams.simulation import observation_path

ROOT = Path(__file__).parent.parent
PICTURE = ROOT / "docs" / "_static" / "scan_patterns.png"
PONG = {
    "pattern": "pong",
    "width": "30 arcmin",
    "height": "30 arcmin",
    "spacing": "4 arcmin",
    "velocity": "4 arcmin / s",
    "terms": 5,
    "duration": "6 min",
    "chunk": "15 s",
    "dither": "0 arcmin",
    "sample_rate": "10 Hz",
}
# Title, scene and changes of each panel.
PANELS = (
    ("raster\n(lynx)", "lynx", {}),
    ("azimuth\n(azimuth_fyst)", "azimuth_fyst", {}),
    ("daisy\n(daisy_mustang2)", "daisy_mustang2", {}),
    ("lissajous\n(lissajous_toltec)", "lissajous_toltec", {"scan.duration": "10 min"}),
    ("pong\n(5 terms)", "lynx", {"scan": PONG}),
)


def main() -> None:
    """Draw the boresight of the first observation of each pattern; write the picture in 256 colours."""
    figure = Figure(figsize=(11, 3.1), dpi=110, layout="constrained")
    panels = figure.subplots(1, len(PANELS))
    for axes, (title, name, changes) in zip(panels, PANELS, strict=True):
        drawn = draw_track(axes, surveysim.load_scene(ROOT / "scenarios" / f"{name}.toml", changes))
        axes.set_title(title, fontsize=9)
    panels[0].set_ylabel("Offset north [arcmin]", fontsize=9)
    bar = figure.colorbar(drawn, ax=panels[-1], fraction=0.06, pad=0.04)
    bar.set_label("Speed over the largest", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    figure.savefig(PICTURE)
    Image.open(PICTURE).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(PICTURE, optimize=True)


def draw_track(axes: Axes, scene: Scene) -> LineCollection:
    """Draw the track about the centre of the field, coloured by its speed over the largest; turnarounds in red."""
    pointing = observation_path(prepare(scene).observing, 0)[1]
    track = np.degrees(np.column_stack([pointing.xi_rad, pointing.eta_rad])) * 60
    after = np.diff(pointing.time_s)
    joined = after < 1.5 * np.median(after)  # not over a turnaround that is left out
    lines = np.stack([track[:-1], track[1:]], axis=1)[joined]
    speed = np.linalg.norm(np.diff(track, axis=0), axis=1)[joined] / after[joined]
    lost = np.zeros(len(lines), bool) if pointing.flagged is None else pointing.flagged[1:][joined]
    shown = {"array": (speed / speed[~lost].max())[~lost], "cmap": "viridis", "clim": (0, 1), "lw": 0.7}
    drawn = axes.add_collection(LineCollection(lines[~lost], **shown))
    axes.add_collection(LineCollection(lines[lost], colors="#D55E00", lw=0.7))
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.xaxis.set_inverted(True)
    axes.set_xlabel("Offset east [arcmin]", fontsize=9)
    axes.tick_params(labelsize=8, direction="in")
    return drawn


if __name__ == "__main__":
    main()
