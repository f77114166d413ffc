"""Normal equations of linear map-makers, and their solution by conjugate gradients.

All linear makers solve ``(P^T N^-1 P) m = P^T N^-1 d`` for pointing P and streams d. They differ in N^-1, a
`NoiseWeight`: that of a destriper (`mapmaker.destriping`), or of a maximum-likelihood map (`mapmaker.gls`). For any
symmetric N^-1 a sky without noise is returned exactly, except for modes of the map that N^-1 gives no weight.

Sums over observations are sums of blocks. A block is needed once for the right-hand side, and once for each iteration:
it may be made anew each time, so memory does not grow with the number of observations.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mapmaker.chunks import row_chunks
from mapmaker.conjugate_gradients import block_descent
from mapmaker.map_scaling import scaling
from mapmaker.validation import number, whole

# The residual of the recurrence drifts from the true one: it is computed anew after a descent by this factor.
_ONE_DESCENT = 1e-5


class NoiseWeight(Protocol):
    """Inverse noise covariance N^-1 of the scans of a block."""

    def apply(self, data_mk: np.ndarray, index: np.ndarray, scan_bounds: np.ndarray) -> np.ndarray:
        """Compute ``N^-1 d``.

        Parameters
        ----------
        data_mk : (n_right, n_det, n_samp)
        index : (n_det, n_samp)
            -1 for samples without data.
        scan_bounds : (n_scan, 2)

        Returns
        -------
        (n_right, n_det, n_samp) array
            [1/mK], of the type of the data; outside scans the values are undefined.
        """

    def white(self, scan_bounds: np.ndarray) -> np.ndarray:
        """Weights (n_det, n_scan) of a sample for the white noise alone [1/mK^2]."""


@dataclass(frozen=True)
class NormalBlock:
    """Pointing and noise of the scans of an observation, or of a part of one.

    Attributes
    ----------
    index : (n_det, n_samp)
        Flat pixel of each sample; -1 off the map and for lost samples.
    scan_bounds : (n_scan, 2)
        Scans [start, stop) to map.
    noise
    """

    index: np.ndarray
    scan_bounds: np.ndarray
    noise: NoiseWeight


@dataclass(frozen=True)
class SolveOptions:
    """Convergence of the conjugate gradients.

    Attributes
    ----------
    tolerance
        Residual of the normal equations over their right-hand side, each mode of the map in units of its noise: about
        the error of the solution in units of the noise, if the map has little signal.
    max_iterations
    """

    tolerance: float = 1e-4
    max_iterations: int = 300

    def __post_init__(self) -> None:
        """Raise ValueError for values out of range."""
        number("tolerance", self.tolerance, above=0)
        whole("max_iterations", self.max_iterations, least=1, most=2**31 - 1)


@dataclass(frozen=True)
class Solution:
    """Solution of the normal equations for several right-hand sides.

    Attributes
    ----------
    sky_mk : (n_right, n_pixel)
        0 in pixels without weight.
    iterations
        Applications of the normal matrix in iterations.
    residual : (n_right,)
        Residual over right-hand side as for `SolveOptions.tolerance`, computed anew from the solution.
    converged : (n_right,)
        Whether the residual is within the tolerance.
    """

    sky_mk: np.ndarray
    iterations: int
    residual: np.ndarray
    converged: np.ndarray


def add_right_side(block: NormalBlock, data_mk: np.ndarray, out: np.ndarray) -> None:
    """Add ``P^T N^-1 d`` of streams (n_right, n_det, n_samp), or (n_det, n_samp), to `out` (n_right, n_pixel) or
    (n_pixel,), float64, in place.
    """
    data = data_mk.reshape(-1, *block.index.shape)
    _bin(block, block.noise.apply(data, block.index, block.scan_bounds), out.reshape(len(data), -1))


def add_normal(block: NormalBlock, skies_mk: np.ndarray, out: np.ndarray) -> None:
    """Add ``P^T N^-1 P m`` of skies (n_right, n_pixel) to `out`, float64 of that shape, in place.

    The streams are of the type of the skies: float32 takes half the time of float64.
    """
    from mapmaker.kernels.pixels import look_up

    for rows in row_chunks(len(skies_mk), block.index.size):
        streams = np.empty((len(skies_mk[rows]), *block.index.shape), skies_mk.dtype)
        look_up(skies_mk[rows], block.index, streams)
        _bin(block, block.noise.apply(streams, block.index, block.scan_bounds), out[rows])


def add_diagonal(block: NormalBlock, weight: np.ndarray, hits: np.ndarray) -> None:
    """Add the weights of the white noise alone [1/mK^2] and the hits to flat maps (n_pixel,), in place."""
    for (start, stop), white in zip(block.scan_bounds, block.noise.white(block.scan_bounds).T, strict=True):
        pixels = block.index[:, start:stop]
        seen = pixels >= 0
        alike = np.broadcast_to(white[:, None], pixels.shape)
        weight += np.bincount(pixels[seen], alike[seen], len(weight))
        hits += np.bincount(pixels[seen], minlength=len(hits))


def _bin(block: NormalBlock, weighed: np.ndarray, out: np.ndarray) -> None:
    from mapmaker.kernels.pixels import bin_samples

    every = np.ones(len(block.scan_bounds), bool)
    for data, flat_map in zip(weighed, out, strict=True):
        bin_samples(data, block.index, block.scan_bounds, every, flat_map, None)


def normal_matrix(
    blocks: Callable[[], Iterable[NormalBlock]], stream_type: np.dtype
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that applies ``P^T N^-1 P`` of all blocks to skies (n_right, n_pixel)."""

    def apply(skies_mk: np.ndarray) -> np.ndarray:
        total = np.zeros(skies_mk.shape)
        skies_mk = skies_mk.astype(stream_type)
        for block in blocks():
            add_normal(block, skies_mk, total)
        return total

    return apply


def solve_normal(
    apply: Callable[[np.ndarray], np.ndarray], right: np.ndarray, weight: np.ndarray, *, options: SolveOptions
) -> Solution:
    """Solve the normal equations for several right-hand sides, by conjugate gradients with common directions.

    Parameters
    ----------
    apply
        Function that applies the normal matrix to skies (n_active, n_pixel), float64.
    right : (n_right, n_pixel)
    weight : (n_y, n_x)
        Weights of the white noise alone, by which the equations are scaled; pixels without weight are 0 in the
        solution.
    options
    """
    root = scaling(apply, weight)

    def scaled(sky: np.ndarray) -> np.ndarray:
        return root.back(apply(root(sky)))

    norm = np.linalg.norm(root.back(right), axis=1)
    norm[norm == 0] = 1.0
    sky, rest, iterations = np.zeros(right.shape), root.back(right), 0
    residual = np.linalg.norm(rest, axis=1) / norm
    while iterations < options.max_iterations and (residual > options.tolerance).any():
        target = np.maximum(0.9 * options.tolerance, _ONE_DESCENT * residual) * norm
        step, taken = block_descent(scaled, rest, target=target, max_iterations=options.max_iterations - iterations)
        new, iterations = sky + root(step), iterations + taken
        rest = root.back(right - apply(new))
        found = np.linalg.norm(rest, axis=1) / norm
        better = found < residual
        sky[better], before = new[better], residual.max()
        residual = np.minimum(found, residual)
        if not better[residual > options.tolerance].all() or residual.max() > 0.5 * before:  # rounding of the matrix
            break
    return Solution(sky, iterations, residual, residual <= options.tolerance)
