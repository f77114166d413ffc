"""Mangled command lines."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz import scenes
from tests.fuzz.mangle import NUMBERS, ODD, mangled_tokens, pick
from tests.fuzz.outcomes import Outcome, call, check, outcome_of_end
from tests.fuzz.sweeps import AXES
from tests.scenes import SMALL_SCENE
from tests.trees import files

TEXTS = (
    "",
    " ",
    "-",
    "--",
    "a\x1b[31mb",
    "\u202eb",
    "x" * 5000,
    "é",
    "\udcff",
    "a\nb",
    "$x$",
    "../..",
    "/dev/null",
    "/proc/self/mem",
    "/",
    ".",
    "scene.toml",
    "sweep.toml",
    "missing.toml",
    "folder",
    "binary.toml",
    "fifo.toml",
    "link.toml",
    *NUMBERS,
)
SETTINGS = (
    "observations=2",
    "seed=7",
    "scan.speed=8 arcmin / s",
    "a",
    "=",
    "a=",
    "=b",
    ".=1",
    "a.b.c=1",
    "scan=1",
    "scan.speed",
    "title=\x1b[31m",
    "name=../x",
    "name=a b",
    "seed=1\nseed=2",
    "title='''",
    "scan.speed='4 4 s'",
    f"{'n.' * 3000}n=1",
    f"seed={'[' * 3000}",
    "seed={a=1}",
    "seed=2003-10-28",
    "instrument.layout.dead=[1,2]",
    "score.signal_sims.skies=1000",
    "scan.step=5 deg",
    "scan.duration=1e308 s",
    "sweep.x=1",
    "assumed=1",
    "observations=0x2",
    "observations=1_0",
    "observations=2 # two",
    "title=\udcff",
    "__class__=1",
)
OPTIONS = {
    "run": (
        "--out",
        "--workers",
        "--engine",
        "--scheduler",
        "--resume",
        "--force",
        "--no-figures",
        "--target-error",
        "--time-budget",
        "--reference",
        "--set",
        "-q",
        "--save-timestreams",
    ),
    "check": ("--set",),
    "plan": ("--set", "--workers"),
    "forecast": ("--out", "--force", "--set", "--no-figures", "--reference", "-q"),
    "report": ("--force",),
    "new": ("--like",),
    "paper": (
        "--table",
        "--figure",
        "--out",
        "--scenarios",
        "--observations",
        "--workers",
        "--engine",
        "--scheduler",
        "--set",
    ),
    "accuracy": ("--reference-error", "--seeds", "--observations", "--workers", "--engine", "--scheduler"),
}
FLAGS = ("--resume", "--force", "--no-figures", "-q", "--save-timestreams")
KNOWN = {
    "--engine": ("serial", "processes", "dask", "mpi", "SERIAL"),
    "--scheduler": (
        "tcp://127.0.0.1:1",
        "tls://127.0.0.1:1",
        "http://127.0.0.1:1",
        "127.0.0.1",
        "tcp://",
        "tcp://host:port",
        "tcp://[::1]:99999999",
        "missing.json",
        "scene.toml",
    ),
    "--out": ("out", "scene.toml", "scene.toml/x", "out/../out", "/dev/null/x", "/proc/x", "a b", "é"),
    "--workers": ("1", "0", "-1", "2"),
    "--like": ("scene.toml", "binary.toml", "first_light", "missing", "../x", "folder.toml"),
    "--target-error": ("3%", "0", "-1%", "nan", "1e400%", "3 % %", "100000%", "1e-9"),
    "--time-budget": ("1 s", "0 s", "-1 s", "nan s", "1e308 s", "1 m", "1"),
    "--reference": ("0", "1", "99", "-1", "scan.speed = 3 arcmin / s", "x = y"),
    "--reference-error": ("0.1", "0", "nan", "1e308"),
}
COMMON = ("run", "run", "run", "check", "check", "plan", "forecast", "report", "new", "new", "paper", "accuracy")


def prepare(folder: Path) -> None:
    """Load what the commands load."""
    scenes.prepare(folder)


def mangled(base: None, rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A command line, in a folder with some files to name."""
    _write_files()
    command = pick(rng, COMMON) if rng.random() < 0.95 else pick(rng, TEXTS)
    arguments = [command]
    options = OPTIONS.get(command, ("--set", "--help", "-v"))
    if command not in ("paper",) and (command != "accuracy" or rng.random() < 0.3):
        arguments.append(_argument(command, rng))
    for _ in range(int(rng.integers(0, 4))):
        if options:
            arguments += _option(pick(rng, options), rng)
    if rng.random() < 0.1:
        arguments.insert(
            int(rng.integers(len(arguments) + 1)), pick(rng, (*TEXTS, "--help", "--version", "--nonsense", "-x"))
        )
    arguments += _quick(arguments)
    arguments = [text.replace("\0", "") for text in arguments]  # the system passes no such argument
    return repr([text[:100] for text in arguments]), lambda: tried(arguments)


def _write_files() -> None:
    Path("scene.toml").write_text(SMALL_SCENE)
    Path("sweep.toml").write_text(SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", "") + "\n" + AXES)
    Path("binary.toml").write_bytes(b'title = "\xff\xfe"\n\0')
    Path("folder.toml").mkdir()
    os.mkfifo("fifo.toml")
    Path("link.toml").symlink_to("link.toml")
    Path("folder").mkdir()
    Path("folder/mine.txt").write_text("mine")
    Path("scenarios").mkdir()
    Path("scenarios/first_light.toml").write_text(SMALL_SCENE)


def _argument(command: str, rng: np.random.Generator) -> str:
    if command == "accuracy":  # a good scene would take minutes
        return pick(rng, ("missing.toml", "folder", "binary.toml", "sweep.toml", ""))
    if command in ("run", "check", "plan", "forecast") and rng.random() < 0.6:
        return pick(rng, ("scene.toml", "scene.toml", "sweep.toml"))
    if command == "new" and rng.random() < 0.4:
        return pick(rng, ("mine", "first_light", "../up", "a b", "é", "x" * 300, ".", "..", "-x", "con.toml"))
    return pick(rng, TEXTS)


def _option(name: str, rng: np.random.Generator) -> list[str]:
    if name in FLAGS:
        return [name]
    if name == "--set":
        text = pick(rng, SETTINGS)
        return [name, mangled_tokens(text, rng, 1) if rng.random() < 0.2 and len(text) < 100 else text]
    odd = [str(item) for item in ODD]
    return [name, pick(rng, KNOWN[name]) if name in KNOWN and rng.random() < 0.8 else pick(rng, (*TEXTS, *odd))]


def _quick(arguments: list[str]) -> list[str]:
    """Arguments that keep an accepted command short, without changing the mangled ones."""
    if arguments[0] in ("run", "forecast"):
        alone = arguments[0] == "run" and not {"--engine", "--workers", "--scheduler"} & set(arguments)
        return ["--no-figures"] * ("--no-figures" not in arguments) + ["--engine", "serial"] * alone
    if arguments[0] == "paper" and "--scenarios" not in arguments:
        return ["--scenarios", "folder"]  # without scenes: all that it could make fails
    return []


def tried(arguments: list[str]) -> Outcome:
    """Run the command: it ends well or with one line; files that were there stay."""
    before = files(Path("."))
    ended = call(*arguments)
    after = files(Path("."))
    lost = [name for name in before if after.get(name) != before[name]]
    check(not lost, f"changed or deleted {lost}")
    check(not [name for name in after if name.endswith(".part")], "partial files left")
    # A machine that fails has exit code 1: outputs that can't be written, a scheduler that does not answer.
    if refused := outcome_of_end(ended, refusals=(1, 2)):
        return refused
    return (
        scenes.whole_summary()
        if Path("out/summary.json").exists() and arguments[0] == "run" and "sweep.toml" not in arguments
        else Outcome("right")
    )
