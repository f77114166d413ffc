"""Figures as points: their tables, how they are drawn, and the geometry of the thin screen's."""

from math import pi, radians, tan
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table
from PIL import Image

from surveysim.paper.figures.model import (
    BANDS_HZ,
    SITE_LOOKS,
    column_edges,
    edge_streams,
    opacity_figure,
    screen_figure,
)
from surveysim.reduction.setup import Setup, prepare
from surveysim.report.figures.layout import draw_figure, lay_out
from surveysim.report.figures.points import points_table
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.scene.scene import load_scene

LYNX = Path(__file__).parents[3] / "scenarios" / "lynx.toml"
RISING = np.arange(1.0, 6.0)
OF_EACH_KIND = (
    Series("a line", "line", RISING, RISING**2, "black --"),
    Series("points", "points", RISING, RISING, "vermilion"),
    Series("bars", "points", RISING, RISING + 0.1, "blue :", RISING - 0.5, RISING + 1.0),
    Series("a band", "band", RISING, RISING, "sky", RISING - 1.0, RISING + 1.0),
    Series("", "steps", RISING, RISING[::-1], "purple -."),
)
CAPTION = "A caption of $B^2$ = 280 mK$^2$ that is longer than a line. " * 6


def _panel(*series: Series, **options) -> Panel:
    return Panel("a panel", "x [m]", "y [mK]", series, **options)


def _figure(*panels: Panel, columns: int = 1) -> PaperFigure:
    return PaperFigure(5, "a figure", CAPTION, panels, columns)


@pytest.fixture(scope="module")
def setup() -> Setup:
    return prepare(load_scene(LYNX, {"score": None, "observations": 3}))


# ---------------------------------------------------------------- records and tables


@pytest.mark.parametrize(
    "arrays",
    [
        {"y": RISING[:-1]},
        {"y": RISING, "low": RISING[1:], "high": RISING},
        {"y": RISING, "low": RISING},
        {"y": RISING, "kind": "band"},
    ],
)
def test_series_of_unequal_lengths_or_with_one_end_are_refused(arrays):
    with pytest.raises(ValueError, match="found"):
        Series(**{"label": "a", "kind": "points", "x": RISING, "look": "black"} | arrays)


def test_points_come_back_from_the_table(tmp_path):
    figure = _figure(_panel(*OF_EACH_KIND), _panel(OF_EACH_KIND[2]))
    points_table(figure).write(tmp_path / "points.ecsv", format="ascii.ecsv")
    table = Table.read(tmp_path / "points.ecsv", format="ascii.ecsv")
    assert table.meta["figure"] == 5 and table.meta["caption"] == CAPTION
    assert [panel["y"] for panel in table.meta["panels"]] == ["y [mK]", "y [mK]"]
    assert len(table) == 6 * len(RISING)
    start = 0
    for number, panel in enumerate(figure.panels, start=1):
        for series in panel.series:
            rows = table[start : start + len(series.x)]
            start += len(series.x)
            assert set(rows["panel"]) == {number} and set(rows["kind"]) == {series.kind}
            assert list(np.ma.filled(rows["series"], "")) == [series.label] * len(series.x)
            for name in ("x", "y", "low", "high"):
                values = getattr(series, name)
                expected = np.full(len(series.x), np.nan) if values is None else values
                np.testing.assert_array_equal(np.ma.filled(rows[name], np.nan), expected)


# ---------------------------------------------------------------- drawing


def test_each_kind_of_series_is_drawn(tmp_path):
    draw_figure(_figure(_panel(*OF_EACH_KIND, notes=((2.0, 20.0, "a note"),))), tmp_path / "five.png")
    assert [path.name for path in tmp_path.iterdir()] == ["five.png"]
    with Image.open(tmp_path / "five.png") as image:
        assert image.format == "PNG" and image.info["dpi"] == pytest.approx((150, 150), abs=0.1)
        seen = {colour for _, colour in image.convert("RGB").getcolors(1 << 16)}
    for wanted in ((0, 0, 0), (0xD5, 0x5E, 0x00), (0x00, 0x72, 0xB2), (0xCC, 0x79, 0xA7)):
        assert min(np.abs(np.subtract(wanted, colour)).max() for colour in seen) < 12


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_points_of_one_value_are_drawn_without_warnings(tmp_path):
    """Of one observation's fit, all but for rounding; matplotlib leaves no room about them on a logarithmic axis."""
    x = 52141.01227743425 * np.array([1.0, 1.0 + 1e-15])
    panel = _panel(Series("a", "line", x, np.array([3.0, 12.0]), "black"), x_log=True, y_log=True)
    draw_figure(_figure(panel), tmp_path / "one.png")
    low, high = lay_out(_figure(panel)).axes[0].get_xlim()
    assert low < x[0] / 1.5 and high > 1.5 * x[0]


def test_nothing_is_left_of_a_figure_that_fails(tmp_path):
    with pytest.raises(ValueError, match="found look 'puce'"):
        draw_figure(_figure(_panel(Series("a", "line", RISING, RISING, "puce"))), tmp_path / "five.png")
    with pytest.raises(ValueError, match="found no panel"):
        draw_figure(_figure(), tmp_path / "five.png")
    assert list(tmp_path.iterdir()) == []


def _ticks(decades: float) -> list[str]:
    x = np.geomspace(2.0, 2.0 * 10**decades, 9)
    canvas = lay_out(_figure(_panel(Series("a", "line", x, x, "black"), x_log=True, x_range=(x[0], x[-1]))))
    canvas.draw_without_rendering()
    low, high = canvas.axes[0].get_xlim()
    ticks = zip(canvas.axes[0].get_xticks(), canvas.axes[0].get_xticklabels(), strict=True)
    return [label.get_text() for value, label in ticks if low <= value <= high]


def test_ticks_of_logarithmic_axes():
    assert _ticks(0.3) == ["2", "2.5", "3", "3.5"]
    assert _ticks(1.5) == ["2", "5", "10", "20", "50"]
    assert _ticks(2.5) == ["3", "10", "30", "100", "300"]
    assert _ticks(4.0) == [rf"$\mathdefault{{10^{{{power}}}}}$" for power in (1, 2, 3, 4)]


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_caption_legends_and_panels_lie_apart(columns):
    rng = np.random.default_rng(1)
    crowd = Series("a crowd of points", "points", rng.random(900), rng.random(900), "blue")
    panels = [_panel(OF_EACH_KIND[0]), _panel(crowd), _panel(OF_EACH_KIND[3]), _panel(crowd, square=True)]
    canvas = lay_out(_figure(*panels, columns=columns))
    canvas.draw_without_rendering()
    title, caption = (text.get_window_extent() for text in canvas.texts)
    boxes = [axes.get_tightbbox() for axes in canvas.axes]
    assert caption.y0 > 0 and caption.x1 < canvas.bbox.width and title.y1 < canvas.bbox.height
    assert caption.y1 < min(box.y0 for box in boxes) and title.y0 > max(box.y1 for box in boxes)
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    below = [axes.get_legend().get_window_extent().y1 < axes.get_window_extent().y0 for axes in canvas.axes]
    assert below == [False, True, False, True]


def test_panels_with_the_same_series_share_a_legend():
    canvas = lay_out(_figure(_panel(*OF_EACH_KIND), _panel(*OF_EACH_KIND), columns=2))
    canvas.draw_without_rendering()
    (shared,) = canvas.legends
    assert [text.get_text() for text in shared.get_texts()] == ["a line", "points", "bars", "a band"]
    box = shared.get_window_extent()
    assert canvas.texts[-1].get_window_extent().y1 < box.y0
    assert box.y1 < min(axes.get_tightbbox().y0 for axes in canvas.axes)
    assert all(axes.get_legend() is None for axes in canvas.axes)


# ---------------------------------------------------------------- the paper's figures of the model


def test_opacity_of_every_site_with_its_median():
    figure = opacity_figure()
    assert len(figure.panels) == len(BANDS_HZ)
    for panel in figure.panels:
        lines, points = panel.series[: len(SITE_LOOKS)], panel.series[len(SITE_LOOKS) :]
        assert [point.x[0] for point in points] == [1.68, 0.25, 1.0, 0.83]  # section 1.2 of the paper, and 3.4
        for line, point in zip(lines, points, strict=True):
            assert np.interp(point.x[0], line.x, line.y) == pytest.approx(point.y[0], rel=1e-3)
            assert (np.diff(line.y) > 0).all()


def test_columns_are_as_wide_as_the_aperture_and_apart_by_angle_times_height():
    heights, offset = np.array([0.0, 1000.0]), radians(4 / 60)
    for elevation in (radians(40), radians(63), pi / 2):
        near, far = column_edges(elevation, 0.0, 8.0, heights)
        np.testing.assert_allclose((far - near) * np.sin(elevation), 8.0, rtol=1e-12)
        centres = [np.mean(column_edges(elevation, side * offset, 8.0, heights), axis=0) for side in (-1, 0, 1)]
        np.testing.assert_allclose([centre[0] for centre in centres], 0.0, atol=2e-5)
        np.testing.assert_allclose(centres[1][1], 1000 / tan(elevation), atol=1e-9)
        # Slant distance h / sin(el), and once more sin(el) from across the column to the horizontal.
        apart = 1000 * 2 * offset / np.sin(elevation) ** 2
        assert centres[0][1] - centres[2][1] == pytest.approx(apart, rel=1e-5)


def test_footprints_of_the_screen_figure(setup):
    figure = screen_figure(setup)
    upwind, downwind, moved, centres, arrow = figure.panels[2].series
    for circle in (upwind, downwind, moved):
        assert np.ptp(circle.x) == pytest.approx(8.0) and np.ptp(circle.y) == pytest.approx(8.0)
    assert downwind.x.mean() - upwind.x.mean() == pytest.approx(1000 * radians(8 / 60), rel=1e-3)
    assert moved.x.max() - upwind.x.max() == pytest.approx(1000 * radians(31 / 60))
    assert np.ptp(arrow.x) == pytest.approx(1000 * radians(31 / 60))
    assert len(centres.x) == setup.camera.n_det
    assert "8 m" in figure.caption and "31 arcmin/s" in figure.caption and "0.26 s" in figure.caption


def test_downwind_detector_sees_the_same_later(setup):
    time_s, upwind, downwind = edge_streams(setup)
    assert len(time_s) == 150 and np.ptp(time_s) == pytest.approx(14.9)
    # On the strip both are one track: only the bilinear look-up's smoothing between lattice points differs.
    delay = 8 / 31
    later = np.interp(time_s[5:-5] - delay, time_s, upwind)
    assert np.abs(downwind[5:-5] - later).max() < 0.05 * np.abs(downwind - upwind).max()
    earlier = np.interp(time_s[5:-5] + delay, time_s, upwind)
    assert np.abs(downwind[5:-5] - earlier).max() > np.abs(downwind - upwind).max()
