"""White levels and modes of the noise of bands of frequencies, from the covariances of detectors in them.

Most noise that detectors share is smooth over the array: the atmosphere, with the responsivities of the detectors. Few
cosine modes of a scan are at low frequencies, fewer than detectors. Their covariance has neither eigenvectors nor
eigenvalues near the true ones, but tells the mean power of few shapes well. The model of a band therefore is

    N_b = w_b diag(r) + sum over degrees d of p_bd Q_d Q_d^T + V_b V_b^T

with a level w_b of the band, r of each detector, orthonormal shapes Q_d of the degree d - polynomials of the position
times responsivities - and a power of each degree. V_b are modes that stand out of the rest, as of noise of the readout.
"""

from dataclasses import dataclass

import numpy as np

from mapmaker.errors import InsufficientDataError

# A detector with less than this fraction of the mean noise is dead; one whose residual from the modes is rounding of
# float32 has no noise of its own. Neither gets weight.
_DEAD, _EXPLAINED = 1e-10, 2.0**-46
_MOST_DEGREE = 3  # of the polynomials; a fourth changes the noise of lynx maps by 1 % or less
_SIGNIFICANT = 3.0  # errors by which the power of a degree exceeds white noise, if it is modelled
_ALIKE = 1e-6  # part of a shape that others leave of it where it is one of them, as on a line


@dataclass(frozen=True)
class BandNoise:
    """Noise of all bands.

    Attributes
    ----------
    white_mk2 : (n_band, n_det)
        0 for dead detectors.
    modes_mk
        (n_det, n_mode) of each band.
    n_found
        Modes of each band, the last ones, that are not smooth: they were found in the data.
    """

    white_mk2: np.ndarray
    modes_mk: tuple[np.ndarray, ...]
    n_found: tuple[int, ...]


def band_noise(
    covariances: np.ndarray, n_vectors: np.ndarray, place_rad: np.ndarray, *, max_modes: int, eigenvalue_cut: float
) -> BandNoise:
    """Model the noise of bands.

    Parameters
    ----------
    covariances : (n_band, n_det, n_det)
        [mK^2]
    n_vectors : (n_band,)
        Number of cosine modes that each is measured with.
    place_rad : (n_det, 2)
        Positions of the detectors.
    max_modes, eigenvalue_cut
        As in `mapmaker.gls.GlsOptions`.

    Raises
    ------
    InsufficientDataError
        Where a band has no detector with noise.
    """
    power = np.diagonal(covariances, axis1=1, axis2=2)
    alive = (power > _DEAD * power.mean(axis=1, keepdims=True)).all(axis=0)
    # Shapes are fitted where the detectors have one rms, and again where their white noise has one level.
    rms = np.sqrt(np.where(alive, n_vectors @ power, 0.0))
    gain = _responsivities(np.tensordot(n_vectors, covariances, 1), rms)
    shapes, degree = _smooth_shapes(place_rad, gain * _inverse(rms), min(max_modes, int(alive.sum()) // 4))
    left = np.array([rms**2 * _without(shapes, _scaled(item, _inverse(rms))) for item in covariances])
    level, own = _separated(np.where(alive & (left > _EXPLAINED * power), left, 0.0), n_vectors)
    inverse = _inverse(np.sqrt(own))
    shapes = np.linalg.qr((rms * inverse)[:, None] * shapes)[0]
    white, modes, n_found = [], [], []
    for covariance, n, of_band in zip(covariances, n_vectors.tolist(), level, strict=True):
        scaled = _scaled(covariance, inverse) / of_band
        smooth, strength = _smooth_modes(scaled, shapes, degree, n)
        rest, further = _further_modes(scaled, smooth, strength, (n, max_modes, eigenvalue_cut))
        both = np.hstack([smooth * np.sqrt(strength - 1), further])
        white.append(of_band * own * rest)
        modes.append(np.sqrt(of_band * own)[:, None] * both)
        n_found.append(further.shape[1])
    return BandNoise(np.outer(*_separated(np.array(white), n_vectors)), tuple(modes), tuple(n_found))


def _inverse(values: np.ndarray) -> np.ndarray:
    """Inverse of values, 0 where they are."""
    return np.divide(1.0, values, out=np.zeros(len(values)), where=values > 0)


def _scaled(covariance: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Covariance (n_det, n_det) of streams times factors (n_det,)."""
    return factor[:, None] * covariance * factor


def _responsivities(total: np.ndarray, rms: np.ndarray) -> np.ndarray:
    """Responsivities (n_det,) to what detectors share, up to a factor, from their covariance (n_det, n_det) and rms.

    Those of a regression on the mean of the streams, each over its rms. One is added to the sums of correlations, so
    that detectors that share nothing have responsivities as their rms.
    """
    return rms * (1 + _scaled(total, _inverse(rms)).sum(axis=1))


def _smooth_shapes(place_rad: np.ndarray, gain: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal shapes (n_det, n_shape), at most `most` and of whole degrees, and the degrees (n_shape,)."""
    x, y = (place_rad - place_rad.mean(axis=0)).T / max(np.ptp(place_rad), np.finfo(float).tiny)
    kept = np.zeros((len(x), 0))
    degrees: list[int] = []
    for degree in range(_MOST_DEGREE + 1):
        before = kept
        for k in range(degree + 1):
            column = gain * x ** (degree - k) * y**k
            rest = column - kept @ (kept.T @ column)
            rest -= kept @ (kept.T @ rest)  # twice is enough
            if np.linalg.norm(rest) > _ALIKE * np.linalg.norm(column):
                kept = np.column_stack([kept, rest / np.linalg.norm(rest)])
        if kept.shape[1] > most:
            return before, np.array(degrees, int)
        degrees += [degree] * (kept.shape[1] - before.shape[1])
    return kept, np.array(degrees, int)


def _without(shapes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Variances (n_det,) where shapes are taken out, over the part of a detector's white noise that this leaves.

    No difference of powers, which a strong atmosphere would reduce to rounding.
    """
    left = np.eye(len(covariance)) - shapes @ shapes.T
    return np.sum((left @ covariance) * left, axis=1) / np.maximum(np.diag(left), 1 / len(left))


def _separated(left: np.ndarray, n_vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Levels (n_band,) of bands and (n_det,) of detectors whose product is about the variances (n_band, n_det)."""
    level = left.mean(axis=1)
    if not (level > 0).all():
        raise InsufficientDataError("found no detector with noise in a band; one or more are needed")
    return level, n_vectors @ (left / level[:, None]) / n_vectors.sum()


def _smooth_modes(scaled: np.ndarray, shapes: np.ndarray, degree: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Shapes (n_det, n_mode) of the degrees with more power than white noise of 1 has by chance, and that power
    (n_mode,), the mean of a degree.
    """
    power = np.sum(shapes * (scaled @ shapes), axis=0)
    number = np.bincount(degree)
    mean = np.bincount(degree, power) / np.maximum(number, 1)
    seen = mean > 1 + _SIGNIFICANT * np.sqrt(2 / (n * np.maximum(number, 1)))
    return shapes[:, seen[degree]], mean[degree[seen[degree]]]


def _further_modes(
    scaled: np.ndarray, smooth: np.ndarray, strength: np.ndarray, limits: tuple[int, int, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Variances (n_det,) left, and modes (n_det, n_mode) that stand out, where smooth modes are made white."""
    n, max_modes, cut = limits
    whiten = np.eye(len(scaled)) + (strength**-0.5 - 1) * smooth @ smooth.T
    values, vectors = np.linalg.eigh(whiten @ scaled @ whiten)
    values, vectors = values[::-1], vectors[:, ::-1]
    n_live = int(np.count_nonzero(np.diag(scaled)))
    count = _count_modes(values, n_live, n, (min(max_modes - len(strength), n // 2, n_live // 2), cut))
    left = vectors[:, count:] ** 2 @ np.maximum(values[count:], 0)
    modes = vectors[:, :count] * np.sqrt(values[:count])
    return left, modes + (strength**0.5 - 1) * smooth @ (smooth.T @ modes)


def _count_modes(values: np.ndarray, n_det: int, n: int, limits: tuple[int, float]) -> int:
    """Count the leading eigenvalues that exceed the cut times the largest one of uncorrelated noise.

    The largest of these, for n vectors of n_det independent deviates of variance v, is ``v (1 + sqrt(n_det / n))^2``
    (Marchenko & Pastur 1967); v is the mean of the remaining eigenvalues.
    """
    most, cut = limits
    for k in range(most):
        left = n_det - k
        if values[k] <= cut * values[k:].sum() / left * (1 + np.sqrt(left / n)) ** 2:
            return k
    return max(most, 0)
