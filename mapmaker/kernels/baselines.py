"""Kernels that project baselines out of time-streams."""

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def project_baselines(data, index, edges, weight, out):
    """Subtract the mean over each baseline and multiply by the weight of the detector; 0 for samples without data.

    Parameters
    ----------
    data, out : (n_right, n_det, n_samp)
    index : (n_det, n_samp)
        -1 for samples without data.
    edges : (n_baseline, 2)
        First and one-past-last samples.
    weight : (n_det,)
        Of the type of the data.
    """
    for r in range(data.shape[0]):
        for d in range(data.shape[1]):
            for b in range(edges.shape[0]):
                part = slice(edges[b, 0], edges[b, 1])
                _project(data[r, d, part], index[d, part], weight[d], out[r, d, part])


@njit(forceinline=True, error_model="numpy")
def _project(samples, pixels, weight, out):
    total, count = 0.0, 0
    for n in range(samples.size):
        seen = pixels[n] >= 0
        total += samples[n] if seen else 0.0
        count += seen
    mean = total / max(1, count)
    for n in range(samples.size):
        out[n] = weight * (samples[n] - mean) if pixels[n] >= 0 else 0.0
