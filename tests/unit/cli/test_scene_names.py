"""Scenes by name, the list of keys, version, help and completion."""

import os
import re
import subprocess
from pathlib import Path

import pytest
import typer.main

from surveysim import __version__
from surveysim.cli.app import app
from surveysim.scene.keys import all_keys, key_rows, scene_sections
from surveysim.scene.metrics import METRIC_SECTIONS
from surveysim.scene.scene import load_scene
from surveysim.scene.shipped import camera_folder, camera_titles, find_scene, scene_names, shipped_folder
from tests.entry import COMMAND
from tests.scenes import SMALL_SCENE

COMMANDS = typer.main.get_command(app).commands
SCENARIOS = Path(__file__).parents[3] / "scenarios"


@pytest.fixture
def empty(tmp_path, monkeypatch):
    """A current directory outside the clone."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


# ---------------------------------------------------------------- names


def test_scenes_that_ship_are_found_by_name(empty):
    assert find_scene("lynx") == shipped_folder() / "lynx.toml"
    assert load_scene("lynx") == load_scene(SCENARIOS / "lynx.toml")
    paths = [*SCENARIOS.glob("*.toml"), *SCENARIOS.glob("cameras/*.toml")]
    assert scene_names() == sorted(path.stem for path in paths) and len(set(scene_names())) == len(paths)


def test_files_here_come_before_scenes_that_ship(empty):
    """A file of that very name, then with .toml, then in scenarios/."""
    Path("scenarios").mkdir()
    for path in ("scenarios/lynx.toml", "lynx.toml", "lynx"):
        Path(path).write_text(SMALL_SCENE)
        assert find_scene("lynx") == Path(path)
    Path("lynx").unlink()
    Path("lynx").mkdir()  # a folder is no scene
    assert find_scene("lynx") == Path("lynx.toml")


@pytest.mark.parametrize("name", ["nowhere", "lynx.toml", "./lynx", "..", "x" * 5000, "a\0b", ""])
def test_paths_and_unknown_names_stay(empty, name):
    assert find_scene(name) == Path(name)


def test_commands_take_names(empty, call):
    code, out, error = call("check", "first_light")
    assert (code, error) == (0, "")
    assert out.startswith(f"{shipped_folder() / 'first_light.toml'}: 'first_light' is a scene that can be run\n")
    code, out, _ = call("new", "mine", "--like", "lynx")
    assert code == 0 and Path("scenarios/mine.toml").read_text() == (SCENARIOS / "lynx.toml").read_text()
    code, out, _ = call("check", "mine")
    assert code == 0 and out.startswith(f"{Path('scenarios/mine.toml')}: 'mine' is a scene that can be run\n115 detect")


def test_cameras_are_listed_and_copied(empty, call):
    code, out, error = call("cameras")
    assert (code, error) == (0, "") and len(camera_titles()) >= 10
    for name, title in camera_titles().items():
        assert re.search(rf"│ {re.escape(name)} +│ {re.escape(title)} +│", out)
    code, out, _ = call("new", "mine", "--like", "prime_cam_280")
    source, target = camera_folder() / "prime_cam_280.toml", Path("scenarios/mine.toml")
    assert (code, out) == (0, f"{target}: a copy of {source}; edit it, then: surveysim check {target}\n")
    assert target.read_text() == source.read_text()
    assert call("check", "mine") == (0, f"{target}: 'mine' is a scene that can be run\n1774 detectors\n", "")


@pytest.mark.slow
def test_cameras_are_checked_by_name(empty, call):
    for name in camera_titles():
        path = camera_folder() / f"{name}.toml"
        code, out, error = call("check", name)
        assert (code, error) == (0, "")
        first, *lines = out.splitlines()
        assert re.fullmatch(rf"{re.escape(str(path))}: '{name}' is a (scene|camera of \d bands) that can be run", first)
        detectors = r"(\d+: )?\d+ detectors(; \d+ dead positions of \d+)?"
        warned = [line for line in lines if line.startswith("Warning: ")]
        # The wings of its band, where water absorbs, count less in the NET than in the map.
        assert [line[:14] for line in warned] == (["Warning: optic"] if name == "scuba2_850" else [])
        assert len(lines) > len(warned) and all(re.fullmatch(detectors, line) for line in lines if line not in warned)


@pytest.mark.parametrize("command", [("check",), ("run",), ("plan",), ("forecast",), ("new", "mine", "--like")])
def test_unknown_names_are_answered_with_those_that_are_alike(empty, call, command):
    names = ", ".join(sorted(path.stem for path in SCENARIOS.glob("*.toml")))
    names = f"a file, a camera (surveysim cameras) or one of {names} is expected"
    for name, said in (
        ("lynxx", "did you mean lynx or lynx_sky?"),
        ("act_151", "did you mean act_150?"),
        ("qqq", names),
    ):
        assert call(*command, name) == (2, "", f"'{name}': no such scene; {said}\n")
    assert [path.name for path in empty.iterdir()] == []


def without(text, *keys):
    """A scene file without some keys of [atmosphere], and without some sections and those within them."""
    kept, section = [], ""
    for line in text.splitlines(keepends=True):
        if match := re.match(r"\[([\w.]+)\]", line):
            section = match[1]
        key = f"{section}.{line.partition(' = ')[0]}" if section == "atmosphere" else ""
        if key not in keys and not any(f"{section}.".startswith(f"{name[1:-1]}.") for name in keys if name[0] == "["):
            kept.append(line)
    return "".join(kept)


B2_KEYS = ("atmosphere.b2", "atmosphere.b2_probabilities")
OTHER_B2 = 'b2_probabilities = [0.5]\nb2 = "[100] mK2 rad(-5/3)"\n'
SITE = 'site = "alma"\n'


@pytest.mark.parametrize(
    "name, hint, changes",
    [
        (
            "lynx",
            "delete [excess]; delete atmosphere.b2 and atmosphere.b2_probabilities, as B2 then follows from"
            " atmosphere.site",
            [("", {})],
        ),
        (
            "first_light",
            "delete [excess]; give atmosphere.b2 and atmosphere.b2_probabilities values of your own, or atmosphere.site"
            " and instrument.bandwidth instead",
            [(OTHER_B2, {}), (SITE, {"instrument.bandwidth": 0.2})],
        ),
        ("suzie_ii", "", []),
    ],
)
def test_hints_on_a_copy_can_be_followed(empty, call, name, hint, changes):
    code, out, _ = call("new", "mine", "--like", name)
    found = [line for line in out.splitlines() if "for another:" in line]
    assert code == 0
    said = f"[excess] and atmosphere.b2 hold for the band and site of the copied scene; for another: {hint}"
    assert found == ([said] if hint else [])
    path = Path("scenarios/mine.toml")
    copied = path.read_text()
    for keys, settings in changes:
        text = without(copied, "[excess]", "[score.reference]", *B2_KEYS)
        assert len(text) < len(copied) and "b2" not in text.replace("B2", "")
        path.write_text(text.replace("[atmosphere]\n", f"[atmosphere]\n{keys}"))
        options = [part for key, value in settings.items() for part in ("--set", f"{key}={value}")]
        code, out, error = call("check", "mine", *options)
        assert (code, error) == (0, "") and out.startswith(f"{path}: 'mine' is a scene that can be run\n")


# ---------------------------------------------------------------- keys


def test_all_keys_are_listed(call, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    code, out, error = call("keys")
    assert (code, error) == (0, "")
    listed = re.findall(r"^│ ([a-z0-9_.]+) +│", out, re.MULTILINE)
    assert list(dict.fromkeys(listed)) == list(all_keys()) and len(listed) > 90
    row = next(line for line in out.splitlines() if "│ scan.speed " in line)
    cells = [cell.strip() for cell in row.strip("│").split("│")]
    assert cells[:4] == [
        "scan.speed",
        'quantity in arcmin / s, as "4 arcmin / s"',
        "1.67e-05 arcmin / s to 21600 arcmin / s",
        "required",
    ]
    assert cells[4] == all_keys()["scan.speed"]["description"]
    assert "`" not in out and "**" not in out


def test_keys_of_a_section(call, monkeypatch):
    """With the sections within it, and no others."""
    monkeypatch.setenv("COLUMNS", "400")
    _, out, _ = call("keys", "score")
    listed = re.findall(r"^│ ([a-z0-9_.]+) +│", out, re.MULTILINE)
    assert list(dict.fromkeys(listed)) == [key for key in all_keys() if key.startswith("score.")]
    assert listed.count("score.metrics.kind") == len(METRIC_SECTIONS)  # a table for each kind
    assert {"score.size", "score.signal_sims.skies"} <= set(listed) and "[score]" in out
    _, out, _ = call("keys", "score.size")
    assert re.findall(r"^│ ([a-z0-9_.]+) +│", out, re.MULTILINE) == ["score.size"]
    code, out, error = call("keys", "scor")
    assert (code, out) == (2, "") and "keys: found 'scor'" in error and "did you mean score" in error
    assert call("keys", "scan.spead") == (2, "", "keys: found 'scan.spead'; did you mean scan.speed?\n")
    pitches = "instrument.layout.pitch_f_lambda or instrument.wafers.pitch_f_lambda"
    assert call("keys", "pitch")[2] == f"keys: found 'pitch'; did you mean {pitches}?\n"
    assert call("keys", "scn")[2] == "keys: found 'scn'; did you mean scan?\n"
    error = call("keys", "scan.quux")[2]
    assert (
        error.startswith("keys: found 'scan.quux'; a key of [scan] is expected: lissajous, pattern")
        and "ell" not in error
    )
    assert "one of the sections field, site, schedule" in call("keys", "quux")[2]


def test_ranges_have_the_unit_of_the_example():
    """One unit a row; it is that of the schema where no scene has an example."""
    rows = {row.key: row for section in scene_sections() for row in key_rows(section)}
    for row in rows.values():
        if found := re.match(r"quantity in `([^`]+)`(?:, as `\"\S+ ([a-zA-Z].*)\"`)?$", row.kind):
            unit, example = found.groups()
            assert example in (None, unit)
            assert all(text in ("0", f"{text.split()[0]} {unit}") for text in row.allowed.split(" to ")), row
    expected = {
        "field.dec": ("deg", "-90 deg to 90 deg"),
        "instrument.beam_fwhm": ("arcsec", "0.001 arcsec to 108000 arcsec"),
        "instrument.frequency": ("GHz", "1 GHz to 10000 GHz"),
        "atmosphere.outer_scale": ("m", "0.001 m to 1e+08 m"),
    }
    for key, (unit, allowed) in expected.items():
        assert rows[key].kind.startswith(f"quantity in `{unit}`") and rows[key].allowed == allowed


def test_rows_hold_one_line_each():
    for section in scene_sections():
        for row in key_rows(section):
            assert row.meaning.endswith(".") and row.kind and row.default
            assert "\n" not in "".join((row.meaning, row.kind, row.allowed, row.default))


# ---------------------------------------------------------------- version, help, completion


def test_version(call):
    assert call("--version") == (0, f"surveysim {__version__}\n", "")


@pytest.mark.parametrize("name", [None, *COMMANDS])
def test_short_and_long_help_are_the_same(call, name):
    words = [] if name is None else [name]
    code, out, _ = call(*words, "-h")
    assert code == 0 and call(*words, "--help") == (0, out, "")
    assert "<bool>" not in out and "<int>" not in out and "╭" not in out


def test_summaries_of_commands_are_whole(call):
    out = call("--help")[1]
    for name, command in COMMANDS.items():
        summary = command.help.partition("\n")[0]
        assert f"  {name.ljust(10)}{summary}\n" in out


def test_shells_complete_commands_and_write_nothing(empty):
    """As bash asks for it."""
    environment = os.environ | {
        "_SURVEYSIM_COMPLETE": "complete_bash",
        "COMP_WORDS": "surveysim fo",
        "COMP_CWORD": "1",
        "HOME": str(empty),
    }
    done = subprocess.run(COMMAND, env=environment, cwd=empty, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["forecast"] and not list(empty.glob("**/.*rc"))


def completions(folder, words):
    """As bash asks for them."""
    environment = os.environ | {
        "_SURVEYSIM_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(words.count(" ")),
    }
    done = subprocess.run(COMMAND, env=environment, cwd=folder, capture_output=True, text=True, timeout=60)
    return done.stdout.split()


def test_shells_complete_scenes(empty):
    (empty / "lynx_mine.toml").touch()
    (empty / "lynx.txt").touch()
    (empty / "lynxes").mkdir()
    (empty / "lynxes" / "one.toml").touch()
    for command in ("run", "check", "new mine --like"):
        assert completions(empty, f"surveysim {command} lyn") == ["lynx", "lynx_sky", "lynx_mine.toml", "lynxes/"], (
            command
        )
    assert completions(empty, "surveysim plan lynxes/") == ["lynxes/one.toml"]
    assert completions(empty, "surveysim plan [") == []


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_no_types_and_ranges(call, name):
    out = call(name, "--help")[1]
    assert not re.search(r"<(path|str|int|float|list|file)|[<>]=|[{}]", out)
