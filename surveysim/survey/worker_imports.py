"""Imports of worker processes, made once in the process that they are forked from."""

import gc
from importlib import import_module

from surveysim.runtime.environment import postpone_unused

postpone_unused()

from numba.core.registry import cpu_target  # noqa: E402

import surveysim.survey.run  # noqa: E402, F401

for _name in (
    "scipy.fft",
    "scipy.linalg",
    "scipy.spatial.distance",
):  # which kernels and factors import at their first use
    import_module(_name)
cpu_target.target_context.refresh()  # numba imports half of its modules once the first kernel is loaded
gc.freeze()  # collections in workers then leave the shared pages as they are
