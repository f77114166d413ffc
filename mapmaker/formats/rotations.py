"""Rotations as unit quaternions (w, x, y, z), and directions on the sky."""

import numpy as np


def about_axis(axis: int, angle_rad: np.ndarray | float) -> np.ndarray:
    """Right-handed rotations (..., 4) about the axis 0, 1 or 2."""
    half = np.asarray(angle_rad, dtype=np.float64) / 2
    result = np.zeros((*half.shape, 4))
    result[..., 0], result[..., axis + 1] = np.cos(half), np.sin(half)
    return result


def product(*rotations: np.ndarray) -> np.ndarray:
    """Rotations, the last one first."""
    result, *others = rotations
    for other in others:
        a, b = result[..., :1], result[..., 1:]
        c, d = other[..., :1], other[..., 1:]
        real = a * c - (b * d).sum(axis=-1, keepdims=True)
        result = np.concatenate([real, a * d + c * b + np.cross(b, d)], axis=-1)
    return result


def rotated(rotations: np.ndarray, vector: tuple[float, float, float]) -> np.ndarray:
    """Rotate a vector by each of the rotations (..., 4) of any length."""
    unit = rotations / np.linalg.norm(rotations, axis=-1, keepdims=True)
    real, axis = unit[..., :1], unit[..., 1:]
    twice = 2 * np.cross(axis, vector)
    return vector + real * twice + np.cross(axis, twice)


def sky_axes(ra_rad: np.ndarray, dec_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors (..., 3) of directions, and of east and north there."""
    (sin_ra, sin_dec), (cos_ra, cos_dec) = ((wave(ra_rad), wave(dec_rad)) for wave in (np.sin, np.cos))
    sight = np.stack([cos_dec * cos_ra, cos_dec * sin_ra, sin_dec], axis=-1)
    east = np.stack([-sin_ra, cos_ra, np.zeros_like(sin_ra)], axis=-1)
    north = np.stack([-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec], axis=-1)
    return sight, east, north


def directions(sight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Right ascension (0 to a turn) and declination [rad] of vectors (..., 3) of any length."""
    x, y, z = np.moveaxis(sight, -1, 0)
    return np.arctan2(y, x) % (2 * np.pi), np.arctan2(z, np.hypot(x, y))


def sky_angles(sight: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right ascension, declination and position angle [rad] of directions and of a second axis square to each.

    Parameters
    ----------
    sight, up : (..., 3)
        Unit vectors.

    Returns
    -------
    ra_rad, dec_rad, angle_rad
        Right ascensions and angles from 0 to a turn.
    """
    ra, dec = directions(sight)
    _, east, north = sky_axes(ra, dec)
    angle = np.arctan2((up * east).sum(axis=-1), (up * north).sum(axis=-1))
    return ra, dec, angle % (2 * np.pi)
