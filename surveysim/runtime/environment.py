"""Process environment of a command: standard streams, caches, and messages of libraries."""

import gc
import logging
import os
import re
import shutil
import sys
import tempfile
import threading
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import Any

from mapmaker.printable import complain

log = logging.getLogger("surveysim")

_OF_FLAGS = ("default", "default::BytesWarning", "error::BytesWarning")  # set by -X dev, -b and -bb
_SIZE = re.compile(r"[1-9][0-9]{1,3}")  # columns or lines
_temporary_homes: list[str] = []
# Scipy loads all parts of numpy, and numba loads YAML. These take 0.1 s, and a run uses none of them.
UNUSED = ("numpy.f2py", "numpy.testing", "yaml")
# Numba looks whether scipy has this module, whose package takes 0.05 s; no kernel here calls BLAS.
PROBED = "scipy.linalg.cython_blas"
# New objects between two searches for cycles, 700 by default. Imports make some 400 000, which stay, and hardly any
# cycles; a search looks at them all.
COLLECT_EVERY = 1_000_000
# Numbers of threads of the libraries that numpy may multiply matrices with; they are read when it is imported.
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def settle() -> str | None:
    """Prepare streams, libraries and caches for a command; return a warning if caches are temporary."""
    open_streams()
    silence_libraries()
    postpone_unused()
    limit_threads()
    forget_sizes()
    return provide_caches()


def open_streams() -> None:
    """Open standard streams that the caller closed, and write ``?`` for characters outside their encoding."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:  # closed: the next file that is opened would be taken for it
            os.open(os.devnull, os.O_RDWR)
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            stream = open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8")  # noqa: SIM115
            setattr(sys, name, stream)
        if name != "stdin" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def silence_libraries() -> None:
    """Silence warnings and logs of libraries, here and in worker processes; log this package to standard error."""
    of_flags = [option for option in sys.warnoptions if option in _OF_FLAGS]  # which subprocess looks for
    sys.warnoptions[:] = [*of_flags, "ignore"]  # worker processes are started with them
    os.environ["PYTHONWARNINGS"] = "ignore"
    warnings.resetwarnings()
    warnings.simplefilter("ignore")
    if not log.handlers:
        logging.getLogger().addHandler(logging.NullHandler())
        log.addHandler(_Lines())
    # What is raised in a finalizer or in a thread can't be handled by anyone.
    sys.unraisablehook = _ignored
    threading.excepthook = _ignored


def forget_sizes() -> None:
    """Remove impossible terminal sizes from the environment: rich and typer would fail."""
    for name in ("COLUMNS", "LINES", "TERMINAL_WIDTH"):
        if not _SIZE.fullmatch(os.environ.get(name, "")):
            os.environ.pop(name, None)


def postpone_unused() -> None:
    """Load modules that libraries import, but hardly anything uses, at their first use; collect garbage less often."""
    gc.set_threshold(COLLECT_EVERY)
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # it reads the metadata of all packages for them
    if _OnUse not in sys.meta_path:
        sys.meta_path.insert(0, _OnUse)
    sys.modules.setdefault(PROBED, _Probed(PROBED))


def limit_threads() -> None:
    """Give matrix products one thread, unless the environment asks for more: they are small, and more threads spin."""
    for name in THREADS:
        os.environ.setdefault(name, "1")


class _OnUse:
    """Finder of modules that are executed at the first use of one of their names."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None, target: object = None) -> ModuleSpec | None:
        """Find one of the unused modules; None for all others."""
        spec = PathFinder.find_spec(name, path) if name in UNUSED else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


class _Probed(ModuleType):
    """Placeholder of a module, which is imported at the first use of one of its names."""

    def __getattr__(self, name: str) -> Any:
        """Import the module in place of this one; tools that ask all modules for a file or a path get none."""
        if name.startswith("__") and name != "__pyx_capi__":
            raise AttributeError(name)
        if sys.modules.get(PROBED) is self:
            del sys.modules[PROBED]
        return getattr(import_module(PROBED), name)


class _Lines(logging.Handler):
    """Log handler that writes one line to standard error per record."""

    def emit(self, record: logging.LogRecord) -> None:
        complain(record.getMessage())


def _ignored(raised: Any) -> None:
    log.debug("ignored: %s: %s", raised.exc_type.__name__, raised.exc_value)


def provide_caches() -> str | None:
    """Provide a writable home for the caches of libraries; return a warning if it is temporary or there is none."""
    home = os.path.expanduser("~")  # without any it is "~", and libraries would make a folder of that name
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.join(home, ".cache")
    config = os.environ.get("XDG_CONFIG_HOME") or os.path.join(home, ".config")
    if os.path.isdir(home) and _can_be_written(cache) and _can_be_written(config):
        return None
    try:
        place = tempfile.mkdtemp(prefix="surveysim-home-")
        _temporary_homes.append(place)
    except OSError:
        place = os.devnull  # below it nobody, not even root, can make a directory
    os.environ["HOME"] = place
    os.environ["XDG_CACHE_HOME"] = os.path.join(place, ".cache")
    os.environ["XDG_CONFIG_HOME"] = os.path.join(place, ".config")
    if os.path.isdir(home):
        found, remedy = f"{cache} and {config} can't both be written", "they can"
    else:
        found, remedy = "found no home directory", "HOME is one that can be written"
    return f"no cache: {found}; commands may start more slowly until {remedy}"


def _can_be_written(directory: str) -> bool:
    """Return whether a directory, or its nearest existing parent, can be written."""
    while not os.path.lexists(directory):
        directory = os.path.dirname(directory) or os.curdir
    return os.path.isdir(directory) and os.access(directory, os.W_OK | os.X_OK)


def clean_up() -> None:
    """Remove the temporary home of this process."""
    while _temporary_homes:
        shutil.rmtree(_temporary_homes.pop(), ignore_errors=True)
