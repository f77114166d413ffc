"""Messages between processes of one machine: arrays are sent from where they are, and received where they stay."""

import pickle
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

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
    arrays: list[pickle.PickleBuffer] = []
    text = pickle.dumps(value, protocol=5, buffer_callback=arrays.append)
    parts = [memoryview(text), *(array.raw() for array in arrays)]
    channel.sendall(struct.pack(f"<{1 + len(parts)}Q", len(parts), *(part.nbytes for part in parts)))
    for part in parts:
        channel.sendall(part)


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
