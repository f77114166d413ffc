"""Points of a sweep before it is run: their names together, and the sensitivity of their detectors."""

import pytest

from surveysim.reduction.setup import prepare
from surveysim.results.sensitivity import sensitivities
from surveysim.studies.sweep.axes import load_sweep
from surveysim.studies.sweep.point_names import name_of_points
from surveysim.studies.sweep.sensitivities import sensitivity_of_points
from tests.camera import BAND, SITE
from tests.scenes import SMALL_SCENE, without_sections

SIX = (
    SMALL_SCENE
    + """
[sweep]
"scan.speed" = ["3 arcmin / s", "4 arcmin / s", "5 arcmin / s"]
"scan.scans" = [4, 5]
"""
)
CALM = without_sections(SMALL_SCENE, "atmosphere", "excess", "photon")
LOAD = '{coherence = "field", load = {sky = "10 K", optics = "30 K"}}'
STATED = '{coherence = "field", coherent_fraction = 0.1, psd = "1 mK2 / Hz"}'


@pytest.fixture
def sweep_of(tmp_path):
    def load(text, overrides=None):
        path = tmp_path / "points.toml"
        path.write_text(text)
        return load_sweep(path, overrides)

    return load


def test_points_are_named_by_what_tells_them_from_others(sweep_of):
    sweep = sweep_of(SIX)
    names = {
        (0, 1, 2, 3, 4, 5): "all points",
        (0, 1): "scan.speed = 3 arcmin / s",
        (1, 3, 5): "scan.scans = 5",
        (1, 5): "scan.speed = 3 arcmin / s or 5 arcmin / s, scan.scans = 5",
        (0, 3): "scan.speed = 3 arcmin / s, scan.scans = 4; scan.speed = 4 arcmin / s, scan.scans = 5",
    }
    assert {numbers: name_of_points(sweep, numbers) for numbers in names} == names


def test_sensitivity_of_a_point_is_that_of_its_scene_at_the_median_water(sweep_of):
    """A load is that of the scene alone; columns have the water and elevation where they differ."""
    sky = '\n[sweep]\n"fixed_pointing.elevation" = ["90 deg", "30 deg"]\n'
    sweep = sweep_of(CALM + SITE + '[photon]\ncoherence = "field"\nload = {optics = "30 K"}\n' + sky, BAND)
    table = sensitivity_of_points(sweep)
    assert [item.name for item in table.shown][:4] == ["fixed_pointing.elevation", "n_det", "water", "elevation"]
    median = [sensitivities(prepare(point.scene))["median"] for point in sweep.points]
    found = {item.name: item.array for item in table.columns}
    assert found["load"] == pytest.approx([1e12 * item.load_w for item in median])
    assert found["net"] == pytest.approx([item.net_mkcmb_rts for item in median])
    assert found["load"][1] > found["load"][0]  # twice the air


def test_points_without_a_load_have_empty_cells(sweep_of):
    """None has one: there is no table."""
    table = sensitivity_of_points(
        sweep_of(f"{without_sections(SMALL_SCENE, 'photon')}\n[sweep]\nphoton = [{LOAD}, {STATED}]\n", BAND)
    )
    (_, detectors, load, *_), (_, *others) = table.rows
    assert (detectors, bool(load)) == ("18", True)
    assert others == ["18", *[""] * (len(table.shown) - 2)]
    assert sensitivity_of_points(sweep_of(SIX)) is None
