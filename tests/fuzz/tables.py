"""Mangled tables of detector positions: what is accepted equals what a simple reader finds, and nothing is left out."""

import csv
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path

import numpy as np
import yaml

from surveysim.scene.table_columns import COLUMNS as KNOWN
from tests.fuzz.mangle import NUMBERS, mangled_bytes, mangled_tokens, pick
from tests.fuzz.outcomes import Outcome, check, outcome_of_error
from tests.fuzz.units import Unreadable, quantity

ROWS = tuple((f"{x:.2f}", f"{y:.2f}") for x, y in ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1), (1.5, 1.5)))
UNITS = ("arcmin", "arcsec", "deg", "rad", "m", "", "s", "arcmin / s", "nonsense", "mm", "mag", "arcmin2", "K", "%")
KINDS = (
    "float64",
    "float32",
    "int64",
    "string",
    "bool",
    "complex128",
    "object",
    "int8",
    "uint8",
    "nonsense",
    "float16",
)
CELLS = (
    "",
    "nan",
    "inf",
    "--",
    "masked",
    "1e400",
    "x",
    '""',
    "1 2",
    "0x10",
    "True",
    "1,5",
    "N/A",
    "1e-400",
    "\x1b[31m",
    *NUMBERS,
)
ADDED = ("", "   ", "#", "# note", "  # note: x", "# meta: {x: 1}", "\t", "\ufeff", "# ---")  # lines
BEHIND = (" ", "\t", "  # note", "#", " # - {name: z}", ",", "\x0b", "\r")  # a line
COLUMNS = ("dead", "z", "name", "masked", "X", "gain", "y", "x\x1b", "kept", "flag")


def prepare(folder: Path) -> str:
    """The text of a good table."""
    text = table([("x", "arcmin", "float64"), ("y", "arcmin", "float64")], ROWS)
    (folder / "camera.ecsv").write_text(text)
    from surveysim.scene.detector_table import read_detectors

    read_detectors(folder / "camera.ecsv")
    return text


def table(columns: list[tuple[str, str, str]], rows: object, delimiter: str = " ") -> str:
    """An ECSV table."""
    lines = ["%ECSV 1.0", "---"] + ([f"delimiter: '{delimiter}'"] if delimiter != " " else []) + ["datatype:"]
    for name, unit, kind in columns:
        lines.append(f"- {{name: {name}, " + (f"unit: {unit}, " if unit else "") + f"datatype: {kind}}}")
    lines.append("schema: astropy-2.0")
    body = [delimiter.join(name for name, _, _ in columns), *(delimiter.join(row) for row in rows)]
    return "\n".join([f"# {line}" for line in lines] + body) + "\n"


def mangled(base: str, rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A mangled table in the working directory."""
    how = int(rng.integers(9))
    columns, rows = [["x", "arcmin", "float64"], ["y", "arcmin", "float64"]], [list(row) for row in ROWS]
    raw = None
    if how == 0:
        raw = mangled_bytes(base.encode(), rng)
    elif how == 1:
        raw = mangled_tokens(base, rng).encode("utf-8", "replace")
    elif how in (2, 3):
        pick(rng, rows)[int(rng.integers(2))] = pick(rng, CELLS)
    elif how == 4:
        pick(rng, columns)[1] = pick(rng, UNITS)
    elif how == 5:
        pick(rng, columns)[2] = pick(rng, KINDS)
    elif how == 6:
        raw = laid_out(base, rng).encode()
    elif how == 7:
        place = int(rng.integers(3))
        columns.insert(place, [pick(rng, COLUMNS), pick(rng, ("", "arcmin")), pick(rng, ("float64", "bool", "string"))])
        for row in rows:
            row.insert(place, pick(rng, ("1", "0", "True", "False", '""', "a")))
    else:
        action = int(rng.integers(5))
        if action == 0:
            columns.reverse()
        elif action == 1:
            rows = rows[: int(rng.integers(3))]
        elif action == 2:
            rows = [*rows, rows[int(rng.integers(len(rows)))]]
        elif action == 3:
            columns = columns[:1]
            rows = [row[:1] for row in rows]
        else:
            pick(rng, rows).append("7")
    delimiter = "," if rng.random() < 0.2 else " "
    raw = table([tuple(c) for c in columns], rows, delimiter).encode() if raw is None else raw
    Path("camera.ecsv").write_bytes(raw)
    changed = [line for line in raw.decode("utf-8", "backslashreplace").splitlines() if line not in base.splitlines()]
    return repr(changed or "lines repeated or left out"), tried


def laid_out(text: str, rng: np.random.Generator) -> str:
    """A table with a line more, or something before or behind a line."""
    lines = text.splitlines()
    for _ in range(int(rng.integers(1, 3))):
        action, place = int(rng.integers(3)), int(rng.integers(len(lines)))
        if action == 0:
            lines.insert(place, pick(rng, ADDED))
        elif action == 1:
            lines[place] += pick(rng, BEHIND)
        else:
            lines[place] = " " + lines[place]
    return "\n".join(lines) + "\n"


def tried() -> Outcome:
    """Read the table; compare it with the simple reader's."""
    from surveysim.scene.detector_table import read_detectors

    try:
        found = read_detectors(Path("camera.ecsv")).positions_rad
    except Exception as error:
        return outcome_of_error(error, (ValueError,))
    check(np.isfinite(found).all() and len(found) > 0, "positions that are not finite, or none")
    try:
        wanted = simply_read(Path("camera.ecsv").read_text(encoding="utf-8-sig"))
    except (Unreadable, UnicodeDecodeError, IndexError, KeyError, TypeError, ValueError, yaml.YAMLError) as error:
        return Outcome("silent", f"accepted as {found.tolist()}: {type(error).__name__} {error}"[:500])
    rough = "float16" in Path("camera.ecsv").read_text(encoding="utf-8-sig")
    near = found.shape == wanted.shape and np.allclose(found, wanted, rtol=1e-3 if rough else 1e-6, atol=1e-12)
    check(near, f"read as {found.tolist()}"[:500])
    return Outcome("right")


def simply_read(text: str) -> np.ndarray:
    """Positions [rad] of a table of detectors; Unreadable for everything else."""
    lines = [line.strip() for line in text.splitlines()]
    header = yaml.safe_load("\n".join(line[1:].removeprefix(" ") for line in takewhile(_begins, lines) if line))
    body = [line for line in lines if line and not line.startswith("#")]
    if not isinstance(header, dict):
        raise Unreadable("no header")
    names, *rows = list(csv.reader(body, delimiter=header.get("delimiter", " "), skipinitialspace=True))
    units = {column["name"]: str(column.get("unit") or "") for column in header["datatype"]}
    if not {"x", "y"} <= set(names) <= KNOWN.keys() or sorted(names) != sorted(units) or len(set(names)) < len(names):
        raise Unreadable(f"columns {names}")
    if any(len(row) != len(names) for row in rows):
        raise Unreadable("rows of other than a cell for each column")
    return np.array(
        [[float(row[names.index(name)]) * quantity(f"1 {units[name]}", "rad") for name in "xy"] for row in rows]
    )


def _begins(line: str) -> bool:
    """Whether a line is of the header, within which lines may be blank."""
    return not line or line.startswith("#")
