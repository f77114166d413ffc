"""Text from outside: reading of whole files, and quotes of their content in error messages."""

import os
import stat
from pathlib import Path
from typing import Any

from mapmaker.printable import printable, shortened
from surveysim.runtime.errors import InputError

LONGEST_KEY = 100


def read_text(path: Path, most_bytes: int) -> str:
    """Read a regular file in UTF-8, without byte order mark.

    Raises
    ------
    InputError
        For directories, pipes and devices, for more than `most_bytes`, and for another encoding.
    """
    return decoded(read_bytes(path, most_bytes))


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Read a regular file; raises InputError for directories, pipes and devices, and for more than `most_bytes`."""
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


def decoded(content: bytes) -> str:
    """Decode UTF-8 without byte order mark; raises InputError, with the line, for another encoding."""
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(f"line {line} is not UTF-8: found the byte 0x{content[error.start]:02x}") from None


def key_text(text: str) -> str:
    """Quote a key for an error message: printable, and no longer than `LONGEST_KEY`."""
    return shortened(printable(text), LONGEST_KEY)


def one_line(error: object, longest: int = 200) -> str:
    """Text of an error, or its type, in one printable line of at most `longest` characters."""
    return shortened(printable(" ".join(str(error).split()) or type(error).__name__), longest)


def nested_deeper(value: Any, depth: int) -> bool:
    """Return whether tables and lists are nested more than `depth` deep."""
    level = [value]
    for _ in range(depth + 1):
        inner = [item.values() if isinstance(item, dict) else item for item in level if isinstance(item, dict | list)]
        if not inner:
            return False
        level = [item for items in inner for item in items]
    return True
