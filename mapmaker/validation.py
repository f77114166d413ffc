"""Checks of arguments, which each public function makes once, before it computes anything.

A check returns its argument in native byte order and in a type that kernels are compiled for, or raises ArgumentError
with the name, the value found and the values expected. Kernels do not check indices.
"""

import math
import operator
from collections.abc import Sequence
from types import EllipsisType
from typing import Any, SupportsIndex, cast

import numpy as np

from mapmaker.errors import ArgumentError

# Sides of a shape: a number, or a name for any length. A leading ... stands for any number of axes.
Shape = Sequence[int | str | EllipsisType]
_KINDS = {"biuf": "real numbers", "iuf": "real numbers", "iu": "integers", "b": "True and False"}
_MOST_TEXT = 60  # characters of a wrong value in a message
MAX_PIXELS = 2**31 - 1  # pixel numbers of a map are int32, -1 off the map


def argument_error(name: str, found: object, expected: str) -> ArgumentError:
    """Error of an argument: its name, the value found, the values expected."""
    text = str(found)
    return ArgumentError(f"{name}: found {text[:_MOST_TEXT]}{'...' * (len(text) > _MOST_TEXT)}; {expected} expected")


def reals(
    name: str,
    value: object,
    shape: Shape,
    *,
    finite: bool = True,
    least: float = -math.inf,
    above: float = -math.inf,
    most: float = math.inf,
    empty: bool = False,
) -> np.ndarray:
    """Convert to an array of real numbers: float32 if it is, else float64.

    Parameters
    ----------
    name
        Name of the argument in messages.
    value
    shape
    finite
        If False, infinities and NaN are allowed, and there are no bounds.
    least, above, most
        Bounds of the values.
    empty
        Allow arrays without a value.

    Raises
    ------
    ValueError
        For other shapes and types (complex, text, objects, masked values, quantities with a unit), and values out of
        bounds.
    """
    array = _plain(name, value, "biuf")
    if array.dtype not in (np.float32, np.float64):
        array = array.astype(np.float64)
    _check_shape(name, array, shape, empty)
    if finite and array.size and not _within(array, least, above, most):
        fits = np.isfinite(array) & (array >= least) & (array > above) & (array <= most)
        if not fits.all():
            expected = f"{_range('finite numbers', least=least, above=above, most=most)} are"
            raise argument_error(name, f"{array[~fits][0]} {_place(fits)}", expected)
    return array


@np.errstate(over="ignore", invalid="ignore")
def _within(array: np.ndarray, least: float, above: float, most: float) -> bool:
    """Tell quickly whether values are certainly finite and within bounds."""
    # A finite sum has finite terms; a sum that is not finite may have overflowed.
    if not math.isfinite(array.sum()):
        return False
    low = array.min() if max(least, above) > -math.inf else math.inf
    return low >= least and low > above and (most == math.inf or array.max() <= most)


def integers(
    name: str,
    value: object,
    shape: Shape,
    *,
    least: int = -(2**63),
    most: int = 2**63 - 1,
    empty: bool = False,
    keep_type: bool = False,
) -> np.ndarray:
    """Convert to an array of integers: int32 if it is, else int64; parameters and errors as for `reals`.

    With `keep_type` large arrays of small integers keep their type.
    """
    array = _plain(name, value, "iu")
    _check_shape(name, array, shape, empty)
    if array.size and not (least <= (low := int(array.min())) and (high := int(array.max())) <= most):
        fits = (array >= least) & (array <= most)
        found = low if low < least else high
        raise argument_error(
            name, f"{found} {_place(fits)}", f"{_range('integers', least=least, above=-math.inf, most=most)} are"
        )
    return array if keep_type or array.dtype in (np.int32, np.int64) else array.astype(np.int64)


def flags(name: str, value: object, shape: Shape, *, empty: bool = False) -> np.ndarray:
    """Check an array of True and False; numbers, which might be indices, are refused; errors as for `reals`."""
    array = _plain(name, value, "b")
    _check_shape(name, array, shape, empty)
    return array


def number(
    name: str,
    value: object,
    *,
    least: float = -math.inf,
    above: float = -math.inf,
    most: float = math.inf,
    below: float = math.inf,
) -> float:
    """Check a finite real number within bounds."""
    array = _plain(name, value, "iuf") if not isinstance(value, float) else value
    if np.ndim(array):
        raise argument_error(name, f"the shape {np.shape(array)}", "one number is")
    found = float(array)
    if not (math.isfinite(found) and least <= found <= most and above < found < below):
        raise argument_error(
            name, found, f"{_range('a finite number', least=least, above=above, most=most, below=below)} is"
        )
    return found


def whole(name: str, value: object, *, least: int, most: int | float = math.inf) -> int:
    """Check an integer within bounds."""
    try:
        found = operator.index(cast(SupportsIndex, value))
    except TypeError:
        found = None
    if found is None or isinstance(value, bool | np.bool_) or not least <= found <= most:
        raise argument_error(
            name,
            repr(value) if found is None else found,
            f"{_range('an integer', least=least, above=-math.inf, most=most)} is",
        )
    return found


def pixel_side(name: str, value: object) -> float:
    """Check the side of a pixel [rad]: above the rounding of directions, below a quarter of a turn."""
    return number(name, value, least=1e-12, below=math.pi / 2)


def plane_sides(n_y: object, n_x: object) -> None:
    """Raise ValueError for sides of a plane that are no integers, or too many cells for a map."""
    rows, columns = (whole(name, n, least=1, most=MAX_PIXELS) for name, n in (("n_y", n_y), ("n_x", n_x)))
    if rows * columns > MAX_PIXELS:
        raise argument_error("n_y, n_x", f"{n_y} x {n_x} cells", f"{MAX_PIXELS} cells in all or less are")


def increasing(name: str, value: object, *, fewest: int, least: float = -math.inf) -> np.ndarray:
    """Check at least `fewest` finite numbers (n,) that increase from `least` or more."""
    array = reals(name, value, ("n",), least=least).astype(np.float64, copy=False)
    if len(array) < fewest:
        raise argument_error(name, f"{len(array)} numbers", f"{fewest} or more are")
    _check_increase(name, array)
    return array


def _check_increase(name: str, array: np.ndarray) -> None:
    rises = np.diff(array) > 0
    if not rises.all():
        place = int(np.argmin(rises))
        raise argument_error(
            name, f"{array[place]:.9g} before {array[place + 1]:.9g} {_place(rises)}", "increasing numbers are"
        )


def band_edges(name: str, value: object) -> np.ndarray:
    """Check edges (n + 1,) of bands that increase from 0 or more; the last may be infinite."""
    array = reals(name, value, ("n_band + 1",), finite=False).astype(np.float64, copy=False)
    if len(array) < 2:
        raise argument_error(name, f"{len(array)} edges", "2 or more are")
    reals(name, array[:-1], ("n_band",), least=0)
    _check_increase(name, array)
    return array


def bounds_of_scans(value: Any, n_samp: int) -> np.ndarray:
    """Check first and one-past-last samples of scans, (n_scan, 2) int64: not empty, within the samples, not
    overlapping.
    """
    name = "scan_bounds"
    if np.size(value) == 0 and np.shape(value) in ((0,), (0, 2)):
        return np.zeros((0, 2), np.int64)
    bounds = integers(name, value, ("n_scan", 2)).astype(np.int64, copy=False)
    bad = (bounds[:, 0] < 0) | (bounds[:, 0] >= bounds[:, 1]) | (bounds[:, 1] > n_samp)
    if bad.any():
        scan = int(np.argmax(bad))
        raise argument_error(
            name,
            f"{bounds[scan].tolist()} of scan {scan}",
            f"[start, stop) with 0 <= start < stop <= {n_samp}, the number of samples, is",
        )
    ordered = bounds[np.argsort(bounds[:, 0], kind="stable")]
    overlap = ordered[1:, 0] < ordered[:-1, 1]
    if overlap.any():
        first = int(np.argmax(overlap))
        raise argument_error(
            name, f"scans {ordered[first].tolist()} and {ordered[first + 1].tolist()}", "scans apart are"
        )
    return bounds


def single_precision(name: str, array: np.ndarray) -> np.ndarray:
    """Convert to float32; raises ValueError for finite numbers beyond its range."""
    try:
        with np.errstate(over="raise"):
            return array.astype(np.float32, copy=False)
    except FloatingPointError:
        raise argument_error(
            name, f"numbers up to {np.abs(array).max():.3g}", "numbers that single precision holds are"
        ) from None


def pixel_numbers(value: object, shape: tuple[int, ...], n_pixel: int) -> np.ndarray:
    """Check flat pixels of samples, of the data's shape: -1 (off the map) to `n_pixel` - 1."""
    return signed("index", value, integers("index", value, shape, least=-1, most=n_pixel - 1))


def signed(name: str, value: object, array: np.ndarray) -> np.ndarray:
    """Return the integers of `value`; raises ValueError for the largest of an unsigned type, which stands for a stored
    -1.
    """
    kind = np.asarray(value).dtype
    if kind.kind == "u" and array.max() == np.iinfo(kind).max:
        raise argument_error(name, f"{array.max()}, which is -1 in the type {kind}", "a type with a sign is")
    return array


def _plain(name: str, value: object, kinds: str) -> np.ndarray:
    """Convert to a numpy array of some kinds of types, in native byte order."""
    expected = f"{_KINDS[kinds]} are"
    if np.ma.is_masked(value):
        raise argument_error(name, "masked values", f"{_KINDS[kinds]} without a mask are")
    if (unit := getattr(value, "unit", None)) is not None:
        raise argument_error(name, f"a quantity in {unit or 'no unit'}", f"plain numbers in the unit of {name} are")
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):  # rows of several lengths
        raise argument_error(name, type(value).__name__, f"an array of {expected}") from None
    if not array.size and array.dtype == np.float64:  # numpy's type of an empty list
        array = array.astype({"iu": np.int64, "b": bool}.get(kinds, np.float64))
    if array.dtype.kind not in kinds:
        found = repr(value) if isinstance(value, str | bytes | None) else f"the type {array.dtype}"
        raise argument_error(name, found, expected)
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _check_shape(name: str, array: np.ndarray, shape: Shape, empty: bool) -> None:
    sides = [side for side in shape if side is not ...]
    tail = array.shape[array.ndim - len(sides) :] if array.ndim >= len(sides) else ()
    fits = len(tail) == len(sides) and (len(sides) < len(shape) or array.ndim == len(sides))
    if not fits or any(side != found for side, found in zip(sides, tail, strict=True) if not isinstance(side, str)):
        text = ", ".join("..." if side is ... else str(side) for side in shape)
        raise argument_error(name, f"the shape {array.shape}", f"({text}{',' * (len(shape) == 1)}) is")
    if not (array.size or empty):
        raise argument_error(name, f"the shape {array.shape}, without a value", "one or more are")


def _place(fits: np.ndarray) -> str:
    """Index of the first value that does not fit, as text."""
    place = np.unravel_index(int(np.argmin(fits)), fits.shape)
    return f"at [{', '.join(map(str, place))}]" if place else ""


def _range(what: str, *, least: float, above: float, most: float, below: float = math.inf) -> str:
    bounds = ((least, "of at least"), (above, "above"), (most, "of at most"), (below, "below"))
    parts = [f"{word} {bound:.10g}" for bound, word in bounds if abs(bound) < 2**63 - 1]
    return " ".join([what, " and ".join(parts)]).rstrip()
