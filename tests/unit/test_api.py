"""The Python interface: the same bits whatever the workers, the resumption and the stages left out."""

import re
import subprocess
import sys
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest

import surveysim
from mapmaker.formats import read_timestreams
from surveysim import SceneError, load_scene, run, simulate_observation
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.survey.run import run_observations
from tests.scenes import WHITE_NOISE_SCENE, write_scene

ROOT = Path(__file__).parents[2]
STAGES = ("atmosphere", "excess", "photon", "detector", "sky")
WHITE = ["photon", "detector"]
ONE_B2 = {"excess.b2": [46], "excess.variance": "[2.05] mK2"}  # excess that needs no weather


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


def streams(path, stages, observation=1, **overrides):
    settings = {name: None for name in (*STAGES, "score") if name not in stages}
    settings["cleaning.algorithm"] = "none"
    if "excess" in stages:
        settings |= ONE_B2
    return simulate_observation(load_scene(path, settings | overrides), observation)


@pytest.mark.parametrize("left_out", [[name] for name in STAGES if name not in WHITE] + [WHITE])
def test_leaving_a_stage_out_moves_no_other_draw(path, left_out):
    """The streams of all stages less those without one are that stage's own, and the rest draws the same.

    Photon and detector noise are one draw.
    Float32 sums of up to ~1e3 mK round to 6e-5 mK a step; all differ by one draw at least otherwise.
    """
    others = [name for name in STAGES if name not in left_out]
    whole, rest = (streams(path, names).data_mk.astype(float) for names in (STAGES, others))
    alone = streams(path, left_out).data_mk.astype(float)
    level = np.abs(whole).max()
    np.testing.assert_allclose(whole - rest, alone, atol=8 * level * 2.0**-24)
    assert alone.std() > 100 * level * 2.0**-24


def test_leaving_stages_out_of_the_end_is_exact(path):
    """[score] draws for the maps only; the pointing does not know of the weather."""
    scene = load_scene(path)
    whole = simulate_observation(scene, 2)
    unscored = simulate_observation(load_scene(path, {"score": None}), 2)
    np.testing.assert_array_equal(whole.data_mk, unscored.data_mk)
    calm = streams(path, ["detector"], 2)
    for name in ("time_s", "ra_rad", "dec_rad", "array_angle_rad", "scan"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(calm, name))


def test_observations_and_seeds_differ(path):
    scene = load_scene(path)
    one, again, other = (simulate_observation(scene, number) for number in (0, 0, 1))
    np.testing.assert_array_equal(one.data_mk, again.data_mk)
    seeded = simulate_observation(load_scene(path, {"seed": 12}), 0)
    # Of neighbouring detectors' differences in time: the layer, which all detectors see, counts as few numbers.
    noise = [np.diff(np.diff(item.data_mk), axis=0).ravel() for item in (one, other, seeded)]
    for different in noise[1:]:
        assert abs(np.corrcoef(noise[0], different)[0, 1]) < 5 / np.sqrt(len(noise[0]))


def test_observations_of_a_longer_survey_are_the_same(path):
    short, long = load_scene(path), load_scene(path, {"observations": 9})
    np.testing.assert_array_equal(simulate_observation(short, 3).data_mk, simulate_observation(long, 3).data_mk)


@pytest.mark.parametrize("observation", [-1, 4])
def test_observations_that_are_not_there(path, observation):
    with pytest.raises(ValueError, match="0 to 3 is expected"):
        simulate_observation(load_scene(path), observation)


def test_two_workers_give_the_same_bits(path, two_threads):
    """Of observations in two blocks; those in one are compared where runs reach a target."""
    setup = prepare(load_scene(path, {"numerics.max_block_memory": "9 kB"}))
    assert len(setup.observing.blocks) == 2
    one, two = (run_observations(setup, None, Engine(workers=workers)) for workers in (1, 2))
    arrays = ("sums", "weight", "hits", "flipped", "signal_maps", "signal_weight", "rows", "raw_psd", "clean_psd")
    for name in arrays:
        np.testing.assert_array_equal(np.array(getattr(one, name)), np.array(getattr(two, name)))


def test_saved_timestreams_are_what_is_simulated(path, tmp_path):
    scene = load_scene(path)
    run(scene, tmp_path / "out", engine=SERIAL, save_timestreams=True, figures=False)
    files = sorted((tmp_path / "out" / "timestreams").iterdir())
    assert [file.name for file in files] == ["0000.h5", "0001.h5", "0002.h5", "0003.h5"]
    for number, file in enumerate(files):
        read, made = read_timestreams(file), simulate_observation(scene, number)
        np.testing.assert_array_equal(read.data_mk, made.data_mk)
        np.testing.assert_array_equal(read.time_s, made.time_s)
        np.testing.assert_array_equal(read.scan, made.scan)
        for name in ("ra_rad", "dec_rad", "array_angle_rad"):
            np.testing.assert_allclose(getattr(read, name), getattr(made, name), rtol=1e-14)
        np.testing.assert_allclose(read.focal_plane.x_rad, made.focal_plane.x_rad, rtol=1e-14, atol=1e-18)
        assert read.focal_plane.fwhm_rad == pytest.approx(made.focal_plane.fwhm_rad)
        assert dict(read.attributes) == pytest.approx(dict(made.attributes))
        assert read.attributes["seed"] == 11 and read.attributes["b2_mk2"] > 0


def test_timestreams_need_a_place(path):
    with pytest.raises(ValueError, match="save_timestreams"):
        run(load_scene(path), save_timestreams=True)


def test_scenes_that_cannot_run(path):
    scene = load_scene(path, {"score.ell_max": 30000})
    for attempt in (lambda: run(scene), lambda: simulate_observation(scene, 0)):
        with pytest.raises(SceneError, match="score.ell_max: found 30000"):
            attempt()


def test_progress_sees_every_observation(path):
    seen = []
    result = run(load_scene(path), engine=SERIAL, progress=lambda coadds: seen.append(coadds.done))
    assert seen == [1, 2, 3, 4] and result.workers == 1 and result.wall_s > 0


def test_white_noise_has_its_variance(tmp_path):
    """PSD times half the rate; the mean of n squares scatters by sqrt(2 / n), of which 4 are allowed."""
    path = tmp_path / "white.toml"
    path.write_text(WHITE_NOISE_SCENE)
    data = simulate_observation(load_scene(path), 0).data_mk.astype(float)
    assert np.mean(data**2) == pytest.approx(2.5 * 10 / 2, rel=4 * np.sqrt(2 / data.size))


def test_white_noise_imports_no_coordinates(tmp_path):
    path = tmp_path / "white.toml"
    path.write_text(WHITE_NOISE_SCENE)
    code = (
        "import sys\nfrom surveysim import Engine, load_scene, run\n"
        f"run(load_scene({str(path)!r}), engine=Engine('serial'))\nprint(' '.join(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    unwanted = {
        "astropy.coordinates",
        "astropy.table",
        "astropy.wcs",
        "healpy",
        "matplotlib",
        "dask",
        "h5py",
        "typer",
    }
    assert not unwanted & set(done.stdout.split())


# ---------------------------------------------------------------- names, arguments


def test_tab_lists_the_public_names():
    assert dir(surveysim) == sorted(surveysim.__all__)
    for name in surveysim.__all__:
        assert name == "__version__" or getattr(surveysim, name).__doc__


def test_names_of_the_guide_exist():
    """Of pages, notebooks and the README."""
    texts = [
        path.read_text() for path in (*ROOT.glob("docs/**/*.md"), *ROOT.glob("docs/**/*.ipynb"), ROOT / "README.md")
    ]
    used = {name for text in texts for name in re.findall(r"\bsurveysim\.([A-Za-z_]\w*)\(", text)}
    assert {"load_scene", "run", "simulate_observation"} <= used
    assert used <= set(dir(surveysim))


def test_scenes_are_taken_by_path_and_as_such(path, tmp_path):
    scene = load_scene(path)
    for given in (path, str(path)):
        np.testing.assert_array_equal(simulate_observation(given, 1).data_mk, simulate_observation(scene, 1).data_mk)
    one, other = (run(given, engine=SERIAL).scores["actual"].band.sigma_ukcmb2 for given in (scene, path))
    assert one == other
    planned = surveysim.plan(path, workers=1)
    assert planned.detector_samples == surveysim.plan(scene, 1).detector_samples > 0 and "score" in planned.stages


def test_forecasts_are_those_of_the_command(path, tmp_path, call):
    scene = load_scene(path)
    found = surveysim.forecast(path, tmp_path / "api")
    assert (
        found.scores.keys()
        == surveysim.forecast(scene).scores.keys()
        == run(scene, engine=SERIAL).expected.scores.keys()
    )
    assert call("forecast", path, "--out", tmp_path / "cli")[0] == 0
    files = [(tmp_path / folder / "forecast.ecsv").read_bytes() for folder in ("api", "cli")]
    assert files[0] == files[1] and len(files[0]) > 1000


def test_sweeps_are_refused_where_a_scene_is_expected(path):
    path.write_text(path.read_text() + '\n[sweep]\n"scan.scans" = [4, 5]\n')
    for function in (run, surveysim.forecast, surveysim.plan):
        with pytest.raises(
            SceneError, match=r"small.toml: sweep: found a sweep; a scene without \[sweep\] is expected"
        ):
            function(path)
    planned = surveysim.plan_sweep(path, 1)
    assert planned.n_points == 2 and planned.detector_samples > 0


@pytest.mark.parametrize(
    ("key", "quantity", "text"),
    [
        ("scan.speed", 8 * u.arcmin / u.s, "8 arcmin / s"),
        ("map.pixel", np.float32(0.5) * u.arcmin, "0.5 arcmin"),
        ("detector.psd", 3.0 * u.mK**2 / u.Hz, "3 mK2 / Hz"),
        ("atmosphere.b2", [1.5, 280, 980] * u.mK**2 * u.rad ** (-5 / 3), "[1.5, 280, 980] mK2 rad(-5/3)"),
        ("observations", np.int64(3), 3),
        ("scan.scans", 5 * u.dimensionless_unscaled, 5),
    ],
)
def test_overrides_may_be_quantities(path, key, quantity, text):
    """And numbers of numpy; the sweep takes them too."""
    assert load_scene(path, {key: quantity}) == load_scene(path, {key: text})
    path.write_text(path.read_text() + '\n[sweep]\n"scan.turnaround" = ["10 s", "11 s"]\n')
    one, other = (surveysim.load_sweep(path, {key: value}).points[1].scene for value in (quantity, text))
    assert one == other


def test_quantities_of_another_kind_are_refused(path):
    with pytest.raises(SceneError, match="scan.speed: found '8.0 kg'; a quantity in units like 'arcmin / s' is"):
        load_scene(path, {"scan.speed": 8 * u.kg})
    with pytest.raises(SceneError, match="scan.speed: found '8.0 mag'; a quantity in units"):
        load_scene(path, {"scan.speed": 8 * u.mag})
