"""Map of a sky as it goes into the observations: averaged over the pixels of the scored patch."""

import numpy as np

from surveysim.reduction.analysis import AnalysisSetup

# Weights of the cells of the sky along a pixel of the map, two cells and their neighbours: the mean over the pixel of
# the sky that bilinear look-ups see.
_PIXEL = np.array([1, 7, 7, 1]) / 16


def input_map(analysis: AnalysisSetup, sky_mk: np.ndarray) -> np.ndarray:
    """Average a sky (n_beam, n_y, n_x) over the pixels of the scored patch, and over the beams: (n, n)."""
    sky, patch = np.tensordot(analysis.beams.share, sky_mk, axes=1), analysis.region.patch
    pixels = np.arange(patch.start, patch.stop)
    for axis, n_pixel in enumerate((analysis.geometry.n_y, analysis.geometry.n_x)):
        n_cell = sky.shape[axis]
        first = n_cell // 2 + 2 * (pixels - n_pixel // 2)  # of the two cells within each pixel
        cells = np.clip(first[:, None] + np.arange(-1, 3), 0, n_cell - 1)
        sky = np.moveaxis(np.moveaxis(sky, axis, -1)[..., cells] @ _PIXEL, -1, axis)
    return sky
