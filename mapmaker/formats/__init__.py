"""Time-streams in files of several formats: the list of the formats, and functions that read and write them.

Each format is one file of this package. A file is recognized by its content.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mapmaker.errors import InputError
from mapmaker.files import regular_file
from mapmaker.formats import g3, hdf5, mustang2, toast
from mapmaker.timestreams import Timestreams
from mapmaker.validation import number

_HEAD = 2880  # bytes that tell a format; the first block of a FITS file


@dataclass(frozen=True)
class TimestreamFormat:
    """A format of files with the time-streams of one observation.

    Attributes
    ----------
    name
        Its name in options.
    suffixes
        Ends of file names; the first is that of converted files.
    recognizes
        Tells the format of a file by its path and first bytes.
    read, write
        Called by `read_timestreams` and `write_timestreams`.
    losses
        Names what a file would not hold of some time-streams.
    """

    name: str
    suffixes: tuple[str, ...]
    recognizes: Callable[[Path, bytes], bool]
    read: Callable[[str | Path, float | None], Timestreams]
    write: Callable[[str | Path, Timestreams], None]
    losses: Callable[[Timestreams], tuple[str, ...]]


# In the order of recognition: each TOAST file is an HDF5 file.
FORMATS = {
    item.name: item
    for item in (
        TimestreamFormat("toast", (".toast.h5",), toast.is_toast, toast.read, toast.write, toast.losses),
        TimestreamFormat("hdf5", (".h5", ".hdf5"), hdf5.is_hdf5, hdf5.read, hdf5.write, hdf5.losses),
        TimestreamFormat("g3", (".g3",), g3.is_g3, g3.read, g3.write, g3.losses),
        TimestreamFormat(
            "mustang2", (".fits", ".fit"), mustang2.is_fits, mustang2.read, mustang2.write, mustang2.losses
        ),
    )
}


def read_timestreams(path: str | Path, *, fwhm_rad: float | None = None) -> Timestreams:
    """Read one observation; the format is recognized by the content of the file.

    Integers and big-endian numbers are converted. Data sets stored in other files are not read.

    Parameters
    ----------
    path
    fwhm_rad
        Full width at half maximum of the beam, in place of the file's, which some formats can lack.

    Raises
    ------
    ValueError
        For a beam out of range.
    InputError
        In one line that names the file: for one that is unreadable, truncated, no regular file, of an unknown format or
        lacks something, for shapes, types, units or values that are refused, and for a format whose library is not
        installed.
    """
    if fwhm_rad is not None:
        fwhm_rad = number("fwhm_rad", fwhm_rad, above=0, below=math.pi)
    return file_format(path).read(path, fwhm_rad)


def write_timestreams(path: str | Path, streams: Timestreams, format: str | None = None) -> None:
    """Write one observation, atomically.

    A warning of one line names what the format cannot hold.

    Parameters
    ----------
    path
    streams
    format
        "hdf5", "toast", "g3" or "mustang2"; by default that of the suffix: ``.h5`` and ``.hdf5``, ``.toast.h5``,
        ``.g3``, ``.fits`` and ``.fit``.

    Raises
    ------
    ValueError
        For an unknown format or suffix, a format whose library is not installed, attributes other than numbers and
        texts, and data that the format cannot hold.
    """
    item = _of_suffix(path) if format is None else named_format(format)
    item.write(path, streams)
    if lost := item.losses(streams):
        warnings.warn(f"{path}: format {item.name} does not hold {', '.join(lost)}", UserWarning, stacklevel=2)


def named_format(name: str) -> TimestreamFormat:
    """Format of a name; raises InputError for an unknown one."""
    if name not in FORMATS:
        raise InputError(f"format: found {name!r}; one of {', '.join(FORMATS)} is expected")
    return FORMATS[name]


def suffix(path: str | Path) -> str:
    """Suffix of a file name that a format has; empty without one."""
    of_formats = [each for item in FORMATS.values() for each in item.suffixes]
    name = Path(path).name
    return next((name[-len(each) :] for each in of_formats if name.lower().endswith(each)), "")


def _of_suffix(path: str | Path) -> TimestreamFormat:
    if found := suffix(path).lower():
        return next(item for item in FORMATS.values() if found in item.suffixes)
    known = ", ".join(each for item in FORMATS.values() for each in item.suffixes)
    raise InputError(f"{path}: found no format and no known suffix; one of {known} is expected")


def file_format(path: str | Path) -> TimestreamFormat:
    """Format of a file, by its content.

    Raises
    ------
    InputError
        For no regular file, and for an unknown format.
    """
    regular_file(path, "time-stream file")
    head = _head(Path(path))
    for item in FORMATS.values():
        if item.recognizes(Path(path), head):
            return item
    raise InputError(f"{path}: not a whole time-stream file (format unknown; known are {', '.join(FORMATS)})")


def _head(path: Path) -> bytes:
    try:
        with open(path, "rb") as file:
            return file.read(_HEAD)
    except OSError as error:
        raise InputError(f"{path}: not a whole time-stream file ({error.strerror})") from None
