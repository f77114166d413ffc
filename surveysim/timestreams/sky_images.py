"""Maps of the sky in FITS files: images with celestial coordinates and HEALPix maps, read and checked."""

import math
import os
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import one_line
from surveysim.scene.map_units import UNITS, contradicts, unit_of_header
from surveysim.scene.sky import SkyMap, check_spectrum
from surveysim.scene.units import shown

if TYPE_CHECKING:
    from astropy.wcs import WCS

MAX_BYTES = 4e9
MAX_NSIDE = 8192
_NO_VALUE = 1e30  # larger numbers mark pixels without a value, as -1.6375e30 in HEALPix files
_CIRCULAR = 0.01  # largest relative difference of the axes of a circular beam
_FRAMES = {"C": "equatorial", "Q": "equatorial", "G": "galactic", "E": "ecliptic"}


@dataclass(frozen=True, eq=False)
class SkyImage:
    """A map of the sky, as its file has it.

    Attributes
    ----------
    values
        (n_y, n_x) of an image, or (n_pixel,) in ring order of a HEALPix map; NaN without a value.
    wcs
        Coordinates of the pixels of an image; None for a HEALPix map.
    frame
        "equatorial", "galactic" or "ecliptic".
    unit
        One of `surveysim.scene.map_units.UNITS`.
    fwhm_rad
        Width of its own beam.
    notes
        Lines on parts of the file that are ignored.
    """

    values: np.ndarray
    wcs: "WCS | None"
    frame: str
    unit: str
    fwhm_rad: float
    notes: tuple[str, ...]

    @property
    def pixel_rad(self) -> float:
        """Side of a pixel: the smaller side in an image."""
        if self.wcs is None:
            return math.sqrt(4 * math.pi / len(self.values))
        from astropy.wcs.utils import proj_plane_pixel_scales

        return math.radians(float(min(proj_plane_pixel_scales(self.wcs))))


@lru_cache(maxsize=4)  # beams and bands have maps in common
def read_sky_image(section: SkyMap) -> SkyImage:
    """Read the map of a section of the scene.

    Raises
    ------
    InputError
        For a file without a map, a unit or coordinates that are missing or contradict the scene, and a map without
        values: one line with the key and the file.
    """
    try:
        # Astropy warns of keywords that it repairs, and of files that are refused below.
        with warnings.catch_warnings(action="ignore"), _opened(section.map_file) as file:
            return _image(file, section)
    except InputError as error:
        missing = "" if os.path.lexists(section.map_file) else "no such file in the folder of the scene"
        key, _, what = str(error).partition(": ")
        raise InputError(f"{key}: {section.map_file}: {missing or what}") from None


def _opened(path: Path) -> Any:
    from astropy.io import fits

    try:
        if os.path.isfile(path) and os.path.getsize(path) > MAX_BYTES:
            raise InputError(f"map_file: found more than {MAX_BYTES / 1e9:g} GB; a smaller map is expected")
        return fits.open(path, memmap=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"map_file: not a FITS file ({one_line(error)}); a map of the sky in FITS is expected"
        ) from None


def _image(file: Any, section: SkyMap) -> SkyImage:
    hdu = _chosen(file, section.hdu)
    values, notes, frame, wcs = _healpix(hdu, section) if _is_healpix(hdu) else _plane(hdu, section)
    unit = _unit(hdu, section)
    fwhm_rad = _own_beam(hdu, section, unit)
    values = np.where(np.abs(values) < _NO_VALUE, values, np.nan)
    if not np.isfinite(values).any():
        raise InputError("map_file: found no pixel with a value; a map is expected")
    return SkyImage(values, wcs, frame, unit, fwhm_rad, notes)


def _chosen(file: Any, number: int | None) -> Any:
    """Choose the header-data unit of a map: the first, or one by its number."""
    if number is not None and number >= len(file):
        raise InputError(f"hdu: found {number} in a file of {len(file)}; {len(file) - 1} or less is expected")
    for hdu in file if number is None else [file[number]]:
        if _is_healpix(hdu) or (hdu.is_image and hdu.header["NAXIS"] >= 2):
            return hdu
    raise InputError("map_file: found neither an image nor a HEALPix map; one of the two is expected")


def _is_healpix(hdu: Any) -> bool:
    return str(hdu.header.get("PIXTYPE", "")).strip() == "HEALPIX"


# ---------------------------------------------------------------- images


def _plane(hdu: Any, section: SkyMap) -> tuple[np.ndarray, tuple[str, ...], str, Any]:
    from astropy.wcs import WCS
    from astropy.wcs.utils import wcs_to_celestial_frame

    if section.frame is not None:
        raise InputError(f"frame: found {section.frame!r} for an image, which has its own; none is expected")
    try:
        whole = WCS(hdu.header)
        celestial = whole.celestial
        frame = wcs_to_celestial_frame(celestial).name
    except Exception as error:  # astropy and wcslib raise many types of errors
        raise InputError(
            f"map_file: found coordinates that can't be read ({one_line(error)}); celestial ones are expected"
        ) from None
    if not whole.has_celestial or celestial.naxis != 2:
        raise InputError("map_file: found no celestial coordinates in the header; an image with a WCS is expected")
    if celestial.wcs.lngtyp not in ("RA", "GLON"):  # astropy takes others for right ascension
        raise InputError(
            f"map_file: found coordinates {celestial.wcs.lngtyp} and {celestial.wcs.lattyp}; ICRS, FK5 of J2000 or"
            " galactic ones are expected"
        )
    frames = {"icrs": "equatorial", "fk5": "equatorial", "galactic": "galactic"}
    if frame not in frames or (frame == "fk5" and not math.isclose(celestial.wcs.equinox, 2000)):
        raise InputError(f"map_file: found coordinates in {frame}; ICRS, FK5 of J2000 or galactic ones are expected")
    values, notes = _first_planes(hdu, whole)
    return values, notes, frames[frame], celestial


def _data(hdu: Any) -> np.ndarray:
    try:
        return hdu.data
    except (OSError, ValueError, TypeError) as error:  # of a file that ends too early
        raise InputError(f"map_file: values can't be read ({one_line(error)}); a map is expected") from None


def _first_planes(hdu: Any, whole: Any) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the image (n_y, n_x) of the first plane along other axes; only those of polarization may have more."""
    values, notes = np.asarray(_data(hdu), dtype=float), []
    places = {whole.naxis - 1 - whole.wcs.lng, whole.naxis - 1 - whole.wcs.lat}
    if whole.wcs.lng > whole.wcs.lat:
        raise InputError("map_file: found latitude on the first axis; longitude is expected there")
    for axis in sorted(set(range(values.ndim)) - places, reverse=True):
        kind = str(whole.wcs.ctype[values.ndim - 1 - axis])
        if values.shape[axis] > 1 and kind != "STOKES":
            raise InputError(
                f"map_file: found {values.shape[axis]} planes along {kind or 'an axis'}; one image is expected"
            )
        if values.shape[axis] > 1:
            notes.append(f"polarization is ignored: the first of {values.shape[axis]} planes is taken")
        number = values.ndim - 1 - axis
        first = whole.wcs.crval[number] + (1 - whole.wcs.crpix[number]) * whole.wcs.cdelt[number]
        if kind == "STOKES" and round(first) != 1:
            raise InputError(
                f"map_file: found Stokes parameter {first:g} in the first plane; 1, the intensity, is expected"
            )
        values = values.take(0, axis=axis)
    return values, tuple(notes)


# ---------------------------------------------------------------- HEALPix


def _healpix(hdu: Any, section: SkyMap) -> tuple[np.ndarray, tuple[str, ...], str, None]:
    header = hdu.header
    nside = header.get("NSIDE", 0)
    if nside not in [2**k for k in range(14)]:
        raise InputError(f"map_file: found NSIDE {shown(nside)}; a power of two from 1 to {MAX_NSIDE} is expected")
    ordering = str(header.get("ORDERING", "")).strip().upper()
    if ordering not in ("RING", "NESTED", "NEST"):
        raise InputError(f"map_file: found ORDERING {ordering!r}; RING or NESTED is expected")
    names = _columns(hdu)
    notes = (f"polarization is ignored: the column {names[0]!r} is taken of {', '.join(names)}",) if names[1:] else ()
    values = _pixels(hdu, names[0], nside)
    if ordering != "RING":
        from ducc0.healpix import Healpix_Base

        values = values[Healpix_Base(nside, "NEST").ring2nest(np.arange(len(values)))]
    return values, notes, _frame(header, section), None


def _columns(hdu: Any) -> list[str]:
    """Names of the columns with values: the map is the first, temperature before polarization."""
    names = [name for name in hdu.columns.names if name.upper() != "PIXEL"]
    if not names:
        raise InputError("map_file: found no column with values; a map is expected")
    return names


def _pixels(hdu: Any, name: str, nside: int) -> np.ndarray:
    """Values (n_pixel,) in the order of the file; NaN of pixels that a file of a part of the sky lacks."""
    found, n_pixel = np.asarray(_data(hdu)[name], dtype=float).ravel(), 12 * nside**2
    if str(hdu.header.get("INDXSCHM", "")).strip().upper() == "EXPLICIT" or "PIXEL" in hdu.columns.names:
        values = np.full(n_pixel, np.nan)
        places = np.asarray(_data(hdu)["PIXEL"], dtype=np.int64).ravel()
        if len(places) and (places.min() < 0 or places.max() >= n_pixel):
            raise InputError(
                f"map_file: column 'PIXEL': found {places.min()} to {places.max()}; 0 to {n_pixel - 1} is expected"
            )
        values[places] = found
        return values
    if len(found) != n_pixel:
        raise InputError(f"map_file: found {len(found)} pixels for NSIDE {nside}; {n_pixel} are expected")
    return found


def _frame(header: Any, section: SkyMap) -> str:
    told = _FRAMES.get(str(header.get("COORDSYS", "")).strip().upper()[:1])
    if told is None and section.frame is None:
        raise InputError("frame: found no COORDSYS in the file; 'equatorial', 'galactic' or 'ecliptic' is expected")
    if None not in (told, section.frame) and told != section.frame:
        raise InputError(f"frame: found {section.frame!r} for a map in {told} coordinates")
    return told or section.frame


# ---------------------------------------------------------------- unit and beam


def _unit(hdu: Any, section: SkyMap) -> str:
    card = f"TUNIT{1 + hdu.columns.names.index(_columns(hdu)[0])}" if _is_healpix(hdu) else "BUNIT"
    text = str(hdu.header.get(card, "")).strip()
    if section.unit is not None:
        if contradicts(section.unit, text):
            raise InputError(f"unit: found {section.unit!r} for a map whose {card} is {shown(text)}")
        return section.unit
    named = unit_of_header(text)
    if named is None:
        found = f"{card} {shown(text)}" if text else f"no {card}"
        raise InputError(f"unit: found {found} in the file; one of {', '.join(UNITS)} is expected")
    try:
        check_spectrum(named, section.frequency_hz)
    except ValueError as error:
        raise InputError(str(error)) from None
    return named


def _own_beam(hdu: Any, section: SkyMap, unit: str) -> float:
    """Width [rad] of the beam of a map: that of the scene, or of the header; 0 without one."""
    fwhm_rad = section.beam_fwhm_rad
    if fwhm_rad is None and "BMAJ" in hdu.header and not _is_healpix(hdu):
        major, minor = (float(hdu.header.get(name, 0)) for name in ("BMAJ", "BMIN"))
        if not 0 < major * (1 - _CIRCULAR) <= minor <= major * (1 + _CIRCULAR):
            raise InputError(
                f"beam_fwhm: found a beam of {major:g} by {minor:g} deg in the file; a circular one is expected"
            )
        fwhm_rad = math.radians(math.sqrt(major * minor))
    if not fwhm_rad and UNITS[unit].kind == "flux":
        raise InputError(f"beam_fwhm: missing; the unit {unit!r} refers to it")
    return fwhm_rad or 0.0
