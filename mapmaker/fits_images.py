"""FITS files of images (FITS standard 4.0, sections 3 and 4), byte for byte as astropy writes them.

To import astropy takes longer than to write the maps of a survey.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mapmaker.files import atomic_write, one_line

_BLOCK, _CARD = 2880, 80  # bytes
_NUMBER = 20  # characters of a number; astropy cuts digits beyond
_KEYWORD = re.compile(r"[A-Z0-9_-]{1,8}")
_TEXT = re.compile(r"[ -&(-~]{0,67}[!-&(-~]")  # fits into one card
_OF_FITS = frozenset(("SIMPLE", "BITPIX", "NAXIS", "EXTEND", "COMMENT", "HISTORY", "CONTINUE", "END", "HIERARCH"))

Cards = Mapping[str, tuple[object, str]]  # value and comment by keyword


def write_images(
    path: str | Path, header: Mapping[str, object], images: Sequence[tuple[str, np.ndarray, Cards, str]]
) -> None:
    """Write image extensions after a primary header without data, atomically.

    Parameters
    ----------
    path
    header
        Values of the primary header.
    images
        Name, image (n_y, n_x) of float32, int32 or int64, cards, and unit of each extension.

    Raises
    ------
    ValueError
        For a header that FITS cannot hold.
    """
    first = _primary(header)
    with atomic_write(path) as partial, open(partial, "wb") as file:
        file.write(first)
        for name, image, cards, unit in images:
            last = {"EXTNAME": (name, "extension name"), "BUNIT": (unit, "")}
            file.write(_header({**_of_image(image), **cards, **last}))
            file.write(_whole_blocks(image.astype(image.dtype.newbyteorder(">")).tobytes(), b"\0"))


def _of_image(image: np.ndarray) -> dict[str, tuple[object, str]]:
    n_y, n_x = image.shape
    bits = 8 * image.dtype.itemsize
    return {
        "XTENSION": ("IMAGE", "Image extension"),
        "BITPIX": (-bits if image.dtype.kind == "f" else bits, "array data type"),
        "NAXIS": (2, "number of array dimensions"),
        "NAXIS1": (n_x, ""),
        "NAXIS2": (n_y, ""),
        "PCOUNT": (0, "number of parameters"),
        "GCOUNT": (1, "number of groups"),
    }


def _primary(header: Mapping[str, object]) -> bytes:
    cards: dict[str, tuple[object, str]] = {
        "SIMPLE": (True, "conforms to FITS standard"),
        "BITPIX": (8, "array data type"),
        "NAXIS": (0, "number of array dimensions"),
        "EXTEND": (True, ""),
    }
    if all(_is_plain(key, value) for key, value in header.items()):
        return _header(cards | {key: (value, "") for key, value in header.items()})
    return _by_astropy(header)


def _is_plain(key: object, value: object) -> bool:
    """Return whether a card needs none of the conventions for long keywords, long text and comments."""
    if not isinstance(key, str) or not _KEYWORD.fullmatch(key) or key in _OF_FITS:
        return False
    if isinstance(value, str):
        return _TEXT.fullmatch(value) is not None
    return isinstance(value, int) and abs(value) < 10**_NUMBER / 10


def _by_astropy(header: Mapping[str, object]) -> bytes:
    from astropy.io import fits

    found = fits.PrimaryHDU().header
    for key, value in header.items():
        try:
            found[key] = value
        except (TypeError, ValueError, AttributeError) as error:
            raise ValueError(
                f"header: found {key!r}: {value!r:.60}; a card of FITS is expected ({one_line(error)})"
            ) from None
    found.set("EXTEND", True, after="NAXIS")
    return found.tostring().encode("ascii")


def _header(cards: Cards) -> bytes:
    lines = [_card(key, value, comment) for key, (value, comment) in cards.items()]
    return _whole_blocks("".join([*lines, f"{'END':{_CARD}}"]).encode("ascii"), b" ")


def _card(key: str, value: object, comment: str) -> str:
    line = f"{key:8}= {_shown(value)}{comment and f' / {comment}'}"
    return f"{line:{_CARD}}"


def _shown(value: object) -> str:
    if isinstance(value, str):
        return f"'{value:8}'".ljust(_NUMBER) if value else "''"
    if isinstance(value, bool):
        return f"{'T' if value else 'F':>{_NUMBER}}"
    text = str(value).replace("e", "E")
    mantissa, power, exponent = text.partition("E")
    return f"{mantissa[: _NUMBER - len(power + exponent)] + power + exponent:>{_NUMBER}}"


def _whole_blocks(content: bytes, fill: bytes) -> bytes:
    return content + fill * (-len(content) % _BLOCK)
