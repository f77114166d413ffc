"""Which cleaning is best for one observation: figures of merit for a flat CMB spectrum and for a point source.

A recipe that removes more noise removes more signal, and which wins depends on the weather (paper, section 4.3).
Its noise is that of the observation's own map; what it leaves of the signal is measured once a survey.
"""

from collections.abc import Sequence

import numpy as np

from mapmaker.window import beam_window
from surveysim.reduction.setup import Setup

TARGETS = ("cmb", "point_source")


def merits(setup: Setup, transmission: np.ndarray, maps: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Figures of merit (n_recipe, 2) of one observation's maps, sums and hits (n_y, n_x) of each recipe.

    For a flat spectrum ``sum n/2 (M T / N)^2`` over the scored bins, sigma(A)^-2 up to a factor; for a point source
    ``sum n B^2 T / N`` over all bins, its squared signal to noise. N is the noise of the map in each bin, T
    (n_recipe, 2, n_bin) what the recipe leaves of the signal's power, n the modes of a bin.
    """
    band, rings = setup.band, setup.band.rings
    rows = band.patch
    noise = np.array([band.ring_noise(total[rows, rows], hits[rows, rows]) for total, hits in maps])
    beam = beam_window(rings.ell, setup.scene.instrument.beam_fwhm_rad)
    flat = band.signal_psd * transmission[:, 0] / noise
    point = beam * transmission[:, 1] / noise
    return np.stack(
        [(rings.n_modes / 2 * flat**2)[:, band.selected].sum(axis=1), (rings.n_modes * point).sum(axis=1)], 1
    )


def best_places(merits: np.ndarray) -> np.ndarray:
    """Place of the recipe with the highest merit, of merits (n_recipe, ...); -1 where none has any."""
    merits = np.nan_to_num(merits)
    return np.where(merits.max(axis=0) > 0, merits.argmax(axis=0), -1)
