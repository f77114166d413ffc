"""Effects on a forecast and their sizes, multipoles that follow the scene, and how far a run agrees."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surveysim import load_scene, run
from surveysim.forecasting.forecast import expected_weights, forecast
from surveysim.forecasting.noise_model import survey_models
from surveysim.forecasting.observing_conditions import observing_conditions, survey_draws
from surveysim.forecasting.pilot import KeptScans, _interpolate_shares, _pilot_size, predict_kept_scans
from surveysim.forecasting.validity import compared_ell, resolution_ell
from surveysim.reduction.setup import prepare
from surveysim.report.terminal.survey import effect_warnings, forecast_warnings
from surveysim.results.agreement import _scatter, agreement, forecast_agreement
from surveysim.results.results import GOOD_PSD, KNOWN
from surveysim.results.summary import summary
from surveysim.results.tables import agreement_table
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.errors import SceneError
from surveysim.runtime.strict_json import known
from surveysim.survey.rows import ROW_FIELDS
from surveysim.telescope.scans import samples_per_scan
from tests.scenes import SMALL_SCENE, with_scan

LYNX = Path(__file__).parents[3] / "scenarios" / "lynx.toml"
ARCMIN = np.radians(1 / 60)
# Weather so calm that the layer hardly stands out of the noise: many scans are discarded.
CALM = {"atmosphere.b2": "[2, 10, 400] mK2 rad(-5/3)", "observations": 12, "score.jackknives": 16}
# Noise so faint that the layer is most of what cleaning leaves.
FAINT = {f"{name}.psd": "1e-4 mK2 / Hz" for name in ("photon", "detector")} | {"excess.variance": "[1e-5, 2e-5] mK2"}
LARGER = {"scan.scans": 9, "scan.duration": "8 s", "score.size": "24 arcmin", "score.ell_bin": 1000}


@pytest.fixture(scope="module")
def scene_of(tmp_path_factory):
    def load(text: str = SMALL_SCENE, **overrides):
        path = tmp_path_factory.mktemp("scene") / "small.toml"
        path.write_text(text)
        return load_scene(path, {key.replace("__", "."): value for key, value in overrides.items()})

    return load


@pytest.fixture(scope="module")
def calm(scene_of):
    return run(scene_of(**CALM, **LARGER), engine=SERIAL)


def effects_of(scene, name="actual"):
    return {effect.name: effect for effect in forecast(prepare(scene)).scores[name].effects}


# ---------------------------------------------------------------- multipoles


def test_multipoles_of_the_taper_the_scan_and_the_beam(scene_of):
    """A taper of 12 arcmin, half of it edges, has 11/16 of its length; a beam of 60 arcsec leaves 3 % at ell 15160."""
    setup = prepare(scene_of())
    assert resolution_ell(setup.scene) == pytest.approx(2 * np.pi / (12 * 11 / 16 * ARCMIN))
    low, high = compared_ell(setup.scene)
    assert low == pytest.approx(3 * resolution_ell(setup.scene))
    width = ARCMIN / np.sqrt(8 * np.log(2))
    assert np.exp(-((high * width) ** 2)) == pytest.approx(0.03)
    short = prepare(scene_of(scan__duration="1.5 s"))  # 6 arcmin, shorter than the taper
    assert resolution_ell(short.scene) == pytest.approx(2 * np.pi / (6 * ARCMIN))


def test_multipoles_end_at_pixels_and_samples(scene_of):
    wide_beam = {"instrument.beam_fwhm": "10 arcsec"}
    pixels = compared_ell(prepare(scene_of(**wide_beam)).scene)[1]
    assert pixels == pytest.approx(0.75 * np.pi / (0.5 * ARCMIN))
    fast = scene_of(scan__speed="20 arcmin / s", **wide_beam)
    assert compared_ell(prepare(fast).scene)[1] == pytest.approx(np.pi * 10 / (20 * ARCMIN))


def testlowest_multipoles_follow_the_scene(scene_of, calm):
    """Ninths of the scene's own, on edges of bins, down to the taper's resolution; those of Bolocam's Lynx survey."""
    from surveysim.results.alternatives import lowest_multipoles

    assert lowest_multipoles(prepare(load_scene(LYNX))) == [1000, 2000, 3000, 4000, 4500, 5000, 5500]
    assert sorted({row["ell_min"] for row in summary(calm)["alternatives"]}) == [2000, 3000, 4000, 5000]
    fine = scene_of(score__ell_min=9000, score__ell_max=18000, score__ell_bin=1000, map__pixel="20 arcsec")
    assert lowest_multipoles(prepare(fine)) == [4000, 6000, 8000, 9000, 10000, 11000]


# ---------------------------------------------------------------- discarded scans


def test_runs_compare_with_the_forecast_of_the_scans_that_they_kept(calm):
    """The noise of each observation, weighted and co-added by hand with its kept scans."""
    setup, expected = calm.setup, calm.expected.scores["actual"]
    counts = np.array([row[len(ROW_FIELDS)] for row in calm.coadds.rows])
    kept = 1 - counts / setup.observing.scans.n_scans
    assert 0.05 < 1 - kept.mean() < 0.95 and expected.kept.discarded == pytest.approx(1 - kept.mean())
    levels = observing_conditions(setup, survey_draws(setup, 0, 12))
    noise = survey_models(setup)[0].noise(levels)
    weight = expected_weights(setup.analysis, noise)
    whole = forecast(setup, {name: np.ones(12) for name in ("actual", "masked_7")}).scores["actual"]
    ratio = (weight**2 * kept) @ noise / (weight @ kept) ** 2 / (weight**2 @ noise / weight.sum() ** 2)
    np.testing.assert_allclose(expected.noise_psd / whole.noise_psd, ratio, rtol=1e-9)
    assert summary(calm)["forecast"]["actual"]["discarded"] == expected.kept.discarded


def test_a_pilot_predicts_the_share(calm):
    """Of a dozen observations it takes all: within three of its errors of what the run counted."""
    counted = calm.expected.scores["actual"].kept
    predicted = forecast(calm.setup).scores["actual"].kept
    assert counted.error == 0 < predicted.error < 0.2
    assert abs(predicted.discarded - counted.discarded) < 3 * predicted.error
    # The calmest lose most.
    order = np.argsort(calm.coadds.column("b2_mk2"))
    assert predicted.share[order][:4].mean() < predicted.share[order][-4:].mean()
    assert np.array_equal(forecast(calm.setup).scores["actual"].kept.share, predicted.share)


def test_a_pilot_of_few_observations_takes_more_of_their_scans(scene_of):
    """Thirty-two times 6 scans in all, or as many as 3e6 detector-samples are; never more than there are."""
    keys = {"scan.scans": 60, "scan.step": "0.2 arcmin"}
    setup = prepare(scene_of(**keys))
    samples = setup.camera.n_det * samples_per_scan(setup.observing.scans)
    sizes = [_pilot_size(setup.observing, samples, n_obs) for n_obs in (1, 4, 16, 1000)]
    assert sizes == [(60, 1), (48, 4), (12, 16), (6, 32)]


def test_a_forecast_without_a_kept_scan_says_how_it_knows(scene_of):
    lost = scene_of(cleaning__max_iterations=1)
    with pytest.raises(SceneError, match="rejected all scans of a pilot; .*Remedy: cleaning.responsiv"):
        forecast(prepare(lost))


def test_a_forecast_without_samples_says_so(scene_of):
    lost = {"dropped_samples.rate": "1 Hz", "dropped_samples.length": "1 day", "dropped_samples.shared": "array"}
    with pytest.raises(SceneError, match=r"^dropped_samples: found all samples lost; some are needed$"):
        forecast(prepare(scene_of(**lost, **CALM)))


def test_known_responsivities_discard_nothing(scene_of, monkeypatch):
    known = scene_of(cleaning__responsivities="known", **CALM)
    assert forecast(prepare(known)).scores["actual"].kept.discarded == 0
    # A pilot of more than a few seconds is not made: the share is said not to be known.
    monkeypatch.setattr("surveysim.forecasting.pilot._MOST_SAMPLES", 1e3)
    effect = effects_of(scene_of(**CALM))["discarded scans"]
    assert effect.size is None and effect.flagged and "unknown" in effect.sentence


def test_fits_to_observations_are_tried_with_fewer_scans(scene_of, monkeypatch):
    """In strong layers all fits to two of the scans converge; in calm weather some fail, and the share is unknown."""
    of_all = CALM | {"cleaning.responsivities": "observation"}
    setup = prepare(scene_of(**of_all))
    scan_samples = setup.camera.n_det * samples_per_scan(setup.observing.scans)
    n_scans, n_pilot = _pilot_size(setup.observing, scan_samples, 12)
    assert n_scans == setup.observing.scans.n_scans > 2
    monkeypatch.setattr("surveysim.forecasting.pilot._MOST_SAMPLES", 2.5 * n_pilot * scan_samples)
    strong = effects_of(scene_of(**(of_all | {"atmosphere.b2": "[400, 900, 2000] mK2 rad(-5/3)"})))["discarded scans"]
    assert strong.size == 0 and not strong.flagged
    assert f"0.0 +- {100 / n_pilot:.1f} %" in strong.sentence  # one observation of the pilot more or less
    calm = effects_of(scene_of(**of_all))["discarded scans"]
    assert calm.size is None and calm.flagged


def test_shares_are_interpolated_between_observations_of_a_pilot():
    """Observations 2, 0, 1, 3, 4 by their layer, of which the first, the fourth and the last are in the pilot."""
    kept = _interpolate_shares(np.array([2, 0, 1, 3, 4]), np.array([0, 3, 4]), np.array([0.25, 1.0, 1.0]), 4)
    np.testing.assert_allclose(kept.share, [0.5, 0.75, 0.25, 1, 1])
    # They stand for 2, 2 and 1 of five; their scatter is that of neighbours.
    assert kept.error == pytest.approx(np.sqrt(0.75**2 / 4) * np.sqrt(2**2 + 2**2 + 1) / 5)
    # As if one scan of the pilot more or less were lost, where all of them are kept.
    assert _interpolate_shares(np.arange(5), np.array([0, 3, 4]), np.ones(3), 4).error == pytest.approx(1 / 12)


def test_shares_of_many_observations_follow_the_weather(scene_of):
    setup = prepare(scene_of(observations=100, atmosphere__b2="[2, 10, 400] mK2 rad(-5/3)"))
    levels = observing_conditions(setup, survey_draws(setup, 0, 100))
    kept = predict_kept_scans(setup, setup.analysis.pipelines, levels, np.ones(100))["actual"]
    assert kept.share.shape == (100,) and kept.share.min() >= 0 and kept.share.max() <= 1
    order = np.argsort(levels.layers[0])
    assert kept.share[order][:25].mean() < kept.share[order][-25:].mean() - 0.5
    assert KeptScans(np.array([1.0, 0.5])).discarded == 0.25


# ---------------------------------------------------------------- effects


@pytest.mark.parametrize(
    "name, keys",
    [
        ("scans that share air", {"cleaning.algorithm": "none"}),
        ("stripes", FAINT),
        ("low multipoles", {}),
        ("discarded scans", CALM),
        ("few detectors", {"cleaning.algorithm": "quadratic"}),
        ("uneven coverage", {"scan.step": "9 arcmin", "scan.dither": "0 arcmin", "score.size": "24 arcmin"}),
        ("cleaning", {"cleaning.algorithm": "wind", "scan.duration": "12 s"}),
    ],
)
def test_effects_are_flagged(scene_of, name, keys):
    text = SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", "")
    effect = effects_of(scene_of(text, **keys))[name]
    assert effect.flagged and effect.sentence.endswith(".")
    assert (effect.size is None) == (name == "cleaning")


def test_a_good_forecast_has_no_flag(scene_of):
    bright = {"atmosphere.b2": "[400, 900, 2000] mK2 rad(-5/3)", "score.ell_min": 6000, "observations": 24}
    found = forecast(prepare(scene_of(**{**LARGER, **bright})))
    assert not any(effect.flagged for effect in found.scores["actual"].effects)
    effects = {name: [vars(effect) for effect in item.effects] for name, item in found.scores.items()}
    assert len(effects["actual"]) > 0 and effect_warnings(effects) == []


def test_sizes_of_effects(scene_of):
    """Templates over detectors; the layer's share falls with the layer, and with its wind no scan shares air."""
    text = SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", "")
    assert effects_of(scene_of(text, cleaning__algorithm="planar"))["few detectors"].size == pytest.approx(3 / 18)
    air = "scans that share air"
    none = {"cleaning.algorithm": "none"}
    bright, faint = (
        effects_of(scene_of(text, **none, **keys))[air].size
        for keys in ({}, {"atmosphere.b2": "[1, 2, 3] mK2 rad(-5/3)"})
    )
    assert 0 < faint < bright < 1
    still, windy = (
        effects_of(scene_of(text, atmosphere__wind_median=f"{speed} arcmin / s"))[air].size for speed in (0.02, 60)
    )
    assert windy == 0 < still


DAISY = 'pattern = "daisy"\nradius = "20 arcmin"\nradial_period = "20 s"\nduration = "200 s"\nchunk = "10 s"\n'
DAISY += 'dither = "2 arcmin"\nsample_rate = "10 Hz"\n'


@pytest.mark.parametrize(
    "name, keys",
    [
        ("curved track", {"scan.radius": "2 arcmin", "score.size": "6 arcmin"}),
        ("scattered noise", {"photon.psd": "1e-3 mK2 / Hz", "detector.psd": "1e-3 mK2 / Hz", "excess": None}),
        ("scans that share air", {"atmosphere.wind_median": "0.1 arcmin / s", **FAINT}),
    ],
)
def test_effects_of_curved_tracks_are_flagged(scene_of, name, keys):
    """Tracks that turn within a wavelength, layers far above the other noise, and air that hardly moves in a petal."""
    text = with_scan(SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", ""), DAISY)
    bright = {"atmosphere.b2": "[400, 900, 2000] mK2 rad(-5/3)", "cleaning.responsivities": "known"}
    found = effects_of(scene_of(text, **(bright | {"score.size": "20 arcmin"} | keys)))
    assert found[name].flagged and found[name].sentence.endswith(".")


def test_effects_of_tracks_are_those_of_the_pattern(scene_of):
    """Stripes are those of rasters, turns and filters those of curves; a wide daisy hardly turns in a wavelength."""
    text = SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", "")
    keys = {"cleaning.algorithm": ["average", "time_polynomial"], "cleaning.time_order": 2}
    raster = effects_of(scene_of(text, **keys))
    daisy = effects_of(scene_of(with_scan(text, DAISY), score__size="20 arcmin", **keys))
    assert "stripes" in raster and "curved track" not in raster
    assert "stripes" not in daisy and "curved track" in daisy
    assert daisy["curved track"].size < 0.02
    assert daisy["filters"].flagged and "filters" not in raster


def test_solved_maps_have_the_effects_of_their_maker(scene_of):
    """Baselines as long as a scan of 6 s take some of the weight, a noise model next to none."""
    text = SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", "")
    likelihood = {"map.maker": "maximum_likelihood", "map.maximum_likelihood.band_edges": "[0.4, 1.6] Hz"}
    found = effects_of(scene_of(text, **likelihood))
    assert "weights" not in found and found["map-maker"].size < 0.05 and not found["map-maker"].flagged
    sizes = [
        effects_of(scene_of(text, map__maker="destriped", map__destriped__baseline=f"{baseline} s"))["map-maker"].size
        for baseline in (6, 0.5)
    ]
    assert sizes[0] < 0.15 < 0.5 < sizes[1]
    iterative = effects_of(scene_of(text, map__maker="iterative"))["map-maker"]
    assert iterative.flagged and iterative.size is None and "map-maker" not in effects_of(scene_of(text))


# ---------------------------------------------------------------- agreement


def test_only_bins_that_are_known_can_be_good(calm):
    """One bin off, one bin known too badly: each ends the claim that all are good."""
    setup, item = calm.setup, calm.scores["actual"]
    weights = np.ones(400)  # hundreds of observations: errors are those of sign flips alone
    rng = np.random.default_rng(3)
    scatter = 1 + 0.02 * rng.standard_normal((64, len(item.signal_psd)))
    psds = scatter / scatter.mean(axis=0)
    sure = replace(item, noise_psds=psds, weights=weights)
    kept = KeptScans(np.ones(400))
    expected = replace(calm.expected.scores["actual"], noise_psd=np.ones(psds.shape[1]), weights=weights, kept=kept)
    found = agreement(setup, sure, expected)
    assert found.bins == found.within > 2 and found.unknown == 0
    edges = setup.analysis.region.rings.edges_ell
    place = int(np.flatnonzero(edges[:-1] >= found.low_ell)[1])
    off = np.ones(psds.shape[1])
    off[place] += GOOD_PSD + 0.02
    worse = agreement(setup, sure, replace(expected, noise_psd=off))
    assert worse.within == found.bins - 1 and worse.psd == pytest.approx(GOOD_PSD + 0.02)
    assert worse.worst_ell == item.band.ell[place]
    noisy = psds.copy()
    noisy[:, place] = 1 + 12 * KNOWN * np.sqrt(2) * np.cos(2 * np.pi * np.arange(64) / 64)
    unknown = agreement(setup, replace(sure, noise_psds=noisy), expected)
    assert unknown.unknown == 1 and unknown.within == found.bins - 1


def test_errors_leave_the_weather_out(scene_of):
    """Weather that spans decades is in the error of the plain sigma(A), and not in that of the ratio."""
    wild = run(
        scene_of(**{**LARGER, **CALM, "cleaning.responsivities": "known", "excess.b2": [1, 1000]}), engine=SERIAL
    )
    for name, item in forecast_agreement(wild).items():
        budget = wild.scores[name].budget
        least = np.hypot(budget.noise, budget.transfer_function) * (1 + item.sigma)
        assert item.sigma_error >= least * (1 - 1e-9)
    actual = forecast_agreement(wild)["actual"]
    plain = wild.scores["actual"].plain_band
    assert actual.sigma_error / (1 + actual.sigma) < plain.error_ukcmb2 / plain.sigma_ukcmb2


def few(calm, weights):
    """A score whose observations have these weights, and its forecast, which expects the same of each."""
    ones = np.ones(len(weights))
    expected = replace(calm.expected.scores["actual"], weights=ones, kept=KeptScans(ones))
    return calm.setup, replace(calm.scores["actual"], weights=weights), expected


def test_scatter_of_few_observations_is_that_of_a_mean_of_few_draws(calm, monkeypatch):
    """8 observations without noise, 30 % off their forecasts, in 4000 draws: chi^2 per draw is 1, and 1.4 without
    Student's factor. Squares of Student's t of 7 degrees of freedom scatter by twice their mean.
    """
    monkeypatch.setattr("surveysim.results.agreement.noise_parts", lambda *_: (0.0, 0.0))
    n_draw, rng, chi2 = 4000, np.random.default_rng(7), []
    for _ in range(n_draw):
        item = few(calm, 1 + 0.3 * rng.standard_normal(8).clip(-3, 3))
        chi2.append(np.log(item[1].weights.mean()) ** 2 / _scatter(*item) ** 2)
    assert np.mean(chi2) == pytest.approx(1, abs=4 * 2 / np.sqrt(n_draw))


def test_three_observations_do_not_tell_the_error(calm):
    setup, item, expected = few(calm, np.array([0.9, 1.0, 1.2]))
    found = agreement(setup, item, expected)
    assert np.isfinite(found.sigma) and np.isnan(found.sigma_error) and np.isnan(found.psd_error)
    assert found.unknown == found.bins > 0 and found.within == 0
    table = agreement_table({"actual": known(vars(found))})
    assert {column.name: column.cells[0] for column in table.shown}["sigma"].endswith("± unknown) %")


def test_the_table_says_what_is_known(calm):
    """Few flips and observations: no claim that all bins are good, and the flag of lost scans."""
    content = summary(calm)
    table = agreement_table(content["forecast_over_simulated"])
    cells = {column.name: column.cells for column in table.shown}
    found = list(forecast_agreement(calm).values())
    assert cells["within"] == tuple(str(item.within) for item in found) != cells["bins"]
    text = "\n".join(forecast_warnings(content))
    assert "the forecast may be off (actual" in text and "Cleaning discarded" in text


@pytest.mark.parametrize("off, error, warned", [(0.3, 0.15, False), (0.45, 0.15, True), (9.0, None, False)])
def test_forecasts_are_warned_of_beyond_two_errors(off, error, warned):
    """sigma(A) is off by more than 10 % and two standard errors; an unknown error tells nothing."""
    content = {"forecast_over_simulated": {"actual": {"sigma": off, "sigma_error": error}}}
    assert bool(forecast_warnings(content)) == warned
