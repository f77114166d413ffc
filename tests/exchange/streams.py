"""Time-streams for the tests of exchange, and the lines of sight of their detectors, computed from scratch."""

import numpy as np

from mapmaker.timestreams import FocalPlane, Timestreams

ARCSEC = np.radians(1 / 3600)
N_DET, N_SAMP = 7, 600


def streams(*, flagged=False, noise_mk=1.0):
    """Four scans across RA 0 at declination 52, two of them side by side, numbered from 100; the array turns."""
    rng = np.random.default_rng(1)
    names = np.array([f"d{number}" for number in range(N_DET)])
    plane = FocalPlane(*rng.normal(0, 2e-3, (2, N_DET)), 2.9e-4, rng.uniform(-1.5, 1.5, N_DET), names)
    time = 1.6e9 + np.arange(N_SAMP) / 20
    ra, dec = 6.28 + 0.01 * np.sin(np.arange(N_SAMP) / 60), 0.9 + 0.005 * np.linspace(-1, 1, N_SAMP)
    angle, scan = 1 + 0.2 * np.linspace(0, 1, N_SAMP), np.repeat([-1, 100, 101, -1, 7000, 7001], N_SAMP // 6)
    data = (100 + noise_mk * rng.normal(size=(N_DET, N_SAMP))).astype(np.float32)
    lost = rng.random((N_DET, N_SAMP)) < 0.05 if flagged else None
    return Timestreams(data, time, ra, dec, angle, scan, plane, {"seed": 3, "scene": "small", "b2_mk2": 280.5}, lost)


def sights(made):
    """Unit vectors (n_det, n_samp, 3) to the detectors, by rotations of the axes of the sky."""
    ra, dec, angle = made.ra_rad, made.dec_rad, made.array_angle_rad
    sight = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    east = np.array([-np.sin(ra), np.cos(ra), 0 * ra])
    up, right = north * np.cos(angle) + east * np.sin(angle), north * np.sin(angle) - east * np.cos(angle)
    plane = made.focal_plane
    vectors = sight + np.multiply.outer(plane.x_rad, right) + np.multiply.outer(plane.y_rad, up)
    return np.moveaxis(vectors / np.linalg.norm(vectors, axis=1)[:, None], 1, -1)


def apart(one, other):
    """Largest angle [rad] between unit vectors (..., 3)."""
    return float(np.linalg.norm(one - other, axis=-1).max())
