"""This project's HDF5 files: one observation each, with the names and units of the guide."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.errors import InputError
from mapmaker.files import atomic_write
from mapmaker.formats.border import check_shape, data_set, refusals
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.validation import argument_error, integers, number, reals, single_precision, whole

# Attributes of a file; version 0 is that of files without them.
_NAME_OF_FORMAT, _VERSION = "mapmaker time-streams", 1
_OWN_ATTRIBUTES = ("format", "format_version", "fwhm_arcsec")
_PER_SAMPLE = ("time_s", "ra_deg", "dec_deg", "array_angle_deg", "scan")
_PER_DETECTOR = ("x_arcmin", "y_arcmin")
# Of each detector; files can lack them.
_ANGLE, _NAME = "polarization_angle_deg", "detector_name"
_FLAGS = "flags"  # of each detector and sample; files can lack them
# Largest absolute values: right ascensions and array angles may be unwrapped by a hundred turns; declinations and
# detector offsets are at most a quarter of a turn.
_LARGEST = {"ra_deg": 36e3, "dec_deg": 90.0, "array_angle_deg": 36e3, "x_arcmin": 5400.0, "y_arcmin": 5400.0} | {
    _ANGLE: 36e3
}


def is_hdf5(path: Path, head: bytes) -> bool:
    """Tell an HDF5 file by its first bytes."""
    return head.startswith(b"\x89HDF\r\n\x1a\n")


def losses(streams: Timestreams) -> tuple[str, ...]:
    """Name what a file would not hold: nothing."""
    return ()


def write(path: str | Path, streams: Timestreams) -> None:
    """Write one observation, atomically; arguments and errors as for `mapmaker.write_timestreams`."""
    with timestream_file(path, streams.data_mk.shape[1]) as add:
        add(streams)


@contextmanager
def timestream_file(path: str | Path, n_samp: int) -> Iterator[Callable[[Timestreams], None]]:
    """Context manager for an HDF5 file of one observation, written in parts in order of time.

    The file gets its name when it is complete.

    Yields
    ------
    callable
        Adds a part, a `Timestreams`.

    Raises
    ------
    ValueError
        Where the parts do not have `n_samp` samples in all or have different detectors, for attributes other than
        numbers and texts, and data beyond single precision.
    """
    import h5py

    with atomic_write(path) as partial, h5py.File(partial, "w") as file:
        done = 0

        def add(part: Timestreams) -> None:
            nonlocal done
            until = done + part.data_mk.shape[1]
            if until > n_samp:
                raise ValueError(f"{path}: found {until} samples; {n_samp} are expected")
            if not done:
                _begin(file, part, n_samp)
            if len(part.data_mk) != len(file["data"]):
                raise ValueError(f"{path}: found {len(part.data_mk)} detectors after {len(file['data'])}; one number")
            if (part.flags is None) != (_FLAGS not in file):
                raise ValueError(f"{path}: found parts with flags and without; flags in all parts or none are expected")
            file["data"][:, done:until] = single_precision("data_mk", part.data_mk)
            if part.flags is not None:
                file[_FLAGS][:, done:until] = part.flags
            for name, values in _sample_columns(part).items():
                file[name][done:until] = values
            done = until

        yield add
        if done != n_samp:
            raise ValueError(f"{path}: found {done} samples; {n_samp} are expected")


def _begin(file: Any, part: Timestreams, n_samp: int) -> None:
    """Write the data sets that do not depend on time, and allocate the others."""
    data = file.create_dataset("data", (len(part.data_mk), n_samp), np.float32)
    data.attrs["unit"] = "mK (Rayleigh-Jeans)"
    if part.flags is not None:  # as numbers: HDF5 has no truth values
        file.create_dataset(_FLAGS, data.shape, np.uint8)
    for name, values in _sample_columns(part).items():
        file.create_dataset(name, (n_samp,), values.dtype)
    file["x_arcmin"] = np.degrees(part.focal_plane.x_rad) * 60
    file["y_arcmin"] = np.degrees(part.focal_plane.y_rad) * 60
    if part.focal_plane.angle_rad is not None:
        file[_ANGLE] = np.degrees(part.focal_plane.angle_rad)
    if part.focal_plane.names is not None:
        file.create_dataset(_NAME, data=part.focal_plane.names.tolist(), dtype=_text())
    file.attrs["format"], file.attrs["format_version"] = _NAME_OF_FORMAT, _VERSION
    file.attrs["fwhm_arcsec"] = np.degrees(part.focal_plane.fwhm_rad) * 3600
    for name, value in part.attributes.items():
        if name in _OWN_ATTRIBUTES:
            expected = "the beam in focal_plane.fwhm_rad, and other names here, are"
            raise argument_error("attributes", name, expected if name == "fwhm_arcsec" else "other names are")
        if np.asarray(value).dtype.kind not in "biufSU":
            raise argument_error(f"attributes[{name!r}]", type(value).__name__, "numbers and texts are")
        file.attrs[name] = value


def _sample_columns(streams: Timestreams) -> dict[str, np.ndarray]:
    """`_PER_SAMPLE` in the units of a file."""
    angles = (np.degrees(angle) for angle in (streams.ra_rad, streams.dec_rad, streams.array_angle_rad))
    return dict(zip(_PER_SAMPLE, (streams.time_s, *angles, streams.scan), strict=True))


def read(path: str | Path, fwhm_rad: float | None) -> Timestreams:
    """Read one observation; arguments and errors as for `mapmaker.read_timestreams`."""
    import h5py

    with refusals(path), h5py.File(path, "r") as file:
        _check_version(file)
        _check_layout(file)
        return _streams_of(file, fwhm_rad)


def _check_version(file: Any) -> None:
    """Refuse another format, and versions of this one that are newer than this program."""
    if "format" not in file.attrs:
        return
    if (found := file.attrs["format"]) != _NAME_OF_FORMAT:
        raise argument_error("the attribute format", found, f"{_NAME_OF_FORMAT!r} is")
    if "format_version" not in file.attrs:
        raise InputError("lacks the attribute format_version")
    whole("the attribute format_version", file.attrs["format_version"], least=1, most=_VERSION)


def _check_layout(file: Any) -> None:
    missing = [name for name in ("data", *_PER_SAMPLE, *_PER_DETECTOR) if name not in file]
    if missing:
        raise InputError(f"lacks {', '.join(missing)}")
    names = ("data", *_PER_SAMPLE, *_PER_DETECTOR, *(name for name in (_ANGLE, _NAME) if name in file))
    shapes = {name: data_set(file, name).shape for name in (*names, *[_FLAGS] * (_FLAGS in file))}
    if len(shapes["data"]) != 2:
        raise InputError(f"data has the shape {shapes['data']}; (n_det, n_samp) is expected")
    n_det, n_samp = shapes["data"]
    expected: dict[str, tuple[int, ...]] = dict.fromkeys(_PER_SAMPLE, (n_samp,))
    expected |= dict.fromkeys(names[1 + len(_PER_SAMPLE) :], (n_det,))
    for name, shape in shapes.items():
        check_shape(name, shape, expected.get(name, (n_det, n_samp)))


def _streams_of(file: Any, fwhm_rad: float | None) -> Timestreams:
    attributes = {name: value for name, value in file.attrs.items() if name not in _OWN_ATTRIBUTES}
    x_rad, y_rad = (_radians(name, file[name][()]) for name in _PER_DETECTOR)
    ra, dec, angle = (_radians(name, file[name][()]) for name in _PER_SAMPLE[1:4])
    beam = _beam(file) if fwhm_rad is None else fwhm_rad
    plane = FocalPlane(x_rad, y_rad, beam, _polarization_angles(file), _names(file))
    data, lost = reals("data", file["data"][()], file["data"].shape, finite=False), _flags(file)
    return Timestreams(data, file["time_s"][()], ra, dec, angle, file["scan"][()], plane, attributes, lost)


def _beam(file: Any) -> float:
    if "fwhm_arcsec" not in file.attrs:
        raise InputError("lacks the attribute fwhm_arcsec")
    return float(np.radians(number("fwhm_arcsec", file.attrs["fwhm_arcsec"], above=0) / 3600))


def _polarization_angles(file: Any) -> np.ndarray | None:
    return _radians(_ANGLE, file[_ANGLE][()]) if _ANGLE in file else None


def _names(file: Any) -> np.ndarray | None:
    return np.array(file[_NAME].asstr()[()]).astype(str) if _NAME in file else None


def _flags(file: Any) -> np.ndarray | None:
    if _FLAGS not in file:
        return None
    return integers(_FLAGS, file[_FLAGS][()], file["data"].shape, least=0, most=1, keep_type=True).astype(bool)


def _text() -> Any:
    import h5py

    return h5py.string_dtype("utf-8")


def _radians(name: str, values: object) -> np.ndarray:
    values = reals(name, values, ("n",), least=-_LARGEST[name], most=_LARGEST[name]).astype(np.float64, copy=False)
    return np.radians(values / 60 if name.endswith("arcmin") else values)
