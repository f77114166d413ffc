"""Detectors that do not follow the signal of the others, as one that reads noise alone."""

import numpy as np

from mapmaker.pipeline.cleaned_tests import robust_scatter

FEWEST = 12  # detectors among which one stands out
_SIGNIFICANT = 5.0  # of the median correlation over its scatter, and of the distance from it
_FOLLOWS = 0.3  # of the median correlation, and of the median gain


def compare_with_others(
    data_mk: np.ndarray, lost: np.ndarray, bounds: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compare each of some detectors with the mean of the others, over all scans without their means.

    Parameters
    ----------
    data_mk, lost : (n_det, n_samp)
        Streams before cleaning; lost samples may have any value.
    bounds : (n_scan, 2)
    rows : (n_row,)
        Numbers of these detectors.

    Returns
    -------
    (n_row,), (n_row,) arrays
        Correlations, and gains: the fitted amplitudes of the mean of the others, medians over the scans, so that a
        planet in some of them changes nothing. 0 where they are unknown.
    """
    products, squares, squares_of_others = np.zeros((3, len(bounds), len(rows)))
    for s, (start, stop) in enumerate(bounds):
        good = ~lost[rows, start:stop]
        own = np.where(good, data_mk[rows, start:stop], 0).astype(float)
        own = np.where(good, own - (own.sum(axis=1) / np.maximum(1, good.sum(axis=1)))[:, None], 0)
        others = np.where(good, own.sum(axis=0) - own, 0) / np.maximum(1, good.sum(axis=0) - 1)
        products[s] = np.einsum("in,in->i", own, others)
        squares[s] = np.einsum("in,in->i", own, own)
        squares_of_others[s] = np.einsum("in,in->i", others, others)
    sizes = np.sqrt(squares.sum(axis=0) * squares_of_others.sum(axis=0))
    gains = np.ma.divide(products, np.ma.masked_equal(squares_of_others, 0))
    return _ratio(products.sum(axis=0), sizes), np.ma.median(gains, axis=0).filled(0.0)


def _ratio(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    return np.divide(part, whole, out=np.zeros(len(part)), where=whole > 0)


def strangers(correlations: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Flags (n_det,) of the detectors that do not follow the others, where these have a signal in common.

    The median correlation has to stand out of the scatter of all, and so has the distance of one from the median.
    Without a common signal all correlations are about 0, and no detector is flagged. A detector that follows the others
    in spite of large noise of its own has little correlation, but their gain.

    Parameters
    ----------
    correlations, gains : (n_det,)
        `compare_with_others`.
    """
    if len(correlations) < FEWEST:
        return np.zeros(len(correlations), bool)
    middle = np.median(correlations)
    least = _SIGNIFICANT * robust_scatter(correlations - middle)
    far = (correlations < _FOLLOWS * middle) & (gains < _FOLLOWS * np.median(gains))
    return far & (middle - correlations > least) & (middle > least)
