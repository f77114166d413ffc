"""HDF5 files of TOAST 3 observations, read and written without TOAST.

The layout is that of ``toast.io.save_hdf5`` (TOAST 3.0, format version 2). Quaternions are (x, y, z, w). They rotate
the z axis to the line of sight. The x axis of a detector is the direction of its polarization. In the frame of the
boresight, the negative y axis is the x axis of this project's arrays, and the negative x axis is their y axis.
"""

import json
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.errors import InputError
from mapmaker.files import atomic_write
from mapmaker.formats.border import check_shape, data_set, detector_names, group, millikelvin, refusals, unit_rotations
from mapmaker.formats.flac import read_compressed
from mapmaker.formats.rotations import about_axis, product, rotated, sky_angles
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.validation import argument_error, increasing, integers, number, reals

_VERSION = 2
_READ = (1, 2)  # versions with this layout
_SCANS, _TURNAROUND = "scanning", 4  # interval of the scans; shared flag of samples outside
_LOST = 1  # detector flag of a lost sample
# Flags that TOAST's map-makers leave out by default: invalid, processing, unstable scan rate, irregular; invalid,
# processing, solar system object.
_SHARED_MASK, _DETECTOR_MASK = 15, 7
_SCAN_NUMBERS = "scan_numbers"  # metadata of files of this project
_MK_PER_K = 1e3


def is_toast(path: Path, head: bytes) -> bool:
    """Tell a TOAST observation by an attribute of an HDF5 file."""
    import h5py

    if not head.startswith(b"\x89HDF\r\n\x1a\n"):
        return False
    try:
        with h5py.File(path, "r") as file:
            return "toast_format_version" in file.attrs
    except Exception:  # a mangled file of either format
        return False


def losses(streams: Timestreams) -> tuple[str, ...]:
    """Name what a file would not hold: nothing."""
    return ()


def write(path: str | Path, streams: Timestreams) -> None:
    """Write one observation, atomically; arguments and errors as for `mapmaker.write_timestreams`."""
    import h5py

    name = Path(path).name.removesuffix(".h5").removesuffix(".toast")
    names = detector_names(streams.focal_plane)
    with atomic_write(path) as partial, h5py.File(partial, "w") as file:
        _write_observation(file, name, names, streams.data_mk.shape[1])
        _write_instrument(file.create_group("instrument"), names, streams)
        _write_metadata(file, streams)
        _write_samples(file, streams)


def _write_observation(file: Any, name: str, names: list[str], n_samp: int) -> None:
    file.attrs["toast_version"] = "3.0"
    file.attrs["toast_format_version"] = _VERSION
    file.attrs["observation_name"], file.attrs["observation_uid"] = name, zlib.crc32(name.encode())
    file.attrs["observation_detectors"] = json.dumps(names)
    file.attrs["observation_detector_sets"] = file.attrs["observation_sample_sets"] = "NONE"
    file.attrs["observation_samples"] = n_samp
    file.attrs["observation_detector_flags"] = json.dumps(dict.fromkeys(names, 0))


def _write_instrument(instrument: Any, names: list[str], streams: Timestreams) -> None:
    from astropy import units as u
    from astropy.table import QTable

    plane, time = streams.focal_plane, streams.time_s
    interval = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    table = QTable({"name": names, "quat": np.roll(_detector_rotations(plane), -1, axis=1)})
    table["fwhm"] = np.full(len(names), np.degrees(plane.fwhm_rad) * 60) * u.arcmin
    reach = float(np.arctan(np.hypot(plane.x_rad, plane.y_rad)).max()) + plane.fwhm_rad
    table.meta |= {"sample_rate": u.Quantity(1 / interval, u.Hz), "field_of_view": u.Quantity(2 * reach, u.rad)}
    with warnings.catch_warnings(action="ignore"):
        table.write(instrument, path="focalplane", format="hdf5", serialize_meta=True)
    instrument.attrs["toast_format_version"] = _VERSION
    instrument.attrs["focalplane_class"] = "toast.instrument.Focalplane"
    for kind, of_class in (("telescope", "toast.instrument.Telescope"), ("site", "toast.instrument.SpaceSite")):
        instrument.attrs[f"{kind}_class"] = of_class
        instrument.attrs[f"{kind}_name"], instrument.attrs[f"{kind}_uid"] = "unknown", zlib.crc32(b"unknown")


def _write_metadata(file: Any, streams: Timestreams) -> None:
    other = file.create_group("metadata/other")
    file.create_group("attr")
    other.attrs["python_data_type"] = "dict"
    other[_SCAN_NUMBERS] = streams.scan[streams.scan_bounds[:, 0]]
    for name, value in streams.attributes.items():
        if np.asarray(value).dtype.kind not in "biufSU" or ":" in name:
            expected = "numbers and texts, with names without a colon, are"
            raise argument_error(f"attributes[{name!r}]", type(value).__name__, expected)
        other.attrs[name] = value


def _write_samples(file: Any, streams: Timestreams) -> None:
    time, outside = streams.time_s, streams.scan < 0
    boresight = product(
        about_axis(2, streams.ra_rad),
        about_axis(1, np.pi / 2 - streams.dec_rad),
        about_axis(2, -streams.array_angle_rad),
    )
    shared = {
        "times": time.astype(np.float64),
        "boresight_radec": np.roll(boresight, -1, axis=1),
        "flags": np.where(outside, _TURNAROUND, 0).astype(np.uint8),
    }
    for name, values in shared.items():
        file.create_dataset(f"shared/{name}", data=values).attrs["comm_type"] = "column"
    lost = np.zeros(streams.data_mk.shape, bool) if streams.flags is None else streams.flags
    detectors = {
        "signal": (streams.data_mk.astype(np.float64) / _MK_PER_K, "K"),
        "flags": (np.where(lost, _LOST, 0).astype(np.uint8), ""),
    }
    for name, (array, unit) in detectors.items():
        file.create_dataset(f"detdata/{name}", data=array).attrs["units"] = unit
    _write_scans(file, streams)


def _write_scans(file: Any, streams: Timestreams) -> None:
    """Write the intervals of the scans.

    An interval ends before the first sample at its end or later, except at the last sample, which is inside.
    """
    time, (start, stop) = streams.time_s, streams.scan_bounds.T
    ends = np.where(stop < len(time), (time[stop - 1] + time[np.minimum(stop, len(time) - 1)]) / 2, time[-1])
    intervals = file.create_group("intervals")
    intervals.attrs["times"] = "times"
    intervals[_SCANS] = np.array([time[start], ends], dtype=np.float64)


def _detector_rotations(plane: FocalPlane) -> np.ndarray:
    """Rotations (n_det, 4) from the boresight to the detectors and their polarization."""
    from_boresight = np.arctan(np.hypot(plane.x_rad, plane.y_rad))
    azimuth = np.arctan2(-plane.x_rad, -plane.y_rad)
    angle = 0.0 if plane.angle_rad is None else -plane.angle_rad
    return product(about_axis(2, azimuth), about_axis(1, from_boresight), about_axis(2, angle - azimuth))


def read(path: str | Path, fwhm_rad: float | None) -> Timestreams:
    """Read one observation; arguments and errors as for `mapmaker.read_timestreams`."""
    import h5py

    with refusals(path), h5py.File(path, "r") as file:
        return _streams_of(file, fwhm_rad)


def _streams_of(file: Any, fwhm_rad: float | None) -> Timestreams:
    version = file.attrs["toast_format_version"]
    if version not in _READ:
        raise argument_error("the attribute toast_format_version", version, f"{_READ[0]} to {_READ[-1]} is")
    names = json.loads(file.attrs["observation_detectors"])
    time = increasing("shared/times", data_set(file, "shared/times")[()], fewest=1)
    shape = (len(names), len(time))
    scan = _scans(file, time)
    lost = _flags(file, names, shape, scan >= 0)
    boresight = _boresight(file, len(time))
    plane = _focal_plane(file, names, fwhm_rad)
    data = _signal_mk(file, shape)
    return Timestreams(data, time, *boresight, scan, plane, _attributes(file), lost)


def _signal_mk(file: Any, shape: tuple[int, int]) -> np.ndarray:
    name = "detdata/signal"
    signal, unit = _detector_data(file, "signal", shape)
    scale = millikelvin(name, unit)
    data = reals(name, signal, shape, finite=False)
    data *= scale
    return data


def _detector_data(file: Any, name: str, shape: tuple[int, int]) -> tuple[np.ndarray, str]:
    """Values of all detectors and their unit."""
    detectors, whole_name = group(file, "detdata"), f"detdata/{name}"
    if name in detectors and hasattr(detectors[name], "keys"):
        item = group(detectors, name)
        return read_compressed(whole_name, item, shape), item.attrs.get("units", "")
    item = data_set(detectors, name)
    check_shape(whole_name, item.shape, shape)
    return item[()], item.attrs.get("units", "")


def _boresight(file: Any, n_samp: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    name = "shared/boresight_radec"
    rotations = np.roll(unit_rotations(name, data_set(file, name)[()], n_samp), 1, axis=1)
    return sky_angles(rotated(rotations, (0, 0, 1)), rotated(rotations, (-1, 0, 0)))


def _scans(file: Any, time: np.ndarray) -> np.ndarray:
    """Scans: the intervals "scanning"; in a file without them, all samples are one scan."""
    intervals = group(file, "intervals") if "intervals" in file else {}
    if _SCANS not in intervals:
        return np.zeros(len(time), np.int64)
    name = f"intervals/{_SCANS}"
    spans = reals(name, data_set(intervals, _SCANS)[()], (2, "n_scan"), empty=True)
    start, stop = np.searchsorted(time, spans)
    stop = np.where(spans[1] >= time[-1], len(time), stop)
    if (start[1:] < stop[:-1]).any():
        raise InputError(f"{name} has intervals that overlap or are not in order; others are expected")
    scan = np.full(len(time), -1)
    for of_span, first, end in zip(_scan_numbers(file, len(start)), start, stop, strict=True):
        scan[first:end] = of_span
    return scan


def _scan_numbers(file: Any, n_scan: int) -> np.ndarray:
    other = _metadata(file)
    if _SCAN_NUMBERS not in other:
        return np.arange(n_scan)
    numbers = data_set(other, _SCAN_NUMBERS)[()]
    return integers(f"metadata/other/{_SCAN_NUMBERS}", numbers, (n_scan,), least=0, empty=True)


def _flags(file: Any, names: list[str], shape: tuple[int, int], inside: np.ndarray) -> np.ndarray | None:
    """Lost samples: flags of whole detectors, of detectors and samples, and of samples in scans; None without any."""
    lost = np.zeros(shape, bool)
    shared = group(file, "shared")
    if "flags" in shared:
        lost |= inside & _masked("shared/flags", data_set(shared, "flags")[()], shape[1:], _SHARED_MASK)
    if "flags" in group(file, "detdata"):
        lost |= _masked("detdata/flags", _detector_data(file, "flags", shape)[0], shape, _DETECTOR_MASK)
    name, whole = "observation_detector_flags", json.loads(file.attrs.get("observation_detector_flags", "{}"))
    lost |= _masked(name, [whole.get(of_detector, 0) for of_detector in names], shape[:1], _DETECTOR_MASK)[:, None]
    return lost if lost.any() else None


def _masked(name: str, value: object, shape: tuple[int, ...], mask: int) -> np.ndarray:
    return integers(name, value, shape, keep_type=True) & mask != 0


def _focal_plane(file: Any, names: list[str], fwhm_rad: float | None) -> FocalPlane:
    from astropy.table import QTable

    instrument = group(file, "instrument")
    data_set(instrument, "focalplane")
    with warnings.catch_warnings(action="ignore"):
        table = QTable.read(instrument, path="focalplane", format="hdf5")
    lacking = [name for name in ("name", "quat", *["fwhm"] * (fwhm_rad is None)) if name not in table.colnames]
    if lacking:
        raise InputError(f"instrument/focalplane lacks the column {lacking[0]}")
    of_table = [name.decode() if isinstance(name, bytes) else str(name) for name in table["name"]]
    row = {name: number for number, name in enumerate(of_table)}
    if missing := [name for name in names if name not in row]:
        raise InputError(f"instrument/focalplane lacks the detector {missing[0]!r}")
    rows = [row[name] for name in names]
    name = "the column quat of instrument/focalplane"
    rotations = np.roll(unit_rotations(name, np.asarray(table["quat"])[rows], len(names)), 1, axis=1)
    sight = rotated(rotations, (0, 0, 1))
    if not (sight[:, 2] > 0).all():
        raise argument_error(name, "a detector a quarter of a turn from the boresight", "smaller offsets are")
    angle = -2 * np.arctan2(rotations[:, 3], rotations[:, 0])
    beam = _beam(table["fwhm"][rows]) if fwhm_rad is None else fwhm_rad
    return FocalPlane(-sight[:, 1] / sight[:, 2], -sight[:, 0] / sight[:, 2], beam, angle, np.array(names, dtype=str))


def _beam(column: Any) -> float:
    """Median beam [rad] of the detectors."""
    from astropy import units as u

    name = "the column fwhm of instrument/focalplane"
    try:
        widths = u.Quantity(column).to_value(u.rad)
    except (u.UnitConversionError, TypeError):
        raise argument_error(name, f"the unit {getattr(column, 'unit', None)}", "an angle is") from None
    return number(name, float(np.median(widths)), above=0)


def _metadata(file: Any) -> Any:
    """Group of the metadata that are no objects of TOAST; empty in a file of version 1."""
    return group(group(file, "metadata"), "other") if "other" in file.get("metadata", {}) else {}


def _attributes(file: Any) -> dict[str, Any]:
    """Numbers and texts of the metadata, without quantities."""
    attributes = dict(getattr(_metadata(file), "attrs", {}))
    attributes.pop("python_data_type", None)
    plain = {name: value for name, value in attributes.items() if np.asarray(value).dtype.kind in "biufSU"}
    return {name: value for name, value in plain.items() if ":" not in name}
