"""Noise-equivalent powers of detectors: bolometers and kinetic inductance detectors (KIDs)."""

from surveysim.scene.noise_and_sky import Bolometer, Detector
from surveysim.scene.scene import Scene
from surveysim.scene.units import BOLTZMANN_J_K


def stated_psd_mk2_hz(scene: Scene) -> float | None:
    """PSD of the detector noise [mK^2/Hz] that the scene or its table of detectors states; None for other noise."""
    if scene.detector is None:
        return 0.0
    if scene.detector.stated is None:
        key, level = scene.instrument.table_noise
        return level if key == "psd" else None
    return scene.detector.psd_mk2_hz


def noise_by_origin(scene: Scene, load_w: float) -> dict[str, float]:
    """Compute the squared NEPs [W^2/Hz] of a scene's detectors under a load [W], by origin; none for a stated PSD."""
    if stated_psd_mk2_hz(scene) is not None:
        return {}
    if scene.detector.stated is None:
        return {"detector": scene.instrument.table_noise[1] ** 2}
    return detector_nep2(scene.detector, load_w)


def detector_nep2(detector: Detector, load_w: float) -> dict[str, float]:
    """Compute the squared NEPs [W^2/Hz] of a detector under a load [W], by origin, but for a stated PSD."""
    if detector.bolometer is not None:
        bolometer = detector.bolometer
        return {"phonon": phonon_nep2(bolometer), "amplifier": bolometer.amplifier_nep_w_rthz**2}
    if detector.kid is not None:
        kid = detector.kid
        recombination = recombination_nep2(load_w, kid.gap_j, kid.pair_breaking_efficiency)
        return {"recombination": recombination, "amplifier": kid.amplifier_nep_w_rthz**2}
    return {"detector": detector.nep_w_rthz**2}


def phonon_nep2(bolometer: Bolometer) -> float:
    """Thermal fluctuation noise [W^2/Hz], ``4 k T_c^2 G F`` (Mather 1982).

    For a link of conductance ``G (T / T_c)^b``, with t = T_bath / T_c, ``F = (b + 1) / (2 b + 3) (1 - t^(2 b + 3)) /
    (1 - t^(b + 1))``: 1 for a bath as warm as the bolometer, about 1/2 for a cold bath.
    """
    b = bolometer.exponent
    t = bolometer.bath_temperature_k / bolometer.critical_temperature_k
    factor = (b + 1) / (2 * b + 3) * (1 - t ** (2 * b + 3)) / (1 - t ** (b + 1))
    return 4 * BOLTZMANN_J_K * bolometer.critical_temperature_k**2 * bolometer.conductance_w_k * factor


def saturation_power_w(bolometer: Bolometer) -> float:
    """Power [W] that the link carries from T_c to the bath, ``G T_c (1 - t^(b + 1)) / (b + 1)``: no more can be
    absorbed."""
    b = bolometer.exponent
    t = bolometer.bath_temperature_k / bolometer.critical_temperature_k
    return bolometer.conductance_w_k * bolometer.critical_temperature_k * (1 - t ** (b + 1)) / (b + 1)


def recombination_nep2(load_w: float, gap_j: float, pair_breaking_efficiency: float) -> float:
    """Recombination noise of the quasiparticles that a load makes [W^2/Hz], ``4 Delta P / eta_pb`` (Zmuidzinas 2012).

    As many pairs recombine as the load breaks, ``r = eta_pb P / 2 Delta`` a second, at random times. Each takes two
    quasiparticles, so that their rate has the one-sided PSD ``2 r 2^2``; one quasiparticle is worth ``Delta / eta_pb``.
    Noise of generation is the photon noise itself.
    """
    return 4 * gap_j * load_w / pair_breaking_efficiency
