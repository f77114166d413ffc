"""Apodization of a scan: the transform of the map's taper along it, and the leakage H(f, f') between frequencies.

`surveysim.forecasting.mode_response` states H, and how the removal of means and of fitted modes enters it.
"""

from dataclasses import dataclass, replace

import numpy as np

from mapmaker.spectrum import tukey
from surveysim.forecasting.fitted_modes import NO_FITTED_MODES, FittedModes
from surveysim.forecasting.mode_kernels import apodized_sums
from surveysim.forecasting.time_filters import ScanFilters, TaperedFilters

_TAPER_STEPS, _CYCLES, _STEPS_PER_CYCLE = 1024, 40, 16
_FINE_STEPS = 64  # a cycle, with filters: what they remove of the layer is to cancel in the leakage
_MOST_ELEMENTS = 2**22  # of a matrix of what filters remove


@dataclass(frozen=True)
class ScanApodization:
    """Transform of a scan that is seen through a taper.

    Attributes
    ----------
    duration_s
        Length of the scan.
    transfer : (n_f,)
        Transform w of the taper at steps of 1 / `per_step` Hz from 0.
    per_step
        Steps of `transfer` per Hz.
    fitted_modes
        Modes in time that scans lose, besides their mean.
    fitted_transfer : (n, n_f)
        Transform of the taper times each fitted mode.
    slack_s
        Time over which the middle of the taper is spread evenly about the middle of the scan.
    steps_per_cycle
        Steps of `transfer` a cycle in the length of the taper.
    filters
        Filters in time; None without any.
    """

    duration_s: float
    transfer: np.ndarray
    per_step: float
    fitted_modes: FittedModes
    fitted_transfer: np.ndarray
    slack_s: float = 0.0
    steps_per_cycle: int = _STEPS_PER_CYCLE
    filters: TaperedFilters | None = None

    def at(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Evaluate w at frequencies of any shape and sign; 0 beyond the table."""
        step = np.arange(len(self.transfer))
        return np.interp(np.abs(frequency_hz) * self.per_step, step, self.transfer, right=0.0)

    def sums(self, strength: np.ndarray, frequency_hz: np.ndarray, at_hz: np.ndarray) -> np.ndarray:
        """Sum H(f_k, f_a) strength_ka over a, (n_k,); `strength` is (n_k, n_a) or (1, n_a)."""
        return self.power_sums(strength, np.ones((1, len(frequency_hz))), frequency_hz, at_hz)[0]

    def power_sums(
        self, gain: np.ndarray, power: np.ndarray, frequency_hz: np.ndarray, at_hz: np.ndarray
    ) -> np.ndarray:
        """Sum H(f_k, f_a) gain_ka power_pa over a.

        Parameters
        ----------
        gain : (n_k, n_a) or (1, n_a)
        power : (n_p, n_a)
        frequency_hz : (n_a,)
        at_hz : (n_k,)

        Returns
        -------
        (n_p, n_k) array

        Raises
        ------
        ValueError
            For shapes that do not match.
        """
        n_k, n_a = len(at_hz), len(frequency_hz)
        if gain.shape not in ((n_k, n_a), (1, n_a)) or power.shape[1:] != (n_a,):
            raise ValueError(
                f"found gain {gain.shape} and power {power.shape}; ({n_k}, {n_a}) and (n, {n_a}) are expected"
            )
        mean, loose = np.sinc(frequency_hz * self.duration_s), 1 - np.sinc(frequency_hz * self.slack_s)
        lost = np.ascontiguousarray(self._lost(frequency_hz).T)
        gain, power, frequency_hz, at_hz = (
            np.ascontiguousarray(array, dtype=np.float64) for array in (gain, power, frequency_hz, at_hz)
        )
        own, share = self.mode_components(at_hz), self.fitted_modes.share

        def of_modes(rows: slice, filtered: np.ndarray) -> np.ndarray:
            strength = gain[rows] if len(gain) > 1 else gain
            at = frequency_hz, at_hz[rows], self.transfer, self.per_step
            return apodized_sums(strength, power, *at, mean, loose, share, own[rows], lost, filtered)

        if self.filters is None:
            return of_modes(slice(None), np.zeros((0, 0)))
        left, right = self.filters.map_components(at_hz), self.filters.stream_components(frequency_hz).T
        step = max(1, _MOST_ELEMENTS // n_a)
        parts = [slice(first, first + step) for first in range(0, n_k, step)]
        return np.concatenate([of_modes(rows, left[rows] @ right) for rows in parts], axis=1)

    def _lost(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Project waves of frequencies (n_f,) on the fitted modes: (n_f, n)."""
        if self.filters is None:
            return self.fitted_modes.wave_components(frequency_hz, self.duration_s)
        return self.filters.lost_components(*self._fitted_samples(), frequency_hz)

    def _fitted_samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Fitted modes (n_samp, n) at the samples, of unit norm, and flags of the odd ones."""
        found = self.fitted_modes.at(self.filters.of.time_s, self.duration_s).T
        return found / np.sqrt(self.filters.of.sample_rate_hz), self.fitted_modes.odd

    def mode_components(self, at_hz: np.ndarray) -> np.ndarray:
        """Project map modes at frequencies (n_f,), seen through the taper, on the fitted modes: (n_f, n)."""
        if self.filters is not None:
            return self.filters.fitted_components(*self._fitted_samples(), at_hz)
        step, place = np.arange(len(self.transfer)), np.abs(at_hz) * self.per_step
        sign = np.where(self.fitted_modes.odd[:, None], np.sign(at_hz), 1.0)
        rows = [np.interp(place, step, row, right=0.0) for row in self.fitted_transfer]
        return np.ascontiguousarray((sign * np.reshape(rows, sign.shape)).T)

    def signal_amplitude(self, at_hz: np.ndarray) -> np.ndarray:
        """Mean fraction of a signal's amplitude that the removal of mean and fitted modes leaves in its own mode."""
        at_hz = np.atleast_1d(at_hz)
        mean = np.sinc(at_hz * self.duration_s) * self.at(at_hz)
        fitted = (self._lost(at_hz) * self.mode_components(at_hz)) @ self.fitted_modes.share
        removed = mean + fitted
        if self.filters is not None:
            removed = removed + np.sum(
                self.filters.map_components(at_hz) * self.filters.stream_components(at_hz), axis=1
            )
        return 1 - removed / self.transfer[0]


def apodization_of(
    duration_s: float,
    taper: np.ndarray,
    step_s: float,
    fitted_modes: FittedModes = NO_FITTED_MODES,
    filters: ScanFilters | None = None,
) -> ScanApodization:
    """Transform a taper about the middle of a scan.

    Parameters
    ----------
    duration_s
        Length of the scan.
    taper : (n,)
        Taper in steps of `step_s`.
    step_s
    fitted_modes
        Modes in time that the scan loses.
    filters
        Filters in time; None without any.
    """
    from scipy.fft import rfft

    n, middle = len(taper), (len(taper) - 1) / 2
    cycle = _STEPS_PER_CYCLE if filters is None else _FINE_STEPS
    padded, step = cycle * n, np.arange(_CYCLES * cycle + 1)
    tapered = taper * fitted_modes.at((np.arange(n) - middle) * step_s, duration_s)
    scale = np.sqrt(step_s / np.sum(taper**2))
    # About the middle, in place of the first sample.
    spectra = rfft(np.vstack([taper, tapered]), padded)[:, : len(step)] * np.exp(2j * np.pi * middle / padded * step)
    transfer, fitted = scale * spectra[0].real, scale * spectra[1:]
    fitted_transfer = np.where(fitted_modes.odd[:, None], -fitted.imag, fitted.real)
    seen = None if filters is None else _at_samples(filters, taper, step_s)
    return ScanApodization(duration_s, transfer, padded * step_s, fitted_modes, fitted_transfer, 0.0, cycle, seen)


def _at_samples(filters: ScanFilters, taper: np.ndarray, step_s: float) -> TaperedFilters:
    """Evaluate a taper, in steps about the middle of a scan, at its samples; 0 outside."""
    middle = (len(taper) - 1) / 2
    steps = filters.time_s / step_s + middle
    found = np.interp(steps, np.arange(len(taper)), taper)
    found[np.abs(steps - middle) > middle + 0.5] = 0.0
    return TaperedFilters(filters, found / np.sqrt(filters.sample_rate_hz * np.sum(found**2)))


def scan_apodization(
    duration_s: float,
    *,
    speed_rad_s: float,
    size_rad: float,
    taper_fraction: float,
    fitted_modes: FittedModes = NO_FITTED_MODES,
    filters: ScanFilters | None = None,
    centred: bool = True,
) -> ScanApodization:
    """Transform the map's taper along a scan through its middle.

    Parameters
    ----------
    duration_s, speed_rad_s
        Length and speed of the scan.
    size_rad, taper_fraction
        Full width of the taper, and the fraction of it in the two cosine edges (`mapmaker.spectrum.tukey_taper`).
    fitted_modes
        Modes in time that the scan loses.
    filters
        Filters in time; None without any.
    centred
        Whether the middle of the scan crosses the middle of the taper. That of a curved chunk does at any time.
    """
    length = min(duration_s, size_rad / speed_rad_s)
    step = length / _TAPER_STEPS
    taper = tukey(_TAPER_STEPS, step * speed_rad_s, size_rad, taper_fraction)
    found = apodization_of(duration_s, taper, step, fitted_modes, filters)
    return found if centred else replace(found, slack_s=duration_s - length)


def hann_apodization(
    duration_s: float, fitted_modes: FittedModes = NO_FITTED_MODES, filters: ScanFilters | None = None
) -> ScanApodization:
    """Transform the Hann taper of the periodograms that measure the PSD of streams."""
    taper = np.hanning(_TAPER_STEPS + 1)[:-1]
    return apodization_of(duration_s, taper, duration_s / _TAPER_STEPS, fitted_modes, filters)


def frequency_nodes(apodization: ScanApodization, highest_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Choose quadrature nodes in frequency.

    They resolve the removed mean of the scan near 0, and the width of the apodization elsewhere.

    Returns
    -------
    frequency_hz, weight_hz : (n,)
        Nodes of both signs up to `highest_hz`, and their weights.
    """
    cycle = min(apodization.steps_per_cycle / apodization.per_step, highest_hz / 8)
    near = np.geomspace(0.02 / apodization.duration_s, 0.5 * cycle, 24)
    far = np.linspace(0.5 * cycle, highest_hz, 1 + int(np.ceil(4 * (highest_hz / cycle - 0.5))))
    positive = np.concatenate([near[near < 0.5 * cycle], far])
    weight = np.gradient(positive)
    weight[0], weight[-1] = positive[0] + weight[0] / 2, weight[-1] / 2
    return np.concatenate([-positive[::-1], positive]), np.concatenate([weight[::-1], weight])
