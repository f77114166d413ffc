"""Apodization of a scan: the transform of the map's taper along it, and the leakage H(f, f') between frequencies.

`surveysim.forecasting.mode_response` states H, and how the removal of means and of fitted modes enters it.
"""

from dataclasses import dataclass, replace

import numpy as np

from mapmaker.spectrum import tukey
from surveysim.forecasting.fitted_modes import NO_FITTED_MODES, FittedModes
from surveysim.forecasting.mode_kernels import apodized_sums

_TAPER_STEPS, _CYCLES, _STEPS_PER_CYCLE = 1024, 40, 16


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
    """

    duration_s: float
    transfer: np.ndarray
    per_step: float
    fitted_modes: FittedModes
    fitted_transfer: np.ndarray
    slack_s: float = 0.0

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
        lost = np.ascontiguousarray(self.fitted_modes.wave_components(frequency_hz, self.duration_s).T)
        arrays = (np.ascontiguousarray(array, dtype=np.float64) for array in (gain, power, frequency_hz, at_hz))
        losses = self.fitted_modes.share, self.mode_components(at_hz), lost
        return apodized_sums(*arrays, self.transfer, self.per_step, mean, loose, *losses)

    def mode_components(self, at_hz: np.ndarray) -> np.ndarray:
        """Project map modes at frequencies (n_f,), seen through the taper, on the fitted modes: (n_f, n)."""
        step, place = np.arange(len(self.transfer)), np.abs(at_hz) * self.per_step
        sign = np.where(self.fitted_modes.odd[:, None], np.sign(at_hz), 1.0)
        rows = [np.interp(place, step, row, right=0.0) for row in self.fitted_transfer]
        return np.ascontiguousarray((sign * np.reshape(rows, sign.shape)).T)

    def signal_amplitude(self, at_hz: np.ndarray) -> np.ndarray:
        """Mean fraction of a signal's amplitude that the removal of mean and fitted modes leaves in its own mode."""
        at_hz = np.atleast_1d(at_hz)
        mean = np.sinc(at_hz * self.duration_s) * self.at(at_hz)
        fitted = (
            self.fitted_modes.wave_components(at_hz, self.duration_s) * self.mode_components(at_hz)
        ) @ self.fitted_modes.share
        return 1 - (mean + fitted) / self.transfer[0]


def apodization_of(
    duration_s: float, taper: np.ndarray, step_s: float, fitted_modes: FittedModes = NO_FITTED_MODES
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
    """
    from scipy.fft import rfft

    n, middle = len(taper), (len(taper) - 1) / 2
    padded, step = _STEPS_PER_CYCLE * n, np.arange(_CYCLES * _STEPS_PER_CYCLE + 1)
    tapered = taper * fitted_modes.at((np.arange(n) - middle) * step_s, duration_s)
    scale = np.sqrt(step_s / np.sum(taper**2))
    # About the middle, in place of the first sample.
    spectra = rfft(np.vstack([taper, tapered]), padded)[:, : len(step)] * np.exp(2j * np.pi * middle / padded * step)
    transfer, fitted = scale * spectra[0].real, scale * spectra[1:]
    fitted_transfer = np.where(fitted_modes.odd[:, None], -fitted.imag, fitted.real)
    return ScanApodization(duration_s, transfer, padded * step_s, fitted_modes, fitted_transfer)


def scan_apodization(
    duration_s: float,
    *,
    speed_rad_s: float,
    size_rad: float,
    taper_fraction: float,
    fitted_modes: FittedModes = NO_FITTED_MODES,
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
    centred
        Whether the middle of the scan crosses the middle of the taper. That of a curved chunk does at any time.
    """
    length = min(duration_s, size_rad / speed_rad_s)
    step = length / _TAPER_STEPS
    taper = tukey(_TAPER_STEPS, step * speed_rad_s, size_rad, taper_fraction)
    found = apodization_of(duration_s, taper, step, fitted_modes)
    return found if centred else replace(found, slack_s=duration_s - length)


def hann_apodization(duration_s: float, fitted_modes: FittedModes = NO_FITTED_MODES) -> ScanApodization:
    """Transform the Hann taper of the periodograms that measure the PSD of streams."""
    return apodization_of(duration_s, np.hanning(_TAPER_STEPS + 1)[:-1], duration_s / _TAPER_STEPS, fitted_modes)


def frequency_nodes(apodization: ScanApodization, highest_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Choose quadrature nodes in frequency.

    They resolve the removed mean of the scan near 0, and the width of the apodization elsewhere.

    Returns
    -------
    frequency_hz, weight_hz : (n,)
        Nodes of both signs up to `highest_hz`, and their weights.
    """
    cycle = min(_STEPS_PER_CYCLE / apodization.per_step, highest_hz / 8)
    near = np.geomspace(0.02 / apodization.duration_s, 0.5 * cycle, 24)
    far = np.linspace(0.5 * cycle, highest_hz, 1 + int(np.ceil(4 * (highest_hz / cycle - 0.5))))
    positive = np.concatenate([near[near < 0.5 * cycle], far])
    weight = np.gradient(positive)
    weight[0], weight[-1] = positive[0] + weight[0] / 2, weight[-1] / 2
    return np.concatenate([-positive[::-1], positive]), np.concatenate([weight[::-1], weight])
