"""Checks at the border: a reader refuses a file in one line, and takes from HDF5 only values that the file holds."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mapmaker.errors import ArgumentError, InputError
from mapmaker.files import one_line
from mapmaker.printable import printable
from mapmaker.timestreams import FocalPlane
from mapmaker.validation import argument_error, reals

if TYPE_CHECKING:
    import h5py

# Largest compression: HDF5's filters compress zeros by a thousand.
_MOST_COMPRESSED = 2000


@contextmanager
def refusals(path: str | Path) -> Iterator[None]:
    """Context manager in which every error becomes an InputError of one line that names the file."""
    try:
        yield
    except (ArgumentError, InputError) as error:
        raise InputError(f"{path}: {printable(one_line(error))}") from None
    except Exception as error:  # libraries raise nearly every kind of exception for a mangled file
        raise InputError(f"{path}: not a whole time-stream file ({printable(one_line(error))})") from None


def group(parent: Any, name: str) -> "h5py.Group":
    """Group of an HDF5 file; raises InputError where there is none in the file itself."""
    import h5py

    item = _item(parent, name)
    if not isinstance(item, h5py.Group):
        raise InputError(f"{name} is a {_kind(item)}; a group is expected")
    return item


def data_set(parent: Any, name: str) -> "h5py.Dataset":
    """Data set of an HDF5 file; raises InputError where there is none with all its values in the file itself."""
    import h5py

    item = _item(parent, name)
    if not isinstance(item, h5py.Dataset):
        raise InputError(f"{name} is a {_kind(item)}; a data set is expected")
    if item.is_virtual or item.external:
        raise InputError(f"{name} is stored in another file; a data set with its values is expected")
    if item.shape is None or item.nbytes > _MOST_COMPRESSED * item.id.get_storage_size():
        raise InputError(
            f"{name} has {item.id.get_storage_size()} bytes of values of the shape {item.shape}; all are expected"
        )
    if item.dtype.kind == "b" or h5py.check_enum_dtype(item.dtype):
        raise InputError(f"{name} has names for its values; numbers are expected")
    return item


def _item(parent: Any, name: str) -> Any:
    import h5py

    if name not in parent:
        raise InputError(f"lacks {name}")
    if isinstance(parent.get(name, getlink=True), h5py.ExternalLink):
        raise InputError(f"{name} is a link to another file; a data set is expected")
    return parent.get(name)


def _kind(item: object) -> str:
    return "link to nothing" if item is None else type(item).__name__.lower()


def millikelvin(name: str, unit: object) -> float:
    """Factor from a unit of temperature to mK; raises InputError for another unit."""
    from astropy import units as u

    try:
        return float(u.Unit(str(unit)).to(u.mK))
    except (ValueError, TypeError):  # also of astropy's UnitConversionError
        raise InputError(f"the unit of {name}: found {str(unit)!r}; K, mK or uK is expected") from None


def unit_rotations(name: str, value: object, n: int) -> np.ndarray:
    """Check quaternions (n, 4) of length 1."""
    rotations = reals(name, value, (n, 4), least=-1.01, most=1.01).astype(np.float64, copy=False)
    length = np.linalg.norm(rotations, axis=1)
    if (bad := abs(length - 1) > 1e-6).any():
        raise argument_error(name, f"a quaternion of the length {length[bad][0]:.6g}", "unit quaternions are")
    return rotations


def check_shape(name: str, found: Sequence[int], expected: Sequence[int]) -> None:
    """Raise InputError for another shape than expected."""
    if tuple(found) != tuple(expected):
        raise InputError(f"{name} has the shape {tuple(found)}; {tuple(expected)} is expected")


def detector_names(plane: FocalPlane) -> list[str]:
    """Names of the detectors, for a format that needs them: their own, or numbers of equal length.

    Raises
    ------
    InputError
        For a name of two detectors.
    """
    if plane.names is None:
        digits = len(str(len(plane.x_rad) - 1))
        return [f"D{number:0{digits}d}" for number in range(len(plane.x_rad))]
    names, counts = np.unique(plane.names, return_counts=True)
    if (counts > 1).any():
        raise InputError(f"found {counts.max()} detectors of the name {names[counts.argmax()]}; one each is expected")
    return plane.names.tolist()
