"""Signals that stop a command: the first interrupts, a second one ends, and the exit code is that of the command."""

import subprocess
import sys

import pytest

INTERRUPTED = """
import signal, time
from mapmaker import stop_signals as stops
stops.interrupt_work(lambda: print("cleaned", flush=True))
try:
    signal.raise_signal(signal.SIGINT)
except KeyboardInterrupt:
    signal.raise_signal(signal.SIGTERM)
    print("the same", stops.asked_to_stop(), flush=True)
stops.SAME_S = 0.0
signal.raise_signal(signal.SIGINT)
print("still there")
"""
AT_START = """
import signal
from mapmaker.stop_signals import end_at_signals
end_at_signals(lambda: print("cleaned", flush=True))
try:
    signal.raise_signal(signal.SIGTERM)
finally:
    print("still there")
"""
IN_AN_EXEC = """
import sys
from mapmaker.stop_signals import keep_exit_code
try:
    exec("raise KeyboardInterrupt")
except KeyboardInterrupt:
    keep_exit_code()
sys.exit(130)
"""
LOST = """
import sys
from contextlib import suppress
from signal import SIGINT, raise_signal
from mapmaker.cli import main
def run(arguments):
    with suppress(KeyboardInterrupt):
        raise_signal(SIGINT)
    return 0
main._run = run
main.main()
"""


@pytest.mark.parametrize(
    "program, out, error",
    [
        (INTERRUPTED, "the same True\ncleaned\n", "interrupted\n"),
        (AT_START, "cleaned\n", "interrupted\n"),
        (IN_AN_EXEC, "", ""),
        (LOST, "", "interrupted too late: the command is finished\n"),
    ],
    ids=["second", "start", "exec", "lost"],
)
def test_processes_that_end(tmp_path, program, out, error):
    """As a module: Python itself ends some of those by SIGINT."""
    (tmp_path / "program.py").write_text(program)
    done = subprocess.run([sys.executable, "-m", "program"], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, out, error)
