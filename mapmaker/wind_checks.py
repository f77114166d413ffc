"""Checks of a measured wind: further layers, agreement of scan directions, and slopes of detector pairs.

`mapmaker.wind` states the model.
"""

from math import pi

import numpy as np

from mapmaker.wind_delays import Delays, ScanSpectra

N_PAIR_BINS = 24
# Centred on the angles of a hexagonal lattice's rows, which edges would split by rounding.
CENTRES_RAD = np.arange(N_PAIR_BINS) * (2 * pi / N_PAIR_BINS) - pi
_HANN = 1 + 2 * (4 / 9 + 1 / 36)  # variance of a mean over bins, raised by a Hann taper's correlation of neighbours
_NEIGHBOUR = 1.2  # pairs up to this many nearest separations apart are neighbours
_GOOD_SHARE = 0.01  # departures by this fraction of the sinusoid do not count in a reduced chi^2
# Limits of the residual of one layer: along the wind as a fraction of its signal and in standard deviations above the
# noise; across the wind the residual of a Kolmogorov layer without a beam, which would lower it.
_ALONG_SHARE, _ALONG_SIGMA, _ACROSS_SHARE = 0.1, 2.5, 1.5


def quadratic_shapes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Constant, slopes and curvatures over the array, (n_det, 6), for coordinates of any scale."""
    x, y = x / np.abs(x).max(), y / np.abs(y).max()
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def has_several_layers(spectra: ScanSpectra, found: Delays) -> bool:
    """Tell whether the array's gradient exceeds that of one frozen layer.

    Along the wind an aligned layer leaves only noise, in slope and curvature: the curvature measures the noise,
    whatever its correlation between detectors. Across the wind a layer has gradients of its own.
    """
    k, at_rest, s = slice(found.n_freq), found.aligned, found.slowness @ [1, 1j]
    unit = s.mean() / abs(s.mean())
    turned = (spectra.r_rad.T @ [1, 1j]) * unit.conjugate()
    shapes = np.linalg.pinv(quadratic_shapes(turned.real, turned.imag))[1:4]
    parts = np.moveaxis(at_rest.d[k] @ shapes.T, 2, 0)
    rate, s = at_rest.rate[k], s * unit.conjugate()
    follows = rate - 2j * pi * at_rest.turn_hz[k, None] * at_rest.mean[k]
    size = np.abs(turned.real).max(), np.abs(turned.imag).max()
    parts[:2] += [follows * s.real * size[0], follows * s.imag * size[1]]
    # Relative to the noise, and the signal along the wind on either axis.
    along, across, noise = np.sum(np.abs(parts) ** 2, axis=(1, 2)) / np.sum(shapes**2, axis=1)
    signal_x, signal_y = (np.sum(np.abs(rate * s.real * size[a]) ** 2) / np.sum(shapes[a] ** 2) for a in (0, 1))
    sigma = np.sqrt(2 * _HANN / rate.size)  # standard deviation of the logarithm of a ratio of two powers
    not_noise = along > noise * np.exp(_ALONG_SIGMA * sigma)
    return bool((not_noise and along - noise > _ALONG_SHARE * signal_x) or across - noise > _ACROSS_SHARE * signal_y)


def group_disagreement(found: Delays, groups: list[np.ndarray], scan_velocity: np.ndarray) -> float:
    """Chi^2 per degree of freedom of the difference between the winds of two groups of scans; 0 for one group."""
    if len(groups) == 1:
        return 0.0
    winds = [1 / (found.slowness[scans[0]] @ [1, -1j]) for scans in groups] + scan_velocity
    less = [1 / (found.left_out[scans] @ [1, -1j]) for scans in groups]
    covariance = sum(np.cov([part.real, part.imag], bias=True) * (len(part) - 1) for part in less)
    apart = np.array([(winds[0] - winds[1]).real, (winds[0] - winds[1]).imag])
    return float(apart @ np.linalg.pinv(covariance) @ apart) / 2


def pair_slopes(spectra: ScanSpectra, found: Delays) -> tuple[np.ndarray, np.ndarray, float]:
    """Slopes of all pairs except neighbours against the pair's angle.

    Returns
    -------
    slope, error : (n_bin,)
        [s/rad]; NaN for bins without pairs.
    goodness : float
        Reduced chi^2 about their best sinusoid.
    """
    rest, norm = _pair_sums(spectra, found)
    used = norm.sum(axis=0) > 0
    circle = np.stack([np.cos(CENTRES_RAD), np.sin(CENTRES_RAD)])
    model = 2 * pi * np.mean(found.slowness, axis=0) @ circle
    slope, error = np.full((2, N_PAIR_BINS), np.nan)
    rest, norm = rest[:, used], norm[:, used]
    total = norm.sum(axis=0)
    whole = rest.sum(axis=0) / total
    less = (rest.sum(axis=0) - rest) / (total - norm)
    slope[used], error[used] = model[used] + whole, jackknife_error(less)
    # A change of the sinusoid is common to all bins: only the residuals from it measure the fit.
    root = np.sqrt(total)
    shape = root[:, None] * circle.T[used]
    project = np.eye(len(total)) - shape @ np.linalg.pinv(shape)
    left, scatter = project @ (root * whole), jackknife_error((root * less) @ project)
    floor = _GOOD_SHARE * np.abs(model).max() * root
    # Pairs are counted in both directions, so half of the bins repeat the others.
    return slope, error, float(np.sum(left**2 / (scatter**2 + floor**2)) / max(len(total) - 4, 1))


def jackknife_error(less: np.ndarray) -> np.ndarray:
    """Standard error (n,) from values with one of n_scan left out, (n_scan, n)."""
    return less.std(axis=0) * np.sqrt(len(less) - 1)


def _pair_sums(spectra: ScanSpectra, found: Delays) -> tuple[np.ndarray, np.ndarray]:
    """Sums over pairs and frequencies, (n_scan, n_bin): residual phase, and its divisor [s/rad]."""
    d = found.aligned.d[: found.n_freq]
    first, second = np.nonzero(~np.eye(d.shape[2], dtype=bool))
    x, y = spectra.r_rad[:, second] - spectra.r_rad[:, first]
    apart = np.hypot(x, y)
    far = apart > _NEIGHBOUR * apart[apart > 0].min()
    first, second, apart = first[far], second[far], apart[far]
    bins = np.rint((np.arctan2(y[far], x[far]) + pi) * (N_PAIR_BINS / (2 * pi))).astype(np.int64) % N_PAIR_BINS
    turn = 2 * pi * found.aligned.turn_hz[: found.n_freq, None]
    rest, norm = np.empty((2, d.shape[1], N_PAIR_BINS))
    for scan in range(d.shape[1]):
        now = d[:, scan]
        phase, power = -((turn * now).conj().T @ now).imag, ((turn**2 * now).conj().T @ now).real
        rest[scan] = np.bincount(bins, phase[first, second] * apart, N_PAIR_BINS)
        norm[scan] = np.bincount(bins, power[first, second] * apart**2, N_PAIR_BINS)
    return 2 * pi * rest, norm
