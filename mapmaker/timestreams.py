"""Time-streams of one observation and its focal plane; HDF5 input and output."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.errors import ArgumentError, InputError
from mapmaker.files import atomic_write, one_line, regular_file
from mapmaker.validation import argument_error, flags, increasing, integers, number, reals, signed, single_precision

_PER_SAMPLE = ("time_s", "ra_deg", "dec_deg", "array_angle_deg", "scan")
_PER_DETECTOR = ("x_arcmin", "y_arcmin")
# Of each detector; files can lack them.
_ANGLE, _NAME = "polarization_angle_deg", "detector_name"
_FLAGS = "flags"  # of each detector and sample; files can lack them
# Largest absolute values: right ascensions and array angles may be unwrapped by a hundred turns; declinations and
# detector offsets are at most a quarter of a turn.
_QUARTER_RAD, _TURNS_RAD = math.pi / 2 * (1 + 1e-9), 200 * math.pi
_LARGEST = {"ra_deg": 36e3, "dec_deg": 90.0, "array_angle_deg": 36e3, "x_arcmin": 5400.0, "y_arcmin": 5400.0} | {
    _ANGLE: 36e3
}
# Largest compression: HDF5's filters compress zeros by a thousand.
_MOST_COMPRESSED = 2000


@dataclass(frozen=True)
class FocalPlane:
    """Detectors in the array frame.

    At the array angle a, the y axis has the position angle a, and the x axis is 90 degrees clockwise of it on the sky.

    Attributes
    ----------
    x_rad, y_rad : (n_det,)
        Offsets from the boresight, in the plane that touches the sky there.
    fwhm_rad
        Full width at half maximum of the Gaussian beam.
    angle_rad : (n_det,), optional
        Polarization angle of each detector from the array's y axis, in the sense of position angles; None where
        unknown.
    names : (n_det,) text, optional
        Name of each detector; None without names.

    Raises
    ------
    ValueError
        For offsets or angles that are not finite, of different number or none, names of another number, and a beam
        outside 0 to half a turn.
    """

    x_rad: np.ndarray
    y_rad: np.ndarray
    fwhm_rad: float
    angle_rad: np.ndarray | None = None
    names: np.ndarray | None = None

    def __post_init__(self) -> None:
        x = reals("x_rad", self.x_rad, ("n_det",))
        y = reals("y_rad", self.y_rad, x.shape)
        fwhm = number("fwhm_rad", self.fwhm_rad, above=0, below=np.pi)
        angle = None if self.angle_rad is None else reals("angle_rad", self.angle_rad, x.shape)
        names = None if self.names is None else np.asarray(self.names)
        if names is not None and (names.shape != x.shape or names.dtype.kind != "U"):
            raise argument_error("names", f"{names.dtype} of the shape {names.shape}", f"{len(x)} texts are")
        _set(self, x_rad=x, y_rad=y, fwhm_rad=fwhm, angle_rad=angle, names=names)

    def subset(self, detectors: np.ndarray | slice) -> "FocalPlane":
        """Focal plane of some detectors, given by index, by a flag each, or by a slice.

        Raises
        ------
        ValueError
            For none, and for an index or flags that do not match the detectors.
        """
        rows = detector_rows(detectors, len(self.x_rad))
        angle, names = (None if item is None else item[rows] for item in (self.angle_rad, self.names))
        return FocalPlane(self.x_rad[rows], self.y_rad[rows], self.fwhm_rad, angle, names)


def detector_rows(detectors: np.ndarray | slice, n_det: int) -> np.ndarray | slice:
    """Rows of some of `n_det` detectors; raises as `FocalPlane.subset`."""
    if isinstance(detectors, slice):
        return detectors
    if np.asarray(detectors).dtype == bool:
        return flags("detectors", detectors, (n_det,))
    return integers("detectors", detectors, ("n",), least=-n_det, most=n_det - 1)


def _set(record: object, **values: object) -> None:
    """Set fields of a frozen record during its construction."""
    for name, value in values.items():
        object.__setattr__(record, name, value)


@dataclass(frozen=True)
class Timestreams:
    """Time-streams of one observation.

    Attributes
    ----------
    data_mk : (n_det, n_samp)
        [mK Rayleigh-Jeans], float32 or float64; other real types become float64. NaN is allowed.
    time_s : (n_samp,)
        Increasing.
    ra_rad, dec_rad : (n_samp,)
        Boresight.
    array_angle_rad : (n_samp,)
        Position angle of the array's y axis at the boresight, from north through east.
    scan : (n_samp,)
        Number of the scan, -1 outside scans; the samples of one scan are contiguous.
    focal_plane
    attributes
        Units, seed and true values of a simulation.
    flags : (n_det, n_samp) bool, optional
        True for lost samples, which maps leave out (`fill_flagged`, `pixel_indices`); None without any.

    Raises
    ------
    ValueError
        For shapes or types that do not match, pointing that is not finite or no direction, times that do not increase,
        and scans as `scan_bounds`.
    """

    data_mk: np.ndarray
    time_s: np.ndarray
    ra_rad: np.ndarray
    dec_rad: np.ndarray
    array_angle_rad: np.ndarray
    scan: np.ndarray
    focal_plane: FocalPlane
    attributes: Mapping[str, float | int | str] = field(default_factory=dict)
    flags: np.ndarray | None = None

    def __post_init__(self) -> None:
        n_det = len(self.focal_plane.x_rad)
        data = reals("data_mk", self.data_mk, (n_det, "n_samp"), finite=False)
        samples = (data.shape[1],)
        time = reals("time_s", self.time_s, samples)
        increasing("time_s", time, fewest=1)
        sizes = {"ra_rad": _TURNS_RAD, "dec_rad": _QUARTER_RAD, "array_angle_rad": _TURNS_RAD}
        angles = {name: reals(name, getattr(self, name), samples, least=-m, most=m) for name, m in sizes.items()}
        scan = integers("scan", self.scan, samples)
        lost = None if self.flags is None else flags("flags", self.flags, data.shape)
        _ = self.scan_bounds  # of the scans as they came
        _set(self, data_mk=data, time_s=time, scan=scan, flags=lost, **angles)

    @cached_property
    def scan_bounds(self) -> np.ndarray:
        """First and one-past-last sample of each scan, (n_scan, 2)."""
        return scan_bounds(self.scan)

    def subset(self, detectors: np.ndarray | slice) -> "Timestreams":
        """Streams of some detectors; argument and errors as for `FocalPlane.subset`."""
        plane, rows = self.focal_plane.subset(detectors), detector_rows(detectors, len(self.data_mk))
        lost = None if self.flags is None else self.flags[rows]
        return replace(self, data_mk=self.data_mk[rows], focal_plane=plane, flags=lost)


def scan_bounds(scan: np.ndarray) -> np.ndarray:
    """First and one-past-last sample of each scan.

    Parameters
    ----------
    scan : (n_samp,)
        Scan numbers, negative outside scans.

    Returns
    -------
    (n_scan, 2) array
        int64.

    Raises
    ------
    ValueError
        For numbers that are not integers, a scan whose samples are not contiguous, and the largest number of an
        unsigned type, which stands for a stored -1.
    """
    scan = signed("scan", scan, integers("scan", scan, ("n_samp",)))
    edges = np.flatnonzero(scan[1:] != scan[:-1]) + 1
    start = np.concatenate([[0], edges]).astype(np.int64)
    stop = np.concatenate([edges, [len(scan)]]).astype(np.int64)
    inside = scan[start] >= 0
    of_pieces = scan[start[inside]]
    if (of_pieces[1:] <= of_pieces[:-1]).any():
        numbers, counts = np.unique(of_pieces, return_counts=True)
        if (counts > 1).any():
            raise argument_error(
                "scan", f"scan {numbers[counts > 1][0]} in {counts.max()} pieces", "contiguous samples of a scan are"
            )
    return np.column_stack([start[inside], stop[inside]])


def write_timestreams(path: str | Path, streams: Timestreams) -> None:
    """Write one observation to HDF5, atomically.

    Raises
    ------
    ValueError
        For attributes other than numbers and texts, and data beyond single precision.
    """
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
        Where the parts do not have `n_samp` samples in all or have different detectors, and as `write_timestreams`.
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
    file.attrs["fwhm_arcsec"] = np.degrees(part.focal_plane.fwhm_rad) * 3600
    for name, value in part.attributes.items():
        if name == "fwhm_arcsec":
            raise argument_error("attributes", name, "the beam in focal_plane.fwhm_rad, and other names here, are")
        if np.asarray(value).dtype.kind not in "biufSU":
            raise argument_error(f"attributes[{name!r}]", type(value).__name__, "numbers and texts are")
        file.attrs[name] = value


def _sample_columns(streams: Timestreams) -> dict[str, np.ndarray]:
    """`_PER_SAMPLE` in the units of a file."""
    angles = (np.degrees(angle) for angle in (streams.ra_rad, streams.dec_rad, streams.array_angle_rad))
    return dict(zip(_PER_SAMPLE, (streams.time_s, *angles, streams.scan), strict=True))


def read_timestreams(path: str | Path) -> Timestreams:
    """Read one observation from HDF5; integers and big-endian numbers are converted.

    Data sets stored in other files are not read.

    Raises
    ------
    InputError
        In one line that names the file: for one that is unreadable, truncated, no regular file or lacks a data set, and
        for shapes, types or values that `Timestreams` refuses.
    """
    import h5py

    regular_file(path, "time-stream file")
    try:
        with h5py.File(path, "r") as file:
            return _streams_of(file)
    except _Unfit as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:  # h5py raises nearly every kind of exception for a mangled file
        raise InputError(f"{path}: not a whole time-stream file ({one_line(error)})") from None


class _Unfit(InputError):
    """Readable file without the expected content."""


def _streams_of(file: Any) -> Timestreams:
    _check_layout(file)
    attributes = dict(file.attrs)
    try:
        fwhm_rad = np.radians(number("fwhm_arcsec", attributes.pop("fwhm_arcsec"), above=0) / 3600)
        x_rad, y_rad = (_radians(name, file[name][()]) for name in _PER_DETECTOR)
        ra, dec, angle = (_radians(name, file[name][()]) for name in _PER_SAMPLE[1:4])
        plane = FocalPlane(x_rad, y_rad, fwhm_rad, _polarization_angles(file), _names(file))
        data, lost = reals("data", file["data"][()], file["data"].shape, finite=False), _flags(file)
        return Timestreams(data, file["time_s"][()], ra, dec, angle, file["scan"][()], plane, attributes, lost)
    except (ArgumentError, InputError) as error:
        raise _Unfit(one_line(error)) from None


def _polarization_angles(file: Any) -> np.ndarray | None:
    return _radians(_ANGLE, file[_ANGLE][()]) if _ANGLE in file else None


def _names(file: Any) -> np.ndarray | None:
    return np.array(file[_NAME].asstr()[()]).astype(str) if _NAME in file else None


def _flags(file: Any) -> np.ndarray | None:
    if _FLAGS not in file:
        return None
    return integers(_FLAGS, file[_FLAGS][()], file["data"].shape, least=0, most=1).astype(bool)


def _text() -> Any:
    import h5py

    return h5py.string_dtype("utf-8")


def _radians(name: str, values: object) -> np.ndarray:
    values = reals(name, values, ("n",), least=-_LARGEST[name], most=_LARGEST[name]).astype(np.float64, copy=False)
    return np.radians(values / 60 if name.endswith("arcmin") else values)


def _check_layout(file: Any) -> None:
    import h5py

    missing = [name for name in ("data", *_PER_SAMPLE, *_PER_DETECTOR) if name not in file]
    if missing or "fwhm_arcsec" not in file.attrs:
        raise _Unfit(f"lacks {', '.join(missing or ['the attribute fwhm_arcsec'])}")
    names = ("data", *_PER_SAMPLE, *_PER_DETECTOR, *(name for name in (_ANGLE, _NAME) if name in file))
    for name in (*names, *[_FLAGS] * (_FLAGS in file)):
        if isinstance(file.get(name, getlink=True), h5py.ExternalLink):
            raise _Unfit(f"{name} is a link to another file; a data set is expected")
        item = file.get(name)
        if not isinstance(item, h5py.Dataset):
            kind = "link to nothing" if item is None else type(item).__name__.lower()
            raise _Unfit(f"{name} is a {kind}; a data set is expected")
        if item.is_virtual or item.external:
            raise _Unfit(f"{name} is stored in another file; a data set with its values is expected")
        if item.shape is None or item.nbytes > _MOST_COMPRESSED * item.id.get_storage_size():
            raise _Unfit(
                f"{name} has {item.id.get_storage_size()} bytes of values of the shape {item.shape}; all are expected"
            )
        if item.dtype.kind == "b" or h5py.check_enum_dtype(item.dtype):
            raise _Unfit(f"{name} has names for its values; numbers are expected")
    if file["data"].ndim != 2:
        raise _Unfit(f"data has the shape {file['data'].shape}; (n_det, n_samp) is expected")
    n_det, n_samp = file["data"].shape
    wanted: dict[str, tuple[int, ...]] = dict.fromkeys(_PER_SAMPLE, (n_samp,))
    wanted |= dict.fromkeys(names[1 + len(_PER_SAMPLE) :], (n_det,))
    wanted |= {_FLAGS: (n_det, n_samp)} if _FLAGS in file else {}
    for name, shape in wanted.items():
        if file[name].shape != shape:
            raise _Unfit(f"{name} has the shape {file[name].shape}; {shape} is expected")
