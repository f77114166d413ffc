"""Glitches: steps that decay, in one detector each. Those that are found are flagged; the others stay in the data.

A glitch begins with its amplitude at a sample, and decays exponentially. Scans have the tails of glitches before them.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.scene.readout import Glitches
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.observed_block import ObservedBlock, mean_white

LEFT = 0.01  # fraction of its amplitude to which a glitch has decayed where its flags end


@dataclass(frozen=True)
class GlitchEvents:
    """Glitches (n_glitch,) of a block.

    Attributes
    ----------
    detector, scan, start
        Detector and scan, and first sample from the start of the scan, negative before it.
    amplitude_mk
    found
        Whether the glitch is found, and flagged.
    """

    detector: np.ndarray
    scan: np.ndarray
    start: np.ndarray
    amplitude_mk: np.ndarray
    found: np.ndarray


def decay(section: Glitches, sample_rate_hz: float) -> float:
    """Amplitude of a glitch over that one sample before."""
    return float(np.exp(-1 / (section.decay_time_s * sample_rate_hz))) if section.decay_time_s else 0.0


def flagged_length(section: Glitches, sample_rate_hz: float) -> int:
    """Samples until a glitch has decayed to `LEFT` of its amplitude, one or more."""
    return max(1, int(np.ceil(-np.log(LEFT) * section.decay_time_s * sample_rate_hz)))


def glitch_amplitudes(section: Glitches, uniform: np.ndarray) -> np.ndarray:
    """Amplitudes [mK] at uniform numbers (n,): the inverse of the cumulated power law."""
    (low, high), power = section.extremes_mk, 1 - (section.slope or 0.0)
    if low == high:
        return np.full(uniform.shape, low)
    if power == 0:
        return low * (high / low) ** uniform
    return low * (1 + uniform * ((high / low) ** power - 1)) ** (1 / power)


def least_found(section: Glitches, white_mk2_hz: float | np.ndarray, sample_rate_hz: float) -> float | np.ndarray:
    """Least amplitude [mK] that the threshold finds in white noise of some PSD."""
    return section.threshold * np.sqrt(np.asarray(white_mk2_hz) * sample_rate_hz / 2)


def _integral(low: float, high: np.ndarray, power: float) -> np.ndarray:
    """Integrate A^power from `low` to `high`."""
    if power == -1:
        return np.log(high / low)
    return (high ** (power + 1) - low ** (power + 1)) / (power + 1)


def missed_moment(section: Glitches, white_mk2_hz: np.ndarray, sample_rate_hz: float, order: int) -> np.ndarray:
    """Mean of A^order over all glitches where they are missed, else 0, in white noise of some PSDs (n,)."""
    (low, high), slope = section.extremes_mk, section.slope or 0.0
    if section.found is not None:
        edge, share = np.full(np.shape(white_mk2_hz), high), 1 - section.found
    else:
        edge, share = np.clip(least_found(section, white_mk2_hz, sample_rate_hz), low, high), 1.0
    if low == high:
        missed = 1.0 if section.found is not None else least_found(section, white_mk2_hz, sample_rate_hz) > low
        return np.asarray(share * missed * low**order * np.ones(np.shape(white_mk2_hz)))
    return share * _integral(low, edge, order - slope) / _integral(low, np.asarray(high), -slope)


def kept_power(section: Glitches, white_mk2_hz: np.ndarray, sample_rate_hz: float) -> np.ndarray:
    """Mean over all glitches of their squared amplitude (n,) [mK^2] in the data, in white noise of some PSDs (n,).

    Missed glitches count with their amplitude; found ones with the rest to which they have decayed where their flags
    end.
    """
    (low, high), slope = section.extremes_mk, section.slope or 0.0
    every = low**2
    if low < high:
        every = _integral(low, np.asarray(high), 2 - slope) / _integral(low, np.asarray(high), -slope)
    missed = missed_moment(section, white_mk2_hz, sample_rate_hz, 2)
    rest = decay(section, sample_rate_hz) ** flagged_length(section, sample_rate_hz)
    return missed + (every - missed) * rest**2


def glitch_psd(section: Glitches, frequency_hz: np.ndarray, sample_rate_hz: float) -> np.ndarray:
    """One-sided PSD of glitches over the mean of their squared amplitudes, by Campbell's theorem."""
    turn = decay(section, sample_rate_hz) * np.exp(-2j * np.pi * frequency_hz / sample_rate_hz)
    return 2 * section.rate_hz / sample_rate_hz**2 / np.abs(1 - turn) ** 2


def draw_glitches(of: ObservedBlock) -> GlitchEvents:
    """Draw the glitches of a block, the same at each call."""
    section, scans, rng = of.setup.scene.glitches, of.setup.observing.scans, of.generator("glitches")
    n_samp, before = samples_per_scan(scans), flagged_length(section, scans.sample_rate_hz) - 1
    expected = section.rate_hz / scans.sample_rate_hz * (n_samp + before)
    count = rng.poisson(expected, (of.setup.camera.n_det, of.block.n_scans))
    detector, scan = (np.repeat(number.ravel(), count.ravel()) for number in np.indices(count.shape))
    start = rng.integers(-before, n_samp, len(detector))
    amplitude, lot = glitch_amplitudes(section, rng.random(len(detector))), rng.random(len(detector))
    if section.found is not None:
        return GlitchEvents(detector, scan, start, amplitude, lot < section.found)
    found = amplitude >= least_found(section, mean_white(of), scans.sample_rate_hz)
    return GlitchEvents(detector, scan, start, amplitude, found)


def add_glitches(data_mk: np.ndarray, of: ObservedBlock) -> None:
    """Add the glitches of a block to streams (n_det, n_samp), in place."""
    from surveysim.timestreams.glitch_kernels import add_pulses

    events, scans = draw_glitches(of), of.setup.observing.scans
    factor = decay(of.setup.scene.glitches, scans.sample_rate_hz)
    n_samp, places = samples_per_scan(scans), (events.detector, events.scan, events.start)
    add_pulses(data_mk, n_samp, *places, events.amplitude_mk, factor)


def flag_glitches(lost: np.ndarray, of: ObservedBlock) -> None:
    """Flag the glitches of a block that are found in flags (n_det, n_samp), in place."""
    from mapmaker.kernels.lost_samples import flag_runs

    events, scans = draw_glitches(of), of.setup.observing.scans
    n_samp, length = samples_per_scan(scans), flagged_length(of.setup.scene.glitches, scans.sample_rate_hz)
    first, start = events.scan[events.found] * n_samp, events.start[events.found]
    end = np.minimum(start + length, n_samp)
    flag_runs(lost, events.detector[events.found], first + np.maximum(start, 0), first + end)
