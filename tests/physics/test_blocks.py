"""A survey in many blocks against the same in one: other noise, the same statistics."""

import numpy as np
import pytest

from surveysim.reduction.observation import transfer_functions
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.survey.run import run_observations
from surveysim.survey.scores import score_survey
from tests.scenes import SMALL_SCENE, write_scene

N_OBS = 48
N_SEEDS = 12


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    """Setup and sums in one block and in four."""
    path = tmp_path_factory.mktemp("blocks") / "small.toml"
    path.write_text(SMALL_SCENE)
    found = []
    for memory, blocks in (("1 MB", 1), ("5 kB", 4)):
        # Enough atmosphere for detectors to be calibrated on: hardly a scan is discarded.
        settings = {"atmosphere.b2": "[2000, 5000, 10000] mK2 rad(-5/3)", "score.jackknives": 32}
        settings |= {"observations": N_OBS, "numerics.max_block_memory": memory}
        setup = prepare(load_scene(path, settings))
        assert len(setup.observing.blocks) == blocks
        found.append((setup, run_observations(setup, None)))
    return found


def test_weather_and_coverage_are_the_same(surveys):
    (_, one), (_, many) = surveys
    for name in ("b2_mk2", "wind_speed_rad_s", "elevation_rad"):
        np.testing.assert_array_equal(one.column(name), many.column(name))
    # Which of the few scans that do not calibrate are discarded is a matter of noise.
    assert many.hits.sum() == pytest.approx(one.hits.sum(), rel=0.05)


def test_noise_of_observations_is_the_same(surveys):
    """Observations have the same weather: their noise differs by chance alone, which its own scatter tells."""
    (_, one), (_, many) = surveys
    ratio = np.log(one.noise_mk2() / many.noise_mk2())
    error = ratio.std(axis=0, ddof=1) / np.sqrt(N_OBS)
    assert (np.abs(ratio.mean(axis=0)) < 4 * error).all() and (error < 0.2).all()


@pytest.mark.parametrize("kind", ["raw_psd", "clean_psd"])
def test_spectra_are_the_same(surveys, kind):
    (_, one), (_, many) = surveys
    ratio = np.log(np.array(getattr(one, kind)) / np.array(getattr(many, kind)))[:, 1:-1]
    error = ratio.std(axis=0, ddof=1) / np.sqrt(N_OBS)
    # 29 frequencies: one in 15000 lies beyond 4 standard errors, all together have a mean square of 1 +- 0.3.
    assert np.abs(ratio.mean(axis=0) / error).max() < 4.5
    assert np.mean((ratio.mean(axis=0) / error) ** 2) < 2


def test_scores_are_the_same(surveys):
    scores = [score_survey(setup, coadds) for setup, coadds in surveys]
    for name, one in scores[0].items():
        many = scores[1][name]
        both = np.hypot(one.band.error_ukcmb2, many.band.error_ukcmb2)
        assert abs(one.band.sigma_ukcmb2 - many.band.sigma_ukcmb2) < 4 * both, name
        assert one.band.ell_eff == pytest.approx(many.band.ell_eff, rel=0.1)


@pytest.mark.parametrize(("scans", "blocks"), [(8, 2), (12, 3)])
def test_central_blocks_tell_what_pipelines_leave_of_a_source(tmp_path, scans, blocks):
    """The blocks that reach the centre of the map stand for the observation: within 2 % of a source's power.

    Seeds differ by dither and by fits of responsivities: over 60 of them the scatter is 5 % in the lowest bin, which 12
    seeds measure to a fifth. A source at the edge of its block would differ by 8 %, with a scatter of 13 % from seed to
    seed.
    """
    path, found = write_scene(tmp_path), []
    settings = {"cleaning.compare": ["planar"], "scan.scans": scans}
    settings |= {"atmosphere.b2": "[2000, 5000, 10000] mK2 rad(-5/3)"}
    for seed in range(N_SEEDS):
        setups = [
            prepare(load_scene(path, settings | {"seed": seed, "numerics.max_block_memory": memory}))
            for memory in ("1 MB", "18 kB")
        ]
        assert [len(setup.observing.blocks) for setup in setups] == [1, blocks]
        whole, central = (transfer_functions(setup)[0, 1, 2:] for setup in setups)
        found.append(np.log(central / whole))
    scatter = np.std(found, axis=0, ddof=1)
    assert (scatter < 0.05 * (1 + 3 / np.sqrt(2 * (N_SEEDS - 1)))).all()
    assert (np.abs(np.mean(found, axis=0)) < 0.02 + 3 * scatter / np.sqrt(N_SEEDS)).all()
