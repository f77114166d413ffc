"""G3 frames of spt3g and so3g: an Observation, a Calibration, and a Scan frame for each scan and turnaround.

Units are those of ``G3Units``. In spt3g's maps the rotation of a sample takes the x axis to the boresight;
before it, the z axis points down and the y axis to the right in the array.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.errors import InputError
from mapmaker.files import atomic_write
from mapmaker.formats.border import check_shape, detector_names, refusals, unit_rotations
from mapmaker.formats.horizon import Site, equatorial
from mapmaker.formats.rotations import about_axis, product, rotated, sky_angles
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.validation import argument_error, integers, number, reals, whole

_DATA, _TIMES, _ROTATION = "CalTimestreams", "DetectorSampleTimes", "OnlineRaDecRotation"
_RA, _DEC, _AZ, _EL = "BoresightRa", "BoresightDec", "BoresightAz", "BoresightEl"
_TURNAROUND, _SCAN, _FLAGS, _SAMPLE_FLAGS = "Turnaround", "ScanNumber", "Flags", "SampleFlags"
_DETECTORS, _ORDER, _BEAM = "BolometerProperties", "DetectorNames", "BeamFWHM"
_SITE = ("site_lon_deg", "site_lat_deg", "site_alt_m")  # of the Observation frame, as TOAST writes them
_TICKS = 1e8  # of G3Time in a second
_SCALARS = (bool, int, float, str)
_TEMPERATURES = ("Trj", "Tcmb")


def is_g3(path: Path, head: bytes) -> bool:
    """Tell a G3 file by its first bytes: order of bytes, version and type of a frame."""
    frame_version, frame_type = head[:5], head[9:13]
    return frame_version == b"\x01\x01\0\0\0" and frame_type[:1].isalpha() and frame_type[1:] == b"\0\0\0"


def losses(streams: Timestreams) -> tuple[str, ...]:
    """Name what a file would not hold."""
    arrays = any(np.ndim(value) > 0 for value in streams.attributes.values())
    return ("attributes that are arrays",) if arrays else ()


def _library(path: str | Path) -> tuple[Any, Any]:
    """Modules ``core`` and ``calibration`` of spt3g, or of its copy in so3g; one process can load only one of them."""
    try:
        from spt3g import calibration, core
    except ImportError:
        try:
            import so3g  # noqa: F401, which makes its copy importable
            from spt3g import calibration, core
        except ImportError:
            raise InputError(f"{path}: G3 frames need spt3g: pip install 'mmcam-surveysim[g3]'") from None
    return core, calibration


def write(path: str | Path, streams: Timestreams) -> None:
    """Write one observation, atomically; arguments and errors as for `mapmaker.write_timestreams`."""
    core, calibration = _library(path)
    if not hasattr(core.G3TimestreamUnits, "Trj"):
        raise InputError(f"{path}: this spt3g, as that in so3g, has no unit Trj; spt3g 1.0 or later is expected")
    names = detector_names(streams.focal_plane)
    if Path(path).suffix != ".g3":
        raise InputError(f"{path}: found no suffix .g3, which spt3g expects of its files")
    with atomic_write(path) as partial, _named(partial) as file, _silent(core):
        writer = core.G3Writer(str(file))
        writer(_observation_frame(core, streams))
        writer(_calibration_frame(core, calibration, names, streams.focal_plane))
        for start, stop in _pieces(streams.scan):
            writer(_scan_frame(core, names, streams, slice(start, stop)))
        writer(core.G3Frame(core.G3FrameType.EndProcessing))


@contextmanager
def _named(partial: Path) -> Iterator[Path]:
    """Context manager for a path with the suffix of spt3g, which becomes `partial`."""
    named = partial.with_suffix(".g3")
    try:
        yield named
        named.replace(partial)
    finally:
        named.unlink(missing_ok=True)


@contextmanager
def _silent(core: Any) -> Iterator[None]:
    """Context manager without spt3g's messages, which accompany its exceptions."""
    logger = core.G3Logger.global_logger
    core.G3Logger.global_logger = core.G3MultiLogger(core.G3LoggerVector([]))
    try:
        yield
    finally:
        core.G3Logger.global_logger = logger


def _pieces(scan: np.ndarray) -> Iterator[tuple[int, int]]:
    """Bounds of each scan and turnaround."""
    edges = np.flatnonzero(np.diff(np.maximum(scan, -1))) + 1
    return zip([0, *edges.tolist()], [*edges.tolist(), len(scan)], strict=True)


def _observation_frame(core: Any, streams: Timestreams) -> Any:
    frame = core.G3Frame(core.G3FrameType.Observation)
    for name, value in streams.attributes.items():
        plain = np.asarray(value)
        if plain.dtype.kind not in "biufSU":
            raise argument_error(f"attributes[{name!r}]", type(value).__name__, "numbers and texts are")
        if not plain.ndim:
            frame[name] = plain.astype(str).item() if plain.dtype.kind == "S" else plain.item()
    return frame


def _calibration_frame(core: Any, calibration: Any, names: list[str], plane: FocalPlane) -> Any:
    frame, detectors = core.G3Frame(core.G3FrameType.Calibration), calibration.BolometerPropertiesMap()
    x, y = np.arctan(plane.x_rad), np.arctan2(plane.y_rad, np.hypot(1, plane.x_rad))
    for row, name in enumerate(names):
        item = calibration.BolometerProperties()
        item.physical_name = name
        item.x_offset, item.y_offset = x[row] * core.G3Units.rad, y[row] * core.G3Units.rad
        if plane.angle_rad is not None:
            item.pol_angle, item.pol_efficiency = plane.angle_rad[row] * core.G3Units.rad, 1.0
        detectors[name] = item
    frame[_DETECTORS], frame[_ORDER] = detectors, core.G3VectorString(names)
    frame[_BEAM] = core.G3Double(plane.fwhm_rad * core.G3Units.rad)
    return frame


def _scan_frame(core: Any, names: list[str], streams: Timestreams, part: slice) -> Any:
    frame, number = core.G3Frame(core.G3FrameType.Scan), int(streams.scan[part.start])
    ticks = np.rint(streams.time_s[part].astype(np.float64) * _TICKS).astype(np.int64)
    times = [core.G3Time(tick) for tick in ticks.tolist()]
    frame[_TIMES] = core.G3VectorTime(times)

    def stream(values: np.ndarray, units: Any) -> Any:
        item = core.G3Timestream(np.ascontiguousarray(values, dtype=np.float64), units)
        item.start, item.stop = times[0], times[-1]
        return item

    data = core.G3TimestreamMap()
    for name, values in zip(names, streams.data_mk[:, part], strict=True):
        data[name] = stream(values * core.G3Units.mK, core.G3TimestreamUnits.Trj)
    frame[_DATA] = data
    ra, dec, angle = (item[part] for item in (streams.ra_rad, streams.dec_rad, streams.array_angle_rad))
    frame[_RA], frame[_DEC] = (stream(item * core.G3Units.rad, core.G3TimestreamUnits.Angle) for item in (ra, dec))
    frame[_ROTATION] = core.G3VectorQuat(product(about_axis(2, ra), about_axis(1, -dec), about_axis(0, np.pi - angle)))
    frame[_TURNAROUND] = number < 0
    if number >= 0:
        frame[_SCAN] = number
    if streams.flags is not None:
        lost = core.G3MapVectorInt()
        for name, flags in zip(names, streams.flags[:, part], strict=True):
            if flags.any():
                lost[name] = _edges(flags)
        frame[_SAMPLE_FLAGS] = lost
    return frame


def _edges(flags: np.ndarray) -> list[int]:
    """First and one-past-last sample of each stretch of flags, in one list."""
    return np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0)).tolist()


@dataclass(frozen=True)
class _Calibration:
    """Detectors by name."""

    offsets_rad: dict[str, tuple[float, float]]
    angle_rad: dict[str, float]
    order: list[str]
    beam_rad: float | None


@dataclass(frozen=True)
class _Scan:
    """Content of a Scan frame; pointing is a rotation, or azimuth and elevation."""

    time_s: np.ndarray
    data_mk: dict[str, np.ndarray]
    lost: dict[str, np.ndarray]
    number: int | None
    is_turnaround: bool
    rotation: np.ndarray | None
    horizon: np.ndarray | None


def read(path: str | Path, fwhm_rad: float | None) -> Timestreams:
    """Read one observation; arguments and errors as for `mapmaker.read_timestreams`."""
    core, _ = _library(path)
    with refusals(path), _silent(core):
        attributes: dict[str, Any] = {}
        calibrations, scans = [], []
        for frame in core.G3File(str(path)):
            if frame.type == core.G3FrameType.Observation:
                attributes |= {key: frame[key] for key in frame if isinstance(frame[key], _SCALARS)}
            elif frame.type == core.G3FrameType.Calibration and _DETECTORS in frame:
                calibrations.append(_calibration(core, frame))
            elif frame.type == core.G3FrameType.Scan:
                scans.append(_scan(core, frame))
        if len(calibrations) != 1 or not scans:
            found = f"{len(calibrations)} frames with {_DETECTORS} and {len(scans)} Scan frames"
            raise InputError(f"found {found}; one and at least one are expected")
        return _streams_of(attributes, calibrations[0], scans, fwhm_rad)


def _calibration(core: Any, frame: Any) -> _Calibration:
    properties, rad = frame[_DETECTORS], core.G3Units.rad
    offsets = {name: (item.x_offset / rad, item.y_offset / rad) for name, item in properties.items()}
    angle = {name: item.pol_angle / rad for name, item in properties.items() if item.pol_efficiency > 0}
    order = list(frame[_ORDER]) if _ORDER in frame else sorted(offsets)
    return _Calibration(offsets, angle, order, frame[_BEAM] / rad if _BEAM in frame else None)


def _scan(core: Any, frame: Any) -> _Scan:
    needed = (_DATA, *[_ROTATION] * (_AZ not in frame or _EL not in frame))
    if lacking := [name for name in needed if name not in frame]:
        raise InputError(f"a Scan frame lacks {lacking[0]}")
    data = frame[_DATA]
    if str(data.units) not in _TEMPERATURES:
        raise argument_error(f"the unit of {_DATA}", str(data.units), f"{' or '.join(_TEMPERATURES)} is")
    times = frame.get(_TIMES, data.times)
    time = np.array([each.time for each in times], dtype=np.int64) / core.G3Units.s
    streams = {name: np.array(values, dtype=np.float64) / core.G3Units.mK for name, values in data.items()}
    for name, values in streams.items():
        check_shape(f"{_DATA}[{name!r}]", values.shape, time.shape)
    lost = {name: np.ones(len(time), bool) for name in (frame[_FLAGS].keys() if _FLAGS in frame else ())}
    for name, edges in frame[_SAMPLE_FLAGS].items() if _SAMPLE_FLAGS in frame else ():
        lost[name] = lost.get(name, False) | _flags(list(edges), len(time))
    rotation = horizon = None
    if _ROTATION in frame:
        rotation = np.asarray(frame[_ROTATION], dtype=np.float64)
    else:
        horizon = np.array([np.asarray(frame[key]) for key in (_AZ, _EL)]) / core.G3Units.rad
    number = whole(_SCAN, frame[_SCAN], least=0, most=2**63 - 1) if _SCAN in frame else None
    return _Scan(time, streams, lost, number, bool(frame.get(_TURNAROUND, False)), rotation, horizon)


def _flags(edges: list[int], n_samp: int) -> np.ndarray:
    """Flags of stretches, given by first and one-past-last samples."""
    bounds = integers(_SAMPLE_FLAGS, edges, ("n_edge",), least=0, most=n_samp, empty=True)
    if len(bounds) % 2 or (np.diff(bounds) <= 0).any():
        raise argument_error(_SAMPLE_FLAGS, edges, "pairs of increasing samples are")
    changes = np.zeros(n_samp + 1, np.int64)
    changes[bounds] = 1
    return np.cumsum(changes[:-1]) % 2 == 1


def _streams_of(
    attributes: dict[str, Any], calibration: _Calibration, scans: list[_Scan], fwhm_rad: float | None
) -> Timestreams:
    for scan in scans:
        if wrong := sorted(scan.data_mk.keys() ^ set(calibration.order)):
            raise InputError(f"{wrong[0]!r} is in {_DATA} or in {_DETECTORS} only; both are expected")
    shape = (len(calibration.order), sum(len(scan.time_s) for scan in scans))
    data, lost = np.empty(shape), np.zeros(shape, bool)
    number, done, counted = np.full(shape[1], -1), 0, 0
    for scan in scans:
        part = slice(done, done + len(scan.time_s))
        for row, name in enumerate(calibration.order):
            data[row, part], lost[row, part] = scan.data_mk[name], scan.lost.get(name, False)
        if not scan.is_turnaround:
            number[part], counted = counted if scan.number is None else scan.number, counted + 1
        done = part.stop
    time = np.concatenate([scan.time_s for scan in scans])
    boresight = _boresight(scans, time, attributes)
    plane = _focal_plane(calibration, fwhm_rad)
    kept = {name: value for name, value in attributes.items() if name not in _SITE}
    return Timestreams(data, time, *boresight, number, plane, kept, lost if lost.any() else None)


def _boresight(
    scans: list[_Scan], time_s: np.ndarray, attributes: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if all(scan.rotation is not None for scan in scans):
        rotation = unit_rotations(_ROTATION, np.concatenate([scan.rotation for scan in scans]), len(time_s))
        return sky_angles(rotated(rotation, (1, 0, 0)), rotated(rotation, (0, 0, -1)))
    if lacking := [key for key in _SITE if key not in attributes]:
        raise InputError(f"lacks {_ROTATION} in Scan frames, or {lacking[0]} in the Observation frame")
    if any(scan.horizon is None for scan in scans):
        raise InputError(f"found {_ROTATION} in some Scan frames; all are expected")
    az, el = np.concatenate([scan.horizon for scan in scans], axis=1)
    site = Site(*(number(key, attributes[key]) for key in _SITE))
    reals(_AZ, az, time_s.shape, least=-200 * np.pi, most=200 * np.pi)
    reals(_EL, el, time_s.shape, least=0, most=np.pi / 2)
    return equatorial(az, el, time_s, site)


def _focal_plane(calibration: _Calibration, fwhm_rad: float | None) -> FocalPlane:
    names = calibration.order
    x, y = np.transpose([calibration.offsets_rad[name] for name in names])
    reals("x_offset", x, ("n_det",), above=-np.pi / 2, most=np.pi / 2)
    reals("y_offset", y, ("n_det",), above=-np.pi / 2, most=np.pi / 2)
    beam = calibration.beam_rad if fwhm_rad is None else fwhm_rad
    if beam is None:
        raise InputError(f"lacks {_BEAM}; give the beam")
    known = all(name in calibration.angle_rad for name in names)
    angle = np.array([calibration.angle_rad[name] for name in names]) if known else None
    return FocalPlane(np.tan(x), np.tan(y) / np.cos(x), beam, angle, np.array(names))
