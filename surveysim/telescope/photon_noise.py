"""Photon noise of an optical load: the background limit (BLIP) of a pixel (section 1.1).

NEPs are in W/sqrt(Hz) of a one-sided spectrum: noise of NEP^2 averaged over a time t has the variance NEP^2 / (2 t).
Powers are absorbed powers.
"""

import math
from dataclasses import dataclass

from surveysim.runtime.errors import OutOfRangeError
from surveysim.scene.passband import top_hat
from surveysim.telescope.radiative_chain import SKY, STOP, RadiativeChain, coupling, stated


@dataclass(frozen=True)
class PhotonNoise:
    """Photon noise of one pixel.

    Attributes
    ----------
    power_w
        Absorbed power [W].
    shot_nep2, bose_nep2
        Squared NEP [W^2/Hz] of independent photons (Poisson), and of photon bunching.
    w_per_k, w_per_k_cmb
        Absorbed power per temperature above the atmosphere [W/K], Rayleigh-Jeans and thermodynamic CMB.
    """

    power_w: float
    shot_nep2: float
    bose_nep2: float
    w_per_k: float
    w_per_k_cmb: float

    @property
    def nep_w_rthz(self) -> float:
        """Noise-equivalent power."""
        return math.sqrt(self.shot_nep2 + self.bose_nep2)

    @property
    def shot_psd_mk2_hz(self) -> float:
        """Shot noise as one-sided PSD [mK_RJ^2/Hz] above the atmosphere."""
        return self.shot_nep2 * (1e3 / self.w_per_k) ** 2

    @property
    def bose_psd_mk2_hz(self) -> float:
        """Bose noise as one-sided PSD [mK_RJ^2/Hz] above the atmosphere."""
        return self.bose_nep2 * (1e3 / self.w_per_k) ** 2

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
        return 1e3 * self.nep_w_rthz / self.w_per_k_cmb


def chain_noise(chain: RadiativeChain) -> PhotonNoise:
    """Compute the photon noise of a detector behind a chain of emitting surfaces."""
    occupation = chain.occupation.sum(axis=0)
    return PhotonNoise(
        float(chain.power_w(occupation)),
        float(chain.shot_nep2(occupation)),
        float(chain.wave_nep2(occupation)),
        chain.w_per_k,
        chain.w_per_k_cmb,
    )


def amplitude_weights(chain: RadiativeChain) -> tuple[float, float]:
    """Weights of aperture and stop in the coherence of two pixels (Hill and Kusaka 2024, eq. 59).

    They are the parts of the occupation number at the absorber that come through the aperture of the stop and from the
    stop itself, averaged over the band with the wave noise as weight.
    """
    total = chain.occupation.sum(axis=0)
    safe = total + (total == 0)
    return chain.wave_average(chain.occupation_of(SKY) / safe), chain.wave_average(chain.occupation_of(STOP) / safe)


def photon_noise(
    load_k: float,
    frequency_hz: float,
    bandwidth: float,
    efficiency: float,
    *,
    polarizations: int,
    transmission: float = 1.0,
) -> PhotonNoise:
    """Compute the photon noise of a load in a top-hat band.

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
    band = top_hat(frequency_hz, bandwidth)
    nodes = band.nodes[0]
    surfaces = stated("load", SKY, load_k, nodes, transmission), coupling(nodes, efficiency)
    return chain_noise(RadiativeChain(band, polarizations, surfaces))


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
