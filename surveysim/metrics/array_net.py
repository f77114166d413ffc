"""Metric `array_net`: noise-equivalent temperature (NET) of detectors and array after cleaning.

It is the NET of an ideal camera, with white noise and no loss of signal, that measures a flat band power as well as
this one: with the same scans, detectors and scored multipoles. Its noise PSD is ``N = sigma(A) (sum_b n_b/2
M_b^2)^(1/2)``, with M the signal PSD before scans and cleaning. The exposure E (detector-seconds per sr) turns it into
the NET of a detector, ``NET^2 = N E``. The array has ``NET / sqrt(n_det)``. The time counts all scans:
discarded scans and bad weather raise the NET.
"""

import numpy as np

from mapmaker.bandpower import bin_weights, flat_band_power
from surveysim.metrics.map_noise import MapNoise, Quantity
from surveysim.scene.metrics import ArrayNet


def quantities(noise: MapNoise, options: ArrayNet) -> tuple[Quantity, ...]:
    """Compute the NETs of array and detector in Rayleigh-Jeans and CMB temperature."""
    region = noise.map
    scored = noise.noise_psd, noise.signal_psd, region.n_modes, region.selected
    ideal = np.sqrt(np.sum((region.n_modes / 2 * region.flat_psd**2)[region.selected]))
    detector = 1e-3 * np.sqrt(flat_band_power(*scored) * ideal * noise.exposure())
    found = {"cmb": detector, "rj": detector * 1e3 / region.ukcmb_per_mk}
    response = bin_weights(*scored) / 2
    return tuple(
        Quantity(f"{part}_{kind}", float(value / root), "mK s(1/2)", response=response)
        for part, root in (("array", np.sqrt(noise.n_det)), ("detector", 1.0))
        for kind, value in sorted(found.items(), reverse=True)
    )
