"""Layouts of wafers against counts and distances of their lattices; random yield; several wafers."""

import json

import numpy as np
import pytest

from surveysim.reduction.setup import prepare
from surveysim.report.html.scene import scene_terms
from surveysim.report.terminal.camera import camera_lines
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene, resolved
from surveysim.telescope.focal_plane import camera
from surveysim.telescope.layouts import placed_wafers
from tests.scenes import write_scene

PITCH = 0.7 * 57.142857  # arcsec
UNMASKED = {"score.mask_separation_f_lambda": None}


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


def camera_of(path, *wafers, seed=11, **layout):
    """Camera of a layout or of wafers."""
    keys = {"pitch_f_lambda": 0.7}
    found = {"instrument.layout": keys | layout} if layout else {"instrument.layout": None}
    if wafers:
        found["instrument.wafers"] = [keys | wafer for wafer in wafers]
    scene = load_scene(path, found | UNMASKED)
    return camera(scene.instrument, seed)


def positions_of(cam):
    """Positions in pitches."""
    plane = cam.focal_plane
    return np.degrees(np.column_stack([plane.x_rad, plane.y_rad])) * 3600 / PITCH


def neighbours(positions):
    """Distances of all pairs, sorted, and the number of neighbours a pitch away of each."""
    apart = np.hypot(*(positions[:, None] - positions).transpose(2, 0, 1))
    return np.sort(apart[np.triu_indices(len(positions), 1)]), (np.abs(apart - 1) < 1e-6).sum(axis=1)


@pytest.mark.parametrize("side", [1, 4, 5])
@pytest.mark.parametrize(("shape", "inner"), [("square", 4), ("rhombus", 6)])
def test_a_grid(path, shape, inner, side):
    """Of n times n positions about the boresight; those inside have 4 neighbours on a square lattice, else 6."""
    positions = positions_of(camera_of(path, shape=shape, side=side))
    assert len(positions) == side**2
    np.testing.assert_allclose(positions.mean(axis=0), 0, atol=1e-9)
    distance = np.hypot(*positions.T)
    assert (np.diff(distance) > -1e-6).all()  # from the centre outwards
    if side > 1:
        apart, count = neighbours(positions)
        assert apart[0] == pytest.approx(1, rel=1e-6)
        assert count.max() == inner and (count == inner).sum() == (side - 2) ** 2
        diagonal = {"square": 2**0.5, "rhombus": 3**0.5}[shape]
        assert apart[-1] == pytest.approx((side - 1) * diagonal, rel=1e-6)


def test_wafers_are_turned_and_moved(path):
    """A wafer is its layout, turned from x to y and moved."""
    one = {"shape": "square", "side": 3, "rotation": "30 deg", "offset_x": "5 arcmin", "offset_y": "-2 arcmin"}
    both = camera_of(path, one, {"rings": 1})
    plain = positions_of(camera_of(path, shape="square", side=3))
    turn = np.exp(1j * np.pi / 6)
    expected = turn * (plain @ [1, 1j]) + (300 - 120j) / PITCH
    found = positions_of(both) @ [1, 1j]
    np.testing.assert_allclose(found[:9], expected, atol=1e-9)
    np.testing.assert_allclose(found[9:], positions_of(camera_of(path, rings=1)) @ [1, 1j], atol=1e-9)
    assert both.counts.wafers == ((9, 9), (7, 7)) and both.counts.positions == 16


def test_a_random_yield(path):
    """The stated fraction of the positions that are not dead, the same in every camera of a seed, others in others."""
    layout = {"rings": 6, "yield": 0.85, "dead": [0, 5]}
    one, again, other = (camera_of(path, seed=seed, **layout) for seed in (3, 3, 4))
    assert len(one.focal_plane.x_rad) == round(0.85 * 125) == 106
    np.testing.assert_array_equal(one.focal_plane.x_rad, again.focal_plane.x_rad)
    whole = {tuple(row) for row in np.round(positions_of(camera_of(path, rings=6, dead=[0, 5])), 6).tolist()}
    drawn = [{tuple(row) for row in np.round(positions_of(cam), 6).tolist()} for cam in (one, other)]
    assert drawn[0] < whole and drawn[1] < whole and drawn[0] != drawn[1]
    assert one.counts.dead == 21 and one.counts.positions == 127


def test_wafers_lose_different_detectors(path):
    wafer = {"rings": 6, "yield": 0.5}
    cam = camera_of(path, wafer | {"offset_x": "-10 arcmin"}, wafer | {"offset_x": "10 arcmin"})
    x, y = positions_of(cam).T
    middles = np.repeat([-600, 600], 64) / PITCH
    places = np.round(np.column_stack([x - middles, y]), 6).tolist()
    sets = [set(map(tuple, places[part])) for part in (slice(0, 64), slice(64, 128))]
    assert len(sets[0]) == len(sets[1]) == 64 and sets[0] != sets[1]


def test_every_position_yields_equally(path):
    """Over many seeds: hits of each of 37 positions at a yield of 1/2 scatter as a sum of hypergeometric draws."""
    n = 400
    hits = np.zeros(37)
    layout = {"rings": 3, "yield": 0.5, "pitch_f_lambda": 0.7}
    instrument = load_scene(path, {"instrument.layout": layout} | UNMASKED).instrument
    whole = placed_wafers(load_scene(path, {"instrument.layout": layout | {"yield": 1}} | UNMASKED).instrument, 0)
    place = {tuple(cell): number for number, cell in enumerate(whole[0].lattice.cells.tolist())}
    for seed in range(n):
        for cell in placed_wafers(instrument, seed)[0].lattice.cells.tolist():
            hits[place[tuple(cell)]] += 1
    share = 18 / 37
    assert np.abs(hits / n - share).max() < 4 * np.sqrt(share * (1 - share) / n)


@pytest.mark.parametrize(
    ("layout", "words"),
    [
        ({"shape": "square", "rings": 2}, "instrument.layout.rings: found with shape 'square'; 'side' is expected"),
        ({"shape": "square"}, "instrument.layout.side: missing; shape 'square' needs the number of detectors"),
        ({"side": 4}, "instrument.layout.side: found with shape 'hexagon'; 'rings' or 'field_of_view' is expected"),
        ({"shape": "rhombus", "side": 121}, "instrument.layout.side: found 121; a number less than or equal to 120"),
        ({"shape": "circle", "rings": 2}, "instrument.layout.shape: found 'circle';"),
        ({"rings": 2, "yield": 0}, "instrument.layout.yield: found 0; a number greater than or equal to 0.001"),
        ({"rings": 2, "offset_x": "1 arcmin"}, "instrument.layout.offset_x: unknown key"),
        ({"rings": 1, "yield": 0.01}, "instrument.layout.yield: found 0.01, no detector of 7; a live one is expected"),
        (
            {"shape": "square", "side": 3, "dead": [9]},
            "instrument.layout.dead: found [9]; different numbers from 0 to 8",
        ),
    ],
)
def test_layouts_that_are_refused(path, layout, words):
    with pytest.raises(SceneError) as caught:
        camera_of(path, **layout)
    assert words in str(caught.value) and len(str(caught.value).splitlines()) == 1


def test_wafers_that_are_refused(path):
    with pytest.raises(SceneError, match=r"instrument.wafers.1.dead: found \[7\]; different numbers from 0 to 6"):
        camera_of(path, {"rings": 1}, {"rings": 1, "dead": [7], "offset_x": "5 arcmin"})
    with pytest.raises(SceneError, match="instrument: detectors 1 and 8 have one position"):
        camera_of(path, {"rings": 1}, {"rings": 1})


def test_counts_of_wafers_are_said(path):
    wafers = [
        {"rings": 1, "pitch_f_lambda": 0.7},
        {"rings": 1, "pitch_f_lambda": 0.7, "offset_x": "5 arcmin", "dead": [3]},
    ]
    scene = load_scene(path, {"instrument.layout": None, "instrument.wafers": wafers} | UNMASKED)
    assert list(camera_lines(prepare(scene))) == [
        "13 detectors; 1 dead position of 14",
        "detectors of wafers: 7 of 7, 6 of 7",
    ]


def described(scene):
    """Terms of the report of a scene."""
    return dict(scene_terms(json.loads(resolved(scene)), 19))


def test_reports_describe_layouts_and_wafers(path):
    square = {"shape": "square", "side": 4, "pitch_f_lambda": 0.7, "yield": 0.75, "dead": [2]}
    said = described(load_scene(path, {"instrument.layout": square} | UNMASKED))["Camera"]
    words = (
        "Positions are on a square lattice over a square of 4 by 4, neighbours 0.7 (f/#)\u03bb apart (40 arcsec), 1 of"
    )
    assert f"{words} them dead, 75 % of the others working." in said.replace("\u00a0", " ")
    wafers = [{"rings": 2, "pitch_f_lambda": 0.7}, square | {"offset_x": "5 arcmin", "rotation": "30 deg"}]
    keys = {"instrument.layout": None, "instrument.wafers": wafers} | UNMASKED
    said = described(load_scene(path, keys))["Camera"].replace("\u00a0", " ")
    assert "Wafer 0 is at (0 arcmin, 0 arcmin). Positions are hexagonal over 2 rings, neighbours" in said
    assert "Wafer 1 is at (5 arcmin, 0 arcmin), turned by 30\u00b0. Positions are on a square lattice" in said


def test_reports_describe_tables(path):
    import astropy.units as u
    from astropy.table import QTable

    table = {"x": [0, 1] * u.arcmin, "y": [0, 1] * u.arcmin, "psd": [1, 2] * u.mK**2 / u.Hz, "band": ["90", "150"]}
    QTable(table).write(path.parent / "camera.ecsv")
    keys = {"instrument.layout": None, "instrument.positions": "camera.ecsv", "instrument.band": "150"}
    said = described(load_scene(path, keys | {"detector.psd": None} | UNMASKED))
    assert "Detectors come from the table camera.ecsv, its band 150." in said["Camera"]
    assert said["Detector noise"].startswith("White, of each detector as in the table of detectors,")
