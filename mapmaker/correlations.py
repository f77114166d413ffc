"""Correlations between detectors: covariance of every pair, and its profile with separation (paper, section 3.2).

The signal of the atmosphere is so similar in all detectors that its correlation falls by only a part in a thousand over
the array, while gains differ by percents. The profile is therefore solved for together with the detectors' gains, by
linear least squares over pairs: ``ln C_ij = ln g_i + ln g_j + p(separation of i and j)``.
"""

from dataclasses import dataclass

import numpy as np

from mapmaker.errors import InsufficientDataError
from mapmaker.timestreams import FocalPlane
from mapmaker.validation import argument_error, bounds_of_scans, reals

# In units of the closest separation: limit of adjacent pairs, and width of a bin of separation.
ADJACENT = 1.2
BIN_WIDTH = 1.0
# Eigenvalues of pair counts below this fraction of the largest are zero except for rounding; a bin of one pair among
# thousands of detectors is above it.
_ALIKE = 1e-12


@dataclass(frozen=True)
class PairBins:
    """Pairs of detectors in bins of separation, with adjacent pairs apart.

    Attributes
    ----------
    first, second, separation_rad : (n_pair,)
        Detectors and separation of each pair.
    bin : (n_pair,)
        Bin of each pair; -1 for adjacent pairs.
    theta_rad : (n_bin,)
        Root mean square separation, because correlations fall nearly with its square.
    count : (n_bin,)
    solve : (n_bin, n_distant)
        Matrix from ln C of pairs that are not adjacent to the profile.
    """

    first: np.ndarray
    second: np.ndarray
    separation_rad: np.ndarray
    bin: np.ndarray
    theta_rad: np.ndarray
    count: np.ndarray
    solve: np.ndarray

    @property
    def adjacent(self) -> np.ndarray:
        """Flags (n_pair,) of adjacent pairs."""
        return self.bin < 0

    def mean(self, per_pair: np.ndarray) -> np.ndarray:
        """Average values (n_pair,) over the pairs of each bin, (n_bin,)."""
        distant = ~self.adjacent
        return np.bincount(self.bin[distant], per_pair[distant]) / self.count


@dataclass(frozen=True)
class Profile:
    """Correlation against separation in one observation; the last three are NaN where an average C_ij is not positive.

    Attributes
    ----------
    covariance_mk2 : (n_bin,)
        Means of C_ij.
    adjacent_mk2
        Mean of C_ij over adjacent pairs.
    log_profile : (n_bin,)
        ln C less its mean over bins, independent of gains.
    scan_profiles : (n_scan, n_bin)
        The same with one scan left out.
    log_level
        Mean of ln C over pairs.
    """

    covariance_mk2: np.ndarray
    adjacent_mk2: float
    log_profile: np.ndarray
    scan_profiles: np.ndarray
    log_level: float


def pair_bins(focal_plane: FocalPlane) -> PairBins:
    """Sort the pairs of a focal plane into bins of separation.

    Raises
    ------
    ValueError
        For fewer than three detectors, two detectors at one position, arrays with adjacent pairs only, and positions
        that can't separate a profile from gains.
    """
    n_det = len(focal_plane.x_rad)
    if n_det < 3:
        raise InsufficientDataError(
            f"found {n_det} detectors; 3 or more are expected for correlations against separation"
        )
    first, second = np.triu_indices(n_det, 1)
    apart = np.hypot(*(axis[first] - axis[second] for axis in (focal_plane.x_rad, focal_plane.y_rad)))
    pitch = apart.min()
    if not pitch > 1e-6 * apart.max():
        raise InsufficientDataError("found two detectors in one place; different places are expected")
    number = np.floor((apart / pitch - ADJACENT) / BIN_WIDTH + 1e-9).astype(int)
    distant = number >= 0
    if not distant.any():
        raise InsufficientDataError("found adjacent pairs of detectors only; pairs further apart are expected")
    used, bins = np.unique(number[distant], return_inverse=True)
    number = np.where(distant, 0, -1)
    number[distant] = bins
    count = np.bincount(bins)
    theta = np.sqrt(np.bincount(bins, apart[distant] ** 2) / count)
    solve = _profile_solution(first[distant], second[distant], bins, n_det)
    return PairBins(first, second, apart, number, theta, count, solve)


def _profile_solution(first: np.ndarray, second: np.ndarray, bins: np.ndarray, n_det: int) -> np.ndarray:
    """Matrix (n_bin, n_pair) from ln C to the profile with mean 0, independent of gains."""
    n_bin = bins.max() + 1
    n = n_det + n_bin
    # Three ones a pair: the normal equations count pairs, which is exact, and thousands of detectors fit in memory.
    columns = np.stack([first, second, n_det + bins])
    counts = np.sum([np.bincount(a * n + b, minlength=n * n) for a in columns for b in columns], axis=0).reshape(n, n)
    values, vectors = np.linalg.eigh(counts.astype(float))
    told_apart = values > _ALIKE * values[-1]
    # A level common to all bins is degenerate with the gains; every other direction must be determined.
    unused = n_det - len(np.union1d(first, second))
    if told_apart.sum() < n - 1 - unused:
        raise InsufficientDataError(
            f"found {n_det} detectors whose places can't tell correlations from gains; more are expected"
        )
    inverse = (vectors[n_det:, told_apart] / values[told_apart]) @ vectors[:, told_apart].T
    solution = sum(inverse[:, column] for column in columns)
    return solution - solution.mean(axis=0)


def scan_covariances(data_mk: np.ndarray, scan_bounds: np.ndarray) -> np.ndarray:
    """Covariance C_ij of each mean-removed scan.

    Parameters
    ----------
    data_mk : (n_det, n_samp)
    scan_bounds : (n_scan, 2)

    Returns
    -------
    (n_scan, n_det, n_det) array
        [mK^2].

    Raises
    ------
    ValueError
        For arrays that do not match, no scan, and values in a scan that are not finite.
    """
    data_mk = reals("data_mk", data_mk, ("n_det", "n_samp"), finite=False)
    covariances = []
    for start, stop in bounds_of_scans(scan_bounds, data_mk.shape[1]):
        block = data_mk[:, start:stop].astype(np.float64)
        block -= block.mean(axis=1, keepdims=True)
        covariances.append(block @ block.T / (stop - start))
    if not covariances:
        raise InsufficientDataError("scan_bounds: found no scan; one or more are expected")
    found = np.array(covariances)
    if not np.isfinite(found).all():
        raise argument_error("data_mk", "values that are not finite in scans", "finite ones are")
    return found


def correlation_profile(covariances_mk2: np.ndarray, bins: PairBins) -> Profile:
    """Profile of correlation against separation.

    Parameters
    ----------
    covariances_mk2 : (n_scan, n_det, n_det)
        From `scan_covariances`.
    bins
        Pairs of the same detectors.

    Raises
    ------
    ValueError
        For covariances of other detectors, and for values that are not finite.
    """
    n_det = int(bins.second.max()) + 1
    covariances_mk2 = reals("covariances_mk2", covariances_mk2, ("n_scan", n_det, n_det))
    pairs = covariances_mk2[:, bins.first, bins.second]
    mean, distant, n_scan = pairs.mean(axis=0), ~bins.adjacent, len(pairs)
    adjacent = float(mean[bins.adjacent].mean()) if bins.adjacent.any() else np.nan
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = np.log(mean[distant])
        others = np.log((n_scan * mean[distant] - pairs[:, distant]) / max(1, n_scan - 1))
    whole = np.isfinite(logs).all() and np.isfinite(others).all()
    if not whole:
        n_bin = len(bins.count)
        nothing = np.full((n_scan, n_bin), np.nan)
        return Profile(bins.mean(mean), adjacent, nothing[0], nothing, np.nan)
    return Profile(bins.mean(mean), adjacent, bins.solve @ logs, others @ bins.solve.T, float(logs.mean()))
