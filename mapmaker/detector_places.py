"""Places of detectors in the tangent plane of a map: a homography of their offsets for each sample.

An array is a plane that touches the sky at the boresight; the map is another, which touches it at the centre. Lines of
sight map one to the other by a homography, which is exact at any distance from the centre: a detector at (x, y) lies at
``(h0 + h1 x + h2 y) / (1 + h6 x + h7 y)`` along xi and at ``(h3 + h4 x + h5 y) / (1 + h6 x + h7 y)`` along eta.
"""

import numpy as np

_Vector = tuple[np.ndarray, np.ndarray, np.ndarray]  # along east, north and the direction of the centre


def array_homography(
    dec0_rad: float, xi_rad: np.ndarray, eta_rad: np.ndarray, plane_angle_rad: np.ndarray
) -> np.ndarray:
    """Compute the homographies (8, n_samp) from offsets in the array to the tangent plane of a map [rad].

    Parameters
    ----------
    dec0_rad
        Declination of the centre of the map.
    xi_rad, eta_rad : (n_samp,)
        Boresight in the plane.
    plane_angle_rad : (n_samp,)
        Position angle of the array's y axis at the boresight plus `mapmaker.geometry.north_angle`.
    """
    length = np.sqrt(1 + xi_rad**2 + eta_rad**2)
    first, second = _meridian_axes(dec0_rad, xi_rad, eta_rad, length)
    cos, sin = np.cos(plane_angle_rad) * length, np.sin(plane_angle_rad) * length
    x_axis = [sin * a - cos * b for a, b in zip(first, second, strict=True)]
    y_axis = [cos * a + sin * b for a, b in zip(first, second, strict=True)]
    return np.stack([xi_rad, x_axis[0], y_axis[0], eta_rad, x_axis[1], y_axis[1], x_axis[2], y_axis[2]])


def to_pixels(homography: np.ndarray, pixel_rad: float, column0: float, row0: float) -> np.ndarray:
    """Convert homographies (8, n_samp) to columns and rows of a map with its centre at (column0, row0)."""
    xi, eta, depth = homography[:3] / pixel_rad, homography[3:6] / pixel_rad, homography[6:]
    column, row = -xi, eta
    column[0] += column0
    column[1:] += column0 * depth
    row[0] += row0
    row[1:] += row0 * depth
    return np.concatenate([column, row, depth])


def _meridian_axes(
    dec0_rad: float, xi_rad: np.ndarray, eta_rad: np.ndarray, length: np.ndarray
) -> tuple[_Vector, _Vector]:
    """Unit vectors at the boresight with the plane angles 0 and 90 degrees.

    They are true north and east there, turned by the angle of the meridian in the plane.
    """
    sin0, cos0 = np.sin(dec0_rad), np.cos(dec0_rad)
    toward, aside = cos0 - eta_rad * sin0, -xi_rad * sin0
    at_pole = (toward == 0) & (xi_rad == 0)  # where all directions are south: the plane's own axes
    toward = np.where(at_pole, 1.0, toward)
    east_length, meridian = np.hypot(toward, xi_rad), np.hypot(toward, aside)
    zero = np.zeros_like(xi_rad)
    east = toward / east_length, -aside / east_length, np.where(at_pole, zero, -cos0 * xi_rad) / east_length
    north = (
        (eta_rad * east[2] - east[1]) / length,
        (east[0] - xi_rad * east[2]) / length,
        (xi_rad * east[1] - eta_rad * east[0]) / length,
    )
    cos, sin = toward / meridian, aside / meridian
    first = tuple(cos * n - sin * e for n, e in zip(north, east, strict=True))
    second = tuple(sin * n + cos * e for n, e in zip(north, east, strict=True))
    return first, second
