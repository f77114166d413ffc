"""Lost samples of time-streams: gaps are filled, so that filters and templates see no jump.

Maps leave lost samples out: `mapmaker.geometry.pixel_indices` puts them off the map.
"""

import numpy as np

from mapmaker.validation import bounds_of_scans, flags, reals


def fill_flagged(data_mk: np.ndarray, scan_bounds: np.ndarray, flagged: np.ndarray) -> np.ndarray:
    """Fill the flagged samples of each scan: with the common signal, and a line across the gap.

    The common signal changes from each time to the next by the mean change of the detectors that have both samples. It
    is interpolated over times without any. The line is through the means of as many samples on both sides as the gap
    has, or fewer up to the next gap; at the ends of a scan it is constant. A detector without any sample in a scan gets
    the common signal; a scan without any sample is NaN, so that cleaning discards it. The filled values are linear in
    the others.

    Parameters
    ----------
    data_mk : (n_det, n_samp)
        float32; other real types become float64. Flagged samples may have any value, NaN too.
    scan_bounds : (n_scan, 2)
        Scans [start, stop), which do not overlap.
    flagged : (n_det, n_samp)
        True for lost samples.

    Returns
    -------
    (n_det, n_samp) array
        A copy; samples without a flag, and outside scans, are unchanged.

    Raises
    ------
    ValueError
        For arrays that do not match.
    """
    from mapmaker.kernels.lost_samples import fill_gaps

    data = reals("data_mk", data_mk, ("n_det", "n_samp"), finite=False)
    bounds, lost = bounds_of_scans(scan_bounds, data.shape[1]), flags("flagged", flagged, data.shape)
    filled = data.copy()
    fill_gaps(filled, bounds, lost)
    return filled
