"""Addresses of dask schedulers, checked before a run starts and without importing dask."""

import json
import re
from pathlib import Path
from urllib.parse import urlsplit

from surveysim.runtime.worker_loss import EngineError

PROTOCOLS = ("tcp", "tls")
LARGEST_FILE = 1 << 20  # bytes; a scheduler's file has some hundreds
SHOWN = 100  # letters of an address or a reason in a message

_EXPECTED = "tcp://host:port, tls://host:port or a scheduler's file is expected"
_ADDRESS = re.compile(r".*://.*|[^/\\]+:\d+", re.DOTALL)


def address_of(scheduler: str) -> str:
    """Return the address ``protocol://host:port`` of a scheduler.

    Parameters
    ----------
    scheduler
        Address, with or without protocol, or path of a scheduler file.

    Raises
    ------
    EngineError
        For text that is neither; one line.
    """
    text = scheduler if _ADDRESS.fullmatch(scheduler) else _address_in(scheduler)
    return _checked(text if "://" in text else f"tcp://{text}")


def _checked(address: str) -> str:
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError as error:  # port out of range, or brackets without an IPv6 address
        raise EngineError(f"scheduler: found {shown(address)} ({shown(error)}); {_EXPECTED}") from None
    if parts.scheme not in PROTOCOLS:
        raise EngineError(f"scheduler: found the protocol {shown(parts.scheme)}; {_EXPECTED}")
    host = f"[{parts.hostname}]" if ":" in (parts.hostname or "") else parts.hostname
    if not host or not port or address != f"{parts.scheme}://{parts.netloc}" or not _plain(parts.netloc):
        raise EngineError(f"scheduler: found {shown(address)}; {_EXPECTED}")
    return f"{parts.scheme}://{host}:{port}"


def _plain(place: str) -> bool:
    """Return whether a location is only host and port: no user, blanks or unprintable characters."""
    return place.isprintable() and not set(place) & set("@ ")


def _address_in(file: str) -> str:
    """Read the address from a scheduler file."""
    path = Path(file)
    try:
        if not path.is_file() or path.stat().st_size > LARGEST_FILE:  # a pipe or a device might never end
            raise ValueError
        address = json.loads(path.read_text(encoding="utf-8"))["address"]
        if not isinstance(address, str):
            raise TypeError
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        found = f"{shown(file)}, which is neither an address nor a scheduler's file"
        raise EngineError(f"scheduler: found {found}; {_EXPECTED}") from None
    return address


def shown(text: object) -> str:
    """Quote text for an error message of one line."""
    short = str(text)
    return repr(short if len(short) <= SHOWN else f"{short[:SHOWN]}...")
