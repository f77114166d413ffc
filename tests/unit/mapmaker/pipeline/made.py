"""Small files of time-streams: common drift, gains, white noise, a source in the centre; and ways to harm them."""

from dataclasses import replace

import numpy as np

import mapmaker as mm
from mapmaker.geometry import north_angle, plane_directions

ARCMIN = np.radians(1 / 60)
N_SIDE, N_SCAN, N, GAP, RATE_HZ = 5, 12, 160, 6, 16.0
N_DET = N_SIDE**2
WHITE_MK, SOURCE_MK = 2.0, 20.0
CENTRE = (132.3, 44.84)


def streams(seed, centre_deg=CENTRE, *, first_scan=0, source_mk=SOURCE_MK, drift_mk=20.0, white_mk=WHITE_MK):
    """25 detectors; 12 scans of 10 s and 20 arcmin, along right ascension for even seeds, else along declination."""
    rng = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(*[(np.arange(N_SIDE) - 2) * 0.7] * 2))
    along = (np.arange(N) - N / 2 + 0.5) * 20 / N
    pieces = [(along * (-1) ** k, np.full(N, (k - (N_SCAN - 1) / 2) * 1.1)) for k in range(N_SCAN)]
    xi, eta = (np.concatenate([np.append(piece[axis], [piece[axis][-1]] * GAP) for piece in pieces]) for axis in (0, 1))
    if seed % 2:
        xi, eta = eta, xi
    scan = np.concatenate([np.append(np.full(N, first_scan + k), [-1] * GAP) for k in range(N_SCAN)])
    field = mm.MapGeometry(*np.radians(centre_deg), 1e-5, 10, 10)
    ra, dec = plane_directions(field, xi * ARCMIN, eta * ARCMIN)
    squared = (xi - x[:, None]) ** 2 + (eta + y[:, None]) ** 2
    common = drift_mk * np.cumsum(rng.standard_normal(len(xi))) / np.sqrt(N)
    gain = 1 + 0.05 * rng.standard_normal((N_DET, 1))
    data = gain * (common + source_mk * np.exp(-4 * np.log(2) * squared / 1.5**2))
    data += white_mk * rng.standard_normal(data.shape)
    names = np.array([f"d{k:02d}" for k in range(N_DET)])
    plane = mm.FocalPlane(x * ARCMIN, y * ARCMIN, 1.5 * ARCMIN, names=names)
    angle = -north_angle(field, xi * ARCMIN, eta * ARCMIN)
    return mm.Timestreams(data, np.arange(len(xi)) / RATE_HZ, np.unwrap(ra), dec, angle, scan, plane)


def changed(item, change):
    """Streams with other data; `change` works in place on (n_det, n_samp), with the bounds of the scans."""
    data = item.data_mk.copy()
    change(data, item.scan_bounds)
    return replace(item, data_mk=data)


def written(folder, items):
    """Paths of files of some streams."""
    paths = [folder / f"{k:03d}.h5" for k in range(len(items))]
    for path, item in zip(paths, items, strict=True):
        mm.write_timestreams(path, item)
    return paths
