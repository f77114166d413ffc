"""Toy surveys of four bins, whose noise is drawn mode by mode."""

import numpy as np

from mapmaker.bandpower import BandPower, flat_spectrum_psd, score
from mapmaker.uncertainty import ErrorBudget

ELL = np.array([4500.0, 5500.0, 6500.0, 7500.0])
EDGES = np.arange(4000.0, 8001.0, 1000.0)
N_MODES = np.array([40, 50, 60, 70])
PSD = 1e-5  # noise of all bins


def toy_score(psds: np.ndarray, weights: np.ndarray) -> tuple[BandPower, ErrorBudget]:
    """Score of sign-flipped co-adds (n_flip, 4), with a transfer function that is known exactly."""
    return score(
        psds,
        flat_spectrum_psd(ELL),
        signal_psd_relative_error=np.zeros(4),
        n_modes=N_MODES,
        mask=ELL > 0,
        observation_weights=weights,
        ell=ELL,
        edges_ell=EDGES,
    )
