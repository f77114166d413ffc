"""Conjugate gradients of several right-hand sides that share their search directions.

The algorithm is BCGrQ (Dubrulle 2001), with the residuals of all right-hand sides in an orthonormal basis. Combinations
of right-hand sides that have converged leave the basis, and so do those that depend on others. All right-hand sides
profit from the directions of all: the more there are, the fewer iterations each takes.
"""

from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

# A combination of residuals below this part of the tolerance has converged.
_NEGLIGIBLE = 0.1
# Residuals that grow by this factor tell that rounding has taken over.
_GROWTH = 100.0


@threadpool_limits.wrap(limits=1)  # no bit depends on the cores of the machine
def block_descent(
    apply: Callable[[np.ndarray], np.ndarray], right: np.ndarray, *, target: np.ndarray, max_iterations: int
) -> tuple[np.ndarray, int]:
    """Solve ``A x = b`` of a positive semi-definite matrix for several b in its range.

    Parameters
    ----------
    apply
        Function that applies A to vectors (n_active, n), n_active at most n_right.
    right : (n_right, n)
    target : (n_right,)
        Norms of the residuals at which right-hand sides have converged, above 0.
    max_iterations

    Returns
    -------
    solution : (n_right, n)
        The best so far if rounding ends the iterations before the target.
    iterations
        Applications of A.
    """
    solution, best, least = np.zeros_like(right), np.zeros_like(right), np.inf
    basis, step = _significant(right.T, np.eye(len(right)), target)
    parts = step  # residuals are basis @ parts
    direction = basis
    for k in range(max_iterations):
        distance = np.max(np.linalg.norm(parts, axis=0) / target) if len(parts) else 0.0
        if distance < least:
            best, least = solution.copy(), distance
        if distance <= 1 or distance > _GROWTH * least:
            return best, k
        ahead = apply(np.ascontiguousarray(direction.T)).T
        square = direction.T @ ahead
        length = np.linalg.pinv((square + square.T) / 2, rcond=1e-12, hermitian=True)
        solution += (direction @ (length @ parts)).T
        basis, step = _significant(basis - ahead @ length, parts, target)
        parts, direction = step @ parts, basis + direction @ step.T
    return solution, max_iterations


def _significant(vectors: np.ndarray, parts: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal basis (n, n_kept) of ``vectors @ parts``, and its products (n_kept, n_vector) with the vectors.

    Directions that hold a negligible part of all residuals are left out.
    """
    basis, inner = np.linalg.qr(vectors)
    left, size, _ = np.linalg.svd(inner @ parts / target, full_matrices=False)
    left = left[:, size > _NEGLIGIBLE]
    return basis @ left, left.T @ inner
