"""The guide against the program: keys of scenes, commands, and what is made when it is built."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest
import typer.main

import mapmaker
import surveysim
from docs import explain_tables
from docs.generated import command_reference, scene_reference
from docs.generated_python import api_reference, markdown, module_reference
from surveysim.cli.app import app
from surveysim.cli.failures import EXIT_BROKEN_PIPE
from surveysim.cli.interrupts import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_WRONG_SCENE
from surveysim.scene.keys import all_keys, scene_keys, scene_sections, section_keys
from surveysim.scene.place import shipped_place
from surveysim.scene.renamed_keys import RENAMED
from surveysim.scene.sites import site_names, with_site
from surveysim.scene.units import to_floats
from surveysim.studies.sweep.choices import CHOICES
from tests.docs.pages import PAGES, README, ROOT, Block, blocks
from tests.docs.tables import documented

pytestmark = pytest.mark.docs
SCENARIOS = sorted((ROOT / "scenarios").glob("*.toml"))


def keys_of(text: str) -> set[str]:
    """Dotted keys of a scene and of its sweep."""
    content = tomllib.loads(text)
    axes = {name: item for name, item in content.get("sweep", {}).items() if name not in CHOICES}
    varied = (item if isinstance(item, dict) else {name: item} for name, item in axes.items())
    return {key for key, _ in scene_keys(content)} | {key for keys in varied for key in keys}


# ---------------------------------------------------------------- scenes


def test_every_key_says_what_it_is():
    keys = all_keys()
    assert len(keys) > 90
    assert [name for name, item in keys.items() if not item.get("description", "").endswith(".")] == []
    assert [item.name for item in scene_sections() if not item.schema.get("description")] == []


def test_every_key_is_in_the_reference():
    text = scene_reference()
    for section in scene_sections():
        part = text.split(f"## {section.heading}\n")[1].partition("\n## ")[0]
        listed = re.findall(r"^\| `(\w+)` \|", part, re.MULTILINE)
        assert listed == list(section_keys(section))


def test_rows_have_type_unit_range_and_default():
    text = scene_reference()
    rows = {line.split("|")[1].strip(): line for line in text.splitlines() if line.startswith("| `")}
    assert rows["`speed`"].endswith(
        '| quantity in `arcmin / s`, as `"4 arcmin / s"` | 1.67e-05 arcmin / s to 21600 arcmin / s | **required** |'
    )
    assert rows["`screen_step`"].endswith("| number | 0.1 to 10 | `1.0` |")
    assert rows["`interpolation`"].endswith('| text | `"nearest"`, `"linear"`, `"cubic"` | `"linear"` |')
    assert rows["`min_elevation`"].endswith('as `"40 deg"` | 5 deg to 90 deg | **required** |')
    assert rows["`layer_height`"].endswith("| 0.001 m to 1e+08 m | the site's |")
    assert rows["`max_block_memory`"].endswith("| quantity in `byte` | 1 byte to 1e15 byte | `2.5e+08 byte` |")
    assert {line.count("|") for line in rows.values()} == {6}


def test_sites_of_the_guide_are_those_that_ship():
    text = (ROOT / "docs" / "guide" / "sites.md").read_text()
    rows = re.findall(r"(?m)^\| `(\w+)` \| [^|]+ \| (\d+) \| ([^|]+) \|", text)
    assert [(name, float(height)) for name, height, _ in rows] == [
        (name, shipped_place(name).height_m) for name in site_names()
    ]
    for name, _, water in rows:
        keys = with_site({"site": name})
        months = [to_floats(month, "mm") for month in keys.get("pwv_by_month", [keys.get("pwv")])]
        medians = [month[2] for month in months]
        found = [float(number) for number in re.findall(r"\d+\.?\d*", water)]
        assert found == sorted({min(medians), max(medians)})


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_keys_of_the_scenes_are_documented(path):
    keys = keys_of(path.read_text())
    assert len(keys) > 30 and keys <= all_keys().keys()


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_keys_of_examples_are_documented(path):
    for block in blocks(path):
        if block.language == "toml":
            assert keys_of(block.text) <= all_keys().keys(), f"{block.page}:{block.line}"


def test_unknown_keys_are_noticed():
    text = '[scan]\nspead = 1\n[sweep]\n"scan.spead" = [1]\n[sweep.both]\n"scan.speeed" = [1]\n[nothing]\nx = 1\n'
    assert keys_of(text) - all_keys().keys() == {"scan.spead", "scan.speeed", "nothing"}


@pytest.mark.parametrize("path", [*PAGES, README], ids=lambda path: path.stem)
def test_keys_and_modules_in_sentences_exist(path):
    text = re.sub(r"(?ms)^## Renamed keys.*|^```.*?^```$", "", path.read_text())
    named = re.findall(r"`([\w./]+)(?: = [^`]*)?`", text)
    keys, sections = all_keys().keys(), {section.name for section in scene_sections()}
    keys_named = {
        name
        for name in named
        if name.rpartition(".")[0] in sections - {""}
        and not name.endswith((".png", ".toml", ".fits", ".ecsv", ".sacc"))
    }
    assert keys_named <= keys | sections
    modules = {name for name in named if re.fullmatch(r"(?:surveysim|mapmaker)/.*\.(?:py|toml)", name)}
    assert [name for name in modules if not (ROOT / name).is_file()] == []


def test_renamed_keys_are_documented():
    text = (ROOT / "docs" / "reference" / "keys.md").read_text()
    assert dict(re.findall(r"^\| `([\w.]+)` \| `([\w.]+)` \|$", text, re.MULTILINE)) == RENAMED


# ---------------------------------------------------------------- commands


def commands_in(path: Path) -> list[tuple[Block, list[str]]]:
    """Words of every call of surveysim in the blocks of a page."""
    found = []
    for block in blocks(path):
        if block.language in ("bash", "console", ""):
            lines = block.text.replace("\\\n", " ").splitlines()
            found += [(block, shlex.split(line, comments=True)) for line in lines if line.startswith("surveysim ")]
    return found


@pytest.mark.parametrize("path", [*PAGES, README], ids=lambda path: path.stem)
def test_options_of_commands_exist(path):
    """Also of commands that are too long to be run."""
    program = typer.main.get_command(app)
    for block, (_, name, *words) in commands_in(path):
        try:
            program.commands[name].make_context(name, list(words))
        except Exception as error:
            raise AssertionError(f"{block.page}:{block.line}: surveysim {name} {' '.join(words)}: {error}") from None


def test_every_command_and_option_is_in_the_reference():
    text = command_reference()
    for name, command in typer.main.get_command(app).commands.items():
        part = text.split(f"## `surveysim {name}`\n")[1].partition("\n## ")[0]
        for parameter in command.params:
            assert parameter.opts[-1] in part or parameter.opts[-1].upper() in part


def test_exit_codes():
    codes = re.findall(r"^\| (\d+) \|", (ROOT / "docs" / "reference" / "commands.md").read_text(), re.MULTILINE)
    assert list(map(int, codes)) == [0, EXIT_FAILED, EXIT_WRONG_SCENE, EXIT_INTERRUPTED, EXIT_BROKEN_PIPE]


# ---------------------------------------------------------------- Python


@pytest.mark.parametrize("package", [mapmaker, surveysim])
def test_every_public_name_is_in_the_reference(package):
    part = api_reference().split(f"## {package.__name__}\n")[1].partition("\n## ")[0]
    names = [name for name in package.__all__ if not name.startswith("_")]
    assert re.findall(r"^### `\w+\.(\w+)`$", part, re.MULTILINE) == names


def test_docstrings_become_lists():
    text = "Add `x_y` [mK].\n\nParameters\n----------\nx_y : float\n    First.\nb : int\n"
    lines = [line for line in markdown(text).splitlines() if line]
    assert lines == [r"Add `x_y` \[mK\].", "**Parameters**", r"- x\_y : float", "  First.", "- b : int"]


def test_every_module_is_in_the_reference():
    text = module_reference()
    for path in [*ROOT.glob("mapmaker/**/*.py"), *ROOT.glob("surveysim/**/*.py")]:
        if not path.name.startswith("__"):
            part = text.split(f"### `{path.parent.relative_to(ROOT)}/`\n")[1].partition("\n### ")[0]
            assert re.search(rf"^\| `{re.escape(path.name)}` \| \S.* \|$", part, re.MULTILINE)


# ---------------------------------------------------------------- the build


def test_what_is_made_has_its_place():
    lines = re.findall(r'^    "(<!-- .* -->)"', (ROOT / "docs" / "conf.py").read_text(), re.MULTILINE)
    assert len(lines) == 6
    for line in lines:
        assert sum(line in path.read_text() for path in PAGES) == 1


def test_tables_are_read():
    found = documented(ROOT / "docs" / "reference" / "files.md")
    assert found["`tables/map_psd.ecsv`"]["noise_<data set>"] == "uK2 sr"
    assert found["`tables/observations.ecsv`"]["wind_speed_rad_s"] == "rad / s"
    assert found["`tables/observations.ecsv`"]["wind_angle_rad"] == "rad"
    assert found["`timestreams/<NNNN>.h5`"].keys() >= {"data", "fwhm_arcsec"}


def test_tables_of_the_explanation_are_those_of_its_run():
    text = explain_tables.PAGE.read_text(encoding="utf-8")
    assert explain_tables.with_tables(text) == text
