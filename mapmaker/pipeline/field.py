"""Place and size of the map, from the scans of all files."""

from dataclasses import dataclass, replace

import numpy as np

from mapmaker.errors import OutOfRangeError
from mapmaker.geometry import MapGeometry, fast_length, mean_direction, plane_directions, plane_offsets
from mapmaker.pipeline.config import MapSection
from mapmaker.pipeline.dropped import FILE, NO_SCAN, OFF_MAP, Dropped, UnusableFileError
from mapmaker.pipeline.usable import in_scans
from mapmaker.timestreams import Timestreams

MOST_PIXELS = 10**7  # of a map whose size is not stated: 2 GB with eight divisions
_PIXELS_OF_BEAM = 3.0
_EDGE = 1.01  # of the extent: distances in two tangent planes differ a little


@dataclass(frozen=True)
class Field:
    """Extent of the scans of some files in the tangent plane of a direction.

    Attributes
    ----------
    centre_rad
        Right ascension and declination of the direction.
    low_rad, high_rad
        Least and largest offsets of detectors to the east and to the north.
    fwhm_rad
        Beam of the first file.
    """

    centre_rad: tuple[float, float]
    low_rad: tuple[float, float]
    high_rad: tuple[float, float]
    fwhm_rad: float


def extended(field: Field | None, name: str, streams: Timestreams, section: MapSection) -> Field:
    """Extend a field by the scans of a file.

    Raises
    ------
    UnusableFileError
        For a file without scans, or with scans that are too far from the field.
    """
    inside = in_scans(streams.scan_bounds, len(streams.time_s))
    if not inside.any():
        raise UnusableFileError((Dropped(name, FILE, NO_SCAN, detail="it has none"),))
    ra, dec = streams.ra_rad[inside], streams.dec_rad[inside]
    centre = field.centre_rad if field else section.centre or mean_direction(ra, dec)
    offsets = plane_offsets(MapGeometry(*centre, 1e-6, 1, 1), ra, dec)
    if not np.isfinite(offsets).all():
        detail = "its scans are 90 deg or more from the centre of the map"
        raise UnusableFileError((Dropped(name, FILE, OFF_MAP, detail=detail),))
    plane = streams.focal_plane
    reach = float(np.hypot(plane.x_rad, plane.y_rad).max())
    east, north = offsets
    low = float(east.min()) - reach, float(north.min()) - reach
    high = float(east.max()) + reach, float(north.max()) + reach
    if field is None:
        return Field(centre, low, high, plane.fwhm_rad)
    lower, higher = np.minimum(field.low_rad, low), np.maximum(field.high_rad, high)
    return replace(field, low_rad=tuple(lower.tolist()), high_rad=tuple(higher.tolist()))


def stated_field(streams: Timestreams, section: MapSection) -> Field:
    """Field of a configuration that states centre and size."""
    east, north = (side / 2 for side in section.size)
    return Field(section.centre, (-east, -north), (east, north), streams.focal_plane.fwhm_rad)


def map_geometry(field: Field, section: MapSection) -> MapGeometry:
    """Geometry of the map.

    Raises
    ------
    OutOfRangeError
        For too many pixels.
    """
    pixel = section.pixel or field.fwhm_rad / _PIXELS_OF_BEAM
    centre = section.centre or _middle(field)
    if section.size:
        n_x, n_y = (max(1, round(side / pixel)) for side in section.size)
    else:
        n_x, n_y = (2 * fast_length(int(np.ceil(_EDGE * side / pixel)) + 1) for side in _half_sides(field, section))
        if n_x * n_y > MOST_PIXELS:
            raise OutOfRangeError(
                f"found scans that need a map of {n_x} x {n_y} pixels; state map.centre and map.size to map a part"
            )
    return MapGeometry(*centre, pixel, n_x, n_y)


def _half_sides(field: Field, section: MapSection) -> np.ndarray:
    """Half of the sides of the map, along right ascension and declination."""
    low, high = np.array(field.low_rad), np.array(field.high_rad)
    return np.maximum(-low, high) if section.centre else (high - low) / 2


def _middle(field: Field) -> tuple[float, float]:
    east, north = (np.array(field.low_rad) + field.high_rad) / 2
    ra, dec = plane_directions(MapGeometry(*field.centre_rad, 1e-6, 1, 1), east, north)
    return float(ra), float(dec)
