"""Time-streams of one observation and its focal plane."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mapmaker.validation import argument_error, flags, increasing, integers, number, reals, signed

# Largest absolute values: right ascensions and array angles may be unwrapped by a hundred turns; declinations and
# detector offsets are at most a quarter of a turn.
_QUARTER_RAD, _TURNS_RAD = math.pi / 2 * (1 + 1e-9), 200 * math.pi


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
        if isinstance(detectors, slice) and detectors == slice(None):
            return self
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
