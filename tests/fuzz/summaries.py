"""Mangled summaries: a report of them, and a run over them, which must leave the user's files alone."""

import json
import shutil
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz import scenes
from tests.fuzz.kept import QUIET, copied
from tests.fuzz.mangle import ODD, mangled_bytes, mangled_tokens, pick
from tests.fuzz.outcomes import Outcome, call, check, outcome_of_end
from tests.scenes import SMALL_SCENE
from tests.trees import files

MINE = (
    "thesis.tex",
    "out/notes.txt",
    "out/maps/mine.fits",
    "out/figures/movie.part",
    "out/.writable",
    "out/maps/a.fits.part",
    "out/tables/draft.12.part.txt",
)
FOREIGN = (
    "thesis.tex",
    "../thesis.tex",
    "notes.txt",
    "maps/mine.fits",
    "/etc/hostname",
    "figures/movie.part",
    "maps",
    ".",
    "..",
    "link/thesis.tex",
    "",
    "x\0y",
    "maps/../notes.txt",
    "summary.json",
    "MAPS/mine.fits",
)
RECORD = ".surveysim.json"
OTHER_HASH = sha256(b"another content").hexdigest()
VALUES = (
    None,
    [],
    {},
    "",
    "<script>alert(1)</script>",
    "\x1b[31mred",
    -1,
    1e300,
    float("nan"),
    True,
    [[]],
    {"a": {"b": []}},
    "x" * 5000,
    "\u202eevil",
    10**400,
)


def prepare(folder: Path) -> Path:
    """The output of a run, with files of the user around and inside it."""
    base = folder / "base"
    shutil.copytree(scenes.prepare(folder)["run"], base / "out")
    (base / "scene.toml").write_text(SMALL_SCENE)
    if not (base / "out" / RECORD).exists():
        raise AssertionError("the run left no record")
    for name in MINE:
        (base / name).parent.mkdir(exist_ok=True)
        (base / name).write_text(f"{name} is mine")
    return base


def mangled(base: Path, rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A mangled summary, or record of the files, in the output directory."""
    path, raw = copied(base, pick(rng, ("summary.json", "summary.json", RECORD)))
    text = raw.decode()
    how = int(rng.integers(6))
    if how == 0:
        path.write_bytes(mangled_bytes(text.encode(), rng))
        label = "bytes"
    elif how == 1:
        path.write_text(mangled_tokens(text, rng), errors="surrogatepass")
        label = "tokens"
    else:
        content = json.loads(text)
        label = _with_files(content, rng) if how < 4 else _with_values(content, rng)
        path.write_text(json.dumps(content, allow_nan=True))
    label = f"{path.name}: {label}"
    then = int(rng.integers(4))
    if then < 2:
        return f"{label}; report", reported
    options = ("--force",) if then == 3 else ()
    return f"{label}; run {options}", lambda: run_over(*options)


def _with_files(content: dict[str, Any], rng: np.random.Generator) -> str:
    """The user's own files in the list of files, in the summary of this program or of another."""
    named = [pick(rng, FOREIGN) for _ in range(int(rng.integers(1, 4)))]
    if rng.random() < 0.3:
        Path("out/link").symlink_to("..")
    if rng.random() < 0.4:
        content.clear()
    if "sha256" in content:
        content["files"] |= {name: pick(rng, (OTHER_HASH, OTHER_HASH.upper(), "", 1)) for name in named}
    else:
        content["files"] = [*content.get("files", []), *named] if rng.random() < 0.8 else pick(rng, VALUES)
    return f"files {'alone' if len(content) == 1 else 'and more'}: {named}"


def _with_values(content: dict[str, Any], rng: np.random.Generator) -> str:
    place: Any = content
    path = []
    while isinstance(place, dict | list) and place and (not path or rng.random() < 0.75):
        parent, key = place, pick(rng, sorted(place)) if isinstance(place, dict) else int(rng.integers(len(place)))
        path.append(str(key))
        place = place[key]
    value = pick(rng, VALUES if rng.random() < 0.8 else [item for item in ODD if isinstance(item, str | list | dict)])
    parent[key] = value
    return f"{'.'.join(path)} = {value!r}"[:300]


def reported() -> Outcome:
    """A report is written, without anything that a browser would run, or refused; nothing else changes."""
    before = files(Path("."))
    ended = call("report", "out")
    after = files(Path("."))
    changed = {name for name in before.keys() | after.keys() if before.get(name) != after.get(name)}
    check(changed <= {"out/report.html", f"out/{RECORD}"}, f"report changed {sorted(changed)}")
    if refused := outcome_of_end(ended):
        return refused
    page = Path("out/report.html").read_text(encoding="utf-8")
    check("<script>alert" not in page, "a script in the page")
    check("\x1b" not in page and "\0" not in page, "control characters in the page")
    return Outcome("right")


def run_over(*options: str) -> Outcome:
    """A run into the directory ends well or is refused, and the user's files stay."""
    mine = [*MINE, *(["out/link"] if Path("out/link").is_symlink() else [])]
    before = {name: files(Path(".")).get(name) for name in mine}
    ended = call("run", "scene.toml", *QUIET, *options)
    after = files(Path("."))
    lost = [name for name in mine if after.get(name) != before[name]]
    check(not lost, f"changed or deleted {lost}; exit code {ended.code}")
    left = [name for name in after if name.endswith(".part") and name not in MINE]
    check(not left, f"partial files left: {left}")
    shutil.rmtree("out")
    return outcome_of_end(ended) or Outcome("right")
