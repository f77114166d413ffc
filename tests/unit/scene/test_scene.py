"""Scenes in internal units, and the hash by which runs know them; what is refused is in test_scene_errors."""

import math
from pathlib import Path

import pytest

from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene, resolved, scene_hash
from surveysim.survey.run import run_observations
from surveysim.survey.scores import score_survey
from tests.cameras import scenes_of
from tests.scenes import SMALL_SCENE, write_scene

SCENARIOS = sorted((Path(__file__).parents[3] / "scenarios").glob("*.toml"))


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


def test_small_scene_in_internal_units(path):
    scene = load_scene(path)
    assert scene.name == "small" and scene.seed == 11
    assert scene.field.ra_rad == pytest.approx(math.radians(132.3))
    assert scene.scan.speed_rad_s == pytest.approx(math.radians(4 / 60))
    assert scene.instrument.frequency_hz == 143e9
    assert scene.atmosphere.spectral_index == pytest.approx(11 / 3)
    assert scene.atmosphere.b2 == pytest.approx((100, 280, 980))
    assert scene.atmosphere.outer_scale_m is None
    assert scene.excess.variance_mk2 == pytest.approx((2.05, 4.52))
    assert scene.sky.point_sources[0].peak_mk == 5
    assert scene.score.signal_sims.band_power_ukcmb2 == 1000


def test_small_scene_runs(path):
    """The scene that other tests use goes through every stage and scores every data set."""
    setup = prepare(load_scene(path))
    scores = score_survey(setup, run_observations(setup, None))
    assert tuple(scores) == ("actual", "uncorrelated", "white", "masked_7")
    assert all(0 < item.band.sigma_ukcmb2 < math.inf for item in scores.values())


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda path: path.name)
def test_scenarios_load(scenario):
    for scene in scenes_of(scenario):
        assert scene.name == "_".join(filter(None, (scenario.stem, scene.band_name))) and scene.title


def test_there_are_scenarios():
    assert "lynx.toml" in [path.name for path in SCENARIOS]


def test_overrides(path):
    scene = load_scene(path, {"scan.duration": "8 s", "score": None, "name": "other", "atmosphere.outer_scale": "2 km"})
    assert (scene.scan.duration_s, scene.score, scene.name) == (8, None, "other")
    assert scene.atmosphere.outer_scale_m == 2000
    assert load_scene(path).scan.duration_s == 6


def test_scenes_do_not_change(path):
    scene = load_scene(path)
    for record, name in ((scene, "seed"), (scene.scan, "speed_rad_s")):
        with pytest.raises(ValueError, match="frozen"):
            setattr(record, name, 1)


def test_equal_scenes_have_equal_hashes(path, tmp_path):
    """Neither units, comments, order and spelling of a quantity nor folder and title make a difference."""
    again = tmp_path / "elsewhere" / "small.toml"
    again.parent.mkdir()
    lines = SMALL_SCENE.replace('duration = "6 s"\n', "").replace("[scan]", '[scan]\nduration = "0.1 min"  # the same')
    again.write_text(lines.replace("A small camera", "Another camera"))
    assert scene_hash(load_scene(path)) == scene_hash(load_scene(again))
    assert len(scene_hash(load_scene(path))) == 64


@pytest.mark.parametrize(
    "key, value",
    [
        ("seed", 12),
        ("observations", 5),
        ("scan.duration", "6.1 s"),
        ("instrument.layout.dead", [4]),
        ("atmosphere.outer_scale", "10 km"),
        ("score", None),
        ("cleaning.tolerance", 1.0000001e-8),
        ("score.noise_only_sets", ["white", "uncorrelated"]),
    ],
)
def test_different_scenes_have_different_hashes(path, key, value):
    assert scene_hash(load_scene(path, {key: value})) != scene_hash(load_scene(path))


def test_hash_follows_the_table_of_positions(path, tmp_path):
    """A run must not be resumed with another focal plane."""
    start, end = SMALL_SCENE.index("[instrument.layout]"), SMALL_SCENE.index("[scan]")
    path.write_text(SMALL_SCENE[:start] + 'positions = "table.ecsv"\n' + SMALL_SCENE[end:])
    header = (
        "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: x, unit: arcsec, datatype: float64}\n"
        "# - {name: y, unit: arcsec, datatype: float64}\nx y\n"
    )
    (tmp_path / "table.ecsv").write_text(header + "0 0\n40 0\n")
    before = scene_hash(load_scene(path))
    assert scene_hash(load_scene(path)) == before
    (tmp_path / "table.ecsv").write_text(header + "0 0\n50 0\n")
    assert scene_hash(load_scene(path)) != before


def test_assumed_values_are_listed_from_the_comments(path):
    path.write_text(SMALL_SCENE.replace('step = "3 arcmin"', 'step = "3 arcmin"    # assumed: one beam'))
    assert load_scene(path).assumed == ('scan.step = "3 arcmin": assumed: one beam',)
    path.write_text(
        SMALL_SCENE.replace("seed = 11", "seed = 11  # calibrated").replace("scans = 4", "scans = 4  # paper")
    )
    assert load_scene(path).assumed == ("seed = 11: calibrated",)
    path.write_text('assumed = ["scan.step"]\n' + SMALL_SCENE)
    with pytest.raises(SceneError, match="assumed: unknown key; allowed are atmosphere, cleaning"):
        load_scene(path)


def test_resolved_scene_names_its_units(path):
    text = resolved(load_scene(path))
    for name in ("speed_rad_s", "duration_s", "frequency_hz", "psd_mk2_hz", "layer_height_m"):
        assert f'"{name}"' in text


def test_none_removes_a_key_or_a_section(path):
    whole = load_scene(path)
    less = load_scene(path, {"excess": None, "numerics": None, "photon.load": None, "site.height": None})
    assert less.excess is None and less == whole.model_copy(update={"excess": None})
    with pytest.raises(SceneError, match="exces.*did you mean excess"):
        load_scene(path, {"exces": None})
    with pytest.raises(SceneError, match="scan.speed: missing"):
        load_scene(path, {"scan.speed": None})


def test_assumed_values_go_with_their_section(tmp_path):
    path = write_scene(tmp_path, SMALL_SCENE.replace('band_limit = "1 Hz"', 'band_limit = "1 Hz"  # assumed'))
    assert load_scene(path).assumed and not load_scene(path, {"excess": None}).assumed
