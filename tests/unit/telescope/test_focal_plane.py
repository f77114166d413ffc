"""Hexagonal layouts, tables of positions, and the mask that keeps detectors apart."""

from pathlib import Path

import numpy as np
import pytest

from surveysim.scene.scene import load_scene
from surveysim.telescope.focal_plane import camera, check_distinct, mask_by_separation
from surveysim.telescope.layouts import alive, hexagon

LYNX = Path(__file__).parents[3] / "scenarios" / "lynx.toml"
PITCH, SEPARATION = 0.7, 1.3
TABLE = """\
# %ECSV 1.0
# ---
# datatype:
# - {name: x, unit: arcsec, datatype: float64}
# - {name: y, unit: arcmin, datatype: float64}
# schema: astropy-2.0
x y
0.0 0.0
40.0 0.5
-20.0 -1.5
"""


def separations(positions):
    """Between all pairs, (n, n), with infinity on the diagonal."""
    result = np.hypot(*(positions[:, None] - positions[None, :]).transpose(2, 0, 1))
    np.fill_diagonal(result, np.inf)
    return result


@pytest.mark.parametrize("rings, count", [(1, 7), (2, 19), (6, 127)])
def test_hexagon(rings, count):
    positions = hexagon(rings, PITCH)
    assert positions.shape == (count, 2)
    distance = separations(positions)
    np.testing.assert_allclose(distance.min(axis=1), PITCH, rtol=1e-12)
    # A hexagon of n rings has 9 n^2 + 3 n pairs of neighbours; any other compact shape has fewer.
    assert (np.triu(distance, 1) * (distance < 1.001 * PITCH)).astype(bool).sum() == 9 * rings**2 + 3 * rings
    np.testing.assert_allclose(positions.mean(axis=0), 0, atol=1e-12)
    radius = np.hypot(*positions.T)
    assert radius[0] == 0 and (np.diff(radius) > -1e-9).all()
    assert radius.max() == pytest.approx(rings * PITCH)


def test_hexagon_without_rings_is_one_detector():
    np.testing.assert_array_equal(hexagon(0, PITCH), [[0, 0]])


def test_lynx_camera():
    """115 of 127 detectors work; 8 arcmin across; a pitch of 0.7 (f/#)lambda is 40 arcsec."""
    scene = load_scene(LYNX)
    cam = camera(scene.instrument, scene.seed)
    assert len(cam.focal_plane.x_rad) == len(cam.focal_plane.y_rad) == 115
    assert len(camera(load_scene(LYNX, {"instrument.layout.dead": []}).instrument, 0).focal_plane.x_rad) == 127
    assert cam.focal_plane.fwhm_rad == scene.instrument.beam_fwhm_rad
    assert np.degrees(cam.radius_rad) * 60 == pytest.approx(4.0)
    assert separations(cam.positions_f_lambda).min() == pytest.approx(0.7)
    x = np.column_stack([cam.focal_plane.x_rad, cam.focal_plane.y_rad])
    assert np.degrees(separations(x).min()) * 3600 == pytest.approx(40.0)


@pytest.mark.parametrize("dead, kept", [(None, 36), ([], 37)])
def test_mask_of_section_5(dead, kept):
    """The paper's mask leaves 36 of 115 detectors; of a whole hexagon it leaves every second position, 37."""
    overrides = {} if dead is None else {"instrument.layout.dead": dead}
    positions = camera(load_scene(LYNX, overrides).instrument, 0).positions_f_lambda
    chosen = mask_by_separation(positions, SEPARATION)
    assert len(chosen) == kept
    check_mask(positions, chosen, SEPARATION)


def check_mask(positions, chosen, separation):
    """All kept pairs are far enough apart, and no other detector could be added."""
    assert len(set(chosen)) == len(chosen)
    assert (np.diff(chosen) > 0).all()
    if len(chosen) > 1:
        assert separations(positions[chosen]).min() >= separation * (1 - 1e-9)
    others = np.setdiff1d(np.arange(len(positions)), chosen)
    distance = np.hypot(*(positions[others][:, None] - positions[chosen]).transpose(2, 0, 1))
    assert (distance.min(axis=1) < separation).all()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("separation", [0.01, 0.3, 1.0, 10.0])
def test_mask_of_any_positions(seed, separation):
    positions = np.random.default_rng(seed).normal(0, 2, (80, 2))
    chosen = mask_by_separation(positions, separation)
    check_mask(positions, chosen, separation)
    if separation == 10.0:  # more than most of the array's extent: the detector nearest the centre stays
        assert np.hypot(*positions.T).argmin() in chosen


@pytest.mark.parametrize("first, second", [(0, 1), (3, 40)])
def test_two_detectors_at_one_position_are_refused(first, second):
    positions = hexagon(4, PITCH)
    check_distinct(positions)
    positions[second] = positions[first] + 1e-9
    with pytest.raises(ValueError, match=f"detectors {first} and {second} have one position"):
        check_distinct(positions)
    with pytest.raises(ValueError, match="detectors 0 and 1 have one position"):
        check_distinct(np.ones((2, 2)))


def test_dead_positions_are_left_out():
    np.testing.assert_array_equal(np.flatnonzero(alive(19, (3, 0), "dead")), [1, 2, *range(4, 19)])


@pytest.mark.parametrize("dead", [(19,), (-1,), (0, 25), (4, 4)])
def test_dead_positions_that_are_not_there_are_refused(dead):
    with pytest.raises(ValueError, match="instrument.layout.dead: found .* from 0 to 18") as caught:
        alive(19, dead, "instrument.layout.dead")
    assert str(list(dead)) in str(caught.value)


def test_a_camera_has_a_live_detector():
    with pytest.raises(ValueError, match="instrument.layout.dead: found all 7 positions"):
        alive(7, tuple(range(7)), "instrument.layout.dead")


def test_camera_of_a_table(tmp_path):
    """A relative path is one from the scene's file."""
    (tmp_path / "positions.ecsv").write_text(TABLE)
    text = LYNX.read_text()
    layout = text[text.index("[instrument.layout]") : text.index("[scan]")]
    scene = tmp_path / "table.toml"
    scene.write_text(text.replace(layout, 'positions = "positions.ecsv"\n'))
    cam = camera(load_scene(scene).instrument, 0)
    assert len(cam.focal_plane.x_rad) == 3
    np.testing.assert_allclose(cam.positions_f_lambda[1], np.array([40, 30]) / 57.142857, rtol=1e-12)
