"""(f/#)lambda overlap: how much of a beam-filling source two pixels share."""

import numpy as np


def mutual_coherence(separation_f_lambda: np.ndarray) -> np.ndarray:
    """Field coherence ``gamma = 2 J1(pi s) / (pi s)`` of two pixels s (f/#)lambda apart.

    Van Cittert-Zernike for a uniformly lit circular stop; 0.506 at 0.7 (f/#)lambda, the paper's
    "50 % of the power received by adjacent bolometers is completely correlated" (section 5.1).
    """
    from scipy.special import j1

    x = np.pi * np.asarray(separation_f_lambda, dtype=float)
    safe = np.where(x == 0, 1.0, x)
    return np.where(x == 0, 1.0, 2 * j1(safe) / safe)


def correlation_matrix(positions_f_lambda: np.ndarray, coherence: str) -> np.ndarray:
    """Correlation (n_det, n_det) of a beam-filling source between pixels at (n_det, 2) positions.

    `coherence` is "field" (gamma), "intensity" (gamma^2, Hanbury Brown and Twiss) or "none".
    All three are positive semi-definite: gamma is the transform of the uniformly lit stop, and a
    product of such functions is one again.
    """
    positions = np.asarray(positions_f_lambda, dtype=float)
    if coherence == "none":
        return np.eye(len(positions))
    separation = np.linalg.norm(positions[:, None] - positions[None, :], axis=-1)
    gamma = mutual_coherence(separation)
    return gamma if coherence == "field" else gamma**2


def correlation_factor(correlation: np.ndarray) -> np.ndarray:
    """A with ``A A^T = correlation``, (n_det, n_det), from eigenvalues.

    Densely packed pixels share modes and make the matrix nearly singular, where Cholesky fails.
    Raises ValueError when an eigenvalue is negative beyond rounding.
    """
    values, vectors = np.linalg.eigh(correlation)
    limit = 1e-10 * max(values[-1], 1.0) * len(values)
    if values[0] < -limit:
        raise ValueError(f"correlation matrix has the eigenvalue {values[0]:.3g}; none below 0 is allowed")
    return vectors * np.sqrt(np.clip(values, 0, None))
