"""Kernel that sums weighted time-streams into pixels."""

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def add_weighted(data, index, bounds, weight, weighted_sum, exposure, hits):
    """Add samples to the flat maps `weighted_sum` and `exposure` (float64) and `hits` (int64), in place.

    Parameters
    ----------
    data, index : (n_det, n_samp)
        Pixels are -1 off the map.
    bounds : (n_scan, 2)
    weight : (n_det, n_scan)
        Weight of a sample; scans of weight 0 are left out.
    weighted_sum, exposure, hits : (n_pixel,)
    """
    for d in range(data.shape[0]):
        for s in range(bounds.shape[0]):
            w = weight[d, s]
            if w == 0.0:
                continue
            for n in range(bounds[s, 0], bounds[s, 1]):
                pixel = index[d, n]
                if pixel >= 0:
                    weighted_sum[pixel] += w * data[d, n]
                    exposure[pixel] += w
                    hits[pixel] += 1
