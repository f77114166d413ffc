"""Time-streams of one observation and the focal plane that recorded them; HDF5 in and out."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mapmaker.files import whole_file

_PER_SAMPLE = ("time_s", "ra_deg", "dec_deg", "array_angle_deg", "scan")
_PER_DETECTOR = ("x_arcmin", "y_arcmin")


@dataclass(frozen=True)
class FocalPlane:
    """Detectors in the array frame.

    `x_rad`, `y_rad` (n_det,): offsets from the boresight; at array angle a the y axis lies at position
    angle a and the x axis 90 degrees clockwise of it as seen on the sky. `fwhm_rad`: Gaussian beam.
    """

    x_rad: np.ndarray
    y_rad: np.ndarray
    fwhm_rad: float

    def subset(self, detectors: np.ndarray) -> "FocalPlane":
        """The focal plane of some detectors, given by index."""
        return FocalPlane(self.x_rad[detectors], self.y_rad[detectors], self.fwhm_rad)


@dataclass(frozen=True)
class Timestreams:
    """Time-streams of one observation.

    `data_mk` (n_det, n_samp) mK Rayleigh-Jeans, float32 or float64; `time_s`, `ra_rad`, `dec_rad`
    (boresight), `array_angle_rad` (position angle of the array's y axis at the boresight, from north through
    east) and `scan` (n_samp,), `scan` -1 outside scans and the samples of one scan contiguous;
    `attributes` hold units, seed and truth.
    """

    data_mk: np.ndarray
    time_s: np.ndarray
    ra_rad: np.ndarray
    dec_rad: np.ndarray
    array_angle_rad: np.ndarray
    scan: np.ndarray
    focal_plane: FocalPlane
    attributes: Mapping[str, float | int | str] = field(default_factory=dict)

    @property
    def scan_bounds(self) -> np.ndarray:
        """First and one-past-last sample of each scan, (n_scan, 2)."""
        return scan_bounds(self.scan)


def scan_bounds(scan: np.ndarray) -> np.ndarray:
    """First and one-past-last sample of each run of equal, non-negative scan numbers, (n_scan, 2) int64."""
    scan = np.asarray(scan)
    edges = np.flatnonzero(np.diff(scan)) + 1
    start = np.concatenate([[0], edges]).astype(np.int64)
    stop = np.concatenate([edges, [len(scan)]]).astype(np.int64)
    inside = scan[start] >= 0
    return np.column_stack([start[inside], stop[inside]])


def write_timestreams(path: str | Path, streams: Timestreams) -> None:
    """Write one observation to HDF5, atomically (a partial file never has the final name)."""
    with timestream_file(path, streams.data_mk.shape[1]) as add:
        add(streams)


@contextmanager
def timestream_file(path: str | Path, n_samp: int) -> Iterator[Callable[[Timestreams], None]]:
    """An HDF5 file of one observation of `n_samp` samples, which it is given in parts, in order of time.

    It has its name, as from `write_timestreams`, once it is whole: raises ValueError where the parts have another
    number of samples in all.
    """
    import h5py

    with whole_file(path) as partial, h5py.File(partial, "w") as file:
        done = 0

        def add(part: Timestreams) -> None:
            nonlocal done
            if not done:
                _begin(file, part, n_samp)
            until = done + part.data_mk.shape[1]
            file["data"][:, done:until] = part.data_mk.astype(np.float32, copy=False)
            for name, values in _sample_columns(part).items():
                file[name][done:until] = values
            done = until

        yield add
        if done != n_samp:
            raise ValueError(f"{path}: found {done} samples; {n_samp} are expected")


def _begin(file, part: Timestreams, n_samp: int) -> None:
    """Write what does not depend on time, and make room for the rest."""
    data = file.create_dataset("data", (len(part.data_mk), n_samp), np.float32)
    data.attrs["unit"] = "mK (Rayleigh-Jeans)"
    for name, values in _sample_columns(part).items():
        file.create_dataset(name, (n_samp,), values.dtype)
    file["x_arcmin"] = np.degrees(part.focal_plane.x_rad) * 60
    file["y_arcmin"] = np.degrees(part.focal_plane.y_rad) * 60
    file.attrs["fwhm_arcsec"] = np.degrees(part.focal_plane.fwhm_rad) * 3600
    file.attrs.update(dict(part.attributes))


def _sample_columns(streams: Timestreams) -> dict[str, np.ndarray]:
    """`_PER_SAMPLE` as a file has them."""
    angles = (np.degrees(angle) for angle in (streams.ra_rad, streams.dec_rad, streams.array_angle_rad))
    return dict(zip(_PER_SAMPLE, (streams.time_s, *angles, streams.scan), strict=True))


def read_timestreams(path: str | Path) -> Timestreams:
    """Read one observation from HDF5.

    Raises ValueError for a file that is unreadable or truncated, lacks a data set, or whose shapes disagree.
    """
    import h5py

    try:
        with h5py.File(path, "r") as file:
            _check_layout(path, file)
            angle = {name: np.radians(file[name][()]) for name in ("ra_deg", "dec_deg", "array_angle_deg")}
            x, y = (np.radians(file[name][()] / 60) for name in _PER_DETECTOR)
            attributes = dict(file.attrs)
            fwhm = np.radians(float(attributes.pop("fwhm_arcsec")) / 3600)
            data, time_s, scan = file["data"][()], file["time_s"][()], file["scan"][()]
    except (OSError, KeyError) as error:
        raise ValueError(f"{path}: not a whole time-stream file ({error})") from None
    return Timestreams(
        data,
        time_s,
        angle["ra_deg"],
        angle["dec_deg"],
        angle["array_angle_deg"],
        scan,
        FocalPlane(x, y, fwhm),
        attributes,
    )


def _check_layout(path: str | Path, file) -> None:
    missing = [name for name in ("data", *_PER_SAMPLE, *_PER_DETECTOR) if name not in file]
    if missing or "fwhm_arcsec" not in file.attrs:
        raise ValueError(f"{path}: lacks {', '.join(missing or ['the attribute fwhm_arcsec'])}")
    if file["data"].ndim != 2:
        raise ValueError(f"{path}: data has the shape {file['data'].shape}; (n_det, n_samp) is expected")
    n_det, n_samp = file["data"].shape
    wanted = {name: (n_samp,) for name in _PER_SAMPLE} | {name: (n_det,) for name in _PER_DETECTOR}
    for name, shape in wanted.items():
        if file[name].shape != shape:
            raise ValueError(f"{path}: {name} has the shape {file[name].shape}; {shape} is expected")
