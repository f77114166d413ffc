"""Times of stages: kernels that are compiled in them do not count."""

from time import perf_counter, sleep

import numba
import numpy as np
from numba.core.compiler_lock import global_compiler_lock

from mapmaker.kernels.compiled import compile_s, is_cached
from surveysim import load_scene, run
from surveysim.reduction import cleaned_block
from surveysim.runtime.engine import SERIAL
from surveysim.timestreams.observation import Stopwatch
from tests.scenes import write_scene

COMPILING_S = 20.0


def test_compilation_in_a_stage_does_not_count():
    @numba.njit
    def doubled(values):
        return 2 * values

    watch, compiled, start = Stopwatch(), compile_s(), perf_counter()
    with watch("stage"):
        doubled(np.ones(3))
        sleep(0.02)
    elapsed, compiling = perf_counter() - start, compile_s() - compiled
    assert compiling > 0.05  # compiled here and now
    assert 0.02 <= watch.seconds["stage"] <= elapsed - compiling


def test_warm_stage_counts_whole():
    watch, compiled = Stopwatch(), compile_s()
    with watch("stage"):
        sleep(0.02)
    assert compile_s() == compiled and watch.seconds["stage"] >= 0.02


def test_cost_of_a_run_leaves_out_compilation(tmp_path, monkeypatch):
    """The first observation compiles for long."""
    clock = [0.0]
    auxiliary_data = cleaned_block.AuxiliaryData

    def slow(*arguments):
        if clock[0] == 0:
            with global_compiler_lock:
                clock[0] += COMPILING_S
        return auxiliary_data(*arguments)

    for name in ("surveysim.timestreams.observation.perf_counter", "numba.core.event.timer"):
        monkeypatch.setattr(name, lambda: perf_counter() + clock[0])
    monkeypatch.setattr(cleaned_block, "AuxiliaryData", slow)
    result = run(load_scene(write_scene(tmp_path)), engine=SERIAL)
    assert clock[0] == COMPILING_S and result.coadds.done == 4
    assert result.coadds.each_s < 0.2 * COMPILING_S / 4
    assert result.parts.each_s == result.coadds.each_s


def test_kernels_on_disk_are_found(tmp_path, monkeypatch):
    class Kernel:
        __name__ = "bin_samples"
        stats = numba.core.dispatcher._CompileStats(str(tmp_path), {}, {})

    assert not is_cached(Kernel())
    (tmp_path / "pixels.other-39.py311.1.nbc").touch()
    assert not is_cached(Kernel())
    (tmp_path / "pixels.bin_samples-39.py311.1.nbc").touch()
    assert is_cached(Kernel())
    monkeypatch.setattr(Kernel, "stats", numba.core.dispatcher._CompileStats(None, {}, {}))
    assert not is_cached(Kernel())
