"""Plans: the stages that run and no others, their time and memory."""

import pytest

from surveysim import run
from surveysim.atmosphere import screen_simulation as screen
from surveysim.output import writer as outputs
from surveysim.reduction import cleaned_block, setup
from surveysim.reduction import observation as reduction
from surveysim.reduction.setup import prepare
from surveysim.results import control_variate, scored
from surveysim.runtime.engine import SERIAL
from surveysim.scene.bands import load_bands
from surveysim.scene.scene import load_scene
from surveysim.studies.resources import make_plan
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams import low_frequency, observed_block, photon, simulation, sky_maps
from surveysim.timestreams import shared_parts as parts
from surveysim.timestreams.observation import draw_band
from tests.scenes import SCHEDULE, SMALL_SCENE, WHITE_NOISE_SCENE, without_sections

ALWAYS = ["pointing", "detector", "cleaning", "maps"]
SCORED = ["data sets", "transfer function", "score", "forecast"]
NO_CHOICE = {"best pipeline": "no cleaning.compare"}
NO_HEALPIX = {"HEALPix": "no map.healpix_nside"}
FIXED = {"ephemerides": "a fixed elevation needs none"}
NO_SITE = {"opacity": "no atmosphere.site"}
NO_SKY = {"sky": "no section [sky]: noise alone"}
NO_AIR = {"atmosphere": "no section [atmosphere]: no layer, no weather"}
NO_SCORE = {
    "score": "no section [score]: no map PSDs, no sign-flipped maps",
    "transfer function": "no section [score]",
    "forecast": "no section [score]",
    "best pipeline": "no section [score]",
}
NO_EXCESS, NO_PHOTON = {"excess": "no section [excess]"}, {"photon": "no section [photon]"}
NO_OVERLAP = {"overlap": "no noise that is common to detectors"}
# The scene's own air goes with the section that it is put into.
AIR_OF_A_SITE = (
    SCHEDULE
    + """
[atmosphere]
site = "mauna_kea"
spectral_index = "11/3"
illuminated_aperture = "8 m"

[own]"""
)
SUZIE = "scenarios/suzie_ii.toml"

# What is called only where a stage runs: the module that calls (or, imported there when first needed, makes) it.
DOES = {
    "atmosphere": [(screen, "add_atmosphere"), (observed_block, "survey_weather")],
    "excess": [(low_frequency, "add_excess")],
    "photon": [(photon, "add_correlated_white")],
    "overlap": [(parts, "correlation_matrices")],
    "sky": [(sky_maps, "draw_sky")],
    "ephemerides": [(simulation, "schedule")],
    "opacity": [(setup, "site_water")],
    "score": [(control_variate, "score_survey")],
    "transfer function": [(sky_maps, "flat_cmb_sky"), (reduction, "add_signal_maps")],
    "forecast": [(scored, "forecast")],
    "best pipeline": [(reduction, "figures_of_merit")],
    "HEALPix": [(outputs, "write_healpix")],
}


def edited(*pairs: tuple[str, str]) -> str:
    text = SMALL_SCENE
    for old, new in pairs:
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


SCENES = {
    "everything": (
        edited(
            ('algorithm = "average"', 'algorithm = "average"\ncompare = ["planar"]'),
            ("[map]", "[map]\nhealpix_nside = 1024"),
        ),
        ["atmosphere", "excess", "photon", "sky", "sky in and out", *SCORED, "HEALPix"],
        FIXED | NO_SITE,
    ),
    "white noise": (
        WHITE_NOISE_SCENE,
        [],
        NO_AIR | NO_EXCESS | NO_PHOTON | NO_SKY | NO_SCORE | FIXED | NO_SITE | NO_OVERLAP | NO_HEALPIX,
    ),
    "a scheduled site": (
        without_sections(
            edited(("[atmosphere]", AIR_OF_A_SITE), ("[instrument]", "[instrument]\nbandwidth = 0.15")),
            "fixed_pointing",
            "own",
            "sky",
            "excess",
        ),
        ["atmosphere", "photon", *SCORED],
        NO_EXCESS | NO_SKY | NO_CHOICE | NO_HEALPIX,
    ),
    "no projection": (
        edited(
            ('algorithm = "average"', 'algorithm = "polynomial"\norder = 1\nregions = 1'),
            ("rings = 2", "rings = 3"),
            ("mask_separation_f_lambda = 1.3\n", ""),
        ),
        ["atmosphere", "excess", "photon", "sky", "sky in and out", *SCORED[:-1]],
        {"forecast": "cleaning by polynomial is no projection"} | FIXED | NO_SITE | NO_CHOICE | NO_HEALPIX,
    ),
    "signal alone scored": (
        without_sections(edited(('algorithm = "average"', 'algorithm = "none"')), "atmosphere", "photon", "excess"),
        ["sky", "sky in and out", *SCORED],
        NO_AIR | NO_EXCESS | NO_PHOTON | FIXED | NO_SITE | NO_OVERLAP | NO_CHOICE | NO_HEALPIX,
    ),
}


@pytest.fixture
def called(monkeypatch):
    """Names of stages whose functions were called since."""
    prepare.cache_clear()
    names = set()

    def watched(name, function):
        def call(*arguments, **named):
            names.add(name)
            return function(*arguments, **named)

        return call

    for name, functions in DOES.items():
        for module, function in functions:
            monkeypatch.setattr(module, function, watched(name, getattr(module, function)))
    yield names
    prepare.cache_clear()


@pytest.mark.parametrize("name", SCENES)
def test_stages_run_or_are_left_out_as_the_plan_says(tmp_path, called, name):
    text, runs, left_out = SCENES[name]
    path = tmp_path / "scene.toml"
    path.write_text(text)
    scene = load_scene(path)
    result = run(scene, out=tmp_path / "out", engine=SERIAL, figures=False)
    assert result.unscored == ""
    done = set(called)
    plan = make_plan(prepare(scene), 1)
    assert plan.left_out == left_out
    assert sorted(plan.stages) == sorted(ALWAYS + runs)
    assert done == DOES.keys() - left_out.keys()


@pytest.mark.parametrize("algorithm, subtracted", [("spectral", True), ("average", False)])
def test_other_bands_are_drawn_only_where_subtracted(monkeypatch, algorithm, subtracted):
    settings = {"cleaning.algorithm": algorithm, "cleaning.compare": [], "observations": 2}
    ready, drawn = prepare(load_bands(SUZIE, settings).bands["143"]), []
    monkeypatch.setattr(cleaned_block, "draw_band", lambda *arguments: drawn.append(draw_band(*arguments)) or drawn[-1])
    plan = make_plan(ready, 1)
    assert (plan.left_out.get("other bands") is None) == subtracted
    assert (len(drawn) > 0) == subtracted and all(len(streams) > 0 for streams in drawn)


def test_observations_of_several_blocks_are_measured_on_one(tmp_path, monkeypatch):
    """A block of two scans and one scan more are made, and stand for four observations of four scans."""
    path = tmp_path / "scene.toml"
    path.write_text(SMALL_SCENE)
    whole = make_plan(prepare(load_scene(path)), 1)
    ready = prepare(load_scene(path, {"numerics.max_block_memory": "9 kB"}))
    drawn, draw = [], cleaned_block.draw_block
    monkeypatch.setattr(cleaned_block, "draw_block", lambda *args: drawn.append(args[3].n_scans) or draw(*args))
    found = make_plan(ready, 1)
    assert drawn == [2, 1]
    assert (
        found.stages["blocks"] == "2 an observation, 2 scans or fewer in 0.00864 MB of streams"
        and "blocks" not in whole.stages
    )
    assert found.detector_samples == whole.detector_samples and found.output_bytes == whole.output_bytes
    assert found.left_out == whole.left_out


def test_cost(tmp_path):
    """Sizes that follow from the scene, and times that add up."""
    path = tmp_path / "scene.toml"
    path.write_text(SMALL_SCENE)
    few, many = (make_plan(prepare(load_scene(path, {"observations": n})), 1, 2.0) for n in (4, 400))
    lines = prepare(load_scene(path)).observing.scans
    assert few.detector_samples == 4 * 18 * lines.n_scans * samples_per_scan(lines)
    assert many.detector_samples == 100 * few.detector_samples
    assert few.timestream_bytes == 4 * few.detector_samples
    # Three starts for figures and one for itself; 400 observations take longer, in no more memory than that of a strip.
    assert few.figures_s == many.figures_s == 6 and 8 < few.wall_s < many.wall_s
    assert 1e8 < few.memory_bytes <= many.memory_bytes < 2 * few.memory_bytes


def test_a_survey_of_one_observation(tmp_path):
    (path := tmp_path / "small.toml").write_text(SMALL_SCENE.replace("observations = 4", "observations = 1", 1))
    plan = make_plan(prepare(load_scene(path)), 1)
    assert plan.wall_s > 0 and plan.memory_bytes > 0
