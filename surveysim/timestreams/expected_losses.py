"""Share of the samples of a survey that are not lost, in closed form."""

import numpy as np

from surveysim.scene.scene import Scene
from surveysim.timestreams.glitches import flagged_length, missed_moment
from surveysim.timestreams.lost_data import gap_length


def sampled_share(scene: Scene, white_mk2_hz: np.ndarray) -> np.ndarray:
    """Expected share (n,) of samples that no section of the scene loses, in white noise of some PSDs (n,).

    Losses are independent: runs of L samples that begin at a rate p a sample leave ``exp(-p L)``.
    """
    share, rate = np.ones(np.shape(white_mk2_hz)), scene.scan.sample_rate_hz
    if glitches := scene.glitches:
        found = glitches.rate_hz / rate * (1 - missed_moment(glitches, white_mk2_hz, rate, 0))
        share *= np.exp(-found * flagged_length(glitches, rate))
    if gaps := scene.dropped_samples:
        share *= np.exp(-gaps.rate_hz / rate * gap_length(gaps, rate))
    if dead := scene.dead_time:
        share *= (1 - dead.detectors) * (1 - dead.scans)
    return share
