"""Consistency of the filters in time of a cleaning with its scans, and with the range of the white level."""

import numpy as np

from mapmaker.cleaning import TIME_FILTERS
from mapmaker.cleaning.time_filters import HighpassOptions, TimeFilterOptions, highpass_response, time_modes
from surveysim.reduction.cleaning_pipelines import filter_options
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Scene

MOST_NOTCH_CYCLES = 500  # widths of all notches times the length of a scan: modes of more take seconds
MOST_ELEMENTS = 3e7  # of the modes of filters: 240 MB


def check_time_filters(scene: Scene, n_samp: int) -> None:
    """Raise SceneError for filters of frequencies that scans of `n_samp` samples do not have, or of nearly all."""
    section, rate = scene.cleaning, scene.scan.sample_rate_hz
    if "highpass" in section.named:
        corner, least = section.highpass_frequency_hz, rate / (2 * n_samp)
        if not least <= corner < rate / 2:
            raise SceneError(
                f"cleaning.highpass_frequency: found {corner:g} Hz; from {least:g} Hz, half a cycle in"
                f" {scene.scan.duration_key}, to less than {rate / 2:g} Hz, half of scan.sample_rate, is expected"
            )
    if "time_polynomial" in section.named and n_samp < section.time_order + 2:
        raise SceneError(
            f"cleaning.time_order: found {section.time_order} with scans of {n_samp} samples; {n_samp - 2} or less is"
            " expected"
        )
    if "notch" in section.named:
        _check_notches(scene, n_samp)


def _check_notches(scene: Scene, n_samp: int) -> None:
    section, rate = scene.cleaning, scene.scan.sample_rate_hz
    for centre, width in zip(section.notch_frequencies_hz, section.notch_widths_hz, strict=True):
        low, high = centre - width / 2, centre + width / 2
        if not (centre > 0 and low >= 0 and high <= rate / 2):
            raise SceneError(
                f"cleaning.notch_frequencies: found a band from {low:g} to {high:g} Hz; one from 0 to {rate / 2:g} Hz,"
                " half of scan.sample_rate, is expected"
            )
    cycles, n_notch = sum(section.notch_widths_hz) * n_samp / rate, len(section.notch_widths_hz)
    most_cycles = min(MOST_NOTCH_CYCLES, n_samp / 4 - 2 * n_notch, MOST_ELEMENTS / n_samp / 4 - 2 * n_notch)
    if cycles > most_cycles:
        most = max(0.0, most_cycles * rate / n_samp)
        raise SceneError(
            f"cleaning.notch_widths: found {sum(section.notch_widths_hz):g} Hz in {n_notch} bands; {most:.3g} Hz or"
            f" less in all is expected for scans of {n_samp} samples"
        )


def filtered_share(scene: Scene, n_samp: int, above_hz: float) -> float:
    """Share of the power of white noise above a frequency that the filters of the scene's own cleaning remove."""
    rate, left = scene.scan.sample_rate_hz, 1.0
    high = np.fft.rfftfreq(n_samp, 1 / rate) > above_hz
    for name in scene.cleaning.algorithm:
        if name in TIME_FILTERS:
            options = filter_options(scene.cleaning, name, rate)
            left *= 1 - _lost_share(options, n_samp, high)
    return 1 - left


def _lost_share(options: TimeFilterOptions, n_samp: int, high: np.ndarray) -> float:
    """Share of the power of white noise in some bins (n_freq,) of a Fourier transform that a filter removes."""
    if isinstance(options, HighpassOptions):
        of_cosines = np.arange(n_samp) / 2 > np.flatnonzero(high)[0] - 0.5 if high.any() else np.zeros(n_samp, bool)
        return float(np.mean(1 - highpass_response(options, n_samp)[of_cosines] ** 2)) if of_cosines.any() else 0.0
    found = time_modes(options, n_samp)
    power = np.abs(np.fft.rfft(found.modes, axis=0)) ** 2
    inside = power[high].sum(axis=0) / power.sum(axis=0)
    return float(inside @ (found.loss * (2 - found.loss)) / max(1, 2 * high.sum()))
