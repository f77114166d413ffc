"""Noise of the map of one observation."""

import numpy as np

from mapmaker.geometry import MapGeometry
from surveysim.reduction.scored_region import ScoredRegion
from surveysim.scene.map_section import MapSection


def map_noise(region: ScoredRegion | None, total: np.ndarray, hits: np.ndarray) -> tuple[float, np.ndarray]:
    """Measure the noise variance per sample of the map of one observation.

    With a score it is measured in the scored multipoles, with the weights of a flat band power:
    ``sum M^2 |FT(T S)|^2 / (sum M^2 sum T^2 H)`` for sums S and hits H under the taper T. For white noise it is the
    variance of a sample. It includes correlations between detectors, which the PSD of a time-stream does not. Without a
    score it is the mean of ``S^2 / H`` over hit pixels.

    Returns
    -------
    noise : float [mK^2]
        Infinite without a hit.
    bin_noise : (n_bin,) array [mK^2]
        The same in each multipole bin; empty without a score.
    """
    if region is None:
        hit = hits > 0
        return float(np.mean(total[hit].astype(float) ** 2 / hits[hit])) if hit.any() else np.inf, np.zeros(0)
    rows = region.patch
    return region.noise(total[rows, rows], hits[rows, rows])


def weighs_itself(section: MapSection) -> bool:
    """Return whether observations enter a map by their measured noise spectra alone, with no weight besides."""
    return section.maker == "maximum_likelihood"


def keeps_large_scales(section: MapSection) -> bool:
    """Return whether maps have the sky and the noise of the largest scales, so that they are scored less a plane."""
    return section.maker == "maximum_likelihood"


def probe_map(geometry: MapGeometry) -> np.ndarray:
    """White map (n_y, n_x), the same for all observations, that tells the weight of their modes."""
    return np.random.default_rng(0).normal(size=(geometry.n_y, geometry.n_x))


def weighed_noise(
    region: ScoredRegion | None, total: np.ndarray, hits: np.ndarray, *, probe: np.ndarray, observed: np.ndarray
) -> tuple[float, np.ndarray]:
    """Measure the noise of an observation whose right-hand side ``S = P^T N^-1 d`` has the weights N^-1 of its own.

    In a map mode let ``A = P^T N^-1 P`` have the value w a sample, and S the variance u. The co-added map has the
    noise ``sum u / (sum w)^2``: as one of binned observations with weights w and noise variances ``u / w^2`` a sample.
    If N were known, that would be 1 / w; a measured N misses a part. The weight w is the mean over the scored modes,
    from the cross-power of a `probe` map (n_y, n_x) and that map `observed`, A times it.

    Returns
    -------
    noise : float [mK^2]
        1 / w; infinite without a hit.
    bin_noise : (n_bin,) array [mK^2]
        u / w^2 in each multipole bin; empty without a score.
    """
    power, of_bins = map_noise(region, total, hits)
    if not np.isfinite(power):
        return np.inf, np.full(len(of_bins), np.inf)
    scale = np.std(probe) / np.std(observed)
    both = [map_noise(region, probe + sign * scale * observed, hits)[0] for sign in (1, -1)]
    unit = map_noise(region, probe, np.ones_like(hits))[0]
    weight = (both[0] - both[1]) / (4 * scale * unit)
    return (1 / weight, of_bins / weight**2) if weight > 0 else (np.inf, np.full(len(of_bins), np.inf))
