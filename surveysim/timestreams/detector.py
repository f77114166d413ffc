"""Noise of detectors and electronics: white, and independent in each detector."""

import numpy as np

from surveysim.runtime.rng import RandomPurpose
from surveysim.timestreams.noise import add_white
from surveysim.timestreams.observed_block import ObservedBlock, white_of_block
from surveysim.timestreams.response import draws_parts


def add_detector_noise(data_mk: np.ndarray, of: ObservedBlock) -> None:
    """Add the detector noise of a block to streams (n_det, n_samp), in place.

    Photon noise includes it, if present, unless detectors differ.
    """
    rate = of.setup.observing.scans.sample_rate_hz
    if draws_parts(of):
        add_white(data_mk, white_of_block(of).detector, rate, of.deviates(RandomPurpose.DETECTOR))
    elif of.setup.scene.photon is None:
        add_white(data_mk, of.levels.detector_mk2_hz, rate, of.deviates(RandomPurpose.DETECTOR))
