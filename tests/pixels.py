"""Correlations of pixels with one part, for tests that need a matrix."""

import numpy as np

from surveysim.telescope.illumination import UNIFORM, Illumination
from surveysim.telescope.lattice_noise import CirculantCorrelation, embed
from surveysim.telescope.layouts import HEXAGONAL, Lattice
from surveysim.telescope.pixel_coherence import Kind, PixelCoherence, correlation_matrices


def correlation_matrix(positions_f_lambda: np.ndarray, kind: Kind, illumination: Illumination = UNIFORM) -> np.ndarray:
    """Correlation (n_det, n_det) of noise with one part between pixels at (n_det, 2) positions."""
    return correlation_matrices(positions_f_lambda, PixelCoherence(kind, illumination))[0]


def torus_of(cells: np.ndarray, pitch_f_lambda: float, kind: Kind, illumination: Illumination) -> CirculantCorrelation:
    """Correlation with one part of detectors on a lattice, on a torus."""
    lattice = Lattice(cells, pitch_f_lambda, HEXAGONAL)
    return embed(lattice, 1.0, PixelCoherence(kind, illumination)).at(0.0)
