"""Mangled inputs of all kinds: each is refused in one short line, or accepted with the right meaning.

Nothing wrong may be accepted in silence; no input may show a traceback, hang or take more than 2 GB. By default a few
inputs are tried; the slow test tries more, or as many as `--fuzz N` says, from `--fuzz-seed SEED`.
"""

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from tests.fuzz.outcomes import BAD

FEW, MANY = 12, 90
SHOWN = 25

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="limits memory through /proc")


def tried(number: int, seed: int) -> list[dict]:
    """Records of the inputs, in a process of their own."""
    command = [sys.executable, "-m", "tests.fuzz.server", "all", str(number), str(seed)]
    environment = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    ended = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert ended.returncode == 0, ended.stderr[-2000:]
    return [json.loads(line) for line in ended.stdout.splitlines()]


def line(record: dict, seed: int) -> str:
    """Outcome of a failing input, and the command that repeats it."""
    again = f"python -m tests.fuzz.server {record['kind']} 1 {seed} {record['number']}"
    return f"{record['outcome']}: {record['text'][:400]}\n  input: {record['input'][:400]}\n  again: {again}"


def good(number: int, seed: int) -> Counter:
    """Try inputs; fails with those that had a bad outcome. Returns how many had which."""
    records = tried(number, seed)
    bad = [record for record in records if record["outcome"] in (*BAD, "harness")]
    shown = "\n".join(line(record, seed) for record in bad[:SHOWN])
    counts = Counter((record["kind"], record["outcome"]) for record in records)
    assert not bad, f"{len(bad)} of {len(records)} inputs: {dict(counts)}\n{shown}"
    return counts


def test_few():
    counts = good(FEW, seed=1)
    assert {outcome for _, outcome in counts} == {"refused", "right"}


@pytest.mark.slow
def test_many(request):
    options = request.config.option
    counts = good(options.fuzz or MANY, options.fuzz_seed)
    print("\n".join(f"{kind} {outcome}: {number}" for (kind, outcome), number in sorted(counts.items())))
