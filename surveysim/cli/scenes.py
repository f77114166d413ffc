"""Commands on scenes and output directories: keys, new, cameras, report."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mapmaker.printable import say
from surveysim.cli.options import Force, fail, scene_completions
from surveysim.runtime.errors import InputError
from surveysim.scene.shipped import HERE, MAX_NAME, NAME, camera_titles, find_scene, no_such_scene
from surveysim.scene.similar_names import did_you_mean
from surveysim.scene.units import shown

if TYPE_CHECKING:
    from surveysim.scene.keys import KeyRow


MOST_HOLDING = 5  # keys that hold a word, of which all are suggested


def keys(
    section: Annotated[
        str | None, typer.Argument(metavar="SECTION", help="A section such as scan, or a key such as scan.speed.")
    ] = None,
) -> None:
    """List the keys of a scene: unit, range, default, meaning."""
    from surveysim.scene.keys import key_rows, scene_sections

    sections, found = scene_sections(), False
    for each in sections:
        rows = key_rows(each)
        if section is not None and not _is_within(each.name, section):
            rows = [row for row in rows if row.key == section]
        if rows:
            found = True
            _print_keys(each.heading, each.introduction, rows)
    if not found:
        names = list(dict.fromkeys(each.name for each in sections[1:]))
        fail(f"keys: found {shown(section)}; {_expected_key(str(section), names)}")


def _expected_key(found: str, sections: Sequence[str]) -> str:
    """Suggest keys and sections that hold a word or resemble a mistyped one, or else name those around it."""
    from surveysim.scene.keys import all_keys

    section, _, name = found.rpartition(".")
    names = [key.rpartition(".")[2] for key in (*sections, *all_keys()) if key.rpartition(".")[0] == section]
    if section in sections:
        return did_you_mean(name, names, section) or f"a key of [{section}] is expected: {', '.join(names)}"
    expected = f"a key or one of the sections {', '.join(sections)} is expected"
    everything = dict.fromkeys((*sections, *all_keys()))
    holding = [key for key in everything if found in key.rpartition(".")[2]]
    if 0 < len(holding) <= MOST_HOLDING:
        return f"did you mean {' or '.join(holding)}?"
    return did_you_mean(found, everything) or expected


def _is_within(name: str, section: str) -> bool:
    return f"{name}.".startswith(f"{section}.")


def _print_keys(heading: str, introduction: Sequence[str], rows: "Sequence[KeyRow]") -> None:
    from rich.table import Table
    from rich.text import Text

    from surveysim.report.terminal.layout import Terminal

    console = Terminal()
    console.say("\n".join(map(_plain, [heading, *introduction])))
    table = Table()
    for name in ("key", "type and unit", "range", "default", "meaning"):
        table.add_column(name)
    for row in rows:
        table.add_row(*(Text(_plain(cell)) for cell in (row.key, row.kind, row.allowed, row.default, row.meaning)))
    console.show(table)


def _plain(text: str) -> str:
    """Remove the Markdown marks from the description of a key."""
    return text.replace("`", "").replace("**", "")


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the new scene.")],
    like: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE",
            autocompletion=scene_completions,
            help="The scene or camera to copy: a file, or a name; 'surveysim cameras' lists the cameras.",
        ),
    ] = None,
    description: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Description of a camera to make a scene of: YAML of bolojax."),
    ] = None,
    channel: Annotated[
        str | None, typer.Option(metavar="CAMERA/CHANNEL", help="With --from: the channel, if there are several.")
    ] = None,
    aperture: Annotated[
        str | None,
        typer.Option(metavar="DIAMETER", help="With --from: illuminated aperture of the telescope, such as '6 m'."),
    ] = None,
) -> None:
    """Make a scene from another one or from a description of a camera.

    It is scenarios/NAME.toml, to be edited. --like copies a scene or a camera; --from reads the description of a camera
    for another program.
    """
    if not re.fullmatch(NAME, name) or len(name) > MAX_NAME:
        fail(f"name: found {shown(name)}; letters, digits, '_', '.' and '-', none of the last two first, are expected")
    if (like is None) == (description is None):
        fail("exactly one of --like and --from is expected")
    if description is not None:
        _import(name, description, channel, aperture)
        return
    if channel is not None or aperture is not None:
        fail(f"--{'channel' if aperture is None else 'aperture'}: found without --from")
    _copy(name, str(like))


def _copy(name: str, like: str) -> None:
    from surveysim.scene.scene import read_scene

    source, target = find_scene(like), HERE / f"{name}.toml"
    if not source.is_file():
        fail(no_such_scene(like))
    text, content = read_scene(source)
    tables = _tables_to_copy(content, source.parent, target.parent)
    _write_new(target, text)
    for table, rows in tables.items():
        table.write_bytes(rows)
    say(f"{target}: a copy of {source}; edit it, then: surveysim check {target}")
    if tables:
        say(f"with {', '.join(table.name for table in tables)} in the same folder")
    if "[sweep" in text:
        say("[sweep] varies keys of the copied scene; give it keys and values of your own, or delete it")
    if "[score.reference]" in text:
        say("[score.reference] has published values of the copied scene; delete it for another survey")
    if hint := _band_hint(content):
        say(hint)


def _tables_to_copy(content: Mapping[str, Any], source: Path, target: Path) -> dict[Path, bytes]:
    """Return the tables beside a scene that its copy in another folder needs, by their new paths."""
    from surveysim.output.scene_copy import file_values

    found: dict[Path, bytes] = {}
    for _, value in file_values(content):
        for name in value if isinstance(value, list) else [value]:
            old, new = source / str(name), target / str(name)
            if not old.is_file() or (new.exists() and new.samefile(old)):
                continue
            if new.exists() and new.read_bytes() != old.read_bytes():
                fail(f"{new}: exists, with another content than {old}; another folder is expected")
            if not new.exists() and new.parent == target:  # tables of other folders stay where they are
                found[new] = old.read_bytes()
    return found


def _import(name: str, description: Path, channel: str | None, aperture: str | None) -> None:
    from surveysim.descriptions.bolojax import import_bolojax
    from surveysim.scene.units import to_float

    target = HERE / f"{name}.toml"
    if aperture is None:
        fail("--aperture: missing; the diameter of the telescope, such as '6 m', is expected with --from")
    try:
        aperture_m = to_float(aperture, "m")
        if not 0.01 <= aperture_m <= 1000:
            raise InputError(f"found {aperture_m:g} m; 0.01 m to 1000 m are expected")
    except InputError as error:
        fail(f"--aperture: {error}")
    try:
        found = import_bolojax(description, name=name, channel=channel, aperture_m=aperture_m)
    except InputError as error:
        fail(str(error))
    _write_new(target, found.text)
    for file, text in found.files.items():
        _write_new(HERE / file, text)
    for line in found.unused:
        say(f"not used: {line}")
    say(f"{target}: a scene of {description}; values that it does not have are 'assumed' there")
    say(f"edit it, then: surveysim check {target}")


def _write_new(target: Path, text: str) -> None:
    target.parent.mkdir(exist_ok=True)
    try:
        with open(target, "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        fail(f"{target}: exists; another name is expected")


def cameras() -> None:
    """List the cameras that ship.

    Each is a scene that runs by its name. 'surveysim new NAME --like CAMERA' copies it; its comments have the source
    of each number.
    """
    from rich.table import Table
    from rich.text import Text

    from surveysim.report.terminal.layout import Terminal

    table = Table()
    for column in ("name", "camera"):
        table.add_column(column)
    for name, title in camera_titles().items():
        table.add_row(Text(name), Text(title))
    Terminal().show(table)


def _band_hint(content: Mapping[str, Any]) -> str:
    """Return a hint about values to replace in a copied scene for another band or site; empty if there are none."""
    air = content.get("atmosphere")
    air = air if isinstance(air, dict) else {}
    found, orders = [], []
    if "excess" in content:
        found.append("[excess]")
        orders.append("delete [excess]")
    if "b2" in air:
        found.append("atmosphere.b2")
        both = "atmosphere.b2 and atmosphere.b2_probabilities"
        orders.append(
            f"delete {both}, as B2 then follows from {'atmosphere.site' if 'site' in air else '[site]'}"
            if "site" in air or "site" in content
            else f"give {both} values of your own, or atmosphere.site and instrument.bandwidth instead"
        )
    if not found:
        return ""
    return f"{' and '.join(found)} hold for the band and site of the copied scene; for another: {'; '.join(orders)}"


def report(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="An output directory of run, budget, accuracy or paper.")
    ],
    force: Force = False,
) -> None:
    """Write report.html of an output directory again.

    The pages of the bands of a camera, and of the points of a sweep, are written again too.
    """
    from surveysim.output.directory import renewed
    from surveysim.report.html.page import REPORT, NoResultsError, write_report

    patterns = ("bands/*", "points/*", "bands/*/points/*")
    nested = sorted(path.parent for each in patterns for path in directory.glob(f"{each}/summary.json"))
    try:
        for each in (*nested, directory):
            with renewed(each, REPORT, force):
                say(write_report(each))
    except NoResultsError as error:
        fail(str(error))
