"""Atomic writing of files, and tables in ECSV."""

import errno
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from mapmaker.errors import InputError

_PLAIN = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_.:+-")


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Context manager for a path to write to, which is renamed to `path` if the block succeeds and removed if it fails.

    Parent folders are created. The file is flushed to the disk before it is renamed.

    Raises
    ------
    OSError
        With number, reason and `path` where the file can't be written.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Another process may write the same file; astropy would expand a leading "~" to the home directory.
    partial = path.absolute().with_name(f"{path.name}.{os.getpid()}.part")
    try:
        yield partial
        _to_disk(partial)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        if error.filename not in (None, str(partial)):
            raise
        raise OSError(*_failure(error), str(path)) from None
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def regular_file(path: str | Path, kind: str) -> None:
    """Raise InputError unless `path` is a regular file: reading a pipe or a device may never end."""
    if not Path(path).is_file():
        found = "no regular file" if Path(path).exists() else "no such file"
        found = "found a directory" if Path(path).is_dir() else found
        raise InputError(f"{path}: {found}; a {kind} is expected")


def one_line(error: BaseException) -> str:
    """Text of an error in one line of at most 200 characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 200 else f"{text[:197]}..."


def _failure(error: OSError) -> tuple[int, str]:
    """Number and reason of an error in writing: numpy has none for a full disk, HDF5 has it in its text only."""
    told = re.search(r"errno = (\d+)", str(error))
    number = error.errno or (int(told[1]) if told else 0)
    return (number, os.strerror(number)) if number else (errno.EIO, "not written whole, as on a full disk")


def _to_disk(path: Path) -> None:
    """Flush a file to the disk: a name that survives a loss of power must not belong to an empty file."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_ecsv(
    path: str | Path, columns: Mapping[str, Sequence | np.ndarray], units: Mapping[str, str], meta: Mapping[str, object]
) -> None:
    """Write columns of equal length as an ECSV 1.0 table (Astropy Proposal for Enhancement 6), atomically.

    Numbers are read back with the same bits.

    Parameters
    ----------
    path
    columns
        1-D columns of bool, integers, floats or text, by name.
    units
        Units of the columns that have one.
    meta
        Text, numbers, bool, None and lists of them.

    Raises
    ------
    ValueError
        For other columns, text with a line break, and a unit without a column.
    """
    # Not astropy's writer: its imports take longer than a small run.
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    kinds = {name: _datatype(name, array) for name, array in arrays.items()}
    if len({array.size for array in arrays.values()}) > 1:
        raise ValueError(f"found columns of {[array.size for array in arrays.values()]} rows; one length is expected")
    if unknown := units.keys() - arrays.keys():
        raise ValueError(f"found units of {sorted(unknown)}; columns among {list(arrays)} are expected")
    header = ["%ECSV 1.0", "---", "datatype:"]
    for name, kind in kinds.items():
        unit = f", unit: {_yaml(units[name])}" if name in units else ""
        header.append(f"- {{name: {_yaml(name)}{unit}, datatype: {kind}}}")
    if meta:
        header += ["meta: !!omap", *(f"- {{{_yaml(key)}: {_yaml(value)}}}" for key, value in meta.items())]
    header.append("schema: astropy-2.0")
    rows = zip(*([_cell(str(value)) for value in array] for array in arrays.values()), strict=True)
    lines = [f"# {line}" for line in header] + [" ".join(row) for row in (map(_cell, arrays), *rows)]
    with atomic_write(path) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _datatype(name: str, array: np.ndarray) -> str:
    """ECSV name of a column's type."""
    if array.ndim != 1 or array.dtype.kind not in "biufU":
        raise ValueError(
            f"column {name}: found {array.ndim} dimensions of {array.dtype}; one of bool, numbers or text is expected"
        )
    if array.dtype.kind == "U" and any(len(text.splitlines()) > 1 for text in array.tolist()):
        raise ValueError(f"column {name}: found a line break; text of one line is expected")
    return "string" if array.dtype.kind == "U" else array.dtype.name


def _cell(text: str) -> str:
    return text if text and _PLAIN.issuperset(text) else '"' + text.replace('"', '""') + '"'


def _yaml(value: object) -> str:
    """Format a value in YAML's flow style."""
    if isinstance(value, str):
        plain = (c if " " <= c <= "~" and c not in '"\\' else f"\\U{ord(c):08x}" for c in value)
        return f'"{"".join(plain)}"'
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_yaml, value))}]"
    if value is None or isinstance(value, bool | np.bool_):
        return "null" if value is None else str(bool(value)).lower()
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return _yaml_float(float(value))
    raise ValueError(f"found {value!r} in meta; text, numbers, bool, None and lists of them are expected")


def _yaml_float(value: float) -> str:
    if not math.isfinite(value):
        return ".nan" if math.isnan(value) else f"{'-' * (value < 0)}.inf"
    mantissa, e, exponent = repr(value).partition("e")
    # YAML 1.1 reads a number with an exponent but without a point as text.
    return mantissa + (".0" if e and "." not in mantissa else "") + e + exponent
