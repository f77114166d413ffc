"""The closed forms of the components of the time-streams: noise of a data set against the observing conditions."""

from collections.abc import Callable, Iterator

import numpy as np

from surveysim.forecasting.noise_bins import NoiseBins
from surveysim.forecasting.observing_conditions import Correlation, ObservingConditions
from surveysim.telescope.pixel_coherence import part_weights
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.glitches import glitch_psd, kept_power
from surveysim.timestreams.lines import line_components
from surveysim.timestreams.low_frequency import excess_psd
from surveysim.timestreams.readout_noise import red_psd, trend_variance

_SLOW = 20  # a wave of the first frequency of two scans over this is a trend in a scan

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


def layers(of: NoiseBins) -> Noise:
    """Layers of the atmosphere, whose noise is independent."""
    parts = [of.layer(number) for number in range(len(of.layers))]

    def noise(conditions: ObservingConditions) -> np.ndarray:
        total = np.zeros((len(conditions.sine), len(of.frequencies.modes.wave)))
        for bins, amplitude, motions in zip(parts, conditions.layers, conditions.motions, strict=True):
            total += (amplitude * conditions.gain**2)[:, None] * bins(motions[:, of.node], conditions.sine)
        return total

    return noise


def readout_noise(of: NoiseBins) -> Noise:
    """1/f noise of the readout: lines of streams twice as long as a scan, and the trends of lower frequencies."""
    terms = [(psd, of.readout(at_hz, power, alike)) for psd, at_hz, power, alike in readout_lines(of)]

    def noise(conditions: ObservingConditions) -> np.ndarray:
        return np.sum([np.outer(readout_level(psd, conditions), bins) for psd, bins in terms], axis=0)

    return noise


def readout_lines(of: NoiseBins) -> Iterator[tuple[float | None, np.ndarray, np.ndarray, Correlation]]:
    """Parts of the readout noise: PSD [mK^2/Hz], and for unit PSD lines (n,) of both signs, variances, correlation.

    The PSD is None where it is that of the white noise (`readout_level`).
    """
    n, rate = 2 * samples_per_scan(of.scans), of.scans.sample_rate_hz
    positive, slow = rate / n * np.arange(1, n // 2 + 1), rate / n / _SLOW
    for shared, part in of.scene.readout_noise.parts.items():
        trend = trend_variance(part, n, rate) / (2 * np.pi * slow) ** 2
        variance = np.concatenate([[trend], red_psd(part, n, rate)[1:] * rate / n])
        at_hz, correlation = np.concatenate([[slow], positive]), of.in_common(shared, getattr(part, "group_size", None))
        yield part.psd_mk2_hz, *_both_signs(at_hz, variance), correlation


def readout_level(psd_mk2_hz: float | None, conditions: ObservingConditions) -> np.ndarray:
    """PSD (n_obs,) [mK^2/Hz] of a part of the readout noise, by default that of the white noise."""
    white = conditions.white + conditions.shared
    return white if psd_mk2_hz is None else np.full(len(white), psd_mk2_hz)


def microphonic_lines(of: NoiseBins) -> Noise:
    """Lines, as waves with a period of two scans about each."""
    n, rate = 2 * samples_per_scan(of.scans), of.scans.sample_rate_hz
    bins = np.zeros(len(of.frequencies.modes.wave))
    for line in of.scene.lines:
        waves = _both_signs(*line_components(line, n, rate))
        bins = bins + of.readout(*waves, of.in_common(line.shared, line.group_size))
    return lambda conditions: np.tile(bins, (len(conditions.white), 1))


def glitches(of: NoiseBins) -> Noise:
    """Glitches that are not found, and the tails of those that are."""
    section, n, rate = of.scene.glitches, 2 * samples_per_scan(of.scans), of.scans.sample_rate_hz
    at_hz = rate / n * np.arange(1, n // 2 + 1)
    bins = of.readout(*_both_signs(at_hz, glitch_psd(section, at_hz, rate) * rate / n), None)

    def noise(conditions: ObservingConditions) -> np.ndarray:
        return np.outer(kept_power(section, conditions.white + conditions.shared, rate), bins)

    return noise


def _both_signs(at_hz: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lines at positive and negative frequencies, each with the whole variance, as of a one-sided PSD."""
    return np.concatenate([-at_hz, at_hz]), np.tile(variance, 2)


# Terms by component; a term of several components is added once. A component without a row can't be forecast. The
# order of additions is part of a forecast, as float sums depend on it.
CLOSED_FORMS: dict[str, tuple[ClosedForm, ...]] = {
    "photon": (independent_white, shared_white),
    "detector": (independent_white,),
    "excess": (low_frequency,),
    "atmosphere": (layers,),
    "sky": (),
    "readout_noise": (readout_noise,),
    "lines": (microphonic_lines,),
    "glitches": (glitches,),
    "dropped_samples": (),
    "dead_time": (),
}
