"""Consistency of the sections of the detectors' response and of pointing errors with the scans."""

import math

from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Scene

MOST_BANDWIDTH = 1 / 8  # of the sample rate


def check_response(scene: Scene) -> None:
    """Raise SceneError for drifts faster than a scan, errors above a beam, and jitter that samples do not resolve."""
    drift, errors = scene.responsivity_drift, scene.pointing_errors
    if drift is not None and drift.rms:
        _check_slow("responsivity_drift.time_scale", drift.time_scale_s, scene)
    if drift is not None and drift.calibration_elevation_rad and scene.place is None:
        raise SceneError(
            "responsivity_drift.calibration_elevation: found without atmosphere.site, whose load depends on the"
            " elevation; a site is expected"
        )
    for name in ("jitter", "drift", "positions") if errors is not None else ():
        _check_small(f"pointing_errors.{name}", getattr(errors, f"{name}_rad"), scene.instrument.beam_fwhm_rad)
    if errors is not None and errors.drift_rad:
        _check_slow("pointing_errors.drift_time_scale", errors.drift_time_scale_s, scene)
    most_hz = MOST_BANDWIDTH * scene.scan.sample_rate_hz
    if errors is not None and errors.jitter_bandwidth_hz is not None and errors.jitter_bandwidth_hz > most_hz:
        raise SceneError(
            f"pointing_errors.jitter_bandwidth: found {errors.jitter_bandwidth_hz:g} Hz; {most_hz:g} Hz or less is"
            " expected, an eighth of scan.sample_rate, or none for jitter that is independent in each sample"
        )


def _check_small(key: str, error_rad: float, beam_rad: float) -> None:
    if error_rad > beam_rad:
        found, allowed = (math.degrees(item) * 3600 for item in (error_rad, beam_rad))
        raise SceneError(f"{key}: found {found:.4g} arcsec; {allowed:.4g} arcsec or less is expected, the beam's FWHM")


def _check_slow(key: str, time_scale_s: float, scene: Scene) -> None:
    scan_s = scene.scan.duration_s
    if time_scale_s < scan_s:
        raise SceneError(
            f"{key}: found {time_scale_s:g} s; {scan_s:g} s or more is expected, {scene.scan.duration_key}"
        )
