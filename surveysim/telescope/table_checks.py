"""Consistency of a table of detectors with the other keys of a scene."""

import numpy as np

from surveysim.runtime.errors import SceneError
from surveysim.scene.detector_table import KEY
from surveysim.scene.scene import Scene
from surveysim.telescope.focal_plane import Camera


def check_table(scene: Scene, cam: Camera) -> None:
    """Raise SceneError for columns of a table of detectors that the scene can't use, or that repeat its keys."""
    _check_noise(scene)
    found = cam.properties
    if found.responsivity is not None and scene.instrument.responsivity_scatter > 0:
        raise _refused(
            scene,
            "responsivity",
            f"together with instrument.responsivity_scatter = {scene.instrument.responsivity_scatter:g}; a scatter of 0"
            " is expected",
        )
    if found.efficiency is not None:
        _check_efficiency(scene, float(found.efficiency.max()))
    _check_pairs(scene, cam)
    duration = scene.scan.duration_s
    if found.time_constant_s is not None and not (longest := found.time_constant_s.max()) <= duration / 10:
        raise _refused(
            scene,
            "time_constant",
            f"{longest:g} s; {duration / 10:g} s or less is expected, a tenth of {scene.scan.duration_key}",
        )
    if found.beam_fwhm_rad is not None and scene.score and scene.score.mask_separation_f_lambda:
        raise _refused(
            scene, "beam_fwhm", "together with score.mask_separation_f_lambda, whose detectors have another mean beam"
        )


def _check_pairs(scene: Scene, cam: Camera) -> None:
    """Refuse detectors at one position where photon noise would correlate them whatever their polarization."""
    positions = np.column_stack([cam.focal_plane.x_rad, cam.focal_plane.y_rad])
    if scene.photon is None or scene.photon.coherence == "none" or len(np.unique(positions, axis=0)) == len(positions):
        return
    if scene.photon.coherence != "hbt":
        raise SceneError(
            f"photon.coherence: found {scene.photon.coherence!r} for detectors that differ in polarization alone; 'hbt'"
            " or 'none' is expected"
        )
    if scene.instrument.polarizations != 1:
        raise SceneError(
            f"instrument.polarizations: found {scene.instrument.polarizations} for detectors that differ in"
            " polarization alone; 1 is expected"
        )


def _check_noise(scene: Scene) -> None:
    stated = scene.instrument.table_noise
    if stated is None:
        return
    if scene.detector is None:
        raise _refused(scene, stated[0], "without the section [detector], which adds that noise")
    if scene.detector.stated is not None:
        raise _refused(scene, stated[0], f"together with detector.{scene.detector.stated}; one of the two is expected")


def _check_efficiency(scene: Scene, highest: float) -> None:
    nominal = scene.instrument.efficiency
    if nominal is not None and nominal * highest > 1 + 1e-9:
        raise _refused(
            scene, "efficiency", f"{highest:g}, times an instrument.efficiency of {nominal:g}; 1 or less is expected"
        )
    if scene.photon is None and scene.detector is None:
        raise _refused(scene, "efficiency", "without [photon] and [detector], whose noise depends on it")
    if scene.detector and scene.detector.kid:
        raise _refused(scene, "efficiency", "together with detector.kid, whose noise depends on the load of each")
    if scene.photon and scene.photon.psd_mk2_hz is not None and scene.photon.bose_fraction is None:
        raise _refused(
            scene,
            "efficiency",
            "with photon.psd and without photon.bose_fraction; that fraction is expected, as shot noise alone depends"
            " on the efficiency",
        )


def _refused(scene: Scene, column: str, why: str) -> SceneError:
    return SceneError(f"{KEY}: {scene.instrument.positions}: column {column!r}: found {why}")
