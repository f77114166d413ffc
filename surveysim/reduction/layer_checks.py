"""Consistency of the changes of the atmosphere's layers with the scans."""

from surveysim.atmosphere.layers import layer_sections
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Scene

FASTEST = 0.1  # of a scan: a realization of a layer for each such time is drawn


def check_changes(scene: Scene) -> None:
    """Raise SceneError for layers that evolve, or winds that drift, too fast for the scans."""
    scan_s, key = scene.scan.duration_s, scene.scan.duration_key
    for number, layer in enumerate(layer_sections(scene.atmosphere) if scene.turbulent else ()):
        given = scene.atmosphere.layers[number] if scene.atmosphere.layers else None
        seconds, drift = layer.decorrelation_time_s, layer.wind_drift
        if seconds is not None and seconds < FASTEST * scan_s:
            where = f"layers.{number}." if given and given.decorrelation_time_s else ""
            raise SceneError(
                f"atmosphere.{where}decorrelation_time: found {seconds:g} s; {FASTEST * scan_s:g} s or more is"
                f" expected, a tenth of {key}"
            )
        if drift is not None and drift.time_scale_s < scan_s:
            where = f"layers.{number}." if given and given.wind_drift else ""
            raise SceneError(
                f"atmosphere.{where}wind_drift.time_scale: found {drift.time_scale_s:g} s; {scan_s:g} s or more is"
                f" expected, {key}"
            )
