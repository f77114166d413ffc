"""Response of the detectors: from the signal that they see to the streams at their output.

Every signal passes through here: the components of the streams, those of the other bands, and simulated signals.
"""

import numpy as np

from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.simulation import Simulation
from surveysim.timestreams.sky import add_seen_sky
from surveysim.timestreams.time_constants import apply_time_constants


def apply_response(setup: Simulation, seen_mk: np.ndarray, band: int = 0, gain: float = 1.0) -> None:
    """Turn signals (n_det, n_samp) that the detectors see into their output, in place.

    Detectors of the mapped band filter them with their time constants.

    Parameters
    ----------
    band
        0 for the mapped band, 1 for the first of the other bands.
    gain
        Common factor of all detectors.
    """
    factor = gain * _responsivity(setup, band)
    if (factor != 1).any():
        seen_mk *= factor[:, None].astype(seen_mk.dtype)
    if band == 0:
        apply_time_constants(setup, seen_mk)


def write_sky_signal(setup: Simulation, pointing: Pointing, sky_mk: np.ndarray, out_mk: np.ndarray) -> None:
    """Write the response to a sky and nothing else to streams (n_det, n_samp), before the time constants.

    The look-up multiplies by the responsivity before it rounds to the type of the streams.
    """
    out_mk[:] = 0
    add_seen_sky(setup, pointing, sky_mk, out_mk, _responsivity(setup, band=0))


def _responsivity(setup: Simulation, band: int) -> np.ndarray:
    return setup.camera.band_responsivity[band - 1] if band else setup.camera.responsivity
