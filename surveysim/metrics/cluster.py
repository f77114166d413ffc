"""Metric `cluster`: depth of a matched filter for clusters of galaxies, in the central Compton parameter y0.

The filter is as in `surveysim.metrics.point_source`, for the profile of a cluster in angles, whatever its redshift.
The thermal Sunyaev-Zeldovich effect turns y0 into a CMB temperature (`surveysim.scene.passband`), without relativistic
corrections. The CMB, other clusters and galaxies add to the scatter in a real map.
"""

import numpy as np

from mapmaker.profiles import arnaud_profile, beta_profile
from surveysim.metrics.map_noise import MapNoise, Quantity
from surveysim.metrics.point_source import depth
from surveysim.scene.metrics import ClusterDepth

NOTE = "without confusion; non-relativistic"


def quantities(noise: MapNoise, options: ClusterDepth) -> tuple[Quantity, ...]:
    """Compute the scatter (1 sigma) of y0; infinite in a band without a signal."""

    def profile(ell: np.ndarray) -> np.ndarray:
        if options.profile == "arnaud":
            return arnaud_profile(ell, options.theta_500_rad)
        return beta_profile(ell, options.core_radius_rad, options.beta)

    sigma_ukcmb, response = depth(noise, noise.map.power_of(profile), options)
    signal = abs(noise.map.sz_ukcmb)
    return (Quantity("depth_y0", sigma_ukcmb / signal if signal else np.inf, "", note=NOTE, response=response),)
