"""Photon noise: white, with a part that overlapping pixels share. It is drawn together with detector noise."""

from functools import lru_cache

import numpy as np

from surveysim.runtime.rng import RandomPurpose
from surveysim.telescope.lattice_noise import LatticeFactor, LatticePixels, WaferPixels
from surveysim.telescope.pixel_coherence import DensePixels
from surveysim.timestreams.noise import add_correlated_white, add_white
from surveysim.timestreams.observed_block import ObservedBlock, white_of_block
from surveysim.timestreams.response import draws_parts, pass_light


def add_photon_noise(data_mk: np.ndarray, of: ObservedBlock) -> None:
    """Add the photon noise of a block to streams (n_det, n_samp), in place, with the detector noise.

    The sum of the two is one Gaussian noise, with one draw: of the levels p and d, of which pixels share ``s p``, its
    level is p + d, of which they share ``s p``. Detectors that differ have parts of their own.
    """
    if draws_parts(of):
        _add_parts(data_mk, of)
        return
    setup, levels, deviates = of.setup, of.levels, of.deviates(RandomPurpose.PHOTON)
    level = levels.photon_mk2_hz + levels.detector_mk2_hz
    noise = (data_mk, level, setup.observing.scans.sample_rate_hz)
    if setup.camera.photon_correlation is None or level == 0:
        add_white(*noise, deviates)
    else:
        share = levels.shared * levels.photon_mk2_hz / level
        add_correlated_white(
            *noise, _shared_factor(setup.camera.photon_correlation, levels.stop_share, share), deviates
        )


def _add_parts(data_mk: np.ndarray, of: ObservedBlock) -> None:
    """Add the shared photon noise and that of each detector, both through the steps of the response, in place."""
    setup, rate = of.setup, of.setup.observing.scans.sample_rate_hz
    white, correlation = white_of_block(of), setup.camera.photon_correlation
    seen = np.zeros_like(data_mk)
    if correlation is None:
        add_white(seen, white.shared + white.alone, rate, of.deviates(RandomPurpose.PHOTON))
    else:
        factor = _shared_factor(correlation, of.levels.stop_share, 1.0)
        add_correlated_white(seen, white.shared, rate, factor, of.deviates(RandomPurpose.PHOTON))
        add_white(seen, white.alone, rate, of.deviates(RandomPurpose.PHOTON, realization=1))
    pass_light(of, seen)
    data_mk += seen


@lru_cache(maxsize=1)  # most scenes have one share for all observations
def _shared_factor(
    pixels: DensePixels | LatticePixels | WaferPixels, stop_share: float, share: float
) -> np.ndarray | LatticeFactor:
    return pixels.at(stop_share).factor(share)
