"""Heavy imports that small commands start without, and the constants that stand in for them."""

import os
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from astropy.table import Table
from scipy.spatial.distance import pdist

from mapmaker.files import write_ecsv
from surveysim.runtime.environment import THREADS, UNUSED
from surveysim.telescope.focal_plane import closest_pair
from surveysim.telescope.layouts import hexagon
from tests.scenes import WHITE_NOISE_SCENE

UNWANTED = (
    "astropy.coordinates",
    "astropy.io.ascii",
    "astropy.table",
    "astropy.time",
    "astropy.wcs",
    "dask",
    "distributed",
    "ducc0",
    "healpy",
    "matplotlib",
    "scipy.interpolate",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.spatial",
    "scipy.stats",
    "surveysim.atmosphere.screen_simulation",
    "surveysim.timestreams.sky_maps",
)
# Also of a run of white noise without a score.
UNWANTED_IN_RUNS = (
    *UNWANTED,
    "rich",
    "surveysim.api.public",
    "surveysim.forecasting.forecast",
    "surveysim.metrics",
    "surveysim.output.study_writer",
    "surveysim.report.figures",
    "surveysim.studies",
)


# Of commands that simulate nothing.
UNWANTED_IN_CHECKS = ("astropy.coordinates", "astropy.table", "healpy", "matplotlib", "numba")
UNWANTED_IN_HELP = (*UNWANTED_IN_CHECKS, "astropy", "numpy", "scipy", "surveysim.scene.scene")


def imported(folder, *commands):
    """Modules that commands load, one after another, in a fresh process."""
    code = (
        "import sys\nfrom surveysim.cli.main import ended\n"
        "from surveysim.runtime.environment import settle\nsettle()\n"
        f"for command in {list(map(list, commands))}:\n    assert ended(command) == 0, command\n"
        "print(' '.join(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split())


def test_names_of_what_is_unwanted_exist():
    """A module that is renamed would never be found."""
    for name in {*UNWANTED_IN_RUNS, *UNWANTED_IN_HELP}:
        assert find_spec(name), name


def test_white_noise_is_run_and_written_without_what_it_does_not_need(tmp_path):
    """The whole command, in a fresh process."""
    (tmp_path / "white.toml").write_text(WHITE_NOISE_SCENE)
    options = ["--no-figures", "--quiet", "--workers", "1", "--out", "out"]
    loaded = imported(tmp_path, ["run", "white.toml", *options])
    assert not set(UNWANTED_IN_RUNS) & loaded and "numba" in loaded
    assert (tmp_path / "out" / "summary.json").exists()
    assert (tmp_path / "out" / "maps" / "actual.fits").exists()
    assert Table.read(tmp_path / "out" / "tables" / "observations.ecsv")["observation"].tolist() == [0, 1, 2, 3]


def test_scenes_are_checked_without_what_only_runs_need(tmp_path):
    """Also scenes of a site, nights and a layer, and of a sweep."""
    scenes = ("lynx", "first_light", "suzie_ii", "pixel_spacing_fixed_fov")
    loaded = imported(tmp_path, *(["check", scene] for scene in scenes))
    assert not set(UNWANTED_IN_CHECKS) & loaded and "surveysim.reduction.setup" in loaded


def test_forecasts_are_made_without_what_only_runs_need(tmp_path):
    """Of a site, nights and a layer. A kernel with a matrix product loads scipy.linalg; an interrupt then aborts it."""
    loaded = imported(tmp_path, ["forecast", "first_light", "--set", "observations=2", "--set", "schedule.nights=1"])
    unwanted = {"astropy", "h5py", "healpy", "matplotlib", "scipy.interpolate", "scipy.linalg", "scipy.optimize"}
    assert not unwanted & loaded and "surveysim.forecasting.layer_table" in loaded


def test_unused_modules_are_executed_at_their_first_use():
    """They are there, but for names that only their execution defines; numba finds BLAS without scipy.linalg."""
    code = (
        f"import sys\nfrom surveysim.runtime.environment import settle\nsettle()\nnames = {UNUSED}\n"
        "import numba.np.arraymath, scipy.special\n"
        "owns = [object.__getattribute__(sys.modules[name], '__dict__') for name in names]\n"
        "print(all(len(own) < 12 for own in owns), all(len(dir(sys.modules[name])) > 20 for name in names))\n"
        "print(numba.np.arraymath._HAVE_BLAS, 'scipy.linalg' in sys.modules)\n"
        "from scipy.linalg import cython_blas\nprint('dgemm' in cython_blas.__pyx_capi__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["True", "True", "True", "False", "True"], done.stderr


def test_matrix_products_get_one_thread_unless_the_environment_asks_for_more():
    code = (
        "from surveysim.runtime.environment import settle\nsettle()\nimport numpy, threadpoolctl\n"
        "print(*{library['num_threads'] for library in threadpoolctl.threadpool_info()})"
    )
    unset = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    for extra, threads in (({}, "1"), (dict.fromkeys(THREADS, "2"), "2")):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=unset | extra)
        assert done.stdout.split() == [threads], done.stderr


def test_help_loads_next_to_nothing(tmp_path):
    loaded = imported(tmp_path, ["--help"], ["--version"], ["run", "--help"])
    assert not set(UNWANTED_IN_HELP) & loaded and "surveysim.cli.app" in loaded


@pytest.mark.parametrize("n", [2, 3, 10, 300])
def test_closest_pair(n):
    for seed in range(10):
        positions = np.random.default_rng(seed).normal(0, 2, (n, 2))
        distance, first, second = closest_pair(positions)
        assert first < second and distance == pytest.approx(pdist(positions).min(), rel=1e-15)
        assert np.hypot(*(positions[first] - positions[second])) == pytest.approx(distance, rel=1e-15)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0, 1.0 + np.pi / 2])
def test_closest_pair_of_rows_and_lattices(angle):
    """Rows along and square to the line by which positions are sorted, and a lattice turned to it."""
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    row = np.column_stack([np.arange(200.0), np.zeros(200)])
    for positions in (row @ turn, hexagon(6, 1.0) @ turn):
        assert closest_pair(positions)[0] == pytest.approx(1, rel=1e-12)
        positions[17] = positions[3]
        assert closest_pair(positions) == (0.0, 3, 17)


# ---------------------------------------------------------------- ECSV


COLUMNS = {
    "number": np.array([3, -1, 2**62]),
    "small": np.array([0, 1, 255], np.uint8),
    "value": np.array([0.1, 1 / 3, -5e-324]),
    "odd": np.array([np.nan, np.inf, -np.inf]),
    "single": np.array([0.1, 1e-30, np.nan], np.float32),
    "y": np.array([True, False, True]),  # a bool in YAML 1.1, if it were not in quotes
    "text": np.array(["plain", "", 'two words, "quoted"']),
    "strange": np.array(["#not a comment", "nan", "µK²"]),
    'name with "quotes"': [1, 2, 3],
}
UNITS = {"value": "uK2 sr", "single": "mK2 / Hz", "number": "s"}
META = {
    "comment": 'uK_CMB^2: "µ", a \\ and # signs',
    "count": 7,
    "level": 1e-5,
    "large": -2.5e300,
    "nothing": None,
    "yes": True,
    "best": [0, 2],
    "names": ("a", "no"),
}


def test_a_table_is_as_astropy_reads_it(tmp_path):
    path = tmp_path / "tables" / "all.ecsv"
    write_ecsv(path, COLUMNS, UNITS, META)
    table = Table.read(path, format="ascii.ecsv")
    assert table.colnames == list(COLUMNS)
    for name, values in COLUMNS.items():
        # astropy takes an empty text for a missing one, also of its own writer.
        found = table[name].filled("") if name == "text" else np.asarray(table[name])
        np.testing.assert_array_equal(found, values)
        assert table[name].dtype.kind == np.asarray(values).dtype.kind
        assert table[name].dtype.kind == "U" or table[name].dtype == np.asarray(values).dtype
        assert (None if table[name].unit is None else str(table[name].unit)) == UNITS.get(name)
    assert dict(table.meta) == META | {"names": ["a", "no"]}
    assert [other.name for other in path.parent.iterdir()] == ["all.ecsv"]


def test_special_numbers_of_meta(tmp_path):
    write_ecsv(tmp_path / "t.ecsv", {"a": [1.5]}, {}, {"odd": [np.inf, -np.inf, np.nan, np.float32(0.5), np.int32(4)]})
    found = Table.read(tmp_path / "t.ecsv", format="ascii.ecsv").meta["odd"]
    np.testing.assert_array_equal(found, [np.inf, -np.inf, np.nan, 0.5, 4])


def test_a_table_without_rows(tmp_path):
    write_ecsv(tmp_path / "t.ecsv", {"a": np.zeros(0), "b": np.zeros(0, int)}, {"a": "s"}, {})
    table = Table.read(tmp_path / "t.ecsv", format="ascii.ecsv")
    assert (len(table), table.colnames, table.meta) == (0, ["a", "b"], {})


@pytest.mark.parametrize(
    "columns, units, meta, message",
    [
        ({"a": np.zeros((2, 2))}, {}, {}, "column a: found 2 dimensions"),
        ({"a": [1j]}, {}, {}, "column a: found 1 dimensions of complex128"),
        ({"a": [None, 1.0]}, {}, {}, "column a: found 1 dimensions of object"),
        ({"a": ["one\ntwo"]}, {}, {}, "column a: found a line break"),
        ({"a": [1, 2], "b": [1]}, {}, {}, r"found columns of \[2, 1\] rows"),
        ({"a": [1]}, {"b": "s"}, {}, r"found units of \['b'\]"),
        ({"a": [1]}, {}, {"b": {1}}, r"found \{1\} in meta"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path, columns, units, meta, message):
    with pytest.raises(ValueError, match=message):
        write_ecsv(tmp_path / "t.ecsv", columns, units, meta)
    assert not list(tmp_path.iterdir())
