"""Metric `flat_band_power`: uncertainty sigma(A) of a flat CMB band power from noise alone."""

from mapmaker.bandpower import band_power
from surveysim.metrics.map_noise import MapNoise, Quantity
from surveysim.scene.metrics import FlatBandPower


def quantities(noise: MapNoise, options: FlatBandPower) -> tuple[Quantity, ...]:
    """Compute ``sigma(A) = (sum_b n_b/2 (M_b/N_b)^2)^(-1/2)`` over the scored bins (`mapmaker.bandpower`)."""
    found = band_power(
        noise.noise_psd,
        noise.signal_psd,
        noise.map.n_modes,
        noise.map.selected,
        ell=noise.map.ell,
        edges_ell=noise.map.edges_ell,
        relative_error=0.0,
    )
    return (Quantity("sigma", found.sigma_ukcmb2, "uK2", response=found.weight),)
