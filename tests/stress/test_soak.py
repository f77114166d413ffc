"""Long runs and many runs: memory stays, and nothing is left behind."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="looks at memory through /proc"),
]

GROWTH = 1.05


@pytest.mark.parametrize("what, number", [("observations", 800), ("runs", 30)])
def test_soak(what, number):
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "tests.stress.soak", what, str(number)]
    ended = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert ended.returncode == 0, ended.stderr[-2000:]
    early, late = json.loads(ended.stdout.splitlines()[-1])
    print(what, early, late)
    assert late["mb"] <= GROWTH * early["mb"], (early, late)
    assert late["descriptors"] <= early["descriptors"]
    assert late["children"] <= early["children"]  # multiprocessing keeps one that looks after its semaphores
    assert late["temporary"] <= early["temporary"]  # the socket of the process that workers are forked from
