"""Every file, column and key that commands leave behind is in the guide, and nothing else is."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

import surveysim
from surveysim.forecasting.forecast import forecast
from surveysim.output.record import RECORD
from surveysim.output.study_writer import write_accuracy, write_extremes
from surveysim.output.writer import write_forecast
from surveysim.paper.explain.ingredients import Explained, ingredients
from surveysim.paper.explain.run import explain
from surveysim.paper.explain.values import SETTINGS
from surveysim.paper.reproduce import reproduce
from surveysim.paper.scenes import TABLES, wanted
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL
from surveysim.studies.convergence import measure_accuracy
from surveysim.studies.optimise.store import FILE as EVALUATIONS
from surveysim.studies.stress import CASES, run_case
from surveysim.survey.checkpoint import NAME as CHECKPOINT
from tests.camera import BOLOMETER, CAMERA, PHOTON
from tests.cameras import write_camera
from tests.docs.pages import ROOT
from tests.docs.tables import differences, documented
from tests.scenes import SCHEDULE, SMALL_SCENE, SPECTRA, without_sections
from tests.unit.paper.test_reproduce import SCENE as PAPER_SCENE

pytestmark = pytest.mark.docs
PAGE = documented(ROOT / "docs" / "reference" / "files.md")
# With a note: the target is out of reach.
SURVEYS = ("A run", "A camera of several bands", "A sweep", "A budget", "A comparison", "A search")

METRICS = """
[[score.metrics]]
kind = "band_powers"
edges = [2000, 6000, 12000]
spectrum = "flat"
band_power = "1000 uK2"

[[score.metrics]]
kind = "time_to"
of = "band_powers.amplitude"
value = 1e-6
"""
# Every optional thing at once.
RICH_SCENE = (
    without_sections(SMALL_SCENE, "photon", "detector")
    .replace("observations = 4\n", "observations = 34\n", 1)
    .replace('beam_fwhm = "60 arcsec"', 'beam_fwhm = "60 arcsec"\nbandwidth = 0.15')
    .replace("bandwidth = 0.15", "bandwidth = 0.15\nefficiency = 0.4\npolarizations = 1")
    .replace("[atmosphere]", '[atmosphere]\nsite = "mauna_kea"')
    .replace(
        'algorithm = "average"',
        'algorithm = "average"\ncompare = ["planar", ["average", "local"]]\nneighbour_radius = 1.2',
    )
    .replace('pixel = "30 arcsec"', 'pixel = "30 arcsec"\nhealpix_nside = 1024')
    + '\n[score.reference]\nsource = "nowhere"\nvalues = { actual = "270 uK2" }\n'
    + '\n[dropped_samples]\nrate = "60 / h"\nlength = "1 s"\nshared = "array"\n'
    + METRICS
    + PHOTON
    + CAMERA
    + BOLOMETER
)
TURBULENT, CALM = ("[1000, 2800, 9800] mK2 rad(-5/3)", "[4, 9, 20] mK2 rad(-5/3)")
# Points without a score, and one of few scans in calm weather, which loses another number of the masked data.
SWEEP = f"""
[[score.metrics]]
kind = "largest_scale"

[sweep]
observations = [4, 1]

[sweep.weather]
"atmosphere.b2" = ["{TURBULENT}", "{TURBULENT}", "{CALM}"]
"scan.scans" = [4, 5, 3]
"""


# Few forecasts of a metric that is smooth.
SEARCH = """
[optimise]
rivals = 1

[[optimise.knobs]]
key = "score.signal_sims.band_power"
low = "50 uK2"
high = "20000 uK2"
scale = "log"

[[optimise.knobs]]
key = "cleaning.algorithm"
choices = ["average", "planar"]

[[optimise.derived]]
key = "detector.psd"
value = "mK**2 / Hz * (score.signal_sims.band_power / (700 * uK**2) + 700 * uK**2 / score.signal_sims.band_power)"

[[optimise.limits]]
quantity = "score.signal_sims.band_power"
at_most = "10000 uK2"
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folders with what each command writes, by the headings of the page."""
    folder = tmp_path_factory.mktemp("files")
    sweep = _sweep(folder)
    return {
        "A run": [_rich_run(folder), _unscored_run(folder), _run_with_spectra(folder), *_runs_of_makers(folder)]
        + [folder / "points" / "0"],
        "A camera of several bands": [_bands(folder)],
        "A sweep": [sweep],
        "A budget": [*_budget(folder)],
        "A comparison": [_comparison(folder)],
        "A search": [
            _search(folder, "search"),
            _search(folder, "front", 'metrics = ["flat_band_power.sigma", "detectors"]'),
        ],
        "A forecast": [_forecast(folder)],
        "Accuracy": [_accuracy(folder)],
        "The paper": [_paper(folder)],
        "An explanation": [_explanation(folder)],
    }


def _scene(folder: Path, name: str, text: str) -> Path:
    path = folder / f"{name}.toml"
    path.write_text(text)
    return path


def _rich_run(folder):
    scene = surveysim.load_scene(_scene(folder, "rich", RICH_SCENE))
    surveysim.run(scene, folder / "rich", save_timestreams=True, target_error=0.9, time_budget_s=100)
    return folder / "rich"


def _unscored_run(folder):
    scene = surveysim.load_scene(_scene(folder, "single", SMALL_SCENE), {"observations": 1})
    assert surveysim.run(scene, folder / "single").unscored
    return folder / "single"


def _run_with_spectra(folder):
    scene = _scene(folder, "splits", without_sections(SMALL_SCENE, "fixed_pointing") + SCHEDULE + SPECTRA)
    keys = {"observations": 16, "schedule.nights": 4, "sky.point_sources": []}
    surveysim.run(surveysim.load_scene(scene, keys), folder / "splits")
    return folder / "splits"


def _runs_of_makers(folder):
    """Runs by other map-makers, one of them with lost samples and one with a bright source."""
    path = _scene(folder, "makers", SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", ""))
    few = {"observations": 16, "score.noise_only_sets": [], "score.jackknives": 2}
    lost = {"dropped_samples.rate": "60 / h", "dropped_samples.length": "1 s", "dropped_samples.shared": "array"}
    bright = {"sky.point_sources": [{"ra": "08h49m12s", "dec": "+44d50m24s", "peak": "1 K"}]}
    settings = {
        "destriped": {"map.destriped.baseline": "2 s", **lost},
        "maximum_likelihood": {"map.maximum_likelihood.band_edges": "[0.5, 1.5] Hz"},
        "iterative": bright,
    }
    for maker, keys in settings.items():
        scene = surveysim.load_scene(path, {"map.maker": maker, **few, **keys})
        surveysim.run(scene, folder / maker, figures=False)
    return [folder / maker for maker in settings]


def _bands(folder):
    surveysim.run(write_camera(folder), folder / "two", figures=False)
    rest = folder / "bands"  # of the runs of bands, which are as other runs
    (folder / "two" / "bands").rename(rest)
    return folder / "two"


def _sweep(folder):
    surveysim.run_sweep(_scene(folder, "sweep", SMALL_SCENE + SWEEP), folder / "sweep", target_error=0.01)
    (folder / "sweep" / "points").rename(folder / "points")  # of the runs of points, which are as other runs
    return folder / "sweep"


def _budget(folder):
    """A simulated budget, and one by forecast with pairs of a scene that has no noise without its detectors'."""
    path = _scene(folder, "stages", SMALL_SCENE)
    surveysim.budget(surveysim.load_scene(path, {"photon": None, "excess": None}), folder / "budget", engine=SERIAL)
    few = {"photon": None, "excess": None, "atmosphere": None, "cleaning.algorithm": "none"}
    surveysim.budget(surveysim.load_scene(path, few), folder / "pairs", simulate=False, pairs=True)
    return folder / "budget", folder / "pairs"


def _comparison(folder):
    """Of the camera with a site, and of another seed."""
    path = _scene(folder, "seeds", RICH_SCENE.replace("observations = 34", "observations = 3"))
    for seed in (11, 12):
        surveysim.run(surveysim.load_scene(path, {"seed": seed}), folder / "seeds" / f"{seed}", figures=False)
    surveysim.compare([folder / "seeds" / "11", folder / "seeds" / "12"], folder / "compared")
    return folder / "compared"


def _search(folder, name, metrics=""):
    """A search with a limit that is not kept everywhere, and with the importance of its knobs."""
    text = SMALL_SCENE.replace("dead = [5]\n", "") + SEARCH.replace("[optimise]\n", f"[optimise]\n{metrics}\n")
    surveysim.optimise(_scene(folder, name, text), folder / name, simulate=not metrics, importance=2, engine=SERIAL)
    return folder / name


def _forecast(folder):
    write_forecast(folder / "forecast", forecast(prepare(surveysim.load_scene(_scene(folder, "small", SMALL_SCENE)))))
    return folder / "forecast"


def _accuracy(folder):
    path = _scene(folder, "small", SMALL_SCENE)
    result = measure_accuracy(path, {"observations": 8}, reference_error=0.5, seeds=1, observations=4)
    write_accuracy(folder / "accuracy", result, figures=False)
    write_extremes(folder / "accuracy" / "extremes.ecsv", CASES[:1], [run_case(CASES[0])])
    return folder / "accuracy"


def _paper(folder):
    (folder / "scenarios").mkdir()
    for number, name in enumerate(("lynx", "sds1", "cosmos", "acbar_south_pole")):
        text = PAPER_SCENE.replace("seed = 11", f"seed = {11 + number}")
        _scene(folder / "scenarios", name, text.replace("143 GHz", "268 GHz") if name == "cosmos" else text)
    _, failed = reproduce(wanted(TABLES, (5,), folder / "scenarios", observations=None), folder / "paper", SERIAL)
    assert not failed
    return folder / "paper"


def _explanation(folder):
    scene = surveysim.load_scene(_scene(folder, "explained", PAPER_SCENE), SETTINGS)
    explain(Explained(ingredients()[:1], (scene,), {(90.0, 0.0): scene}), folder / "explained", SERIAL)
    return folder / "explained"


# ---------------------------------------------------------------- what there is


def files(folder: Path) -> dict[str, str]:
    return {path.relative_to(folder).as_posix(): "" for path in sorted(folder.rglob("*")) if path.is_file()}


def columns(path: Path) -> dict[str, str]:
    table = Table.read(path)
    return {name: str(table[name].unit or "") for name in table.colnames}


def keys(path: Path) -> dict[str, str]:
    """Keys of all levels, joined by dots; those of a list's items are marked by brackets."""
    return {".".join(levels): "" for levels in _keys(json.loads(path.read_text()), ())}


def _keys(value, above):
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _keys(item, (*above, key))
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for item in value:
            yield from _keys(item, (*above[:-1], f"{above[-1]}[]"))
    else:
        yield above


def images(path: Path) -> dict[str, str]:
    with fits.open(path) as file:
        return {item.name: item.header["BUNIT"] for item in file[1:]}


def sparse_map(path: Path) -> dict[str, str]:
    with fits.open(path) as file:
        return {item.name: item.unit or "" for item in file[1].columns}


def arrays(path: Path) -> dict[str, str]:
    with np.load(path) as file:
        return dict.fromkeys(file.files, "")


def hdf5(path: Path) -> dict[str, str]:
    """Groups, data sets and attributes of all levels, joined by slashes."""
    found: list[str] = []
    with h5py.File(path) as file:
        file.visit(found.append)
        found += [f"{name}/{attribute}" for name in found for attribute in file[name].attrs]
        return dict.fromkeys([*found, *file.attrs], "")


def contents(name: str):
    """Reader of the names in a file; None for pictures and the like."""
    kinds = {"_healpix.fits": sparse_map, ".fits": images, ".h5": hdf5, ".ecsv": columns, "summary.json": keys}
    kinds |= {".npz": arrays}
    return next((read for ending, read in kinds.items() if name.endswith(ending)), None)


# ---------------------------------------------------------------- compared


@pytest.mark.parametrize("command", [*SURVEYS, "The paper", "An explanation"])
def test_every_file(made, command):
    there = {name: "" for folder in made[command] for name in files(folder)}
    if command == "The paper":  # one figure stands for all
        assert {"figure05.png", "figure05.ecsv"} <= there.keys()
    assert differences(PAGE[command], there) == []


@pytest.mark.parametrize("heading", [heading for heading in PAGE if heading.startswith("`")])
def test_every_name_in_a_file(made, heading):
    """Over all files that a heading stands for."""
    there = {}
    for folder in _folders(made, heading):
        for name in files(folder):
            if contents(name) and _is_of(heading, name):
                there |= contents(name)(folder / name)
    assert there, f"no such file was made: {heading}"
    assert differences(PAGE[heading], there) == []


def _folders(made, heading):
    if heading.startswith("`summary.json`"):
        return made[heading.removeprefix("`summary.json` of ").capitalize()]
    return [folder for folders in made.values() for folder in folders]


def _is_of(heading, name):
    from tests.docs.tables import pattern

    documented_name = heading.split("`")[1]
    return bool(pattern(documented_name).fullmatch(name))


def test_the_list_of_files_in_the_summary_is_whole(made):
    for command in SURVEYS:
        for folder in made[command]:
            listed = set(json.loads((folder / "summary.json").read_text())["files"])
            assert listed == files(folder).keys() - {"summary.json", CHECKPOINT, EVALUATIONS, RECORD, "scene.toml"}


@pytest.mark.parametrize("command", [*SURVEYS, "The paper", "An explanation"])
def test_the_record_is_whole(made, command):
    """Each file that a command writes is known as its own."""
    for folder in made[command]:
        record = json.loads((folder / RECORD).read_text())
        assert record["finished"] and record["files"].keys() == files(folder).keys() - {RECORD}


# ---------------------------------------------------------------- the comparison itself


def test_differences_are_found():
    said = {"ell": "", "noise_<data set>": "uK2", "gone": ""}
    there = {"ell": "", "noise_actual": "mK2", "noise_error_actual": "uK2"}
    assert differences(said, there) == [
        "not documented: noise_error_actual",
        "documented, but not there: gone",
        "noise_actual: unit 'mK2', documented as 'uK2'",
    ]
