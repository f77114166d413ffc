"""Output directories: whose files are whose, what is refused, and what is removed."""

import json
import os
from hashlib import sha256
from pathlib import Path

import pytest

from surveysim.output.directory import FinishedError, begin, claimed, remove, renewed, replacing
from surveysim.output.file_names import NEW
from surveysim.output.lock import LOCK, OutputError, locked
from surveysim.output.record import RECORD, Results

NAMES = ("summary.json", "maps/actual.fits", "figures/map.png", "checkpoint.h5", "timestreams/0000.h5")
RUN = Results("run", "small", "a" * 64, NAMES, {"scene.toml": b"seed = 1\n"})
OTHER = Results("run", "small", "b" * 64, NAMES, {"scene.toml": b"seed = 2\n"})
GONE = 2**30  # no process has this number


def written(directory, names=NAMES[:3], results=RUN, whole=True, **how):
    """A run that leaves these files."""
    work = [name for name in names if name.startswith(("checkpoint", "timestreams"))]
    with claimed(directory, results, **how) as place:
        begin(place, removed=lambda name: how.get("force", False))
        put(directory, {name: f"{name} of {results.sha256}" for name in work})
        with replacing(place, whole=whole) as new:
            put(new, {name: f"{name} of {results.sha256}" for name in names if name not in work})


def tree(directory):
    """Kind and content of everything there."""
    found = {}
    for path in sorted(directory.rglob("*")):
        if path.is_symlink():
            kind = os.readlink(path)
        else:
            kind = sha256(path.read_bytes()).hexdigest() if path.is_file() else "no file"
        found[path.relative_to(directory).as_posix()] = kind
    return found


def put(directory, files):
    for name, content in files.items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_text(content)


# ---------------------------------------------------------------- files of the user


@pytest.mark.parametrize(
    "listed",
    [
        ["thesis.tex"],
        ["../outside.txt"],
        ["/etc/hostname"],
        ["maps/mine.fits", "figures/mine.png", "data.h5"],
        ["figures", ".", ""],
        ["a\0b"],
        "thesis.tex",
        None,
    ],
)
def test_no_list_of_others_makes_a_file_ours(tmp_path, listed):
    """Neither a foreign summary, nor a record that was tampered with, in which names can't be ours or have changed."""
    out = tmp_path / "out"
    mine = {"thesis.tex": "x", "data.h5": "x", "figures/mine.png": "x", "maps/mine.fits": "x"}
    put(out, mine)
    put(tmp_path, {"outside.txt": "x"})
    summary = json.dumps({"surveysim": "0.2.0", "files": listed})
    put(out, {"summary.json": summary})
    before = tree(tmp_path)
    with pytest.raises(OutputError, match=r"summary.json: not written by this program, .*; --force replaces it, --out"):
        written(out)
    assert tree(tmp_path) == before
    written(out, force=True)
    record = json.loads((out / RECORD).read_text())
    files = dict.fromkeys(listed, None if listed == ["thesis.tex"] else "0" * 64) if isinstance(listed, list) else {}
    (out / RECORD).write_text(json.dumps(record | {"files": record["files"] | files}))
    written(out)
    assert {name: before[f"out/{name}"] for name in mine} == {name: tree(out)[name] for name in mine}
    assert (tmp_path / "outside.txt").exists()


@pytest.mark.parametrize("name", [*NAMES, "scene.toml", RECORD])
def test_files_of_the_user_by_our_names_stay(tmp_path, name):
    put(tmp_path, {name: "mine", "notes.txt": "mine"})
    before = tree(tmp_path)
    with pytest.raises(OutputError, match=f"{name}: not written by this program"):
        written(tmp_path)
    assert tree(tmp_path) == before


def test_force_replaces_files_that_are_written_and_no_other(tmp_path):
    put(tmp_path, {"maps/actual.fits": "mine", "figures/map.png": "mine", "figures/own.png": "mine", "a.txt": "mine"})
    written(tmp_path, names=NAMES[:2], force=True)
    assert (tmp_path / "maps/actual.fits").read_text().startswith("maps/actual.fits of")
    assert json.loads((tmp_path / RECORD).read_text())["files"].keys() == {*NAMES[:2], "scene.toml"}
    for name in ("figures/map.png", "figures/own.png", "a.txt"):
        assert (tmp_path / name).read_text() == "mine"


def test_a_result_that_the_user_changed_stays(tmp_path, caplog):
    """Refused where it would be written again, left alone where not."""
    written(tmp_path)
    put(tmp_path, {"figures/map.png": "mine"})
    with pytest.raises(OutputError, match=r"figures/map.png: .*changed since"):
        written(tmp_path)
    fewer = Results("run", "small", "a" * 64, NAMES[:2])
    written(tmp_path, names=NAMES[:2], results=fewer)
    assert (tmp_path / "figures/map.png").read_text() == "mine"
    assert caplog.messages == [f"{tmp_path / 'figures/map.png'}: changed since it was written; it stays"]


def test_time_streams_are_told_by_size_and_time(tmp_path):
    names = ("timestreams/0000.h5",)
    written(tmp_path, names)
    written(tmp_path, names)
    path = tmp_path / names[0]
    os.utime(path, ns=(1, 1))
    with pytest.raises(OutputError, match=r"0000.h5: .*changed since"):
        written(tmp_path, names)


# ---------------------------------------------------------------- links and what is no file


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("folder", ["figures", "maps", "timestreams"])
def test_nothing_goes_through_a_link_to_a_folder(tmp_path, folder, force):
    out, other = tmp_path / "out", tmp_path / "other"
    put(other, {f"download.{GONE}.part": "mine", "actual.fits": "mine", "map.png": "mine", "0000.h5": "mine"})
    out.mkdir()
    (out / folder).symlink_to("../other")
    before = tree(tmp_path)
    with pytest.raises(OutputError, match=f"{folder}: a link where a folder is to be written"):
        written(out, force=force)
    assert tree(tmp_path) == before


def test_a_folder_that_became_a_link_is_left_alone(tmp_path):
    """Files that were written there before are reached through it no longer."""
    out, other = tmp_path / "out", tmp_path / "other"
    written(out)
    (out / "figures").rename(other)
    (out / "figures").symlink_to(other)
    fewer = Results("run", "small", "a" * 64, NAMES[:2])
    written(out, names=NAMES[:2], results=fewer)
    assert (other / "map.png").exists() and (out / "figures").is_symlink()


@pytest.mark.parametrize("name", ["summary.json", "scene.toml", "maps/actual.fits", "checkpoint.h5", RECORD])
def test_links_to_files_are_not_followed(tmp_path, name):
    """Refused; with force the link makes way, never the file behind it."""
    out = tmp_path / "out"
    put(tmp_path, {"mine.txt": "mine"})
    (out / name).parent.mkdir(parents=True)
    (out / name).symlink_to(tmp_path / "mine.txt")
    before = tree(tmp_path)
    with pytest.raises(OutputError):
        written(out)
    assert tree(tmp_path) == before
    with claimed(out, RUN, force=True) as place, replacing(place):
        pass
    assert (tmp_path / "mine.txt").read_text() == "mine"


def test_a_link_to_nowhere_is_there(tmp_path):
    (tmp_path / "summary.json").symlink_to(tmp_path / "nowhere")
    with pytest.raises(OutputError, match=r"summary.json: not a regular file"):
        written(tmp_path)


def test_the_directory_itself_may_be_reached_through_a_link(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to("disk")
    written(tmp_path / "out")
    written(tmp_path / "out")
    assert (tmp_path / "disk" / "maps" / "actual.fits").exists()


@pytest.mark.parametrize("name", ["summary.json", RECORD, "checkpoint.h5", "figures/map.png", LOCK])
@pytest.mark.parametrize("resume", [False, True])
def test_a_fifo_is_refused_at_once(tmp_path, name, resume, monkeypatch):
    monkeypatch.setattr("surveysim.output.lock._READ_AGAIN_S", 0.001)
    (tmp_path / name).parent.mkdir(exist_ok=True)
    os.mkfifo(tmp_path / name)
    with pytest.raises(OutputError, match=name):
        written(tmp_path, resume=resume)
    if name != RECORD:
        with pytest.raises(OutputError, match=name), renewed(tmp_path, "report.html"):
            pytest.fail("written")


@pytest.mark.parametrize("name", ["summary.json", "maps/actual.fits", "scene.toml"])
@pytest.mark.parametrize("force", [False, True])
def test_a_folder_by_the_name_of_a_file(tmp_path, name, force):
    (tmp_path / name / "mine").mkdir(parents=True)
    with pytest.raises(IsADirectoryError, match="a folder where a file is to be written"):
        written(tmp_path, force=force)


def test_directories_that_can_not_be(tmp_path):
    put(tmp_path, {"file": "mine"})
    (tmp_path / "link").symlink_to("nowhere")
    (tmp_path / "loop").symlink_to("loop")
    found = {"file": "a file", "file/below": "a file", "link": "a link to nowhere", "link/below": "a link to nowhere"}
    for name, words in (found | {"loop": "a link to nowhere", "/dev/null": "a file"}).items():
        with pytest.raises(NotADirectoryError, match=f"{words} where a folder is to be written"):
            written(tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "link", "loop"]


def test_a_home_directory_that_the_shell_left(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("~", "~/out"):
        with pytest.raises(OutputError, match="found a '~' that the shell has not replaced"):
            written(Path(name))
    assert tree(tmp_path) == {}


def test_the_folder_above_a_link(tmp_path):
    """It is that of the link's target, as for the system."""
    (tmp_path / "real" / "deep").mkdir(parents=True)
    (tmp_path / "link").symlink_to("real/deep")
    written(tmp_path / "link" / ".." / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "real"]
    assert {RECORD, "summary.json"} <= set(tree(tmp_path / "real" / "out"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_folders_that_can_not_be_written(tmp_path):
    (tmp_path / "maps").mkdir(mode=0o555)
    with pytest.raises(PermissionError, match="maps"):
        written(tmp_path)


def test_names_with_spaces_and_umlauts(tmp_path):
    written(tmp_path / "meine Läufe" / "zwölf [1]*")
    written(tmp_path / "meine Läufe" / "zwölf [1]*")
    assert not list(tmp_path.rglob("*.part")) and not list(tmp_path.rglob(LOCK))


# ---------------------------------------------------------------- other results


def test_the_same_results_are_replaced(tmp_path):
    written(tmp_path)
    fewer = Results("run", "small", "a" * 64, NAMES[:2])
    written(tmp_path, names=NAMES[:2], results=fewer)
    assert {name for name in tree(tmp_path) if "." in name} == {RECORD, *NAMES[:2]}


@pytest.mark.parametrize(
    "results, words",
    [
        (OTHER, "holds results of 'small' with other settings"),
        (Results("run", "big", "c" * 64, NAMES), "holds results of another scene, 'small'"),
        (Results("forecast", "small", "a" * 64, ("forecast.ecsv",)), "holds results of 'surveysim run'"),
        (Results("paper", "", "", ("table1.ecsv",)), "holds results of 'surveysim run'"),
    ],
)
def test_other_results_are_refused(tmp_path, results, words):
    written(tmp_path)
    before = tree(tmp_path)
    for resume in (False, True):
        with pytest.raises(OutputError) as error:
            written(tmp_path, results.names[:1], results, resume=resume)
        assert f"{tmp_path}: {words}; --force replaces them, --out writes elsewhere" in str(error.value)
    assert tree(tmp_path) == before
    put(tmp_path, {"notes.txt": "mine"})
    written(tmp_path, results.names[:1], results, force=True)
    there = {name for name in tree(tmp_path) if "." in name}
    assert there == {RECORD, "notes.txt", results.names[0], *results.inputs}


def test_a_record_that_someone_edited_is_shown_in_a_short_line(tmp_path):
    written(tmp_path)
    record = json.loads((tmp_path / RECORD).read_text())
    for key in ("command", "scene"):
        edited = record | {"sha256": "other", key: "\x1b[31mx\n" * 100}
        (tmp_path / RECORD).write_text(json.dumps(edited))
        with pytest.raises(OutputError) as error:
            written(tmp_path)
        assert str(error.value).isprintable() and len(str(error.value)) < 200 + len(str(tmp_path))


def test_force_keeps_results_that_the_user_changed(tmp_path):
    written(tmp_path)
    put(tmp_path, {"maps/actual.fits": "mine"})
    with claimed(tmp_path, Results("forecast", "small", "", ("forecast.ecsv",)), force=True) as place, replacing(place):
        pass
    assert (tmp_path / "maps/actual.fits").read_text() == "mine" and not (tmp_path / "summary.json").exists()


# ---------------------------------------------------------------- unfinished and finished runs


def killed(directory, names, results=RUN):
    """A run that was killed once these files were there."""
    with claimed(directory, results) as place:
        begin(place, removed=lambda name: False)
        put(directory, dict.fromkeys(names, "half of it"))


@pytest.mark.parametrize("names", [["checkpoint.h5"], ["timestreams/0000.h5"], ["checkpoint.h5", "maps/actual.fits"]])
def test_a_run_is_not_thrown_away(tmp_path, names):
    killed(tmp_path, names)
    before = tree(tmp_path)
    with pytest.raises(OutputError) as error:
        written(tmp_path)
    words = "from a run that has not finished; --resume goes on from there, --force starts anew, --out writes elsewhere"
    assert str(error.value) == f"{tmp_path / names[0]}: {words}"
    with pytest.raises(OutputError, match="holds an unfinished run of 'small' with other settings"):
        written(tmp_path, results=OTHER)
    with pytest.raises(OutputError, match="found both resume and force"):
        written(tmp_path, resume=True, force=True)
    assert tree(tmp_path) == before
    written(tmp_path, force=True)
    assert not (tmp_path / "checkpoint.h5").exists()


def test_a_run_that_has_nothing_to_lose_is_no_obstacle(tmp_path):
    """Interrupted before its first observation."""
    killed(tmp_path, [])
    written(tmp_path, results=OTHER)


def test_a_file_that_came_after_a_run_was_killed_is_the_user_s(tmp_path):
    """By any name but those of work under way: results take their places once they are all there."""
    killed(tmp_path, [])
    put(tmp_path, {"maps/actual.fits": "mine"})
    before = tree(tmp_path)
    with pytest.raises(OutputError, match="actual.fits: not written by this program"):
        written(tmp_path)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt(), ValueError("x")])
def test_results_that_are_not_written_whole_cost_none_of_before(tmp_path, error):
    written(tmp_path)
    before = tree(tmp_path)
    with pytest.raises(type(error)) as caught, claimed(tmp_path, RUN) as place:
        begin(place, removed=lambda name: False)
        with replacing(place) as new:
            put(new, {"summary.json": "new", "maps/actual.fits": "half"})
            if isinstance(error, OSError):
                error.filename = str(new / "maps/actual.fits")
            raise error
    after = tree(tmp_path)
    assert {name: after[name] for name in before if name != RECORD} == {k: v for k, v in before.items() if k != RECORD}
    assert after.keys() == before.keys()
    if isinstance(error, OSError):
        assert caught.value.filename == str(tmp_path / "maps/actual.fits")
    written(tmp_path)


def test_the_folder_of_a_killed_job_goes_but_for_what_others_put_there(tmp_path):
    for pid in (GONE, GONE + 1):
        files = {"summary.json": "half", f"maps/actual.fits.{pid}.part": "half", "figures/map.png": "whole"}
        put(tmp_path / f"{NEW}.{pid}.part", files)
    put(tmp_path / f"{NEW}.{GONE}.part", {"maps/notes.txt": "mine"})
    put(tmp_path / f"{NEW}.1.part", {"summary.json": "of a process that is there"})
    put(tmp_path / "mine.1.part", {"summary.json": "mine"})
    written(tmp_path)
    left = {name for name in tree(tmp_path) if ".part/" in name}
    assert left == {f"{NEW}.{GONE}.part/{n}" for n in ("maps", "maps/notes.txt")} | {
        f"{NEW}.1.part/summary.json",
        "mine.1.part/summary.json",
    }


def test_a_finished_run_is_not_resumed(tmp_path):
    written(tmp_path)
    before = tree(tmp_path)
    with pytest.raises(FinishedError, match="finished; there is nothing to resume"):
        written(tmp_path, resume=True)
    assert tree(tmp_path) == before


def test_a_run_that_was_stopped_early_is_resumed(tmp_path):
    """It has both results and a checkpoint."""
    written(tmp_path, NAMES[:4], whole=False)
    with pytest.raises(OutputError, match="checkpoint.h5: from a run that has not finished; --resume"):
        written(tmp_path)
    with claimed(tmp_path, RUN, resume=True) as place:
        begin(place, removed=lambda name: False)
        assert (tmp_path / "maps/actual.fits").exists() and (tmp_path / "checkpoint.h5").exists()
        remove(place, ["maps/actual.fits", "../x", "notes.txt"])
        with replacing(place, over=lambda name: name == "checkpoint.h5") as new:
            put(new, {"summary.json": "new"})
    assert {name for name in tree(tmp_path) if "." in name} == {RECORD, "scene.toml", "summary.json"}


def test_a_checkpoint_alone_is_resumed_and_not_replaced(tmp_path):
    """One that was brought here, without the record of its run: it says itself of which scene it is."""
    put(tmp_path, {"checkpoint.h5": "brought"})
    with pytest.raises(OutputError, match="checkpoint.h5: .*--resume goes on from there"):
        written(tmp_path)
    with claimed(tmp_path, RUN, resume=True) as place:
        assert place.mine == {"checkpoint.h5": None}


def test_partial_files_of_processes_that_are_gone(tmp_path):
    ours = [f"{name}.{GONE}.part" for name in (*NAMES, RECORD, f"{LOCK}.x1", "points/003.npz", "timestreams/0007.h5")]
    theirs = [
        "download.part",
        f"download.{GONE}.part",
        "figures/movie.part",
        f"figures/movie.png.{GONE}.part",
        ".writable",
    ]
    theirs += [f"summary.json.{os.getppid()}.part", "summary.json.x.part", "summary.json.part", f"map.png.{GONE}.part"]
    put(tmp_path, dict.fromkeys([*ours, *theirs], "half"))
    (tmp_path / f"scene.toml.{GONE}.part").symlink_to("download.part")
    written(tmp_path)
    assert not [name for name in ours if (tmp_path / name).exists()]
    assert not [name for name in theirs if not (tmp_path / name).exists()]
    assert (tmp_path / f"scene.toml.{GONE}.part").is_symlink()


# ---------------------------------------------------------------- a report written anew


def test_a_report_is_renewed(tmp_path):
    results = Results("run", "small", "", ("summary.json", "report.html"))
    written(tmp_path, results.names, results)
    for text in ("anew", "and again"):
        with renewed(tmp_path, "report.html"):
            put(tmp_path, {"report.html": text})
    written(tmp_path, results.names, results)  # the record knows it


@pytest.mark.parametrize("change", ["edited", "a link"])
def test_a_report_that_the_user_changed_is_not_renewed(tmp_path, change):
    results = Results("run", "small", "", ("summary.json", "report.html"))
    written(tmp_path, results.names, results)
    if change == "edited":
        put(tmp_path, {"report.html": "with notes"})
    else:
        (tmp_path / "report.html").rename(tmp_path / "page.html")
        (tmp_path / "report.html").symlink_to("page.html")
    before = tree(tmp_path)
    refused = pytest.raises(OutputError, match="report.html: not written by this program, or changed since; --force")
    with refused, renewed(tmp_path, "report.html"):
        pytest.fail("written")
    assert tree(tmp_path) == before


def test_a_report_of_the_user_is_not_renewed(tmp_path):
    put(tmp_path, {"report.html": "mine"})
    refused = pytest.raises(OutputError, match="report.html: not written by this program, or changed since; --force")
    with refused, renewed(tmp_path, "report.html"):
        pytest.fail("written")
    with renewed(tmp_path, "report.html", force=True):
        put(tmp_path, {"report.html": "anew"})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html"]


def test_leftovers_of_writers_of_points_that_are_gone(tmp_path, caplog):
    """Their folders, partial files and locks; not files of the user, nor those of a writer at work."""
    with locked(tmp_path):
        holder = json.loads((tmp_path / LOCK).read_text()) | {"pid": GONE}
    put(tmp_path / "points/0", {f"{NEW}.{GONE}.part/tables/weights.ecsv.{GONE}.part": "half", LOCK: json.dumps(holder)})
    put(tmp_path / "points/1", {f"{RECORD}.{GONE}.part": "half", "movie.1.part": "mine"})
    put(tmp_path / "points/2", {f"{NEW}.{GONE}.part/summary.json": "of a writer at work"})
    with locked(tmp_path / "points/2"):
        written(tmp_path)
    left = {path.relative_to(tmp_path / "points").as_posix() for path in (tmp_path / "points").rglob("*")}
    assert not caplog.messages
    assert left == {"0", "1", "1/movie.1.part", "2", f"2/{NEW}.{GONE}.part", f"2/{NEW}.{GONE}.part/summary.json"}
