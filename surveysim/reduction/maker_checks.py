"""Checks of the map-maker of a scene."""

import math

from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Scene
from surveysim.telescope.scans import Scans, samples_per_scan

_FEWEST_MODES = 2  # cosine modes of a scan in each band of a noise model
_FEWEST_SAMPLES = 2  # of a baseline


def check_maker(scene: Scene, scans: Scans) -> None:
    """Raise SceneError for sections that a map-maker does not take, and for options that scans are too short for."""
    maker = scene.map.maker
    if maker == "binned":
        return
    if scene.cleaning.compare:
        raise SceneError(f"cleaning.compare: found pipelines with map.maker {maker!r}; 'binned' maps compare them")
    if maker == "iterative" and scene.score and scene.score.mask_separation_f_lambda:
        raise SceneError(
            f"score.mask_separation_f_lambda: found with map.maker {maker!r}; other maps have a masked array"
        )
    if scene.spectra:
        raise SceneError(f"spectra: found with map.maker {maker!r}; 'binned' maps are split")
    if maker == "destriped":
        _check_baseline(scene, scans)
    if maker == "maximum_likelihood":
        _check_bands(scene, scans)


def _check_baseline(scene: Scene, scans: Scans) -> None:
    length_s, rate = scene.map.destriped.baseline_s, scans.sample_rate_hz
    if length_s * rate < _FEWEST_SAMPLES:
        raise SceneError(
            f"map.destriped.baseline: found {length_s:g} s, {length_s * rate:.3g} samples; {_FEWEST_SAMPLES / rate:g} s"
            " or more is expected"
        )


def _check_bands(scene: Scene, scans: Scans) -> None:
    """Raise SceneError for bands of frequency that hold too few modes of a scan."""
    n, rate = samples_per_scan(scans), scans.sample_rate_hz
    edges = (0.0, *scene.map.likelihood.band_edges_hz, math.inf)
    modes = [k * rate / (2 * n) for k in range(1, n)]
    for low, high in zip(edges, edges[1:], strict=False):
        if sum(low <= mode < high for mode in modes) < _FEWEST_MODES:
            raise SceneError(
                f"map.maximum_likelihood.band_edges: found a band from {low:g} to {high:g} Hz with fewer than"
                f" {_FEWEST_MODES} modes of a scan, which are {modes[0]:.3g} Hz apart up to {modes[-1]:.3g} Hz; wider"
                " bands are expected"
            )
