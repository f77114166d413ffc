"""The closed forms of the components of the time-streams: noise of a data set against the observing conditions."""

from collections.abc import Callable

import numpy as np

from surveysim.forecasting.noise_bins import NoiseBins
from surveysim.forecasting.observing_conditions import ObservingConditions
from surveysim.telescope.pixel_coherence import part_weights
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.low_frequency import excess_psd

Noise = Callable[[ObservingConditions], np.ndarray]  # noise variance a sample (n_draw, n_bin) [mK^2]
ClosedForm = Callable[[NoiseBins], Noise]


def independent_white(of: NoiseBins) -> Noise:
    """White noise that detectors do not share: photon noise, and that of detectors, which has another filter."""
    bins = of.white(of.independent)
    if of.filters is None:
        return lambda conditions: np.outer(conditions.white, bins)
    of_detectors = of.white(of.independent, "output")
    return lambda conditions: (
        np.outer(conditions.white - conditions.detector, bins) + np.outer(conditions.detector, of_detectors)
    )


def shared_white(of: NoiseBins) -> Noise:
    """Photon noise that detectors share."""
    photon, _ = of.correlations
    bins = np.stack([of.white(part) for part in photon])
    return lambda conditions: conditions.shared[:, None] * (part_weights(conditions.stop_share, len(bins)).T @ bins)


def low_frequency(of: NoiseBins) -> Noise:
    """Excess noise.

    Lines are those of streams twice as long as a scan, as in the simulation: the lowest dominate a steep spectrum.
    """
    _, excess = of.correlations
    n_samp, rate = samples_per_scan(of.scans), of.scans.sample_rate_hz
    psd = excess_psd(of.scene.excess, 1.0, n_samp, 2 * n_samp, rate)[1:]
    step = rate / (2 * n_samp)
    positive = step * np.arange(1, n_samp + 1)
    bins = of.low_frequency(np.concatenate([-positive, positive]), np.tile(psd * step, 2), excess)
    return lambda conditions: np.outer(conditions.excess * conditions.gain**2, bins)


def layer(of: NoiseBins) -> Noise:
    """Layer of the atmosphere."""
    bins = of.layer()
    return lambda conditions: (
        (conditions.layer * conditions.gain**2)[:, None] * bins(conditions.motion, conditions.sine)
    )


# Terms by component; a term of several components is added once. A component without a row can't be forecast. The
# order of additions is part of a forecast, as float sums depend on it.
CLOSED_FORMS: dict[str, tuple[ClosedForm, ...]] = {
    "photon": (independent_white, shared_white),
    "detector": (independent_white,),
    "excess": (low_frequency,),
    "atmosphere": (layer,),
    "sky": (),
}
