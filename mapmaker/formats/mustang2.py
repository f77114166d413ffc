"""FITS tables of MUSTANG-2: one row for each sample of each detector, as minkasi reads them.

The files have the line of sight of each detector and sample, and neither boresight nor array angle. The reader takes
the mean direction of the detectors for the boresight, and counts the array angle from the first sample.
"""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.errors import InputError
from mapmaker.files import atomic_write
from mapmaker.formats.border import millikelvin, refusals
from mapmaker.formats.rotations import directions, sky_axes
from mapmaker.geometry import sky_offsets
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.validation import integers, number, reals

_COLUMNS = ("DX", "DY", "TIME", "FNU", "UFNU", "PIXID")  # SCAN can lack
_LOST_ABOVE, _LOST = 9e5, 1e6  # UFNU of lost samples, as minkasi cuts them and as it is written
_MK_PER_K = 1e3
# Detectors must keep their places in the array within this fraction of the beam, in the root mean square.
_LARGEST_SHIFT = 0.1
_OTHER_NAMES = {"radians": "rad", "radian": "rad", "degrees": "deg", "seconds": "s", "sec": "s"}


def is_fits(path: Path, head: bytes) -> bool:
    """Tell a FITS file by its first bytes."""
    return head.startswith(b"SIMPLE  =")


def losses(streams: Timestreams) -> tuple[str, ...]:
    """Name what a file would not hold."""
    plane = streams.focal_plane
    lost = {
        "the boresight and the zero point of the array angle": True,
        "names of detectors": plane.names is not None and not _are_numbers(plane.names),
        "polarization angles": plane.angle_rad is not None,
        "attributes": len(streams.attributes) > 0,
    }
    return tuple(name for name, is_lost in lost.items() if is_lost)


def write(path: str | Path, streams: Timestreams) -> None:
    """Write one observation, atomically; arguments and errors as for `mapmaker.write_timestreams`."""
    from astropy.io import fits

    plane, shape = streams.focal_plane, streams.data_mk.shape
    numbers = plane.names.astype(np.int64) if _are_numbers(plane.names) else np.arange(shape[0])
    lost = np.zeros(shape, bool) if streams.flags is None else streams.flags
    ra, dec = _lines_of_sight(streams)
    columns = [
        fits.Column("PIXID", "J", array=np.repeat(numbers, shape[1])),
        fits.Column("DX", "D", unit="rad", array=ra.ravel()),
        fits.Column("DY", "D", unit="rad", array=dec.ravel()),
        fits.Column("TIME", "D", unit="s", array=np.tile(streams.time_s, shape[0])),
        fits.Column("SCAN", "K", array=np.tile(streams.scan, shape[0])),
        fits.Column("FNU", "D", unit="K", array=streams.data_mk.ravel().astype(np.float64) / _MK_PER_K),
        fits.Column("UFNU", "D", unit="K", array=np.where(lost, _LOST, 1.0).ravel()),
    ]
    table = fits.BinTableHDU.from_columns(columns)
    table.header["BUNIT"] = ("K", "Rayleigh-Jeans")
    table.header["BMAJ"] = table.header["BMIN"] = (np.degrees(plane.fwhm_rad), "[deg] FWHM of the beam")
    table.header["RADESYS"] = "ICRS"
    with atomic_write(path) as partial:
        fits.HDUList([fits.PrimaryHDU(), table]).writeto(partial, output_verify="exception")


def _are_numbers(names: np.ndarray | None) -> bool:
    """Tell whether names are distinct numbers, which the column PIXID can hold."""
    if names is None:
        return False
    texts = names.tolist()
    plain = all(text.isascii() and text.isdecimal() and text == str(int(text)) and len(text) < 10 for text in texts)
    return plain and len(set(texts)) == len(texts)


def _lines_of_sight(streams: Timestreams) -> tuple[np.ndarray, np.ndarray]:
    """Right ascension and declination [rad] of each detector and sample, (n_det, n_samp)."""
    result = np.empty((2, *streams.data_mk.shape))
    sight, east, north = sky_axes(streams.ra_rad, streams.dec_rad)
    for detector in range(len(streams.data_mk)):
        plane = streams.focal_plane.subset(slice(detector, detector + 1))
        to_east, to_north = sky_offsets(plane, streams.array_angle_rad)
        result[:, detector] = directions(sight + to_east * east + to_north * north)
    return result[0], result[1]


def read(path: str | Path, fwhm_rad: float | None) -> Timestreams:
    """Read one observation; arguments and errors as for `mapmaker.read_timestreams`."""
    from astropy.io import fits

    with refusals(path), warnings.catch_warnings(action="ignore"), fits.open(path) as file:
        return _streams_of(_table(file), fwhm_rad)


def _table(file: Any) -> Any:
    """First table with a column of the format."""
    for hdu in file[1:]:
        if hdu.header.get("XTENSION") == "BINTABLE" and "PIXID" in hdu.columns.names:
            if missing := [name for name in _COLUMNS if name not in hdu.columns.names]:
                raise InputError(f"lacks the column {', '.join(missing)}")
            return hdu
    raise InputError("has no table with the column PIXID")


def _streams_of(table: Any, fwhm_rad: float | None) -> Timestreams:
    pixel = integers("PIXID", table.data["PIXID"], ("n_row",))
    order, numbers = _by_detector(pixel)
    shape = (len(numbers), len(pixel) // len(numbers))

    def column(name: str, unit: str, *, finite: bool = True) -> np.ndarray:
        values = reals(name, table.data[name], pixel.shape, finite=finite)[order].reshape(shape)
        return values.astype(np.float64, copy=False) * (_factor(table, name, unit) if unit else 1.0)

    beam = _beam(table) if fwhm_rad is None else fwhm_rad
    times = column("TIME", "s")
    if (apart := abs(times - times[0]) > 1e-3 * np.median(np.diff(times[0]))).any():
        raise InputError(f"TIME of PIXID {numbers[apart.any(axis=1)][0]} differs from that of {numbers[0]}; one time")
    scan = np.zeros(shape, np.int64)
    if "SCAN" in table.columns.names:
        scan = integers("SCAN", table.data["SCAN"], pixel.shape)[order].reshape(shape)
        if (scan != scan[0]).any():
            raise InputError("SCAN differs between the detectors; one scan for each time is expected")
    boresight, places = _array(column("DX", "rad"), column("DY", "rad"), beam)
    unit = table.columns["FNU"].unit or table.header.get("BUNIT", "K")
    data = column("FNU", "", finite=False) * millikelvin("FNU", unit)
    lost = column("UFNU", "", finite=False) > _LOST_ABOVE
    plane = FocalPlane(*places, beam, names=numbers.astype(str))
    return Timestreams(data, times[0], *boresight, scan[0], plane, {}, lost if lost.any() else None)


def _by_detector(pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows by detector, each with its samples in the order of the file; and the numbers of the detectors."""
    numbers, first, detector, counts = np.unique(pixel, return_index=True, return_inverse=True, return_counts=True)
    if (counts != counts[0]).any():
        other = int(np.argmax(counts != counts[0]))
        raise InputError(f"PIXID {numbers[other]} has {counts[other]} rows, {numbers[0]} has {counts[0]}; one number")
    place = np.argsort(np.argsort(first))
    return np.argsort(place[detector], kind="stable"), numbers[np.argsort(first)]


def _factor(table: Any, name: str, unit: str) -> float:
    """Factor from the unit of a column to another; columns without a unit have that one."""
    from astropy import units as u

    found = table.columns[name].unit or unit
    try:
        return float(u.Unit(_OTHER_NAMES.get(found.lower(), found)).to(u.Unit(unit)))
    except (ValueError, TypeError):
        raise InputError(f"the unit of {name}: found {found!r}; {unit} is expected") from None


def _beam(table: Any) -> float:
    if "BMAJ" not in table.header:
        raise InputError("lacks the keyword BMAJ; give the beam")
    return float(np.radians(number("BMAJ [deg]", table.header["BMAJ"], above=0, below=1)))


def _array(
    ra_rad: np.ndarray, dec_rad: np.ndarray, beam_rad: float
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Find boresight, array angle and offsets that give the lines of sight (n_det, n_samp) of a rigid array.

    The mean direction of the detectors turns with the array, and the offsets from it turn by the array angle.
    """
    if not abs(dec_rad).max() <= np.pi / 2 * (1 + 1e-9):
        raise InputError(f"DY: found {abs(dec_rad).max():.6g} rad; declinations are expected")
    total = np.zeros((ra_rad.shape[1], 3))
    for sky in zip(ra_rad, dec_rad, strict=True):
        total += sky_axes(*sky)[0]
    ra, dec = directions(total)
    angle, array = _rigid_array(_offsets(ra_rad, dec_rad, ra, dec), beam_rad)
    return (ra, dec, angle), (-array.imag, array.real)


def _offsets(ra_rad: np.ndarray, dec_rad: np.ndarray, ra0_rad: np.ndarray, dec0_rad: np.ndarray) -> np.ndarray:
    """Offsets (n_det, n_samp) from a boresight in its tangent plane, north + i east: arguments are position angles."""
    sight, east, north = sky_axes(ra0_rad, dec0_rad)
    offsets = np.empty(ra_rad.shape, complex)
    for place, *sky in zip(offsets, ra_rad, dec_rad, strict=True):
        line = sky_axes(*sky)[0]
        depth, to_north, to_east = ((line * axis).sum(axis=-1) for axis in (sight, north, east))
        if not (depth > 0).all():
            raise InputError("DX, DY: found detectors a quarter of a turn apart; an array is expected")
        place[:] = (to_north + 1j * to_east) / depth
    return offsets


def _rigid_array(offsets: np.ndarray, beam_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Angle (n_samp,) and offsets at the angle 0 (n_det,); raises InputError for detectors that move in the array."""
    array = offsets[:, 0]
    for _ in range(2):  # turn to the array, and average the array
        angle = np.angle((offsets * array.conj()[:, None]).sum(axis=0))
        array = (offsets * np.exp(-1j * angle)).mean(axis=1)
    shift = float(np.sqrt((abs(offsets - array[:, None] * np.exp(1j * angle)) ** 2).mean()))
    if shift > _LARGEST_SHIFT * beam_rad:
        arcsec = np.degrees([shift, beam_rad]) * 3600
        raise InputError(
            f"DX, DY: detectors move in the array by {arcsec[0]:.3g} arcsec; "
            f"at most {_LARGEST_SHIFT:.0%} of the beam of {arcsec[1]:.3g} arcsec is expected"
        )
    return angle, array
