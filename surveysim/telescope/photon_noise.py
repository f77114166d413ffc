"""Photon noise of an optical load: what a pixel at the background limit (BLIP) has, and nothing else (section 1.1).

One spatial mode, fully coherent over the pixel, in one or two polarizations; a band with straight sides; loads in
Rayleigh-Jeans temperature at the cryostat's window. NEPs are in W/sqrt(Hz) of a one-sided spectrum, so a noise of
NEP^2 averaged over a time t has the variance NEP^2 / (2 t). Powers are those absorbed.
"""

import math
from dataclasses import dataclass

from surveysim.runtime.errors import OutOfRangeError
from surveysim.scene.units import BOLTZMANN_J_K, PLANCK_J_S, rj_to_cmb


@dataclass(frozen=True)
class PhotonNoise:
    """Photon noise of one pixel: absorbed power, NEP, and one-sided PSDs [mK_RJ^2/Hz] above the atmosphere.

    `shot_psd_mk2_hz` is what photons that came one by one would make, `bose_psd_mk2_hz` what their bunching adds.
    """

    frequency_hz: float
    bandwidth: float
    power_w: float
    nep_w_rthz: float
    shot_psd_mk2_hz: float
    bose_psd_mk2_hz: float

    @property
    def psd_mk2_hz(self) -> float:
        """Shot and Bose noise together."""
        return self.shot_psd_mk2_hz + self.bose_psd_mk2_hz

    @property
    def net_mk_rthz(self) -> float:
        """Its root, in Rayleigh-Jeans temperature."""
        return math.sqrt(self.psd_mk2_hz)

    @property
    def net_mkcmb_rthz(self) -> float:
        """Its root, in CMB temperature."""
        return self.net_mk_rthz * rj_to_cmb(self.frequency_hz, self.bandwidth)


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
    """Photon noise of a load of `load_k` [K_RJ] at the window in a band of fractional width `bandwidth`.

    `efficiency` is from window to detector, `transmission` that of the atmosphere, which dims the sky but is no
    part of the load. Raises ValueError for values out of range.
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
