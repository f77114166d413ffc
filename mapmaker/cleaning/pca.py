"""Cleaning by principal component analysis (Sayers et al. 2010, "Adaptive Principal Component Analysis").

The leading eigenvectors of each scan's covariance are projected out. Their number follows from a criterion:

- "sigma_cut": log-eigenvalues that are outliers, as in the paper.
- "modes": a fixed number.
- "variance": the fewest that hold a share of the variance of all.
- "marchenko_pastur": eigenvalues above those of white noise. With n samples of p detectors of variance v they reach up
  to v (1 + sqrt(p / n))^2 (Marchenko & Pastur 1967); v is the mean of the eigenvalues that remain.

Eigenvalues that are zero except for rounding, because of fewer samples than detectors or of an earlier cleaning, are
not counted in the distribution.

A matrix of at most `MOST_DENSE` detectors (or samples, if fewer) has all its eigenvectors computed. A larger one is
reduced to tridiagonal form, which gives all eigenvalues, and only the eigenvectors that are projected out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import floor
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from mapmaker.cleaning.scans import Cleaned, Fit, checks_streams, clean_scans, has_dead
from mapmaker.errors import InsufficientDataError
from mapmaker.validation import argument_error, number, whole

if TYPE_CHECKING:
    from mapmaker.timestreams import FocalPlane

# Modes with less than this fraction of the strongest detector's power are rounding. Rounding of float32 streams, which
# earlier cleaning leaves in place of a template, is at most a quarter of it.
_ZERO = 2.0**-46
# The Gram matrix rounds its small eigenvalues by some 1e-16 of the largest. Where they are below this fraction, the
# singular values of the streams are used, which takes twice the time.
_BURIED = 1e-11
# The largest matrix with all eigenvectors, which take as long as its reduction to tridiagonal form or longer.
MOST_DENSE = 4000
_STRONG = 8.0  # times the median eigenvalue: modes that are removed before the others are measured anew
_MOST_SIGMA = 1e6  # larger cuts need more detectors than any camera has
# Logarithms of equal eigenvalues differ by rounding, which must not count as outliers.
_ROUNDING = 1e-9


SIGMA_CUT, MODES, VARIANCE, MARCHENKO_PASTUR = "sigma_cut", "modes", "variance", "marchenko_pastur"
CRITERIA = (SIGMA_CUT, MODES, VARIANCE, MARCHENKO_PASTUR)


@dataclass(frozen=True)
class PcaOptions:
    """Options of PCA cleaning: a criterion of the modes to remove, and the number that it needs.

    Attributes
    ----------
    sigma_cut
        Standard deviations of log(eigenvalue) above the mean from which on an eigenvalue is an outlier; 3 in the paper.
    criterion
        One of `CRITERIA`.
    modes
        Number of modes.
    variance
        Least share of the variance of all detectors that the removed modes hold.
    """

    sigma_cut: float | None = None
    criterion: str = SIGMA_CUT
    modes: int | None = None
    variance: float | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range, a missing one, and one of another criterion."""
        if not isinstance(self.criterion, str) or self.criterion not in CRITERIA:
            raise argument_error("criterion", repr(self.criterion), f"one of {', '.join(map(repr, CRITERIA))} is")
        for name in (SIGMA_CUT, MODES, VARIANCE):
            if name != self.criterion and getattr(self, name) is not None:
                raise argument_error(name, f"a value with criterion {self.criterion!r}", "None is")
        if self.criterion == SIGMA_CUT:
            number("sigma_cut", self.sigma_cut, above=0, most=_MOST_SIGMA)
        elif self.criterion == MODES:
            whole("modes", self.modes, least=1)
        elif self.criterion == VARIANCE:
            number("variance", self.variance, above=0, below=1)


def needed_eigenvalues(options: PcaOptions) -> int:
    """Least number of eigenvalues of a scan for a criterion: one mode can stand out, and one remains."""
    if options.sigma_cut is not None:
        return min_eigenvalues(options.sigma_cut)
    return 2 if options.modes is None else options.modes + 1


def min_eigenvalues(sigma_cut: float) -> int:
    """Least number of values of which one can be more than `sigma_cut` standard deviations above their mean.

    One value apart from n - 1 equal ones is sqrt(n - 1) above the mean, and none can be further.
    """
    return floor(sigma_cut**2) + 2


@threadpool_limits.wrap(limits=1)  # small eigenproblems: more threads are slower and change the last bits
@checks_streams
def subtract_pca(data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: PcaOptions) -> Cleaned:
    """Remove the mean and the outlier modes; arguments, result and errors as for `clean`.

    `removed` is the number of modes; responsivities are 1, without iterations. In a scan of few samples there may be
    too few eigenvalues for the criterion; it loses its mean alone. A scan with enough samples but too few eigenvalues
    above rounding is discarded: the atmosphere exceeds the noise by some 10^7, or earlier cleaning removed the others.
    Source: Sayers et al. (2010), "Adaptive Principal Component Analysis (PCA)".

    Raises
    ------
    ValueError
        For too few detectors.
    """
    needed = needed_eigenvalues(options)
    if len(data_mk) < needed:
        asked = f"a cut at {options.sigma_cut} sigma" if options.sigma_cut is not None else "PCA"
        raise InsufficientDataError(f"{asked} needs at least {needed} detectors, got {len(data_mk)}")
    return clean_scans(data_mk, scan_bounds, lambda block, scan: _project(block, options))


def count_outliers(eigenvalues: np.ndarray, sigma_cut: float) -> int:
    """Count the outliers at the upper end of positive eigenvalues in rising order."""
    logarithm = np.log(eigenvalues)
    n_left = len(logarithm)
    while n_left > 0:
        rest = logarithm[:n_left]
        limit = rest.mean() + max(sigma_cut * rest.std(), _ROUNDING)
        within = int(np.searchsorted(rest, limit, side="right"))
        if within == n_left:
            break
        n_left = within
    return len(logarithm) - n_left


def count_modes(eigenvalues: np.ndarray, options: PcaOptions, *, n_det: int, n_samp: int) -> int:
    """Count the modes that a criterion removes.

    Parameters
    ----------
    eigenvalues : (n,)
        Positive eigenvalues of the Gram matrix of mean-removed streams, in rising order.
    options
    n_det
        Dimensions that the streams span, or would with more samples.
    n_samp
        Independent samples: one fewer than the scan has, for its mean.
    """
    if options.sigma_cut is not None:
        return count_outliers(eigenvalues, options.sigma_cut)
    if options.modes is not None:
        return options.modes
    falling = eigenvalues[::-1]
    if options.variance is not None:
        held = np.cumsum(falling) / falling.sum()
        return min(1 + int(np.searchsorted(held, options.variance * (1 - 1e-12))), len(falling) - 1)
    return _count_above_white(falling, n_det, n_samp)


def _count_above_white(falling: np.ndarray, n_det: int, n_samp: int) -> int:
    """Count the eigenvalues above those of white noise with the mean of the others; one at least remains."""
    left = np.cumsum(falling[::-1])[::-1]  # sum from each eigenvalue on
    for k in range(len(falling) - 1):
        size = n_det - k
        # Each mode takes a dimension of the samples too.
        if falling[k] <= left[k] / size * (1 + np.sqrt(size / (n_samp - k))) ** 2:
            return k
    return len(falling) - 1


def _project(block: np.ndarray, options: PcaOptions) -> Fit:
    """Project the modes of a criterion out of one mean-removed scan, in place."""
    if has_dead(block):
        return Fit(None)
    n_det, n_samp = block.shape
    across = n_det <= n_samp
    eigenvalues, leading = (
        _spectrum(block, across) if min(block.shape) <= MOST_DENSE else _large_spectrum(block, across)
    )
    most = min(n_det, n_samp - 1)
    rank = int(np.sum(eigenvalues[len(eigenvalues) - most :] > _ZERO * np.square(block).sum(axis=1).max()))
    needed = needed_eigenvalues(options)
    if rank < needed <= most:
        return Fit(None)
    spanned = {"n_det": n_det - (most - rank), "n_samp": n_samp - 1}
    n_modes = count_modes(eigenvalues[len(eigenvalues) - rank :], options, **spanned) if needed <= most else 0
    _remove(block, leading(n_modes), across)
    return Fit(np.ones(n_det), 0, n_modes)


def _remove(block: np.ndarray, modes: np.ndarray, across: bool) -> None:
    """Project modes (columns) of the detectors if `across`, else of the samples, out of a scan, in place."""
    block -= modes @ (modes.T @ block) if across else (block @ modes) @ modes.T


def _gram(block: np.ndarray, across: bool) -> np.ndarray:
    return block @ block.T if across else block.T @ block


def _is_buried(eigenvalues: np.ndarray, across: bool) -> bool:
    """Tell whether rounding reaches the smallest eigenvalue."""
    # For samples, the mean is a mode without power.
    return not eigenvalues[0 if across else 1] > _BURIED * eigenvalues[-1]


_Spectrum = tuple[np.ndarray, Callable[[int], np.ndarray]]


def _spectrum(block: np.ndarray, across: bool) -> _Spectrum:
    """Eigenvalues in rising order, and a function of k: the k leading modes of the detectors if `across`, else samples.

    Both have the same non-zero eigenvalues: the smaller matrix is faster.
    """
    eigenvalues, vectors = np.linalg.eigh(_gram(block, across))
    if _is_buried(eigenvalues, across):
        left, singular, right = np.linalg.svd(block, full_matrices=False)
        eigenvalues, vectors = singular[::-1] ** 2, (left if across else right.T)[:, ::-1]
    return eigenvalues, lambda k: vectors[:, len(eigenvalues) - k :]


def _large_spectrum(block: np.ndarray, across: bool) -> _Spectrum:
    """Compute `_spectrum` without the eigenvectors of small eigenvalues; eigenvalues that are rounding are 0."""
    eigenvalues, leading = _tridiagonal_spectrum(_gram(block, across))
    n, largest = len(eigenvalues), eigenvalues[-1]
    strong = int(np.sum(eigenvalues > _STRONG * np.median(eigenvalues)))
    if strong and _is_buried(eigenvalues, across):
        weak = block.copy()
        _remove(weak, leading(strong), across)
        # The lowest eigenvalues are those of the removed modes.
        eigenvalues[: n - strong] = np.linalg.eigvalsh(_gram(weak, across))[strong:]
        largest = eigenvalues[n - strong - 1]
    eigenvalues[eigenvalues < n * np.finfo(float).eps * largest] = 0.0
    return eigenvalues, leading


def _tridiagonal_spectrum(matrix: np.ndarray) -> _Spectrum:
    """Eigenvalues of a symmetric matrix in rising order, and a function of k: the k leading eigenvectors (columns).

    The matrix is overwritten.
    """
    from scipy.linalg import eigh_tridiagonal, eigvalsh_tridiagonal
    from scipy.linalg.lapack import dormqr, dsytrd, dsytrd_lwork

    n = len(matrix)
    with threadpool_limits(limits=1):  # of scipy's own library too, once it is imported
        work = int(dsytrd_lwork(n, lower=1)[0])
        reflectors, diagonal, off_diagonal, tau, _ = dsytrd(matrix.T, lower=1, lwork=work, overwrite_a=1)
        eigenvalues = eigvalsh_tridiagonal(diagonal, off_diagonal)

    @threadpool_limits.wrap(limits=1)
    def leading(k: int) -> np.ndarray:
        if k == 0:
            return np.zeros((n, 0))
        vectors = eigh_tridiagonal(diagonal, off_diagonal, select="i", select_range=(n - k, n - 1))[1]
        # The first row and column are not reflected.
        vectors[1:] = dormqr("L", "N", reflectors[1:, :-1], tau, vectors[1:], 64 * k)[0]
        return vectors

    return eigenvalues, leading
