"""Output directories of the command line: their names, what is refused with which exit code, runs at the same time."""

import json
import os
import re
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from surveysim import load_scene, run
from surveysim.output.directory import FinishedError
from surveysim.output.lock import LOCK, OutputError, locked
from surveysim.output.record import RECORD
from surveysim.runtime.engine import SERIAL
from tests.scenes import SMALL_SCENE, WHITE_NOISE_SCENE
from tests.unit.cli.test_cli import interrupt_after
from tests.unit.output.test_directory import put, tree
from tests.unit.output.test_lock import left
from tests.unit.studies.test_sweep_run import WHITE
from tests.unit.survey.test_interruption import long_scene, none_left, start, wait_for

SWEEP = '\n[sweep]\n"scan.speed" = ["3 arcmin / s", "4 arcmin / s"]\n'
QUICK = ("--engine", "serial", "--no-figures", "-q")


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A quick scene in the working directory."""
    monkeypatch.chdir(tmp_path)
    path = Path("small.toml")
    path.write_text(WHITE_NOISE_SCENE.replace("observations = 4", "observations = 2"))
    return path


def names(directory="outputs"):
    return sorted(path.name for path in Path(directory).iterdir())


def test_each_set_of_overrides_has_a_directory(call, scene):
    """Neither is in the other's way; the same again takes the place of its own."""
    for _ in range(2):
        assert call("run", scene, *QUICK) == (0, "", "")
        assert call("run", scene, *QUICK, "--set", "scan.speed=8 arcmin / s") == (0, "", "")
    assert names() == ["small", "small+scan.speed=8arcmin-s"]
    assert call("run", scene, *QUICK, "--set", "scan.speed=8arcmin/s", "--workers", 1) == (0, "", "")
    scene.write_text(scene.read_text().replace("seed = 11", "seed = 12"))
    before = tree(Path("outputs"))
    code, out, error = call("run", scene, *QUICK)
    words = "holds results of 'small' with other settings; --force replaces them, --out writes elsewhere"
    assert (code, out, error) == (2, "", f"outputs/small: {words}\n") and tree(Path("outputs")) == before
    assert call("run", scene, *QUICK, "--force") == (0, "", "")
    assert json.loads(Path("outputs/small/summary.json").read_text())["seed"] == 12


def test_its_own_scene_run_again_gives_the_same_bits(call, scene):
    assert call("run", scene, *QUICK, "--set", "seed=5", "--out", "one") == (0, "", "")
    assert call("run", "one/scene.toml", *QUICK, "--out", "two") == (0, "", "")
    for name in ("maps/actual.fits", "scene.toml", "scene.json"):
        assert Path("one", name).read_bytes() == Path("two", name).read_bytes()
    assert call("run", "one/scene.toml", *QUICK, "--out", "one") == (0, "", "")
    assert Path("one/scene.toml").read_bytes() == Path("two/scene.toml").read_bytes()


def test_a_finished_run_has_nothing_to_resume(call, scene):
    assert call("run", scene, *QUICK) == (0, "", "")
    before = tree(Path("outputs"))
    said = "outputs/small: the run is finished; there is nothing to resume\n"
    assert call("run", scene, "--engine", "serial", "--resume") == (0, "", said)
    assert tree(Path("outputs")) == before
    with pytest.raises(FinishedError):
        run(load_scene(scene), "outputs/small", engine=SERIAL, resume=True)
    assert call("run", scene, *QUICK, "--resume", "--force")[::2] == (
        2,
        "outputs/small: found both resume and force; a run goes on, or is replaced\n",
    )


def test_a_checkpoint_is_not_thrown_away(call, scene, monkeypatch):
    interrupt_after(call, scene, Path("outputs/small"), 1, monkeypatch)
    before = tree(Path("outputs"))
    code, _, error = call("run", scene, *QUICK)
    assert code == 2 and "checkpoint.h5: from a run that has not finished; --resume goes on from there" in error
    assert tree(Path("outputs")) == before
    assert call("run", scene, *QUICK, "--resume") == (0, "", "")


def test_observations_are_added_to_a_finished_run(call, scene):
    """In place of its results, which stay until then; other changes of the scene are refused."""
    assert call("run", scene, *QUICK, "--out", "out") == (0, "", "")
    more = ("--set", "observations=8")
    code, _, error = call("run", scene, *QUICK, *more, "--out", "out")
    assert code == 2 and "with other settings; --resume changes the number of observations, --force replaces" in error
    code, _, error = call("run", scene, *QUICK, *more, "--set", "seed=12", "--out", "out", "--resume")
    assert code == 2 and "with other settings; --force replaces them" in error
    assert call("run", scene, *QUICK, *more, "--out", "out", "--resume") == (0, "", "")
    assert call("run", scene, *QUICK, *more, "--out", "whole") == (0, "", "")
    maps = [fits.getdata(Path(folder, "maps/actual.fits")) for folder in ("out", "whole")]
    np.testing.assert_array_equal(*maps)
    code, _, error = call("run", scene, *QUICK, "--out", "out", "--resume")
    assert code == 2 and "checkpoint.h5: has observations up to number 7, found observations = 2; 8 or more" in error
    said = "out: the run is finished; there is nothing to resume\n"
    assert call("run", scene, *QUICK, *more, "--out", "out", "--resume") == (0, "", said)


@pytest.mark.parametrize("text", [WHITE_NOISE_SCENE, WHITE + SWEEP], ids=["scene", "sweep"])
def test_a_run_that_is_interrupted_costs_no_earlier_results(call, scene, monkeypatch, text):
    scene.write_text(text.replace("observations = 4", "observations = 2"))
    assert call("run", scene, *QUICK, "--out", "out") == (0, "", "")
    before = tree(Path("out"))

    def stopped(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("surveysim.api.surveys.survey_result", stopped)
        patch.setattr("surveysim.api.sweeps.compare_runs", stopped)
        assert call("run", scene, *QUICK, "--out", "out")[0] == 130
    after = tree(Path("out"))
    # Sums, and results of points, have the times of their own run.
    timed = {RECORD, "checkpoint.h5", *(name for name in before if re.match(r"points/\d+/[^/]*$", name))}
    results = [name for name in before if name not in timed]
    assert [after[name] for name in results] == [before[name] for name in results]
    assert call("run", scene, *QUICK, "--out", "out", "--resume") == (0, "", "")
    assert names("out") == sorted({name.partition("/")[0] for name in before})


@pytest.mark.parametrize("command", ["run", "forecast"])
def test_sweeps(call, scene, command):
    """As scenes, with the reference point and the table [sweep]."""
    scene.write_text(WHITE.replace("observations = 4", "observations = 2") + SWEEP)
    how = QUICK if command == "run" else ("--no-figures", "-q")
    ending = "" if command == "run" else "_forecast"
    assert call(command, scene, *how, "--reference", 1) == (0, "", "")
    one = Path(f"outputs/small{ending}+reference=1")
    assert call(command, one / "scene.toml", *how, "--out", "two") == (0, "", "")
    assert (one / "sweep.ecsv").read_bytes() == Path("two/sweep.ecsv").read_bytes()
    assert call(command, scene, *how, "--out", "two")[0] == 2
    assert call("forecast" if command == "run" else "run", scene, *how[-2:], "--out", "two")[0] == 2
    if command == "run":
        said = (0, "", "two: the run is finished; there is nothing to resume\n")
        assert call(command, "two/scene.toml", *how, "--out", "two", "--resume") == said
    assert call(command, scene, *how, "--out", "two", "--force") == (0, "", "")


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "small.toml", *QUICK),
        ("forecast", "small.toml", "-q"),
        ("accuracy", "small.toml", "-q", "--no-figures"),
        ("accuracy", "--extremes", "-q"),
        ("paper", "--figure", "1", "-q"),
    ],
)
def test_every_command_leaves_files_of_the_user_alone(call, scene, arguments):
    """None starts its work where a file or a link of the user is in its way, or another job works."""
    out, others = Path("out"), Path("others")
    scene.write_text(SMALL_SCENE)
    mine = ("summary.json", "forecast.ecsv", "extremes.ecsv", "figure01.ecsv")
    put(Path(), {f"out/{name}": '{"files": ["thesis.tex"]}' for name in mine})
    put(Path(), {"out/thesis.tex": "mine", "out/.writable": "mine", "others/download.part": "mine"})
    (out / "figures").symlink_to("../others")
    before = tree(Path()), tree(others)
    code, text, error = call(*arguments, "--out", out)
    assert (code, text) == (2, "") and len(error.splitlines()) == 1
    assert "not written by this program" in error and "--force" in error and "--out" in error
    assert (tree(Path()), tree(others)) == before


def test_a_report_of_the_user(call, scene):
    assert call("run", scene, *QUICK, "--out", "out") == (0, "", "")
    assert call("report", "out")[0] == 0
    (Path("out") / RECORD).unlink()
    page = Path("out/report.html").read_bytes()
    code, _, error = call("report", "out")
    assert (
        code == 2 and error == "out/report.html: not written by this program, or changed since; --force replaces it\n"
    )
    assert call("report", "out", "--force")[0] == 0 and Path("out/report.html").read_bytes() == page


def test_new_never_writes_over_a_scene(call, scene):
    Path("scenarios").mkdir()
    Path("scenarios/link.toml").symlink_to("../mine.toml")  # to nowhere as yet
    put(Path(), {"scenarios/there.toml": "mine"})
    for name in ("there", "link"):
        code, _, error = call("new", name, "--like", scene)
        assert code == 2 and error == f"scenarios/{name}.toml: exists; another name is expected\n"
    assert Path("scenarios/there.toml").read_text() == "mine" and not Path("mine.toml").exists()


def test_outputs_beside_a_project(call, scene):
    """In the working directory: refused where its own scene would be written over."""
    put(Path(), {"scene.toml": scene.read_text(), "figures/own.png": "mine", "maps/own.fits": "mine", "README": "mine"})
    before = tree(Path())
    code, _, error = call("run", "scene.toml", *QUICK, "--out", ".")
    assert (code, tree(Path())) == (2, before) and error.startswith("scene.toml: not written by this program")
    Path("scene.toml").unlink()
    assert call("run", scene, *QUICK, "--out", ".") == (0, "", "")
    after = tree(Path())
    assert [name for name in before if after[name] != before[name]] == ["scene.toml"]


# ---------------------------------------------------------------- jobs at the same time


def test_a_directory_in_use(call, scene, caplog):
    """Refused with one line; where the job was killed, the next one takes its place and says so."""
    assert call("run", scene, *QUICK) == (0, "", "")
    before, out = tree(Path("outputs")), Path("outputs/small")
    with locked(out):
        for command in (("run", scene), ("run", scene, "--resume"), ("run", scene, "--force"), ("report", out)):
            code, text, error = call(*command)
            assert (code, text) == (2, "") and len(error.splitlines()) == 1
            assert error.startswith(f"{out}: in use by process {os.getpid()} of host ")
    assert tree(Path("outputs")) == before
    left(out, pid=2**30)
    assert call("run", scene, *QUICK)[0] == 0
    assert len(caplog.messages) == 1 and "this job takes its place" in caplog.messages[0]
    assert not (out / LOCK).exists()


@pytest.mark.slow
def test_a_killed_run_is_replaced(call, tmp_path):
    """It leaves its lock, streams and perhaps half a file: all go, and nothing of the user's."""
    path, out = long_scene(tmp_path, 5000), tmp_path / "out"
    put(out, {"notes.txt": "mine", "timestreams/notes.txt": "mine", "timestreams/movie.part": "mine"})
    process = start("run", path, "--out", out, "--workers", 2, "--no-figures", "-q", "--save-timestreams")
    wait_for(out / "timestreams" / "0003.h5", process)
    process.kill()
    process.communicate(timeout=20)
    assert (out / LOCK).exists() and none_left(process.pid)
    short = ("--set", "observations=2", "--set", "name=other")
    assert call("run", path, "--out", out, *QUICK, *short)[0] == 2
    assert call("run", path, "--out", out, *QUICK, "--force", *short)[0] == 0
    files = ["checkpoint.h5", "report.html", "scene.json", "scene.toml", "scores.npz", "summary.json"]
    assert names(out) == sorted([RECORD, "maps", "notes.txt", *files, "tables", "timestreams"])
    assert names(out / "timestreams") == ["movie.part", "notes.txt"]


def test_two_runs_at_the_same_moment(tmp_path):
    """Exactly one works and is refused nothing; its results are of one seed, and the user's files as before.

    Slow stress tests start more pairs.
    """
    path, out, alone = tmp_path / "small.toml", tmp_path / "out", tmp_path / "alone"
    path.write_text(WHITE_NOISE_SCENE)
    put(out, {"notes.txt": "mine", "figures/own.png": "mine", "figures/movie.part": "mine"})
    how = ("--out", out, *QUICK, "--save-timestreams")
    jobs = {seed: start("run", path, "--set", f"seed={seed}", *how) for seed in (1, 2)}
    ends = {seed: (job.communicate(timeout=60)[1], job.returncode) for seed, job in jobs.items()}
    done = [seed for seed, (error, code) in ends.items() if code == 0]
    assert len(done) == 1, ends
    error, code = ends[3 - done[0]]
    assert code == 2 and len(error.splitlines()) == 1 and ("in use by" in error or "with other settings" in error)
    run(load_scene(path, {"seed": done[0]}), alone, engine=SERIAL, save_timestreams=True, figures=False)
    maps = [sha256((place / "maps" / "actual.fits").read_bytes()).digest() for place in (out, alone)]
    assert maps[0] == maps[1] and names(out / "timestreams") == names(alone / "timestreams")
    assert (out / "figures/own.png").read_text() == (out / "notes.txt").read_text() == "mine"
    assert names(out / "figures") == ["movie.part", "own.png"]


def test_python_is_refused_alike(scene):
    put(Path(), {"out/summary.json": "{}"})
    with pytest.raises(OutputError, match="not written by this program"):
        run(load_scene(scene), "out", engine=SERIAL, figures=False)
    assert run(load_scene(scene), "out", engine=SERIAL, figures=False, force=True).coadds.done == 2
