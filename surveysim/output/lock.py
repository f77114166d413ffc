"""Lock of an output directory: one job at a time writes there; the lock of a dead process is taken over."""

import json
import logging
import os
import socket
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from stat import S_ISREG
from time import sleep
from typing import Any

from surveysim.runtime.engine import defer_signals
from surveysim.runtime.errors import SceneError
from surveysim.runtime.provenance import now

LOCK = ".surveysim.lock"
_READ_AGAIN_S, _TRIES = 0.1, 20  # for a lock that is made but not yet written
_MOST_BYTES = 10_000

_KEYS = ("host", "machine", "boot", "processes", "pid", "age", "started")

log = logging.getLogger("surveysim")


class OutputError(SceneError):
    """An output directory that cannot be used as it is; the text says in one line why, and what to do."""


@contextmanager
def locked(directory: Path, *, level: int = logging.WARNING) -> Iterator[None]:
    """Hold the lock of a directory.

    The lock is a file that is created atomically with its content (a hard link), which is safe on network file systems
    too. A lock from this machine is taken over if its process no longer exists. A lock from another machine is never
    taken over, as its process cannot be checked. A lock that is taken over is logged at `level`.

    Raises
    ------
    OutputError
        If another process holds the lock; the text names it.
    OSError
        If the directory cannot be written; it names the directory.
    """
    own = None
    try:
        with defer_signals():  # an interrupt cannot leave a lock behind
            own = _take(directory, level)
        yield
    finally:
        if own is not None and _read(directory / LOCK) == own:
            (directory / LOCK).unlink(missing_ok=True)


def alive(pid: int) -> bool:
    """Return whether a process of this machine exists and is not a zombie."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        pass  # a process of another user, or no process number
    return (_status(pid) or "?")[0] not in "ZX"


def _take(directory: Path, level: int) -> dict[str, Any]:
    """Make the lock and return its content."""
    lock, own, tries = directory / LOCK, _holder(), 0
    while True:
        if _make(lock, own):
            return own
        found = _read(lock)
        if found is None and not os.path.lexists(lock):
            continue  # released just now
        if found is None and tries < _TRIES:
            tries += 1
            sleep(_READ_AGAIN_S)
            continue
        _refuse_or_remove(lock, found, level)


def _make(lock: Path, own: Mapping[str, Any]) -> bool:
    """Make a lock unless there is one already; return whether it was made."""
    try:
        folder = os.path.realpath(lock.parent)  # tempfile takes ".." after a link for the link's own folder
        number, name = tempfile.mkstemp(f".{os.getpid()}.part", f"{LOCK}.", folder)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(lock.parent)) from None
    try:
        with open(number, "w", encoding="utf-8") as file:
            os.chmod(name, 0o644)  # other users of a shared directory can read who works there
            json.dump(own, file)
        try:
            os.link(name, lock)
        except FileExistsError:
            return False
        except OSError:  # a file system without hard links
            return _make_without_links(lock, own)
        return True
    finally:
        os.unlink(name)


def _make_without_links(lock: Path, own: Mapping[str, Any]) -> bool:
    try:
        file = open(lock, "x", encoding="utf-8")  # noqa: SIM115, closed below
    except FileExistsError:
        return False
    try:
        with file:
            json.dump(own, file)
    except BaseException:
        lock.unlink()
        raise
    return True


def _read(lock: Path) -> dict[str, Any] | None:
    """Read the holder of a lock; None without a readable one."""
    try:
        if not S_ISREG(os.lstat(lock).st_mode):
            return None
        with open(lock, encoding="utf-8") as file:
            found = json.loads(file.read(_MOST_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    whole = isinstance(found, dict) and found.keys() == set(_KEYS) and isinstance(found["pid"], int)
    return found if whole else None


def _refuse_or_remove(lock: Path, found: Mapping[str, Any] | None, level: int) -> None:
    """Remove a lock whose process no longer exists; raises OutputError for any other."""
    if found is None:
        raise OutputError(f"{lock}: a lock that can't be read; delete it if no job writes to {lock.parent}")
    who = f"process {found['pid']} of host {_word(found['host'])} since {_word(found['started'])}"
    own = _holder()
    if any(found[key] != own[key] for key in ("host", "machine", "processes")):
        raise OutputError(
            f"{lock.parent}: in use by {who}; wait for its end or write elsewhere with --out, and if that process is "
            f"gone delete {lock}"
        )
    if found["boot"] == own["boot"] and alive(found["pid"]) and _age(found["pid"]) == found["age"]:
        raise OutputError(f"{lock.parent}: in use by {who}; wait for its end, or write elsewhere with --out")
    if _remove_if_same(lock, found):
        log.log(level, "%s: was in use by %s, which is gone; this job takes its place", lock.parent, who)


def _remove_if_same(lock: Path, found: Mapping[str, Any]) -> bool:
    """Remove a lock unless another job has replaced it; a file is removed only by the holder of its flock."""
    import fcntl

    with suppress(FileNotFoundError), open(lock, encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
        except OSError:  # a file system without it
            raise OutputError(f"{lock}: left by a process that no longer exists; delete it and try again") from None
        if _read(lock) == found and os.path.samestat(os.stat(lock), os.fstat(file.fileno())):
            lock.unlink()
            return True
    return False


def _holder() -> dict[str, Any]:
    """Describe this process for its lock."""
    pid = os.getpid()
    return {
        "host": socket.gethostname(),
        "machine": _text("/etc/machine-id"),
        "boot": _text("/proc/sys/kernel/random/boot_id"),
        "processes": _link("/proc/self/ns/pid"),  # containers number their processes themselves
        "pid": pid,
        "age": _age(pid),
        "started": now(),
    }


def _status(pid: int) -> list[str] | None:
    """Read the fields of a process from its state on (Linux)."""
    text = _text(f"/proc/{pid}/stat")
    return text.rpartition(")")[2].split() if text else None


def _age(pid: int) -> str:
    """Start of a process in ticks since boot, which distinguishes two processes with the same number."""
    fields = _status(pid)
    return fields[19] if fields and len(fields) > 19 else ""


def _text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except (OSError, ValueError):
        return ""


def _link(path: str) -> str:
    try:
        return os.readlink(path)
    except OSError:
        return ""


def _word(value: object) -> str:
    """Make text from an untrusted file safe for a terminal."""
    return "".join(c if c.isprintable() else "?" for c in str(value))[:64]
