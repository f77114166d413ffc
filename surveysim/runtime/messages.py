"""Messages between processes of one machine: arrays are sent from where they are, and received where they stay."""

import pickle
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from surveysim.runtime.text_files import one_line

if TYPE_CHECKING:
    from socket import socket

_COUNT = struct.Struct("<Q")


def send(channel: "socket", value: Any) -> None:
    """Send a picklable value.

    Raises
    ------
    OSError
        If the other end is closed.
    """
    send_parts(channel, pickled(value))


def pickled(value: Any) -> list[memoryview]:
    """Pickle a value, arrays apart from the rest; what pickling raises passes on."""
    arrays: list[pickle.PickleBuffer] = []
    text = pickle.dumps(value, protocol=5, buffer_callback=arrays.append)
    return [memoryview(text), *(array.raw() for array in arrays)]


def send_parts(channel: "socket", parts: list[memoryview]) -> None:
    """Send a value from `pickled`; OSError if the other end is closed."""
    channel.sendall(struct.pack(f"<{1 + len(parts)}Q", len(parts), *(part.nbytes for part in parts)))
    for part in parts:
        channel.sendall(part)


def sendable(error: Exception) -> Exception:
    """Return an error that another process can unpickle: the same one, or one with its type and text."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception as reason:
        found = RuntimeError(f"{type(error).__qualname__}: {one_line(error)}")
        found.add_note(f"the error itself can't be sent by a worker: {one_line(reason)}")
        return found
    return error


def receive(channel: "socket") -> Any:
    """Wait for a value and return it.

    Raises
    ------
    EOFError
        If the other end is closed, or OSError if it was closed by force.
    """
    (n_part,) = _COUNT.unpack(_filled(channel, _COUNT.size))
    sizes = struct.unpack(f"<{n_part}Q", _filled(channel, n_part * _COUNT.size))
    text, *arrays = (_filled(channel, size) for size in sizes)
    return pickle.loads(text, buffers=arrays)


def _filled(channel: "socket", size: int) -> memoryview:
    found = rest = np.empty(size, np.uint8).data  # a bytearray would be filled with zeros first
    while rest:
        n = channel.recv_into(rest)
        if not n:
            raise EOFError("the other end of the channel is closed")
        rest = rest[n:]
    return found
