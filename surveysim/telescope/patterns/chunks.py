"""Paths that are cut into chunks of equal duration, which take the place of scans."""

from collections.abc import Callable

import numpy as np

from surveysim.telescope.scans import ScanPath, Scans, mid_times, samples_per_scan


def chunked_path(scans: Scans, offsets: Callable[[np.ndarray], np.ndarray], dither: np.ndarray) -> ScanPath:
    """Sample a path that is a function of time.

    Samples are at the middle of sampling intervals, symmetric about the middle of a chunk, as those of scans.

    Parameters
    ----------
    scans
        Number and timing of the chunks.
    offsets
        Function of times (n,) since the start of the observation [s]: offsets (2, n) [rad], along xi first.
    dither : (2,)
        Offset of the pattern [rad].
    """
    n, mid_s = samples_per_scan(scans), mid_times(scans)
    from_mid_s = (np.arange(n) + 0.5 - n / 2) / scans.sample_rate_hz
    time_s = (mid_s[:, None] + from_mid_s).ravel()
    xi, eta = offsets(time_s) + np.asarray(dither)[:, None]
    travel = offsets(mid_s + scans.scan_s / 2) - offsets(mid_s - scans.scan_s / 2)
    return ScanPath(
        time_s=time_s,
        xi_rad=xi,
        eta_rad=eta,
        scan=np.repeat(np.arange(scans.n_scans), n),
        velocity_rad_s=travel.T / scans.scan_s,
        mid_time_s=mid_s,
        straight=False,
    )
