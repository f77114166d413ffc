"""Response of the detectors: from the signal that they see to the streams at their output.

Every signal passes through here: the components of the streams, and simulated signals.
"""

import numpy as np

from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.simulation import Simulation
from surveysim.timestreams.sky import add_seen_sky
from surveysim.timestreams.time_constants import apply_time_constants


def apply_response(setup: Simulation, seen_mk: np.ndarray) -> None:
    """Turn signals (n_det, n_samp) that the detectors see into their output, in place: responsivity, time constants."""
    if (setup.camera.responsivity != 1).any():
        seen_mk *= setup.camera.responsivity[:, None].astype(seen_mk.dtype)
    apply_time_constants(setup, seen_mk)


def write_sky_signal(setup: Simulation, pointing: Pointing, sky_mk: np.ndarray, out_mk: np.ndarray) -> None:
    """Write the response to a sky and nothing else to streams (n_det, n_samp), before the time constants.

    The look-up multiplies by the responsivity before it rounds to the type of the streams.
    """
    out_mk[:] = 0
    add_seen_sky(setup, pointing, sky_mk, out_mk, setup.camera.responsivity)
