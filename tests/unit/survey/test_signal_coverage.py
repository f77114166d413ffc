"""Warnings about scored patches that the signal simulations do not cover."""

from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.survey.run import run_observations
from surveysim.survey.signal_coverage import signal_coverage_warnings
from tests.scenes import write_scene


def test_holes_of_the_signal_simulations_alone(tmp_path):
    """Half of the patch is half of the squared taper; pixels without any data do not count."""
    setup = prepare(load_scene(write_scene(tmp_path), {"observations": 2}))
    coadds, analysis = run_observations(setup, None), setup.analysis
    patch, n = analysis.region.patch, len(analysis.region.taper)
    assert signal_coverage_warnings(analysis, coadds) == []
    coadds.signal_weight[:, : n // 2] = 0
    (line,) = signal_coverage_warnings(analysis, coadds)
    assert line.startswith("score.signal_sims.observations: the observations with simulated signal miss 50 % of the")
    coadds.weight[:, patch, patch][:, : n // 2] = 0
    assert signal_coverage_warnings(analysis, coadds) == []
    coadds.signal_weight[:] = 0
    assert signal_coverage_warnings(analysis, coadds) == []
