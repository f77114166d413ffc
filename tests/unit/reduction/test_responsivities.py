"""Whose responsivities a scene cleans with: keys, draws, pipelines, blocks, signal simulations and forecasts."""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker.cleaning import TEMPLATE_CLEANINGS
from surveysim import run
from surveysim.forecasting.fitted_modes import NO_FITTED_MODES
from surveysim.forecasting.mode_response import projected_array
from surveysim.forecasting.noise_model import noise_models
from surveysim.forecasting.observing_conditions import observing_conditions, removed_modes, survey_draws
from surveysim.reduction import cleaned_block, signal_maps
from surveysim.reduction.cleaning_pipelines import AuxiliaryData, apply_pipeline
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.studies.sweep.axes import load_sweep
from tests.scenes import SMALL_SCENE

SOURCES = {
    "scan": {},
    "observation": {"cleaning.responsivities": "observation"},
    "survey": {"cleaning.responsivities": "survey", "cleaning.calibration_error": 0.02},
    "known": {"cleaning.responsivities": "known"},
}
KEYS = {"sigma_cut": 3.0, "order": 1, "regions": 1}
PCA = {"cleaning.algorithm": "pca", "cleaning.sigma_cut": 3.0, "score.mask_separation_f_lambda": None}
LONG = {"scan.duration": "15 s", "scan.sample_rate": "10 Hz"}  # for 'wind', which measures it


@pytest.fixture
def setup_of(tmp_path):
    def make(**settings):
        path = tmp_path / "small.toml"
        path.write_text(SMALL_SCENE)
        return prepare(load_scene(path, {key.replace("__", "."): value for key, value in settings.items()}))

    return make


@pytest.mark.parametrize(
    "settings, words",
    [
        ({"cleaning.responsivities": "night"}, "cleaning.responsivities: .*'scan', 'observation', 'survey' or 'known'"),
        (
            {"cleaning.responsivities": "survey"},
            "cleaning.calibration_error: missing; responsivities 'survey' needs it",
        ),
        (SOURCES["survey"] | {"cleaning.calibration_error": 0}, "calibration_error: found 0; a number greater than"),
        (SOURCES["survey"] | {"cleaning.calibration_error": 1.5}, "calibration_error: .*less than or equal to 1"),
        (
            SOURCES["known"] | {"cleaning.algorithm": "pca", "cleaning.sigma_cut": 3.0},
            "responsivities: found 'known' with 'pca' alone, which needs none; 'scan' is expected, or an algorithm of",
        ),
    ],
)
def test_keys_that_do_not_fit(setup_of, settings, words):
    with pytest.raises(SceneError, match=words) as caught:
        setup_of(**settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("source", ["scan", "observation", "known"])
def test_only_survey_uses_the_calibration_error(setup_of, source):
    plain, erring = setup_of(**SOURCES[source]), setup_of(**SOURCES[source], cleaning__calibration_error=0.5)
    np.testing.assert_array_equal(observe(erring, 0, True).sums, observe(plain, 0, True).sums)


def test_a_sweep_takes_all_settings(tmp_path):
    path = tmp_path / "sources.toml"
    path.write_text(f'{SMALL_SCENE}\n[sweep]\n"cleaning.responsivities" = {list(SOURCES)}\n')
    scenes = [point.scene for point in load_sweep(path, {"cleaning.calibration_error": 0.02}).points]
    assert [scene.cleaning.responsivities for scene in scenes] == list(SOURCES)


def test_a_compared_cleaning_may_be_the_one_that_takes_them(setup_of):
    setup = setup_of(**SOURCES["known"], **PCA, cleaning__compare=["average"])
    assert setup.analysis.calibration is not None


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("name", TEMPLATE_CLEANINGS)
def test_every_cleaning_runs_with_every_setting(setup_of, name, source):
    keys = {f"cleaning.{key}": value for key, value in KEYS.items()}
    setup = setup_of(**SOURCES[source], **keys, **LONG, cleaning__algorithm=name, score__noise_only_sets=[])
    found = observe(setup, 0, with_signal_sims=True)
    assert (found.iterations[0] == 0) == (source in ("survey", "known"))
    assert found.hits.any() and np.isfinite(found.sums).all() and found.signal_maps.any()


def test_the_calibration_is_the_true_one_with_its_error(setup_of):
    """Of 127 detectors and seven seeds, the rms of the error is known to 9 %; nothing else that is drawn moves."""
    errors = []
    for seed in range(7):
        keys = {"seed": seed, "instrument__layout__rings": 6}
        known, survey = setup_of(**keys, **SOURCES["known"]), setup_of(**keys, **SOURCES["survey"])
        np.testing.assert_array_equal(known.analysis.calibration[0], known.camera.responsivity)
        np.testing.assert_array_equal(survey.camera.responsivity, known.camera.responsivity)
        assert survey.analysis.calibration[0].mean() == pytest.approx(1)
        errors.append(np.log(survey.analysis.calibration[0] / survey.camera.responsivity))
    errors = np.array(errors)
    assert errors.std(axis=1).mean() == pytest.approx(0.02, rel=4 / np.sqrt(2 * errors.size))
    assert np.abs(np.corrcoef(errors)[0, 1:]).max() < 4 / np.sqrt(errors.shape[1])
    assert all(setup_of(**SOURCES[source]).analysis.calibration is None for source in ("scan", "observation"))


@pytest.mark.parametrize("place", [0, -1], ids=["all", "masked"])
def test_a_pipeline_knows_its_own_detectors(setup_of, place):
    """A signal times the true responsivities vanishes, of all detectors and of the masked ones."""
    setup = setup_of(**SOURCES["known"])
    pipeline, plane = setup.analysis.pipelines[place], setup.camera.focal_plane
    data = setup.camera.responsivity[:, None] * np.random.default_rng(1).standard_normal(60)
    auxiliary = AuxiliaryData(np.zeros((1, 2)), np.zeros((0, *data.shape)), setup.analysis.calibration)
    bounds, section = np.array([[0, 60]]), setup.scene.cleaning
    left = apply_pipeline(
        section,
        pipeline,
        data[pipeline.rows],
        scan_bounds=bounds,
        focal_plane=plane.subset(pipeline.rows),
        auxiliary=auxiliary,
        sample_rate_hz=10.0,
    )
    assert left.kept.all() and np.abs(left.data_mk).max() < 1e-12


def test_other_bands_are_cleaned_with_their_own(setup_of):
    """Signal common to all detectors and bands vanishes: each band is cleaned with its own responsivities."""
    setup = setup_of(**SOURCES["known"])
    rng, n_det = np.random.default_rng(2), setup.camera.n_det
    calibration = np.exp(0.1 * rng.standard_normal((2, n_det)))
    noise, bounds, found = rng.standard_normal((2, n_det, 60)), np.array([[0, 60]]), []
    pipeline, section = replace(setup.analysis.pipelines[0], steps=("average", "spectral")), setup.scene.cleaning
    for strength in (1.0, 1000.0):
        common = strength * np.sin(np.arange(60))
        mapped, other = noise + calibration[..., None] * common
        auxiliary = AuxiliaryData(np.zeros((1, 2)), other[None], calibration)
        found.append(
            apply_pipeline(
                section,
                pipeline,
                mapped,
                scan_bounds=bounds,
                focal_plane=setup.camera.focal_plane,
                auxiliary=auxiliary,
                sample_rate_hz=10.0,
            ).data_mk
        )
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)


# ---------------------------------------------------------------- blocks, engines, signal simulations


def test_a_fit_to_an_observation_needs_it_whole(setup_of):
    words = (
        "numerics.max_block_memory: found 0.009 MB, which cuts an observation into 2 blocks; cleaning.responsivities "
        "'observation' needs it whole: 0.01728 MB or more is expected, or 'survey' in its place"
    )
    with pytest.raises(SceneError, match=words):
        setup_of(**SOURCES["observation"], numerics__max_block_memory="9 kB")
    for source in ("survey", "known"):
        assert len(setup_of(**SOURCES[source], numerics__max_block_memory="9 kB").observing.blocks) == 2


def test_a_survey_has_one_calibration_however_it_is_cut(setup_of):
    whole, cut = (setup_of(**SOURCES["survey"], numerics__max_block_memory=memory) for memory in ("1 MB", "5 kB"))
    np.testing.assert_array_equal(cut.analysis.calibration, whole.analysis.calibration)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["observation", "survey"])
def test_workers_change_no_bit(setup_of, source, two_threads):
    scene = setup_of(**SOURCES[source]).scene
    one, two = (run(scene, engine=engine) for engine in (SERIAL, Engine(workers=2)))
    np.testing.assert_array_equal(one.coadds.sums, two.coadds.sums)
    np.testing.assert_array_equal(one.coadds.signal_maps, two.coadds.signal_maps)


# Scans that the second cleaning and the next get: three skies in one pass, or a fit to all scans with each sky.
@pytest.mark.parametrize("source, again", [("scan", [9]), ("observation", [4, 4, 4])])
def test_signal_simulations_are_fitted_with_the_same_scans(setup_of, monkeypatch, source, again):
    """A scan that is lost without a sky is cleaned again only where it has a part in the others' responsivities."""
    clean, cleaned = cleaned_block.apply_pipeline, []

    def lossy(*arguments, **options):
        done = clean(*arguments, **options)
        first = not cleaned
        cleaned.append(len(done.kept))
        if not first:
            return done
        done.data_mk[:, :60] = 0
        return replace(done, kept=np.arange(4) > 0)

    for module in (cleaned_block, signal_maps):
        monkeypatch.setattr(module, "apply_pipeline", lossy)
    strong = {"atmosphere__b2": "[2000, 5000, 10000] mK2 rad(-5/3)"}  # so that no other scan is lost
    found = observe(
        setup_of(**SOURCES[source], **strong, score__mask_separation_f_lambda=None), 0, with_signal_sims=True
    )
    assert cleaned == [4, *again] and found.signal_maps.any()


def test_a_fit_that_other_scans_share_with_the_sky_tells_nothing(setup_of, monkeypatch):
    clean = cleaned_block.apply_pipeline

    def lossy(*arguments, **options):
        return replace(clean(*arguments, **options), kept=np.arange(4) > 0)

    monkeypatch.setattr(signal_maps, "apply_pipeline", lossy)
    found = observe(setup_of(**SOURCES["observation"], score__mask_separation_f_lambda=None), 0, with_signal_sims=True)
    assert not found.signal_maps.any()


@pytest.mark.parametrize("algorithm", ["average", "quadratic", "wind", "pca", "local", "none"])
def test_skies_in_one_pass_have_the_bits_of_skies_in_turn(setup_of, monkeypatch, algorithm):
    keys = {"pca": {"cleaning__sigma_cut": 3.0}, "local": {"cleaning__neighbour_radius": 1.5}}.get(algorithm, {})
    setup = setup_of(cleaning__algorithm=algorithm, score__mask_separation_f_lambda=None, **keys)
    together = observe(setup, 0, with_signal_sims=True).signal_maps
    monkeypatch.setattr(signal_maps, "_MOST_SAMPLES", 1)
    np.testing.assert_array_equal(observe(setup, 0, with_signal_sims=True).signal_maps, together)
    assert together.any(axis=(-1, -2)).all()


# ---------------------------------------------------------------- forecast


def _modes(setup):
    pipeline, levels = setup.analysis.pipelines[0], observing_conditions(setup, survey_draws(setup, 0, 4))
    plane = setup.camera.focal_plane
    return removed_modes(
        setup,
        pipeline,
        projected_array(plane, 0.0, responsivity=setup.camera.responsivity, algorithm=pipeline.steps[0]),
        levels,
    )


def test_what_a_forecast_takes_for_fitted(setup_of):
    scan, observation = (_modes(setup_of(**SOURCES[source])) for source in ("scan", "observation"))
    assert 0.9 < scan.share.sum() < 1
    np.testing.assert_allclose(observation.share, scan.share / 4)  # of four scans
    assert _modes(setup_of(**SOURCES["survey"])) is _modes(setup_of(**SOURCES["known"])) is NO_FITTED_MODES
    assert _modes(setup_of(cleaning__algorithm="none")) is NO_FITTED_MODES
    # PCA fits a mode to each scan whatever templates take.
    np.testing.assert_allclose(_modes(setup_of(**PCA)).share, scan.share)


def test_a_survey_s_error_leaves_a_part_of_the_layer(setup_of):
    """Closed form: e^2 of the layer that all detectors see, beside what known responsivities leave."""
    noise = []
    for error in (None, 1e-6, 0.05, 0.1):
        source = SOURCES["known"] if error is None else SOURCES["survey"] | {"cleaning.calibration_error": error}
        setup = setup_of(**source)
        levels = observing_conditions(setup, survey_draws(setup, 0, 4))
        model = next(noise_models(setup, levels))
        noise.append(model.layer_noise(replace(levels, layers=np.ones((1, 4)))))
    known, least, some, twice = noise
    np.testing.assert_allclose(least, known, rtol=1e-4)
    added = (twice - known) / (some - known)
    assert (some > known).all() and np.median(added) == pytest.approx(4, rel=0.25)
