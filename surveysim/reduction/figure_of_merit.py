"""Figures of merit of the cleaning pipelines in one observation, for a flat CMB spectrum and for a point source.

A pipeline that removes more noise removes more signal, and the best one depends on the weather (paper, section 4.3).
The noise is measured on the map of the observation, the transfer function once per survey.
"""

from collections.abc import Sequence

import numpy as np

from surveysim.reduction.analysis import AnalysisSetup

TARGETS = ("cmb", "point_source")


def figures_of_merit(
    analysis: AnalysisSetup, transmission: np.ndarray, maps: Sequence[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Compute figures of merit of the pipelines from the maps of one observation.

    For a flat spectrum ``sum n/2 (M T / N)^2`` over the scored bins, which is proportional to sigma(A)^-2; for a point
    source ``sum n B^2 T / N`` over all bins, its squared signal to noise. N is the noise of the map in each bin, T the
    transfer function, n the number of modes, M the signal and B the beam.

    Parameters
    ----------
    transmission : (n_pipeline, 2, n_bin)
        Transfer functions T for both targets.
    maps
        Sums and hits (n_y, n_x) of each pipeline.

    Returns
    -------
    (n_pipeline, 2) array
    """
    band, rings = analysis.region, analysis.region.rings
    rows = band.patch
    noise = np.array([band.ring_noise(total[rows, rows], hits[rows, rows]) for total, hits in maps])
    beam = analysis.beams.window(rings.ell)
    flat = band.signal_psd * transmission[:, 0] / noise
    point = beam * transmission[:, 1] / noise
    return np.stack(
        [(rings.n_modes / 2 * flat**2)[:, band.selected].sum(axis=1), (rings.n_modes * point).sum(axis=1)], 1
    )


def best_places(figures_of_merit: np.ndarray) -> np.ndarray:
    """Find the pipeline with the largest figure of merit (n_pipeline, ...); -1 if none is above 0."""
    figures_of_merit = np.nan_to_num(figures_of_merit)
    return np.where(figures_of_merit.max(axis=0) > 0, figures_of_merit.argmax(axis=0), -1)
