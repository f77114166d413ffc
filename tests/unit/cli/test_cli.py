"""The command line: wrong input in one line, clean interruption, progress, plan, check, new."""

import contextlib
import errno
import os
import pty
import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from surveysim.cli import options
from surveysim.runtime.errors import OutOfRangeError
from surveysim.survey import run as survey
from tests.camera import BAND, BOLOMETER, CAMERA, HORNS, PHOTON, QUIET, SITE, STATED_SKY
from tests.scenes import SCHEDULE, SMALL_SCENE, WHITE_NOISE_SCENE, without_sections
from tests.unit.survey.test_interruption import COMMAND, assert_same_results

ECSV = (
    "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: x, unit: arcsec, datatype: float64}\n"
    "# - {name: y, unit: arcsec, datatype: float64}\nx y\n"
)


@pytest.fixture
def scene(scene_file):
    return scene_file


def refused(call, scene, *arguments):
    """The line that `run` refuses a scene with; checks that nothing is written."""
    out = scene.parent / "out"
    code, _, error = call("run", scene, "--out", out, *arguments)
    assert code == 2 and not out.exists()
    assert len(error.splitlines()) == 1 and "Traceback" not in error
    return error


@pytest.mark.parametrize(
    "setting, words",
    [
        ("typo=1", ("typo: unknown key; allowed are atmosphere",)),
        ("scan=3", ("scan: found 3; a section is expected",)),
        ("instrument.layout=[1]", ("instrument.layout: found [1]; a section is expected",)),
        ("title=2003-01-01", ("title: found 2003-01-01; a text in quotes is expected",)),
        ("atmosphere.b2_probabilities=0.5", ("b2_probabilities: found 0.5; a list is expected",)),
        ("atmosphere.b2=[]", ("b2: found 0 values for 3", "expected")),
        ("atmosphere.spectral_index=true", ("index: found true",)),
        ("atmosphere.spectral_index=1/0", ("index: found '1/0'; a number or a fraction like '11/3' is expected",)),
        ("scan.speed=4 arcmin", ("scan.speed: found '4 arcmin'", "like 'arcmin / s'")),
        ("scan.speed=-4 arcmin/s", ("scan.speed: found", "0.001 arcsec / s or more")),
        ("scan.scans=nan", ("scan.scans: found nan; an integer is expected",)),
        ("scan.scans=1000000000", ("scan.scans: found 1000000000", "100000")),
        ("observations=1000000000", ("observations: found 1000000000", "1000000")),
        ("instrument.layout.rings=61", ("rings: found 61", "60")),
        ("instrument.layout.rings=0", ("dead: found [5]", "0 to 0 are expected")),
        ("instrument.layout.dead=[19]", ("dead: found [19]", "0 to 18 are expected")),
        (
            "score.mask_separation_f_lambda=9",
            ("mask_separation_f_lambda: found 1 detector;", "needs 2 or more"),
        ),
        ("scan.duration=0.5 s", ("scan.duration: found 5 samples", "8 or more")),
        ("scan.duration=2e5 s", ("scan: found a map that reaches", "15 deg or less")),
        ("map.pixel=0.01 arcsec", ("map.pixel: found a map of", "16384 or less")),
        ("scan.sample_rate=9e8 Hz", ("scan.sample_rate: found", "1e+11 or less")),
        ("scan.sample_rate=2e7 Hz", ("scan.sample_rate: found 4.8e+08 samples", "1e+08 or less")),
        ("score.size=3 deg", ("score.size: found 180 arcmin", "or less is expected")),
        ("score.ell_max=30000", ("score.ell_max: found 30000", "21600 or less")),
        ("score.ell_bin=3", ("score.ell_bin: no Fourier mode", "expected")),
        ("score.white_noise_above=5 Hz", ("score.white_noise_above: found 5 Hz", "the highest frequency of a scan")),
        ("instrument.beam_fwhm=5 deg", ("score.ell_min: found 4000", "beam")),
        ("excess.band_limit=0.1 Hz", ("excess.band_limit: found 0.1 Hz", "1 / scan.duration")),
        ("atmosphere.outer_scale=1 m", ("atmosphere.outer_scale: found 1 m with an aperture of 8 m",)),
        ("map.healpix_nside=3", ("healpix_nside: found 3; a power of two",)),
        ("map.healpix_nside=8192", ("map.healpix_nside: found 8192 for pixels of", "4096 or less is expected")),
        ("sky.curved_nside=512", ("sky.curved_nside: found; the key is 'curved_lmax' now",)),
        ("sky.curved_lmax=1", ("sky.curved_lmax: found 1; ", "greater than or equal to 2")),
        ("sky.curved_lmax=true", ("sky.curved_lmax: found true; no key of a scene is true or false",)),
        ("sky.curved_lmax=12000", ("sky.curved_lmax: found 12000; 15600 or more", "up to 12000", "its taper")),
        ("fixed_pointing.elevation=91 deg", ("elevation: found '91 deg'; 90 deg or less",)),
        ("field.dec=91 deg", ("field.dec: found '91 deg'; -90 deg to 90 deg",)),
        ("name=..", ("name: found '..'",)),
        ("assumed=[]", ("assumed: unknown key",)),
        ("exces=", ("exces", "unknown key; did you mean excess?")),
        ("assumed=", ("assumed", "unknown key")),
        ("scan.speed=", ("scan.speed: missing",)),
    ],
)
def test_wrong_scene(call, scene, setting, words):
    error = refused(call, scene, "--set", setting)
    assert error.startswith((f"{scene}: ", f"{scene} with --set {setting}: "))
    assert all(word in error for word in words), error


def test_too_few_detectors(call, scene):
    text = without_sections(SMALL_SCENE, "score").replace("dead = [5]", "")
    scene.write_text(text.replace("rings = 2", "rings = 0"))
    assert "cleaning.algorithm: found 1 detector; 'average' needs 2 or more" in refused(call, scene)


@pytest.mark.parametrize("item", ["scan.speed", "=3", "scan..speed=3", ""])
def test_set_syntax(call, scene, item):
    assert f"--set: found {item!r}; KEY=VALUE is expected" in refused(call, scene, "--set", item)


def test_set_values(tmp_path):
    """TOML where it is TOML, else text: quantities need no quotes; one value only."""
    parse = options.setting
    assert parse("a=3") == ("a", 3) and parse("a = [1, 2]") == ("a", [1, 2])
    assert parse("a=4 arcmin / s") == ("a", "4 arcmin / s") == parse('a="4 arcmin / s"')
    assert parse("a=1\nb=2") == ("a", "1\nb=2") and parse("a=") == ("a", None) and parse("a=x=y") == ("a", "x=y")


@pytest.mark.parametrize("workers", ["0", "-1"])
def test_workers(call, scene, workers):
    assert f"--workers: found {workers}; 1 or more is expected" in refused(call, scene, "--workers", workers)


@pytest.mark.parametrize(
    "content, words",
    [
        (None, "can't be read"),
        (b"\x93NUMPY\x00\xff\xfe", "line 1 is not UTF-8"),
        (SMALL_SCENE[:300].encode(), "missing"),
        (b"first_night = 2003-02-30", "not a valid TOML file"),
        (b"a = " + b"[" * 5000, "expected"),
        (b"", "missing"),
    ],
)
def test_unreadable_scene(call, tmp_path, content, words):
    path = tmp_path / "bad.toml"
    if content is not None:
        path.write_bytes(content)
    code, _, error = call("run", path, "--out", tmp_path / "out")
    assert code == 2 and not (tmp_path / "out").exists()
    assert all(line.startswith(f"{path}: ") for line in error.splitlines()) and words in error
    code, _, error = call("run", tmp_path)
    assert code == 2 and "can't be read (Is a directory)" in error


@pytest.mark.parametrize(
    "table, words",
    [
        (ECSV + "0 0\n40 0\n0 0\n", "row 3: found the position of row 1"),
        (ECSV, "no row"),
        (ECSV + "0 nan\n", "row 1, column 'y': found 'nan arcsec'; a finite offset"),
        (ECSV.replace("unit: arcsec", "unit: m"), "column 'x': found the unit 'm'"),
        (ECSV.replace("name: x", "name: z") + "0 0\n", "columns x and y"),
        (ECSV[:40], "found no row of column names"),
        ("\0\1\2", "'# %ECSV 1.0' is expected in the first line"),
        (None, "no such file"),
    ],
)
def test_positions(call, scene, table, words):
    before = 'camera_rotation_range = "60 deg"'
    text = SMALL_SCENE.replace(before, f'{before}\npositions = "table.ecsv"')
    start, end = text.index("[instrument.layout]"), text.index("[scan]")
    scene.write_text(text[:start] + text[end:])
    if table is not None:
        (scene.parent / "table.ecsv").write_text(table)
    error = refused(call, scene)
    assert "instrument" in error and words in error and error.startswith(f"{scene}: ")


def test_schedules(call, scene):
    text = without_sections(SMALL_SCENE, "fixed_pointing") + SCHEDULE
    scene.write_text(text)
    assert "schedule: 100000 observations" in (error := refused(call, scene, "--set", "observations=100000"))
    assert "would fit" in error and error.startswith(f"{scene} with --set observations=100000: schedule: ")
    room = int(re.search(r"\((\d+) a night\)", error)[1])
    assert f"; nights = {-(-100000 // room)} or more, a larger max_hour_angle or a lower min_elevation is" in error
    error = refused(call, scene, "--set", "field.dec=-60 deg")
    assert "schedule: the field never rises above 10." in error and "40.00 deg" in error
    for date in ("28 October", "2003-10-32", 3):
        assert "first_night: found" in refused(call, scene, "--set", f"schedule.first_night={date}")
    scene.write_text(text.replace('"2003-10-28"', "2003-10-28"))
    assert "a date in quotes like '2003-10-28' is expected" in refused(call, scene)


def test_a_file_in_the_way(call, scene):
    """Found before any work."""
    out = scene.parent / "out"
    out.write_text("mine")
    for found in (out, out / "below"):
        code, _, error = call("run", scene, "--out", found)
        assert code == 1 and str(out) in error and len(error.splitlines()) == 1
    assert out.read_text() == "mine"
    out.unlink()
    out.mkdir()
    (out / "maps").write_text("mine")
    code, _, error = call("run", scene, "--out", out)
    assert code == 1 and f"{out / 'maps'}: a file where a folder is to be written" in error
    assert list(out.iterdir()) == [out / "maps"]
    (out / "maps").unlink()
    (out / "summary.json").mkdir()
    assert call("run", scene, "--out", out)[0] == 1


def test_full_disk(call, scene, monkeypatch):
    """One line that names the file; no half-written checkpoint, and an older one stays."""
    out = scene.parent / "out"

    fsync = os.fsync

    def full(file):
        if "checkpoint" in os.readlink(f"/proc/self/fd/{file}"):
            raise OSError(errno.ENOSPC, "No space left on device")
        fsync(file)

    monkeypatch.setattr(survey, "CHECKPOINT_SECONDS", 0.0)
    monkeypatch.setattr("mapmaker.files.os.fsync", full)
    code, _, error = call("run", scene, "--out", out, "--workers", 1, "--quiet")
    assert (code, error) == (1, f"{out / 'checkpoint.h5'}: No space left on device\n")
    assert sorted(path.name for path in out.iterdir()) == [".surveysim.json", "scene.toml"]


def test_failure_in_an_observation(call, scene, monkeypatch):
    def fail(*arguments, **options):
        raise OutOfRangeError("no strip\nis long enough")

    monkeypatch.setattr(survey, "observe", fail)
    code, _, error = call("run", scene, "--out", scene.parent / "out", "--workers", 1)
    assert (code, error) == (1, f"{scene}: an observation failed: no strip is long enough\n")


@pytest.mark.parametrize("fault", [FloatingPointError("overflow"), np.linalg.LinAlgError("Singular matrix")])
def test_a_fault_of_numpy_leaves_finished_work_to_resume(call, scene, monkeypatch, fault):
    """The line says it, beside where the details are."""
    observe, done, out = survey.observe, [], scene.parent / "out"

    def fail_third(*arguments, **options):
        done.append(arguments)
        if len(done) == 3:
            raise fault
        return observe(*arguments, **options)

    monkeypatch.setattr(survey, "observe", fail_third)
    code, _, error = call("run", scene, "--out", out, "--workers", 1, "--quiet")
    assert code == 1 and error.startswith(f"surveysim can't go on: {type(fault).__name__}: {fault}; please report it")
    command = shlex.join(["surveysim", "run", str(scene), "--out", str(out), "--workers", "1", "--quiet", "--resume"])
    assert error.endswith(f"; go on with: {command}\n") and len(error.splitlines()) == 1
    monkeypatch.setattr(survey, "observe", observe)
    assert call("run", scene, "--out", out, "--workers", 1, "--quiet", "--resume", "--no-figures")[0] == 0


@pytest.mark.parametrize("damage", ["truncated", "bits", "other", "version"])
def test_wrong_checkpoints(call, scene, monkeypatch, damage):
    out = scene.parent / "out"
    interrupt_after(call, scene, out, 2, monkeypatch)
    path = out / "checkpoint.h5"
    raw = bytearray(path.read_bytes())
    if damage == "truncated":
        raw = raw[: len(raw) // 2]
    if damage == "bits":
        raw[len(raw) // 3] ^= 0x10
    if damage == "version":
        monkeypatch.setattr("surveysim.survey.checkpoint.__version__", "0.0.1")
    path.write_bytes(raw)
    settings = ("--set", "seed=12") if damage == "other" else ()
    code, _, error = call("run", scene, "--out", out, "--resume", "--workers", 1, *settings)
    where = out if damage == "other" else path
    assert code == 2 and error.startswith(f"{where}: ") and len(error.splitlines()) == 1
    assert ("go on with --resume" if damage in ("truncated", "bits") else "--force") in error
    assert path.read_bytes() == raw
    assert sorted(item.name for item in out.iterdir()) == [".surveysim.json", "checkpoint.h5", "scene.toml"]


def interrupt_after(call, scene, out, done, monkeypatch):
    """A run that is interrupted once `done` observations are in."""

    @contextlib.contextmanager
    def display(name, work, quiet, workers):
        def show(finished, status, left_s=None):
            if finished == done:
                raise KeyboardInterrupt

        yield show

    with monkeypatch.context() as patch:
        patch.setattr("surveysim.cli.progress.progress_display", display)
        code, _, error = call("run", scene, "--out", out, "--workers", 1)
    command = shlex.join(["surveysim", "run", str(scene), "--out", str(out), "--workers", "1", "--resume"])
    assert (code, error) == (130, f"interrupted; go on with: {command}\n")


def test_resume_gives_the_same_bits(call, scene, monkeypatch):
    out, whole = scene.parent / "out", scene.parent / "whole"
    interrupt_after(call, scene, out, 3, monkeypatch)
    for directory, more in ((out, ["--resume"]), (whole, [])):
        code, _, error = call("run", scene, "--out", directory, "--no-figures", "--workers", 1, "-q", *more)
        assert (code, error) == (0, "")
    assert_same_results(out, whole)


def test_progress_lines(call, scene):
    code, out, error = call("run", scene, "--out", scene.parent / "out", "--workers", 1, "--no-figures")
    assert code == 0 and "sigma(A)" in out and "Results in" in out
    lines = error.splitlines()
    assert [line.split()[1] for line in lines] == ["1/4", "2/4", "3/4", "4/4"]
    assert [" s left" in line for line in lines[1:]] == [True, True, False] and "\x1b" not in error
    assert "sigma(A) = " in lines[-1] and " uK_CMB^2" in lines[-1]


def test_quiet(call, scene):
    arguments = ("run", scene, "--out", scene.parent / "out", "--workers", 1, "--no-figures", "--quiet")
    assert call(*arguments) == (0, "", "")


def test_bar_on_a_terminal(tmp_path):
    path = tmp_path / "white.toml"
    path.write_text(WHITE_NOISE_SCENE)
    ours, theirs = pty.openpty()
    arguments = ["run", str(path), "--out", str(tmp_path / "o"), "--no-figures", "--workers", "1"]
    with subprocess.Popen([*COMMAND, *arguments], stdout=theirs, stderr=theirs, stdin=theirs) as process:
        os.close(theirs)
        shown = b""
        with contextlib.suppress(OSError):
            while part := os.read(ours, 4096):
                shown += part
    os.close(ours)
    assert process.returncode == 0
    assert b"4/4" in shown and "━".encode() in shown and b"\x1b[" in shown


def test_help(call):
    code, out, error = call()
    assert code == 2 and all(name in out + error for name in ("run", "forecast", "plan", "check", "new"))
    code, out, _ = call("--help")
    assert code == 0 and "Usage" in out
    code, _, error = call("run")
    assert code == 2 and "Missing argument 'SCENE'" in error
    code, _, error = call("sprint")
    assert code == 2 and "sprint" in error


def test_check(call, scene):
    assert call("check", scene) == (
        0,
        f"{scene}: 'small' is a scene that can be run\n18 detectors; 1 dead position of 19\n",
        "",
    )
    code, out, error = call("check", scene, "--set", "scan.typo=1", "--set", "map.typo=1")
    assert code == 2 and out == "" and len(error.splitlines()) == 2
    assert sorted(path.name for path in scene.parent.iterdir()) == ["small.toml"]


@pytest.mark.parametrize(
    "settings, words",
    [
        (("observations=300000",), "with 1,296 million detector-samples: 'surveysim plan' says"),
        (("map.pixel=0.5 arcsec", "scan.scans=2", "score.size=7 arcmin", "score.ell_bin=4000"), " and maps of "),
        (("observations=200000",), ""),
    ],
)
def test_check_says_that_a_scene_is_large(call, scene, settings, words):
    """One with many samples, or a fine map, runs for minutes."""
    code, out, error = call("check", scene, *(part for item in settings for part in ("--set", item)))
    first, _, *more = out.splitlines()
    assert (code, first, error) == (0, f"{scene}: 'small' is a scene that can be run", "")
    assert len(more) == bool(words) and all(line.startswith("it is large, ") and words in line for line in more)


def test_optics(call, tmp_path):
    """Tables of load and noise; a scene without a load is told so."""
    path, keys = tmp_path / "camera.toml", (*BAND.items(), *HORNS.items())
    settings = [part for key, value in keys for part in ("--set", f"{key}={value}")]
    path.write_text(QUIET + PHOTON + CAMERA + SITE)
    code, out, error = call("optics", path, *settings)
    assert (code, error) == (0, "")
    for words in ("Load of a detector: median water, 1.68 mm", "atmosphere", "NEFD [mJy", "effective area of 78"):
        assert words in out
    path.write_text(WHITE_NOISE_SCENE)
    code, out, error = call("optics", path)
    assert (code, out) == (2, "") and "'photon.load' or a section [optics] is expected" in error
    assert len(error.splitlines()) == 1


def test_optics_of_a_sweep_is_one_table(call):
    """A row for each point, the swept value first."""
    code, out, error = call("optics", "horn_spacing_280")
    assert (code, error) == (0, "")
    title, *lines = out.splitlines()
    assert title.strip() == "Load and sensitivity of a detector: median water, 0.830 mm, at an elevation of 60.0 deg"
    rows = [[cell.strip() for cell in line.split("│")[1:4]] for line in lines if line.startswith("│")]
    assert rows == [["1.2", "241", "4.50"], ["0.8", "542", "2.41"]]


def test_check_warns_of_a_bolometer_that_saturates(call, tmp_path):
    path, keys = tmp_path / "camera.toml", (*BAND.items(), *HORNS.items(), ("optics.sky", "400 K"))
    settings = [part for key, value in keys for part in ("--set", f"{key}={value}")]
    path.write_text(QUIET + PHOTON + STATED_SKY + BOLOMETER)
    code, out, error = call("check", path, *settings)
    assert (code, error) == (0, "")
    assert out.splitlines()[2].startswith("Warning: detector.bolometer: ") and "3.57 pW" in out


def test_plan(call, tmp_path):
    path = tmp_path / "white.toml"
    path.write_text(WHITE_NOISE_SCENE)
    code, out, error = call("plan", path, "--workers", 1)
    assert (code, error) == (0, "")
    assert "4 observations of 4 scans, 18 detectors" in out
    for name in ("atmosphere", "excess", "photon", "sky", "score"):
        assert f"left out: no section [{name}]" in out
    assert "MB a process" in out and "with 1 worker(s)" in out
    assert "0.01728 million detector-samples" in out  # 4 observations of 4 scans of 60 samples, 18 detectors
    assert list(tmp_path.iterdir()) == [path]


def test_accuracy_that_is_refused(call, scene):
    for arguments in ((), (scene, "--extremes")):
        code, out, error = call("accuracy", *arguments)
        assert (code, out) == (2, "") and "one of them is expected" in error
    scene.write_text(without_sections(SMALL_SCENE, "score"))
    code, out, error = call("accuracy", scene)
    assert (code, out) == (2, "") and "score: missing; accuracy is that of a score" in error


def test_extremes(call, tmp_path, monkeypatch):
    from surveysim.studies.stress import CASES

    monkeypatch.setattr("surveysim.studies.stress.CASES", tuple(case for case in CASES if "one detector" in case.name))
    code, out, error = call("accuracy", "--extremes", "--out", tmp_path / "out")
    assert code == 0 and "2 of 2 as expected" in out and error.splitlines()[-1].startswith("extremes: 2/2 cases")
    table = Table.read(tmp_path / "out" / "extremes.ecsv", format="ascii.ecsv")
    assert list(table["ok"]) == [True, True] and len(table["why"][0]) > 5


def test_new(call, scene, monkeypatch):
    monkeypatch.chdir(scene.parent)
    code, out, _ = call("new", "mine", "--like", "small.toml")
    assert code == 0 and Path("scenarios/mine.toml").read_text() == SMALL_SCENE and "surveysim check" in out
    assert call("new", "yours", "--like", "mine")[0] == 0
    with Path("scenarios/yours.toml").open("a") as file:
        file.write('[sweep]\n"scan.scans" = [4, 5]\n')
    assert (
        "[sweep] varies keys of the copied scene" in call("new", "ours", "--like", "yours")[1] and "[sweep]" not in out
    )
    for arguments, words in (
        (("mine", "--like", "yours"), "exists"),
        (("other", "--like", "nowhere"), "optimal_scan_speed, ours, pixel_spacing_fixed_count"),
        (("../other", "--like", "mine"), "letters, digits"),
        (("..", "--like", "mine"), "none of the last two first"),  # no scene by this name could be run
        (("x" * 101, "--like", "mine"), "letters, digits"),
    ):
        code, _, error = call("new", *arguments)
        assert code == 2 and words in error and len(error.splitlines()) == 1
    assert call("new", "other")[0] == 2


def test_verbose_prints_more(call, scene):
    """Of a run, a forecast and their sweeps; all that the short output has is in the long one too."""
    path = scene.parent / "sweep.toml"
    path.write_text(SMALL_SCENE + '\n[sweep]\n"scan.turnaround" = ["10 s", "11 s"]\n')
    out = ("--out", scene.parent / "out", "--force", "--no-figures")
    for command in (("forecast", scene), ("run", scene, "--workers", 1), ("forecast", path)):
        (code, short, _), (_, long, _) = call(*command, *out), call(*command, *out, "--verbose")
        assert code == 0 and len(long.splitlines()) >= len(short.splitlines()) > 3
        if command[0] == "run":
            assert len(long.splitlines()) > len(short.splitlines())
