"""Map geometry: the tangent plane of a field, its pixels, and where the detectors look."""

import math
from dataclasses import dataclass

import numpy as np

from mapmaker.kernels.pixels import plane_pixels
from mapmaker.timestreams import FocalPlane, Timestreams


@dataclass(frozen=True)
class MapGeometry:
    """Square pixels of a tangent plane; map arrays are (n_y, n_x), row 0 south, column 0 east."""

    ra0_rad: float
    dec0_rad: float
    pixel_rad: float
    n_x: int
    n_y: int


def same_geometry(one: MapGeometry, other: MapGeometry) -> bool:
    """Whether two geometries are one but for the rounding of degrees in a file."""
    angles = [(g.ra0_rad, g.dec0_rad, g.pixel_rad) for g in (one, other)]
    return (one.n_x, one.n_y) == (other.n_x, other.n_y) and bool(np.allclose(*angles, rtol=1e-12, atol=0))


def plane_offsets(geometry: MapGeometry, ra_rad: np.ndarray, dec_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gnomonic (xi east, eta north) [rad] of directions."""
    delta = ra_rad - geometry.ra0_rad
    sin0, cos0 = np.sin(geometry.dec0_rad), np.cos(geometry.dec0_rad)
    sin, cos = np.sin(dec_rad), np.cos(dec_rad)
    depth = sin0 * sin + cos0 * cos * np.cos(delta)
    return cos * np.sin(delta) / depth, (cos0 * sin - sin0 * cos * np.cos(delta)) / depth


def plane_directions(geometry: MapGeometry, xi_rad: np.ndarray, eta_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Right ascension (0 to 2 pi) and declination [rad] of points of the tangent plane."""
    sin0, cos0 = np.sin(geometry.dec0_rad), np.cos(geometry.dec0_rad)
    depth = cos0 - eta_rad * sin0
    ra = geometry.ra0_rad + np.arctan2(xi_rad, depth)
    dec = np.arctan2(sin0 + eta_rad * cos0, np.hypot(xi_rad, depth))
    return np.mod(ra, 2 * np.pi), dec


def pixel_centres(geometry: MapGeometry) -> tuple[np.ndarray, np.ndarray]:
    """Tangent-plane (xi, eta) [rad] of all pixel centres, each (n_y, n_x)."""
    xi = (geometry.n_x / 2 - 0.5 - np.arange(geometry.n_x)) * geometry.pixel_rad
    eta = (np.arange(geometry.n_y) + 0.5 - geometry.n_y / 2) * geometry.pixel_rad
    return np.meshgrid(xi, eta)


def sky_offsets(plane: FocalPlane, array_angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (n_angle, n_det) [rad] of the detectors from the boresight, east and north."""
    cos, sin = np.cos(array_angle_rad)[:, None], np.sin(array_angle_rad)[:, None]
    return -plane.x_rad * cos + plane.y_rad * sin, plane.x_rad * sin + plane.y_rad * cos


def pixel_indices(geometry: MapGeometry, streams: Timestreams) -> np.ndarray:
    """Flat pixel index (n_det, n_samp) int32 of every sample, -1 off the map."""
    xi, eta = plane_offsets(geometry, streams.ra_rad, streams.dec_rad)
    return boresight_pixels(geometry, xi, eta, streams.array_angle_rad, streams.focal_plane)


def boresight_pixels(
    geometry: MapGeometry,
    xi_rad: np.ndarray,
    eta_rad: np.ndarray,
    array_angle_rad: np.ndarray,
    plane: FocalPlane,
) -> np.ndarray:
    """Flat pixel index (n_det, n_samp) int32 for a boresight (n_samp,) in the tangent plane, -1 off the map.

    Detector offsets are added in the plane: over half a degree that is good to 0.1 arcsec, with the array
    angle counted from the plane's north. (An angle counted from north at the boresight differs from it by
    xi tan(dec): 2 arcsec at 4 arcmin from a boresight 30 arcmin off centre at 45 degrees.)
    """
    scale = 1 / geometry.pixel_rad
    column = geometry.n_x / 2 - xi_rad * scale
    row = geometry.n_y / 2 + eta_rad * scale
    cos, sin = np.cos(array_angle_rad) * scale, np.sin(array_angle_rad) * scale
    return plane_pixels(column, row, cos, sin, plane.x_rad, plane.y_rad, geometry.n_x, geometry.n_y)


def covering_geometry(ra0_rad: float, dec0_rad: float, pixel_rad: float, half_extent_rad: float) -> MapGeometry:
    """A square geometry that reaches `half_extent_rad` on each side, its size good for FFTs."""
    from scipy.fft import next_fast_len

    n = 2 * next_fast_len(int(np.ceil(half_extent_rad / pixel_rad)) + 1, real=True)
    return MapGeometry(ra0_rad, dec0_rad, pixel_rad, n, n)


def wcs_cards(geometry: MapGeometry) -> dict[str, tuple[str | int | float, str]]:
    """Value and comment of every FITS keyword of the geometry's world coordinates (RA---TAN, DEC--TAN; degrees)."""
    ra_deg, dec_deg, pixel_deg = (
        math.degrees(angle) for angle in (geometry.ra0_rad, geometry.dec0_rad, geometry.pixel_rad)
    )
    return {
        "WCSAXES": (2, "Number of coordinate axes"),
        "CRPIX1": (geometry.n_x / 2 + 0.5, "Pixel coordinate of reference point"),
        "CRPIX2": (geometry.n_y / 2 + 0.5, "Pixel coordinate of reference point"),
        "CDELT1": (-pixel_deg, "[deg] Coordinate increment at reference point"),
        "CDELT2": (pixel_deg, "[deg] Coordinate increment at reference point"),
        "CUNIT1": ("deg", "Units of coordinate increment and value"),
        "CUNIT2": ("deg", "Units of coordinate increment and value"),
        "CTYPE1": ("RA---TAN", "Right ascension, gnomonic projection"),
        "CTYPE2": ("DEC--TAN", "Declination, gnomonic projection"),
        "CRVAL1": (ra_deg, "[deg] Coordinate value at reference point"),
        "CRVAL2": (dec_deg, "[deg] Coordinate value at reference point"),
        "LONPOLE": (180.0, "[deg] Native longitude of celestial pole"),
        "LATPOLE": (dec_deg, "[deg] Native latitude of celestial pole"),
        "MJDREF": (0.0, "[d] MJD of fiducial time"),
        "RADESYS": ("ICRS", "Equatorial coordinate system"),
    }


def wcs(geometry: MapGeometry):
    """The astropy WCS (RA---TAN, DEC--TAN) of the geometry."""
    from astropy.wcs import WCS

    return WCS({keyword: value for keyword, (value, _) in wcs_cards(geometry).items()})
