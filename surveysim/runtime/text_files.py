"""Texts from outside: files that are read whole, and what an error shows of what they hold."""

import os
import stat
from pathlib import Path
from typing import Any

from surveysim.runtime.errors import InputError
from surveysim.runtime.printable import printable, shortened

LONGEST_KEY = 100


def read_text(path: Path, most_bytes: int) -> str:
    """The text of a regular file in UTF-8, a byte order mark dropped.

    Raises InputError for anything else (folders, pipes and devices are not opened for reading), for more than
    `most_bytes`, and for another encoding.
    """
    return _decoded(_read_bytes(path, most_bytes))


def _read_bytes(path: Path, most_bytes: int) -> bytes:
    try:
        # Without waiting for somebody who writes into a pipe; the kind is that of the file that is open.
        with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise InputError("found a pipe or a device, not a file")
            content = file.read(most_bytes + 1)
    except OSError as error:
        raise InputError(f"can't be read ({error.strerror})") from None
    if len(content) > most_bytes:
        raise InputError(f"found more than {most_bytes / 1e6:g} MB")
    return content


def _decoded(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(f"line {line} is not UTF-8: found the byte 0x{content[error.start]:02x}") from None


def key_text(text: str) -> str:
    """A key as errors show it: printable, and not longer than keys are."""
    return shortened(printable(text), LONGEST_KEY)


def one_line(error: object, longest: int = 200) -> str:
    """The text of an error, or of its type if it has none, in one printable line of so many characters at most."""
    return shortened(printable(" ".join(str(error).split()) or type(error).__name__), longest)


def nested_deeper(value: Any, depth: int) -> bool:
    """Whether tables and lists stand within each other more than `depth` deep."""
    level = [value]
    for _ in range(depth + 1):
        inner = [item.values() if isinstance(item, dict) else item for item in level if isinstance(item, dict | list)]
        if not inner:
            return False
        level = [item for items in inner for item in items]
    return True
