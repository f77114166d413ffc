"""Metric `point_source`: depth and mapping speed of a matched filter for point sources.

The scatter of a source's amplitude is ``sigma^-2 = sum_b P_b T_b / N_b`` (`mapmaker.matched_filter`), with the power
P_b of the source in beam and pixels, noise PSD N_b and transfer function T_b of power: the filter's template has all
that cleaning leaves of a source. A filter that treats directions alike, with the amplitudes that cleaning leaves, has a
scatter that is larger by about 0.5 %.

The mapping speed is ``Omega / (sigma^2 t)``. Omega is the area over which the detector-seconds of all scans, spread
evenly, have the exposure of the scored patch; t is the time of scans and turnarounds. In white noise without losses it
is the number of detectors times half the beam's solid angle over the squared NEFD, times the share of scans in t.
"""

from functools import partial

import numpy as np

from mapmaker.matched_filter import filter_information
from surveysim.metrics.map_noise import MapNoise, Quantity, ScoredMap
from surveysim.scene.metrics import ClusterDepth, PointSourceDepth

_UNSEEN = 0.05  # share of the beam's power above `score.ell_max` that goes without a note
_DEG2_PER_SR = np.degrees(1) ** 2


def quantities(noise: MapNoise, options: PointSourceDepth) -> tuple[Quantity, ...]:
    """Compute the scatter (1 sigma) of a source in flux density and peak temperature, and the mapping speed."""
    region = noise.map
    power = region.power_of(partial(np.full_like, fill_value=region.beam_sr))
    depth_mk, response = depth(noise, power, options)
    depth_mk /= region.ukcmb_per_mk
    depth_mjy = depth_mk * region.mjy_per_mk
    area_deg2 = noise.n_det * region.scan_hours * 3600 / noise.exposure() * _DEG2_PER_SR
    speed = float(area_deg2 / (depth_mjy**2 * region.hours))
    note = _note(region)
    return (
        Quantity("depth_mjy", depth_mjy, "mJy", note=note, response=response),
        Quantity("depth_mk", depth_mk, "mK", note=note, response=response),
        Quantity("mapping_speed", speed, "deg2 / (mJy2 h)", lower_is_better=False, note=note, response=-2 * response),
    )


def depth(noise: MapNoise, power: np.ndarray, options: PointSourceDepth | ClusterDepth) -> tuple[float, np.ndarray]:
    """Compute the scatter of an amplitude [uK_CMB] and the response (n_bin,) of its logarithm to ln N.

    Parameters
    ----------
    noise
    power : (n_bin,)
        Power of a source of amplitude 1 [sr].
    options
        Multipoles.
    """
    region = noise.map
    lowest = region.edges_ell[:-1][region.selected][0] if options.ell_min is None else options.ell_min
    highest = region.edges_ell[1:][region.selected][-1]
    mask = (region.edges_ell[:-1] >= lowest) & (region.edges_ell[1:] <= highest) & (noise.noise_psd > 0)
    # Far above the beam a forecast's transfer function is a ratio of rounding errors, of either sign.
    passed = np.where(noise.transmission > 0, noise.transmission, 0.0)
    information = filter_information(noise.noise_psd, power, passed, mask)
    total = float(information.sum())
    return total**-0.5, information / (2 * total)


def _note(region: ScoredMap) -> str:
    """Limits of the metric: confusion, and multipoles that the score leaves out."""
    highest = region.edges_ell[1:][region.selected][-1]
    lost = float(np.exp(-(highest**2) * region.beam_sr / (2 * np.pi)))  # of the integral of the squared beam
    return "without confusion" + f"; score.ell_max leaves out {100 * lost:.0f} % of the beam's power" * (lost > _UNSEEN)
