"""Map geometry: the tangent plane of a field, its pixels, and the directions of detectors in it."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.detector_places import array_homography, to_pixels
from mapmaker.errors import OutOfRangeError
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.validation import MAX_PIXELS, argument_error, number, pixel_side, reals, whole

if TYPE_CHECKING:
    from astropy.wcs import WCS

# Least ratio of the sides of a HEALPix and a map pixel. The fraction of HEALPix pixels within the map that get no map
# pixel is 20 % at 1, 6 % at 1.2, 0.2 % at sqrt(2) and none at 1.5, for all declinations and rotations.
_HEALPIX_SIDE = 1.5
_FINEST_ORDER = 29  # HEALPix pixel numbers have 64 bits
HORIZON = 1e-12  # cosine of the angle from the centre: smaller values are rounding of 90 degrees


@dataclass(frozen=True)
class MapGeometry:
    """Square pixels on a tangent plane; map arrays are (n_y, n_x), with row 0 south and column 0 east.

    Attributes
    ----------
    ra0_rad, dec0_rad
        Centre, where the plane touches the sky.
    pixel_rad
        Side of a pixel.
    n_x, n_y

    Raises
    ------
    ValueError
        For fewer than 1 or more than `MAX_PIXELS` pixels, a centre that is no direction, and pixels that are not
        positive and smaller than a quarter of a turn.
    """

    ra0_rad: float
    dec0_rad: float
    pixel_rad: float
    n_x: int
    n_y: int

    def __post_init__(self) -> None:
        number("ra0_rad", self.ra0_rad)
        number("dec0_rad", self.dec0_rad, least=-math.pi / 2, most=math.pi / 2)
        pixel_side("pixel_rad", self.pixel_rad)
        for name in ("n_x", "n_y"):
            whole(name, getattr(self, name), least=-(2**63), most=2**63 - 1)
        if not (self.n_x >= 1 and self.n_y >= 1 and int(self.n_x) * int(self.n_y) <= MAX_PIXELS):
            raise OutOfRangeError(
                f"found a map of {self.n_x} x {self.n_y} pixels; 1 to {MAX_PIXELS} pixels in all are expected"
            )


def same_geometry(one: MapGeometry, other: MapGeometry) -> bool:
    """Compare two geometries up to the rounding of degrees in a file and full turns of right ascension."""
    turn = abs(math.remainder(one.ra0_rad - other.ra0_rad, 2 * math.pi))
    first, second = ((g.dec0_rad, g.pixel_rad) for g in (one, other))
    sizes_agree = (one.n_x, one.n_y) == (other.n_x, other.n_y)
    return sizes_agree and turn < 1e-11 and bool(np.allclose(first, second, rtol=1e-12, atol=0))


def mean_direction(ra_rad: np.ndarray, dec_rad: np.ndarray) -> tuple[float, float]:
    """Mean of directions, for use as the centre of their map.

    It is the direction of the mean unit vector, which is right across RA 0 and at a pole, where means of angles are
    not.

    Parameters
    ----------
    ra_rad, dec_rad : any shape

    Returns
    -------
    ra_rad, dec_rad : float
        Right ascension (0 to 2 pi) and declination.

    Raises
    ------
    ValueError
        For directions that are not finite, for none, and for those that cancel.
    """
    ra = reals("ra_rad", ra_rad, (...,), empty=True)
    dec = reals("dec_rad", dec_rad, ra.shape, empty=True)
    vectors = np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)
    x, y, z = (float(np.mean(item)) if item.size else math.nan for item in vectors)
    length = math.hypot(x, y, z)
    if not length > 1e-6:
        raise OutOfRangeError(
            f"found {ra.size} directions whose mean vector has the length {length:.2g}; above 0 expected"
        )
    # Twice, because the remainder of a tiny negative angle rounds to a full turn.
    return math.atan2(y, x) % math.tau % math.tau, math.atan2(z, math.hypot(x, y))


def plane_offsets(
    geometry: MapGeometry, ra_rad: float | np.ndarray, dec_rad: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gnomonic offsets (xi east, eta north) [rad] of directions; NaN from 90 degrees off the centre on."""
    delta = ra_rad - geometry.ra0_rad
    sin0, cos0 = np.sin(geometry.dec0_rad), np.cos(geometry.dec0_rad)
    sin, cos = np.sin(dec_rad), np.cos(dec_rad)
    depth = sin0 * sin + cos0 * cos * np.cos(delta)
    depth = np.where(depth > HORIZON, depth, np.nan)
    return cos * np.sin(delta) / depth, (cos0 * sin - sin0 * cos * np.cos(delta)) / depth


def plane_directions(geometry: MapGeometry, xi_rad: np.ndarray, eta_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Right ascension (0 to 2 pi) and declination [rad] of points in the tangent plane."""
    sin0, cos0 = np.sin(geometry.dec0_rad), np.cos(geometry.dec0_rad)
    depth = cos0 - eta_rad * sin0
    ra = geometry.ra0_rad + np.arctan2(xi_rad, depth)
    dec = np.arctan2(sin0 + eta_rad * cos0, np.hypot(xi_rad, depth))
    return np.mod(ra, 2 * np.pi), dec


def north_angle(geometry: MapGeometry, xi_rad: np.ndarray, eta_rad: np.ndarray) -> np.ndarray:
    """Angle of true north in the tangent plane, from the plane's north (eta) through its east (xi) [rad].

    A position angle at a point plus this angle is the angle in the plane. Meridians are straight lines in the plane,
    which meet at the pole ``(0, cot dec0)``, so the result is exact. To first order it is -xi tan(dec0) near the
    centre.
    """
    sin0, cos0 = np.sin(geometry.dec0_rad), np.cos(geometry.dec0_rad)
    return np.arctan2(-xi_rad * sin0, cos0 - eta_rad * sin0)


def pixel_centres(geometry: MapGeometry) -> tuple[np.ndarray, np.ndarray]:
    """Tangent-plane (xi, eta) [rad] of all pixel centres, each (n_y, n_x)."""
    xi = (geometry.n_x / 2 - 0.5 - np.arange(geometry.n_x)) * geometry.pixel_rad
    eta = (np.arange(geometry.n_y) + 0.5 - geometry.n_y / 2) * geometry.pixel_rad
    return np.meshgrid(xi, eta)


def sky_offsets(plane: FocalPlane, array_angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets of the detectors from the boresight, east and north.

    Parameters
    ----------
    plane
    array_angle_rad : (n_angle,)
        Position angle of the array's y axis, from the north of the sky at the boresight or of the tangent plane.

    Returns
    -------
    east, north : (n_angle, n_det)
        [rad].
    """
    cos, sin = np.cos(array_angle_rad)[:, None], np.sin(array_angle_rad)[:, None]
    return -plane.x_rad * cos + plane.y_rad * sin, plane.x_rad * sin + plane.y_rad * cos


def pixel_indices(geometry: MapGeometry, streams: Timestreams) -> np.ndarray:
    """Flat pixel index of every sample.

    The array angle of streams is the position angle at the boresight. Lines of sight of the detectors are exact at any
    distance from the centre of the map.

    Parameters
    ----------
    geometry
    streams

    Returns
    -------
    (n_det, n_samp) array
        int32; -1 off the map, and for samples that `streams` flags as lost.
    """
    xi, eta = plane_offsets(geometry, streams.ra_rad, streams.dec_rad)
    angle = streams.array_angle_rad + north_angle(geometry, xi, eta)
    index = boresight_pixels(geometry, xi, eta, angle, plane=streams.focal_plane)
    if streams.flags is not None:
        index[streams.flags] = -1
    return index


def boresight_pixels(
    geometry: MapGeometry,
    xi_rad: np.ndarray,
    eta_rad: np.ndarray,
    plane_angle_rad: np.ndarray,
    *,
    plane: FocalPlane,
) -> np.ndarray:
    """Flat pixel index of every sample for a boresight in the tangent plane.

    Parameters
    ----------
    geometry
    xi_rad, eta_rad : (n_samp,)
        Boresight; samples where it is NaN, behind the plane, are off the map.
    plane_angle_rad : (n_samp,)
        Position angle of the array's y axis at the boresight plus `north_angle`.
    plane
        Detector positions.

    Returns
    -------
    (n_det, n_samp) array
        int32; -1 off the map.

    Raises
    ------
    ValueError
        For arrays of different lengths, or that are not real numbers.
    """
    from mapmaker.kernels.pixels import plane_pixels

    xi_rad = reals("xi_rad", xi_rad, ("n_samp",), finite=False)
    eta_rad = reals("eta_rad", eta_rad, xi_rad.shape, finite=False)
    plane_angle_rad = reals("plane_angle_rad", plane_angle_rad, xi_rad.shape, finite=False)
    place = pixel_homography(geometry, xi_rad, eta_rad, plane_angle_rad, first=0.0)
    return plane_pixels(place, plane.x_rad, plane.y_rad, geometry.n_x, geometry.n_y)


def pixel_homography(
    geometry: MapGeometry, xi_rad: np.ndarray, eta_rad: np.ndarray, plane_angle_rad: np.ndarray, *, first: float
) -> np.ndarray:
    """Homographies (8, n_samp) from offsets in the array to pixels, the outer edge of the map at `first`.

    Other arguments are those of `boresight_pixels`.
    """
    place = array_homography(geometry.dec0_rad, xi_rad, eta_rad, plane_angle_rad)
    return to_pixels(place, geometry.pixel_rad, first + geometry.n_x / 2, first + geometry.n_y / 2)


def covering_geometry(ra0_rad: float, dec0_rad: float, pixel_rad: float, half_extent_rad: float) -> MapGeometry:
    """Square geometry that extends `half_extent_rad` to each side of its centre, with a size suited to FFTs.

    Raises
    ------
    ValueError
        For an extent that is not positive or beyond 90 degrees, and as `MapGeometry`.
    """
    number("half_extent_rad", half_extent_rad, above=0, most=math.pi / 2)
    if half_extent_rad > MAX_PIXELS * pixel_side("pixel_rad", pixel_rad):
        raise argument_error("pixel_rad", pixel_rad, f"a side of {MAX_PIXELS} pixels or less is")
    n = 2 * fast_length(int(np.ceil(half_extent_rad / pixel_rad)) + 1)
    return MapGeometry(ra0_rad, dec0_rad, pixel_rad, n, n)


def fast_length(n: int) -> int:
    """Smallest product of 2, 3 and 5 that is not below `n`, for FFTs: scipy, which knows it, takes long to import."""
    while True:
        left = n
        for prime in (2, 3, 5):
            while left % prime == 0:
                left //= prime
        if left == 1:
            return n
        n += 1


def finest_nside(pixel_rad: float) -> int:
    """Largest nside (a power of two) of a HEALPix map that a map of these pixels fills without holes.

    The side of HEALPix pixels, ``sqrt(pi / 3) / nside``, must be at least 1.5 times that of the map's. 0 where no nside
    is coarse enough.

    Raises
    ------
    ValueError
        For pixels that are not positive.
    """
    most = math.sqrt(math.pi / 3) / (_HEALPIX_SIDE * pixel_side("pixel_rad", pixel_rad))
    return 2 ** min(math.floor(math.log2(most)), _FINEST_ORDER) if most >= 1 else 0


def check_nside(name: str, nside: int, pixel_rad: float) -> None:
    """Raise ValueError unless a map of pixels of this side fills a HEALPix map of `nside`, a power of two."""
    finest = finest_nside(pixel_rad)
    pixel = f"pixels of {math.degrees(pixel_rad) * 3600:.4g} arcsec"
    if not finest:
        raise OutOfRangeError(f"{name}: found {nside} for {pixel}; no nside is wide enough for these")
    whole(name, nside, least=1)
    if nside > finest:
        raise OutOfRangeError(f"{name}: found {nside} for {pixel}; {finest} or less is expected, a finer map has holes")
    if nside & (nside - 1):
        raise OutOfRangeError(f"{name}: found {nside}; a power of two is expected")


def wcs_cards(geometry: MapGeometry) -> dict[str, tuple[str | int | float, str]]:
    """Value and comment of every FITS keyword of the world coordinates (RA---TAN, DEC--TAN; degrees)."""
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


def wcs(geometry: MapGeometry) -> "WCS":
    """Astropy WCS (RA---TAN, DEC--TAN) of the geometry."""
    from astropy.wcs import WCS

    return WCS({keyword: value for keyword, (value, _) in wcs_cards(geometry).items()})
