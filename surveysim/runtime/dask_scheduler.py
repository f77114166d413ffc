"""Checks of a dask scheduler at an address, in limited time."""

import asyncio
import queue
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar
from urllib.parse import urlsplit

import distributed
from distributed.core import rpc
from distributed.security import Security

from surveysim.runtime.addresses import SHOWN, shown
from surveysim.runtime.interrupt_signals import ignore_sigint_in_children
from surveysim.runtime.worker_loss import EngineError

CONNECT_S = 10.0  # longest time for an answer of a scheduler
_CONNECTING = 0.8  # fraction of the time after which a connection is given up, so that its error is reported
_NO_SCHEDULER = "the answer is not that of a scheduler"

Found = TypeVar("Found")


def workers_at(address: str) -> int:
    """Number of workers of the scheduler at an address.

    Raises
    ------
    EngineError
        If no scheduler answers within `CONNECT_S`, or one with another version of dask.
    """
    return within(CONNECT_S, address, lambda: _asked(address))


def within(seconds: float, address: str, ask: Callable[[], Found]) -> Found:
    """Return ``ask()``, a request to the scheduler at an address, if it takes no longer than `seconds`.

    It runs in a thread of its own, so that the process handles signals meanwhile.

    Raises
    ------
    EngineError
        For any error of the request, and after `seconds`.
    """
    answer: queue.Queue[tuple[Found | None, Exception | None]] = queue.Queue()

    def work() -> None:
        try:
            with ignore_sigint_in_children():
                answer.put((ask(), None))
        except Exception as error:  # dask and the network raise many types of errors for other programs
            answer.put((None, error))

    threading.Thread(target=work, daemon=True).start()
    none = f"scheduler: no scheduler answers at {address}"
    try:
        found, error = answer.get(timeout=seconds)
    except queue.Empty:
        raise EngineError(f"{none} within {seconds:g} s") from None
    if isinstance(error, EngineError):
        raise error from None
    if error is not None:
        raise EngineError(f"{none} ({reason(error, _NO_SCHEDULER)})") from None
    return found


def reason(error: BaseException, other: str = "") -> str:
    """Summarize an error of dask: the first OSError in its chain, or `other` if there is none."""
    chain = [error]
    while isinstance(before := chain[-1].__cause__ or chain[-1].__context__, Exception):
        chain.append(before)
    first = next((each for each in reversed(chain) if isinstance(each, OSError)), error)
    if isinstance(first, TimeoutError):
        return "timed out"
    if other and not isinstance(first, OSError):
        return other
    lines = str(getattr(first, "strerror", None) or first).splitlines()
    return " ".join(lines[0].split())[:SHOWN] if lines else type(first).__name__


def _asked(address: str) -> int:
    parts = urlsplit(address)
    try:
        socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or "no host name"
        raise EngineError(f"scheduler: host {shown(parts.hostname)} is not known ({why})") from None
    try:
        arguments = Security().get_connection_args("client")
    except (OSError, ValueError) as error:  # certificates of dask's configuration that are not there, or no such
        raise EngineError(f"scheduler: dask's certificates can't be read ({reason(error)})") from None
    if parts.scheme == "tls" and arguments["ssl_context"] is None:
        raise EngineError(
            f"scheduler: found {address} and no certificates; dask's keys distributed.comm.tls.ca-file, client.cert "
            "and client.key are expected"
        )
    if parts.scheme == "tcp" and arguments["require_encryption"]:
        raise EngineError(
            f"scheduler: found {address}, which is not encrypted; tls://host:port is expected by dask's key "
            "distributed.comm.require-encryption"
        )
    kind, version, workers = asyncio.run(asyncio.wait_for(_answers(address, arguments), CONNECT_S))
    if kind != "Scheduler":
        raise EngineError(f"scheduler: found a {shown(kind)} at {address}; a scheduler is expected")
    if version != distributed.__version__:
        raise EngineError(
            f"scheduler: found distributed {version} at {address}; {distributed.__version__}, the version here, is "
            "expected"
        )
    return workers


async def _answers(address: str, arguments: dict[str, Any]) -> tuple[str, str, int]:
    """Ask the server at an address for its type, its version of distributed and its number of workers."""
    server = rpc(address, timeout=_CONNECTING * CONNECT_S, connection_args=arguments)
    try:
        kind = str((await server.identity())["type"])
        if kind != "Scheduler":
            return kind, "", 0
        versions = await server.versions()
        return kind, str(versions["packages"]["distributed"]), len(await server.ncores())
    finally:
        with suppress(Exception):
            await server.close_rpc()
