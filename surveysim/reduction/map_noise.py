"""Noise of the map of one observation."""

import numpy as np

from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.scored_region import ScoredRegion
from surveysim.scene.map_section import MapSection


def map_noise(
    analysis: AnalysisSetup, total: np.ndarray, weight: np.ndarray, hits: np.ndarray
) -> tuple[float, np.ndarray]:
    """Measure the noise variance per sample of the map of one observation.

    With a score it is measured in the scored multipoles, with the weights of a flat band power:
    ``sum M^2 |FT(T S)|^2 / (sum M^2 sum T^2 W)`` for sums S and weights W under the taper T. For white noise it is the
    variance of a sample. It includes correlations between detectors, which the PSD of a time-stream does not. Without a
    score it is the mean of ``S^2 / W`` over hit pixels.

    The right-hand side of a maximum-likelihood map has the covariance P^T N^-1 P: its power is the information of the
    observation. With hits in place of weights its mean is the information a sample, the inverse of a variance.

    Returns
    -------
    noise : float [mK^2]
        Infinite without a hit.
    bin_noise : (n_bin,) array [mK^2]
        The same in each multipole bin; empty without a score.
    """
    if not weighs_itself(analysis.scene.map):
        return _power(analysis.region, total, weight)
    information, of_bins = _power(analysis.region, total, hits)
    return _inverse(information).item(), _inverse(of_bins)


def weighs_itself(section: MapSection) -> bool:
    """Return whether observations enter a map by their measured noise spectra alone, with no weight besides."""
    return section.maker == "maximum_likelihood"


def _inverse(information: float | np.ndarray) -> np.ndarray:
    values = np.asarray(information)
    return np.divide(1.0, values, out=np.full(values.shape, np.inf), where=np.isfinite(values) & (values > 0))


def _power(region: ScoredRegion | None, total: np.ndarray, weight: np.ndarray) -> tuple[float, np.ndarray]:
    """Mean power over the mean weight, and that in each bin; infinite without a hit."""
    if region is None:
        hit = weight > 0
        return float(np.mean(total[hit].astype(float) ** 2 / weight[hit])) if hit.any() else np.inf, np.zeros(0)
    rows = region.patch
    return region.noise(total[rows, rows], weight[rows, rows])
