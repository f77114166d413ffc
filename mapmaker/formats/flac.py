"""Arrays that flacarray compressed in an HDF5 file, as TOAST stores signals and flags."""

from typing import Any

import numpy as np

from mapmaker.errors import InputError
from mapmaker.formats.border import check_shape, data_set
from mapmaker.validation import integers, whole

_VERSION = "1"


def read_compressed(name: str, group: Any, shape: tuple[int, int]) -> np.ndarray:
    """Read an array.

    Parameters
    ----------
    name
        Name of the group in messages.
    group
    shape
        Expected shape.

    Raises
    ------
    InputError
        Without the package flacarray, for another version of its format, another shape, and streams beyond the
        compressed bytes.
    """
    advice = 'or save the observation with detdata=["signal", "flags"]'
    if group.attrs.get("flacarray_format_version") != _VERSION:
        raise InputError(f"{name} is compressed in an old format; load it with TOAST, and save it without compression")
    try:
        from flacarray.hdf5 import read_array
    except ImportError:
        raise InputError(f"{name} is compressed: pip install 'mmcam-surveysim[toast]' to read it, {advice}") from None
    start, size, content = (data_set(group, key) for key in ("stream_starts", "stream_bytes", "compressed"))
    n_samp = whole(f"{name}/stream_starts: stream_size", start.attrs.get("stream_size"), least=1)
    check_shape(name, (*start.shape, n_samp), shape)
    first = integers(f"{name}/stream_starts", start[()], shape[:1], least=0)
    least = np.append(first[1:], content.size) - first
    if (integers(f"{name}/stream_bytes", size[()], shape[:1], least=1) > least).any():
        raise InputError(
            f"{name} has streams beyond its {content.size} bytes; streams one after the other are expected"
        )
    return read_array(group).reshape(shape)
