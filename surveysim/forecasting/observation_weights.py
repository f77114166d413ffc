"""Expected weights of observations in a co-added map."""

import numpy as np

from mapmaker.bandpower import flat_spectrum_psd
from surveysim.reduction.analysis import AnalysisSetup


def expected_weights(analysis: AnalysisSetup, noise: np.ndarray) -> np.ndarray:
    """Expected weights of observations, as a run measures them on their maps.

    Parameters
    ----------
    analysis
    noise : (n_draw, n_bin)
        Noise variance a sample [mK^2].

    Returns
    -------
    (n_draw,) array
        [1/mK^2].
    """
    band = analysis.region
    sky = _beamed_sky(analysis)
    weight = band.rings.n_modes * (sky * band.selected / sky[band.selected].max()) ** 2
    return 1 / (noise @ weight / weight.sum())


def _beamed_sky(analysis: AnalysisSetup) -> np.ndarray:
    ell = analysis.region.rings.ell
    # The lowest bin of a small map may contain only ell = 0.
    return flat_spectrum_psd(np.maximum(ell, 1)) * analysis.beams.window(ell)
