"""Photon noise of an optical load: the background limit (BLIP) of a pixel (section 1.1).

Assumptions: one spatial mode, fully coherent over the pixel, in one or two polarizations; a top-hat band; loads in
Rayleigh-Jeans temperature at the cryostat window. NEPs are in W/sqrt(Hz) of a one-sided spectrum: noise of NEP^2
averaged over a time t has the variance NEP^2 / (2 t). Powers are absorbed powers.
"""

import math
from dataclasses import dataclass

from surveysim.runtime.errors import OutOfRangeError
from surveysim.scene.passband import top_hat
from surveysim.scene.units import BOLTZMANN_J_K, PLANCK_J_S


@dataclass(frozen=True)
class PhotonNoise:
    """Photon noise of one pixel: absorbed power, NEP, and one-sided PSDs [mK_RJ^2/Hz] above the atmosphere.

    `shot_psd_mk2_hz` is Poisson noise of independent photons, `bose_psd_mk2_hz` the excess from photon bunching.
    """

    frequency_hz: float
    bandwidth: float
    power_w: float
    nep_w_rthz: float
    shot_psd_mk2_hz: float
    bose_psd_mk2_hz: float

    @property
    def psd_mk2_hz(self) -> float:
        """Sum of shot and Bose noise."""
        return self.shot_psd_mk2_hz + self.bose_psd_mk2_hz

    @property
    def net_mk_rthz(self) -> float:
        """Noise-equivalent temperature [mK_RJ/sqrt(Hz)]: square root of the PSD."""
        return math.sqrt(self.psd_mk2_hz)

    @property
    def net_mkcmb_rthz(self) -> float:
        """Noise-equivalent temperature in CMB temperature."""
        return self.net_mk_rthz * top_hat(self.frequency_hz, self.bandwidth).cmb_per_rj


def power_per_k(bandwidth_hz: float, efficiency: float, polarizations: int) -> float:
    """Absorbed power per Rayleigh-Jeans temperature at the window [W/K], ``k dnu eta n_pol``."""
    return BOLTZMANN_J_K * bandwidth_hz * efficiency * polarizations


def power_w(temperature_rj_k: float, bandwidth_hz: float, efficiency: float, polarizations: int) -> float:
    """Absorbed power [W] of a load that fills the beam, ``k T dnu eta n_pol``."""
    return temperature_rj_k * power_per_k(bandwidth_hz, efficiency, polarizations)


def shot_nep2(load_w: float, frequency_hz: float) -> float:
    """Shot noise [W^2/Hz] of an absorbed power, ``2 h nu P`` (Richards 1994)."""
    return 2 * PLANCK_J_S * frequency_hz * load_w


def bose_nep2(load_w: float, bandwidth_hz: float, polarizations: int) -> float:
    """Bose noise [W^2/Hz] of an absorbed power, ``2 P^2 / (n_pol dnu)`` (Richards 1994, Zmuidzinas 2003).

    Polarizations bunch by themselves: two share the power and their noises add in squares.
    """
    return 2 * load_w**2 / (polarizations * bandwidth_hz)


def photon_noise(
    load_k: float,
    frequency_hz: float,
    bandwidth: float,
    efficiency: float,
    *,
    polarizations: int,
    transmission: float = 1.0,
) -> PhotonNoise:
    """Compute the photon noise of a load.

    Parameters
    ----------
    load_k
        Load [K_RJ] at the cryostat window.
    bandwidth
        Fractional width of the band.
    efficiency
        Optical efficiency from window to detector.
    transmission
        Transmission of the atmosphere. It dims the sky and does not change the load.

    Raises
    ------
    OutOfRangeError
        For values out of range.
    """
    _check(load_k, frequency_hz, bandwidth, efficiency, polarizations=polarizations, transmission=transmission)
    bandwidth_hz = bandwidth * frequency_hz
    load_w = power_w(load_k, bandwidth_hz, efficiency, polarizations)
    shot, bose = shot_nep2(load_w, frequency_hz), bose_nep2(load_w, bandwidth_hz, polarizations)
    mk2_per_w2 = (1e3 / (power_per_k(bandwidth_hz, efficiency, polarizations) * transmission)) ** 2
    return PhotonNoise(frequency_hz, bandwidth, load_w, math.sqrt(shot + bose), shot * mk2_per_w2, bose * mk2_per_w2)


def _check(
    load_k: float, frequency_hz: float, bandwidth: float, efficiency: float, *, polarizations: int, transmission: float
) -> None:
    if polarizations not in (1, 2):
        raise OutOfRangeError(f"polarizations = {polarizations} found; 1 or 2 is allowed")
    if not 0 <= load_k < math.inf:
        raise OutOfRangeError(f"load_k = {load_k:g} found; a finite temperature of 0 K or more is allowed")
    if not 0 < frequency_hz < math.inf:
        raise OutOfRangeError(f"frequency_hz = {frequency_hz:g} found; a positive finite frequency is allowed")
    if not 0 < bandwidth < 2:
        raise OutOfRangeError(f"bandwidth = {bandwidth:g} found; a share of the frequency between 0 and 2 is allowed")
    for name, share in (("efficiency", efficiency), ("transmission", transmission)):
        if not 0 < share <= 1:
            raise OutOfRangeError(f"{name} = {share:g} found; a share above 0 and up to 1 is allowed")
