"""Maps of the sky on the tangent-plane grid of the simulated sky, through Gaussian beams.

An image is interpolated by splines of the fifth order on a grid as fine as its own pixels, and convolved there. A
HEALPix map is analysed into spherical harmonics, which are multiplied by the beam and summed up at the points of the
grid. Both keep the flux of sources, and have no other error than that of their pixels.
"""

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from mapmaker.geometry import MapGeometry, fast_length, pixel_centres, plane_directions
from mapmaker.spectrum import mode_ell
from surveysim.runtime.errors import InputError
from surveysim.timestreams.sky_images import SkyImage

MARGIN = 2.0  # of an image beyond the grid, in widths of the widest beam: the beam's tail beyond holds 1.5e-5 of it
FINEST_CELL = 0.6  # of a pixel: side of the cells that an image is convolved on, for 5e-5 of the flux of one pixel
MAX_CELLS = 5e7  # of the grid that an image is convolved on: 3 GB of memory
MAX_COEFFICIENTS = 3e7  # of a HEALPix map: 2 GB of memory, minutes of computing
_FAINTEST = 1e-6  # amplitude that the beam leaves at the highest multipole of a HEALPix map
_ORDER = 5  # of splines
_CYLINDERS, _REPEATED = ("CAR", "CEA", "MER"), 16  # projections, and columns over which a spline forgets an edge
_JUMP = 5  # between the places of neighbouring cells, over that in the middle of a plane projection
# Of the analysis of a HEALPix map: waves longer than two pixels are exact to 1e-4 at the poles, elsewhere to 1e-5. More
# iterations change little but waves that pixels hardly determine.
_TOLERANCE, _ITERATIONS = 1e-5, 3


def map_on_grid(image: SkyImage, geometry: MapGeometry, fwhm_rad: tuple[float, ...]) -> np.ndarray:
    """Convolve a map with beams of some widths (n_beam,) at the cells of a grid: (n_beam, n_y, n_x), in its own unit.

    The beams are those on the sky; the map's own beam counts as part of them. Missing values are 0.
    """
    extra = tuple(math.sqrt(max(0.0, width**2 - image.fwhm_rad**2)) for width in fwhm_rad)
    return _image_on_grid(image, geometry, extra) if image.wcs else _healpix_on_grid(image, geometry, extra)


def missing_cells(image: SkyImage, geometry: MapGeometry, fwhm_rad: float) -> tuple[int, int, int]:
    """Count the cells of a grid and of a margin for the beam around it: off a map, without a value, and all.

    A HEALPix map has pixels everywhere.
    """
    wide, _ = _widened(geometry, fwhm_rad)
    inside, values = _values_at(image, wide)
    return inside.size - int(inside.sum()), int(np.isnan(values[inside]).sum()), inside.size


def check_cost(image: SkyImage, path: Path, geometry: MapGeometry, fwhm_rad: tuple[float, ...]) -> None:
    """Raise InputError for a map of a file with too many pixels, or harmonics, to project."""
    if image.wcs is None:
        lmax = _highest_multipole(image, math.sqrt(min(fwhm_rad) ** 2 - image.fwhm_rad**2))
        if (lmax + 1) * (lmax + 2) / 2 > MAX_COEFFICIENTS:
            raise InputError(
                f"file: {path}: found a HEALPix map that takes harmonics up to l = {lmax}; {_most_multipoles()} or less"
                " is expected: an image of the field in its place"
            )
        return
    wide, _ = _widened(geometry, max(fwhm_rad))
    cells = wide.n_x * wide.n_y * _refinement(image, geometry) ** 2
    if cells > MAX_CELLS:
        side = math.degrees(_finest_side(image, geometry)) * 3600
        raise InputError(
            f"file: {path}: found pixels of {side:.3g} arcsec, {cells:.2g} of them in the field of the scans;"
            f" {MAX_CELLS:.0e} or fewer are expected: a map averaged over larger pixels"
        )


def _most_multipoles() -> int:
    return int(math.sqrt(2 * MAX_COEFFICIENTS)) - 2


def _widened(geometry: MapGeometry, fwhm_rad: float) -> tuple[MapGeometry, tuple[int, int]]:
    """Widen a grid by a margin for the beam, to a size suited to FFTs; return it with the numbers of new cells."""
    margin = math.ceil(MARGIN * fwhm_rad / geometry.pixel_rad)
    n_y, n_x = (n % 2 + 2 * fast_length(n // 2 + margin) for n in (geometry.n_y, geometry.n_x))
    wide = replace(geometry, n_y=n_y, n_x=n_x)
    return wide, ((n_y - geometry.n_y) // 2, (n_x - geometry.n_x) // 2)


def _values_at(image: SkyImage, geometry: MapGeometry) -> tuple[np.ndarray, np.ndarray]:
    """Flags of the cells of a grid that lie on a map, and the values of the nearest pixels, both (n_y, n_x)."""
    if image.wcs is None:
        from ducc0.healpix import Healpix_Base

        nside = math.isqrt(len(image.values) // 12)
        values = image.values[Healpix_Base(nside, "RING").ang2pix(_angles(image.frame, geometry))]
        return np.ones(values.shape, bool), values
    column, row = (np.rint(place) for place in _pixel_places(image, geometry))
    n_y, n_x = image.values.shape
    inside = (column >= 0) & (column < n_x) & (row >= 0) & (row < n_y)  # False for NaN
    values = np.full(column.shape, np.nan)
    values[inside] = image.values[row[inside].astype(int), column[inside].astype(int)]
    return inside, values


# ---------------------------------------------------------------- directions


@lru_cache
def _rotation(frame: str) -> np.ndarray:
    """Matrix (3, 3) that turns unit vectors from ICRS into a frame."""
    if frame == "equatorial":
        return np.eye(3)
    from astropy.coordinates import SkyCoord

    axes = SkyCoord(*np.eye(3), representation_type="cartesian", frame="icrs")
    turned = axes.transform_to("galactic" if frame == "galactic" else "barycentricmeanecliptic")
    return turned.cartesian.xyz.value


def _unit_vectors(longitude_rad: np.ndarray, latitude_rad: np.ndarray) -> np.ndarray:
    cos = np.cos(latitude_rad)
    return np.stack([cos * np.cos(longitude_rad), cos * np.sin(longitude_rad), np.sin(latitude_rad)])


def _vectors(frame: str, geometry: MapGeometry) -> np.ndarray:
    """Unit vectors (3, n_y, n_x) of the cells of a grid in a frame."""
    ra, dec = plane_directions(geometry, *pixel_centres(geometry))
    vectors = _unit_vectors(ra, dec)
    return vectors if frame == "equatorial" else np.tensordot(_rotation(frame), vectors, axes=1)


def _angles(frame: str, geometry: MapGeometry) -> np.ndarray:
    """Colatitude and longitude (n_y, n_x, 2) of the cells of a grid in a frame [rad]."""
    x, y, z = _vectors(frame, geometry)
    return np.stack([np.arctan2(np.hypot(x, y), z), np.arctan2(y, x) % (2 * np.pi)], axis=-1)


def _pixel_places(image: SkyImage, geometry: MapGeometry) -> tuple[np.ndarray, np.ndarray]:
    """Column and row (n_y, n_x) of an image, from 0, at the cells of a grid; NaN where its projection has no place."""
    colatitude, longitude = np.moveaxis(_angles(image.frame, geometry), -1, 0)
    return image.wcs.world_to_pixel_values(np.degrees(longitude), 90 - np.degrees(colatitude))


def _finest_side(image: SkyImage, geometry: MapGeometry) -> float:
    """Smallest side [rad] of the pixels of an image in a grid: those of a cylinder are narrow far from its equator."""
    few = replace(geometry, pixel_rad=geometry.pixel_rad * max(geometry.n_y, geometry.n_x) / 3, n_y=3, n_x=3)
    column, row = _pixel_places(image, few)
    sides = []
    for across, along in ((0.5, 0.0), (0.0, 0.5)):
        ends = (image.wcs.pixel_to_world_values(column + s * across, row + s * along) for s in (-1, 1))
        first, last = (_unit_vectors(*np.radians(end)) for end in ends)
        sides.append(np.sqrt(np.sum((first - last) ** 2, axis=0)))
    return float(np.fmin.reduce(np.ravel(sides), initial=image.pixel_rad))  # NaN where the projection has no place


# ---------------------------------------------------------------- images


def _refinement(image: SkyImage, geometry: MapGeometry) -> int:
    """Cells of the convolution along the side of a cell of the grid: odd, so that they share their centres."""
    ratio = geometry.pixel_rad / _finest_side(image, geometry) / FINEST_CELL
    return 1 + 2 * max(0, math.ceil((ratio * (1 - 1e-9) - 1) / 2))


def _fine_places(image: SkyImage, wide: MapGeometry, cells: MapGeometry, fine: int) -> tuple[np.ndarray, np.ndarray]:
    """Column and row of an image at fine cells: linear between cells of a grid, over which projections hardly bend.

    Exact where columns or rows jump, as at the seam of a map of the whole sky.
    """
    column, row = _pixel_places(image, wide)
    reach = _JUMP * wide.pixel_rad / image.pixel_rad
    if fine == 1 or any(np.abs(np.diff(place, axis=axis)).max() > reach for place in (column, row) for axis in (0, 1)):
        return (column, row) if fine == 1 else _pixel_places(image, cells)
    return _between(_between(column, fine).T, fine).T, _between(_between(row, fine).T, fine).T


def _between(places: np.ndarray, fine: int) -> np.ndarray:
    """Interpolate along the first axis, `fine` values for each, at the centres of the parts of cells."""
    n = len(places)
    at = (np.arange(n * fine) + 0.5) / fine - 0.5
    first = np.clip(np.floor(at).astype(int), 0, n - 2)
    share = (at - first)[:, None]
    return places[first] * (1 - share) + places[first + 1] * share


def _joined(image: SkyImage, values: np.ndarray) -> tuple[np.ndarray, int]:
    """Repeat the outer columns of a cylinder around the whole sky, whose sides meet; return it with their number."""
    around = values.shape[1] * abs(image.wcs.pixel_scale_matrix[0, 0])
    if image.wcs.wcs.ctype[0][-3:] not in _CYLINDERS or not math.isclose(around, 360, rel_tol=1e-6):
        return values, 0
    return np.pad(values, ((0, 0), (_REPEATED, _REPEATED)), mode="wrap"), _REPEATED


def _image_on_grid(image: SkyImage, geometry: MapGeometry, extra_rad: tuple[float, ...]) -> np.ndarray:
    from scipy.fft import irfft2, rfft2
    from scipy.ndimage import map_coordinates

    wide, (below, left) = _widened(geometry, max(extra_rad))
    fine = _refinement(image, geometry)
    cells = MapGeometry(wide.ra0_rad, wide.dec0_rad, wide.pixel_rad / fine, wide.n_x * fine, wide.n_y * fine)
    column, row = _fine_places(image, wide, cells, fine)
    n_y, n_x = image.values.shape
    # Half a pixel beyond the outer centres still lies on the map.
    inside = (column >= -0.5) & (column <= n_x - 0.5) & (row >= -0.5) & (row <= n_y - 0.5)
    sky = np.zeros(column.shape)
    known, beyond = _joined(image, np.where(np.isfinite(image.values), image.values, 0.0))
    sky[inside] = map_coordinates(known, [row[inside], column[inside] + beyond], order=_ORDER, mode="nearest")
    modes, ell = rfft2(sky), mode_ell(cells.n_y, cells.n_x, cells.pixel_rad)
    middle = fine // 2
    found = np.empty((len(extra_rad), geometry.n_y, geometry.n_x))
    for plane, width in zip(found, extra_rad, strict=True):
        smooth = irfft2(modes * _amplitude(ell, width), sky.shape)[middle::fine, middle::fine]
        plane[:] = smooth[below : below + geometry.n_y, left : left + geometry.n_x]
    return found


def _amplitude(ell: np.ndarray, fwhm_rad: float) -> np.ndarray:
    """Amplitude that a Gaussian beam leaves of a multipole."""
    return np.exp(-(ell**2) * (fwhm_rad**2 / (16 * math.log(2))))


# ---------------------------------------------------------------- HEALPix


def _highest_multipole(image: SkyImage, extra_rad: float) -> int:
    most = 3 * math.isqrt(len(image.values) // 12) - 1
    return (
        most if extra_rad == 0 else min(most, math.ceil(math.sqrt(-16 * math.log(2) * math.log(_FAINTEST)) / extra_rad))
    )


def _healpix_on_grid(image: SkyImage, geometry: MapGeometry, extra_rad: tuple[float, ...]) -> np.ndarray:
    from ducc0.healpix import Healpix_Base
    from ducc0.sht import pseudo_analysis, synthesis_general

    lmax = _highest_multipole(image, min(extra_rad))
    known = np.where(np.isfinite(image.values), image.values, 0.0)
    rings = Healpix_Base(math.isqrt(len(known) // 12), "RING").sht_info()
    # One thread, so that no bit depends on the machine.
    alm = pseudo_analysis(
        map=known[None], lmax=lmax, spin=0, nthreads=1, maxiter=_ITERATIONS, epsilon=_TOLERANCE, **rings
    )[0]
    multipole = np.concatenate([np.arange(m, lmax + 1) for m in range(lmax + 1)])
    places = _angles(image.frame, geometry).reshape(-1, 2)
    found = np.empty((len(extra_rad), geometry.n_y, geometry.n_x))
    for plane, width in zip(found, extra_rad, strict=True):
        smooth = alm * _amplitude(np.sqrt(multipole * (multipole + 1.0)), width)
        at = synthesis_general(alm=smooth, loc=places, spin=0, lmax=lmax, epsilon=1e-6, nthreads=1)
        plane[:] = at.reshape(plane.shape)
    return found
