"""Runs killed at random moments and resumed: the same bits, and no file of the user's lost."""

import contextlib
import os
import signal
import subprocess
import time
from dataclasses import dataclass

import numpy as np
import pytest

from tests.scenes import SMALL_SCENE
from tests.stress.commands import SCENE, SWEEP, ended, start
from tests.trees import lost, plant, results

pytestmark = pytest.mark.slow

FEW = 2
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)


@dataclass(frozen=True)
class Variant:
    """A command that is killed; `resume` is what it goes on with."""

    text: str
    arguments: tuple[str, ...]
    resume: tuple[str, ...] = ("--resume",)


RUNS = (
    Variant(SCENE, ("run", "scene.toml", "--workers", "1", "--no-figures")),
    Variant(SCENE, ("run", "scene.toml", "--workers", "2", "--no-figures", "--save-timestreams")),
    Variant(SCENE, ("run", "scene.toml", "--engine", "serial")),
    Variant(SWEEP, ("run", "scene.toml", "--workers", "2", "--no-figures")),
    Variant(SWEEP, ("run", "scene.toml", "--engine", "serial", "--no-figures")),
    Variant(SCENE, ("run", "scene.toml", "--workers", "1", "--no-figures", "--set", "seed=5")),
)
ACCURACY = ("accuracy", "scene.toml", "--seeds", "1", "--observations", "2", "--reference-error", "0.5", "--no-figures")
VARIANTS = (*RUNS, *RUNS, Variant(SMALL_SCENE, ACCURACY, resume=()))  # it takes as long as many runs)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Files of each command left undisturbed, and its time."""
    kept = {}

    def of(variant):
        if variant not in kept:
            root = tmp_path_factory.mktemp("whole")
            (root / "scene.toml").write_text(variant.text)
            begin = time.monotonic()
            code, error = ended(start(root, *variant.arguments, "-q", "--out", "out"))
            assert code == 0, error
            kept[variant] = results(root / "out"), time.monotonic() - begin
        return kept[variant]

    return of


def test_kills(request, tmp_path, whole):
    number = request.config.option.stress or FEW
    rng = np.random.default_rng(request.config.option.fuzz_seed)
    failed = []
    for place in range(number):
        root = tmp_path / f"{place:03d}"
        root.mkdir()
        if fault := killed(root, VARIANTS[place % len(VARIANTS)], rng, whole):
            failed.append(f"{place}: {fault}")
    assert not failed, "\n".join([f"{len(failed)} of {number} kills:", *failed])


def killed(root, variant, rng, whole):
    """Kill a command once or twice, go on with it, and say what is wrong then, or nothing."""
    expected, taken = whole(variant)
    (root / "scene.toml").write_text(variant.text)
    before = plant(root)
    said = f"{' '.join(variant.arguments)}"
    for again in range(int(rng.integers(1, 3))):
        number, to_group = SIGNALS[int(rng.integers(len(SIGNALS)))], rng.random() < 0.5
        delay = float(rng.uniform(0.1, 1.05)) * taken
        said += f"; {number.name} {'to the group' if to_group else 'to the parent'} after {delay:.2f} of {taken:.2f} s"
        process = start(root, *variant.arguments, *(variant.resume if again else ()), "-q", "--out", "out")
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(delay)
        with contextlib.suppress(ProcessLookupError):
            (os.killpg if to_group else os.kill)(process.pid, number)
        code, error = ended(process)
        if fault := fault_of_end(code, error, number):
            return f"{said}: {fault}"
        if gone := lost(root, before):
            return f"{said}: then lost {gone}"
    code, error = ended(start(root, *variant.arguments, *variant.resume, "-q", "--out", "out"))
    if code != 0:
        return f"{said}: going on ended with {code}: {error}"
    if gone := lost(root, before):
        return f"{said}: going on lost {gone}"
    found = results(root / "out")
    if variant.arguments[0] == "accuracy":  # its table holds times
        expected, found = dict.fromkeys(expected), dict.fromkeys(found)
    odd = sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))
    return f"{said}: other files than a whole run's: {odd}" if odd else ""


def fault_of_end(code, error, number):
    """Fault in the end of a killed command, empty if there is none."""
    if "Traceback" in error and "surveysim" in error:  # not of Python's own start
        return f"a traceback: {error[-600:]}"
    if number != signal.SIGKILL and code not in (0, 130, -number):
        return f"exit code {code}: {error}"
    lines = [line for line in error.splitlines() if "this job takes its place" not in line]  # of one killed before
    if code == 130 and len(lines) != 1:
        return f"{len(error.splitlines())} lines: {error}"
    return ""
