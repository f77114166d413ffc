"""Weather that drifts through a survey: its correlation, its distributions, and the errors that follow from it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mapmaker.uncertainty import block_sums, draws, ratio_error, weather_error
from surveysim.atmosphere.dated_weather import drifting_scores, independent_blocks, variance_factor
from surveysim.atmosphere.water import Season
from surveysim.atmosphere.weather import survey_weather
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.survey.error_modes import error_modes
from surveysim.timestreams.observed_block import observation_weather
from tests.physics.test_sweep import toy_item
from tests.scenes import SCHEDULE, SMALL_SCENE, without_sections, write_scene
from tests.toys import N_MODES

TAU_S = 7200.0
N_NIGHTS = 4000
PLACES = np.array([0.0, 0.4, 1.1])  # of the observations of a night, in correlation times
STARTS_S = ((np.arange(N_NIGHTS) * 100)[:, None] + PLACES).ravel() * TAU_S
NIGHTS = without_sections(SMALL_SCENE, "fixed_pointing").replace("observations = 4", "observations = 24")
NIGHTS += SCHEDULE.replace("nights = 1", "nights = 6")
DRIFT = {"atmosphere.correlation_time": "2 h"}


@pytest.fixture(scope="module")
def nights():
    """Scores (night, observation, 4) with standard normal levels in place of probabilities of the water."""
    from scipy.special import ndtri

    scores = drifting_scores(5, STARTS_S, TAU_S)
    scores[:, 2] = ndtri(scores[:, 2])
    return scores.reshape(N_NIGHTS, 3, 4)


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (0, 2)])
def test_levels_correlate_by_the_exponential_of_their_lag(nights, pair):
    expected = math.exp(PLACES[pair[0]] - PLACES[pair[1]])
    first, later = nights[:, pair[0]], nights[:, pair[1]]
    found = (first[:, :3] * later[:, :3]).mean(axis=0)
    np.testing.assert_allclose(found, expected, atol=5 * math.sqrt((1 + expected**2) / N_NIGHTS))
    turned = np.cos(later[:, 3] - first[:, 3])
    assert turned.mean() == pytest.approx(expected, abs=5 * math.sqrt(0.5 / N_NIGHTS))


def test_different_quantities_and_nights_are_independent(nights):
    flat = nights[:, :, :3].reshape(N_NIGHTS, 9)
    products = np.corrcoef(np.hstack([flat[:-1], flat[1:]]).T)
    other = np.equal.outer(np.tile(np.arange(3), 6), np.tile(np.arange(3), 6))
    same_night = np.equal.outer(np.arange(18) // 9, np.arange(18) // 9)
    assert np.abs(products[~(other & same_night)]).max() < 5 / math.sqrt(N_NIGHTS)


@pytest.mark.parametrize("place", [0, 2])
def test_each_observation_has_the_distribution_of_independent_draws(nights, place):
    """By Kolmogorov and Smirnov, beyond which one draw in 1e5 lies."""
    from scipy.special import ndtr

    bound = math.sqrt(-math.log(1e-5 / 2) / 2 / N_NIGHTS) + 1 / N_NIGHTS
    shares = np.column_stack([ndtr(nights[:, place, :3]), nights[:, place, 3] / (2 * math.pi)])
    steps = (np.arange(N_NIGHTS) + 0.5) / N_NIGHTS
    assert np.abs(np.sort(shares, axis=0) - steps[:, None]).max() < bound


def test_an_observation_depends_on_earlier_ones_alone():
    whole = drifting_scores(5, STARTS_S[:60], TAU_S)
    np.testing.assert_array_equal(drifting_scores(5, STARTS_S[:7], TAU_S), whole[:7])
    moved = drifting_scores(5, STARTS_S[:60] + 3600 * (np.arange(60) >= 30), TAU_S)
    np.testing.assert_array_equal(moved[:30], whole[:30])


def test_weather_does_not_depend_on_the_length_of_the_survey(tmp_path):
    """In proportion to the nights, as in a survey that is extended; in any order."""
    path = write_scene(tmp_path, NIGHTS)
    setups = [prepare(load_scene(path, DRIFT | more)) for more in ({}, {"observations": 12, "schedule.nights": 3})]
    later, earlier = [[observation_weather(setup, n) for n in reversed(range(12))] for setup in setups]
    assert later == earlier
    assert observation_weather(prepare(load_scene(path)), 3) != earlier[-4]


def test_water_has_the_quantiles_of_its_month_and_hour():
    from surveysim.atmosphere.dated_weather import dated_weather
    from surveysim.atmosphere.water import pwv_quantile
    from surveysim.atmosphere.weather import site_water
    from surveysim.scene.atmosphere import Atmosphere
    from surveysim.scene.passband import top_hat
    from surveysim.scene.place import shipped_place

    keys = {"spectral_index": "11/3", "illuminated_aperture": "6 m", "site": "alma", "pwv_probabilities": [0, 1]}
    air = Atmosphere.model_validate(keys | {"pwv_by_month": [f"[{n / 4}, {n / 2}] mm" for n in range(1, 13)]})
    water = site_water(air, shipped_place("alma"), top_hat(150e9, 0.2))
    when = (Season(2, 3), Season(7, 3), Season(2, 4))
    dated = dated_weather(1, (60000.0, 60150.0, 60365.0), correlation_s=3600.0, seasons=when)
    for number, season in enumerate(when):
        found = survey_weather(air, water, 1, number, dated=dated)
        assert found.pwv_mm == pwv_quantile(air, dated.scores[number, 2], season)


def test_dates_are_needed(tmp_path):
    with pytest.raises(SceneError) as error:
        load_scene(write_scene(tmp_path), DRIFT)
    expected = "atmosphere.correlation_time: found with [fixed_pointing]; [schedule] is expected, which has dates"
    assert str(error.value).endswith(f": {expected}")


# ---------------------------------------------------------------- errors


def test_the_variance_factor_is_the_sum_over_all_pairs():
    starts = np.sort(np.random.default_rng(2).uniform(0, 50 * TAU_S, 80))
    pairs = np.exp(-np.abs(starts[:, None] - starts) / TAU_S)
    assert variance_factor(starts, TAU_S) == pytest.approx(pairs.sum() / 80, rel=1e-12)


def test_blocks_end_at_gaps_and_at_their_longest():
    starts = np.array([0, 1, 2, 5.5, 6, 8.5, 11, 13.5, 16, 17]) * TAU_S
    assert independent_blocks(starts, TAU_S).tolist() == [0, 0, 0, 1, 1, 1, 1, 1, 2, 2]


def test_errors_from_blocks_are_those_of_drifting_weather():
    """The scatter of a mean over many surveys against the errors that each survey states, in 40 nights of 8."""
    starts = (np.arange(40)[:, None] * 24 + np.arange(8)).ravel() * 3600.0
    block, n_survey = independent_blocks(starts, 4 * 3600), 600
    assert draws(len(starts), block) == 40
    levels = [drifting_scores(seed, starts, 4 * 3600)[:, 0] for seed in range(n_survey)]
    information = np.exp(0.5 * np.array(levels))
    scatter = np.std(np.log(information.mean(axis=1)), ddof=1)
    stated = [ratio_error(item, np.ones(320), block) for item in information]
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(scatter, rel=5 / math.sqrt(2 * n_survey))
    alone = [ratio_error(item, np.ones(320)) for item in information]
    bound = math.sqrt(variance_factor(starts, 4 * 3600))
    assert np.mean(alone) < 0.6 * scatter < np.mean(alone) * bound


def test_paired_errors_are_of_the_blocks_of_both_surveys():
    """Rows are sums over blocks that are independent in each survey; one is longer than the other."""
    rng = np.random.default_rng(4)
    weights, flips = np.exp(rng.normal(size=48)), rng.normal(size=(8, N_MODES.sum() // 2, 2)) @ [1, 1j]
    whole = replace(toy_item(flips, weights), block=np.repeat(np.arange(24), 2))
    part = replace(toy_item(flips, weights[:24]), block=np.repeat(np.arange(6), 4))
    common = np.concatenate([np.repeat(np.arange(6), 4), np.repeat(np.arange(6, 18), 2)])
    rows = error_modes([whole, part], ("", ""))[:, 8:26]
    for row, item in zip(rows, (whole, part), strict=True):
        off = item.information - item.expected
        expected = np.bincount(common[: len(off)], off, 18)
        scale = item.budget.weather / np.linalg.norm(expected)
        np.testing.assert_allclose(row, expected * scale, atol=1e-12)


def test_few_blocks_tell_no_error():
    information, nights = np.linspace(1, 2, 40), np.repeat(np.arange(10), 4)
    assert math.isnan(weather_error(information, block=nights))
    assert weather_error(information, block=np.arange(40)) == pytest.approx(weather_error(information), rel=1e-12)
    assert math.isnan(ratio_error(information, np.ones(40), np.zeros(40, int)))
    assert block_sums(information, nights).sum() == pytest.approx(0, abs=1e-12)
