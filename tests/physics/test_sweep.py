"""Paired errors of points against the scatter that surveys of many seeds have.

A variance from n draws is known to sqrt(2 / n), relative; the tests allow three times that unless said otherwise.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.transfer_function import TransferFunction
from surveysim import load_sweep, run_sweep
from surveysim.metrics.errors import Estimate
from surveysim.reduction.data_set import DataSetKind
from surveysim.results.metrics import MetricResult
from surveysim.runtime.engine import SERIAL
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.studies.sweep.comparison import compare_forecasts, compare_runs, forecast_points
from surveysim.studies.sweep.point_store import PointResult
from surveysim.studies.sweep.rounds import SweepLimits, run_rounds
from surveysim.survey.error_modes import error_modes, sigma_response
from surveysim.survey.scores import DataSetScore
from tests.scenes import SMALL_SCENE, without_sections
from tests.seeds import shared_expectations
from tests.toys import ELL, N_MODES, PSD, toy_score

FLIPS = 16

NO_SETS = (
    without_sections(SMALL_SCENE, "sky")
    .replace('noise_only_sets = ["uncorrelated", "white"]', "noise_only_sets = []")
    .replace("mask_separation_f_lambda = 1.3\n", "")
    .replace("jackknives = 4", f"jackknives = {FLIPS}")
)
NO_AIR = (
    without_sections(NO_SETS, "atmosphere", "excess")
    .replace('algorithm = "average"', 'algorithm = "none"')
    .replace("observations = 4\n", "observations = 10\n")
)
# Eighteen detectors that fit their responsivities to each scan would lose a fifth of the scans, each point others.
AIR = NO_SETS.replace("observations = 4\n", "observations = 24\n").replace(
    'algorithm = "average"\n', 'algorithm = "average"\nresponsivities = "observation"\n'
)
MORE_DETECTOR_NOISE = '"detector.psd" = ["2.5 mK2 / Hz", "3.75 mK2 / Hz"]'


# ---------------------------------------------------------------- surveys of toy modes


def toy_item(flipped, weights, share=1.0):
    """Score of sign-flipped co-adds (K, n_mode) of a share of a survey, of observations with these weights."""
    power = np.abs(flipped) ** 2 * share
    psds = PSD * np.stack([part.mean(axis=1) for part in np.split(power, np.cumsum(N_MODES // 2)[:-1], 1)], 1)
    band, budget = toy_score(psds, weights)
    noise = np.repeat(1 / weights[:, None], 4, axis=1)
    known = TransferFunction(ELL, np.ones(4), np.zeros((2, 4)))
    of_maps = psds, flat_spectrum_psd(ELL), known, weights, noise
    return DataSetScore("actual", DataSetKind.ACTUAL, 100, band, budget, *of_maps)


def toy_pair(weights, own, rng):
    """Scores of two surveys with the same signs, weather and transfer function; `own` is the power of own noise."""
    shape = (weights.size, N_MODES.sum() // 2)
    common, *apart = (rng.normal(size=(*shape, 2)) @ [1, 1j] / np.sqrt(2) for _ in range(3))
    signs = rng.choice([-1.0, 1.0], size=(FLIPS, weights.size))
    items = []
    for noise in apart:
        modes = np.sqrt(weights)[:, None] * (np.sqrt(1 - own) * common + np.sqrt(own) * noise)
        items.append(toy_item(signs @ modes / weights.sum(), weights))
    return items


@pytest.mark.slow
@pytest.mark.parametrize("own", [0.03, 0.3, 1.0])
def test_error_of_a_ratio_of_toy_surveys(own):
    """300 pairs of surveys of 60 observations that share all, most or none of their noise, in new weather each time:
    the mean squared error of their ratio against its scatter. What is not common, and no more, is in it.
    """
    n, rng = 300, np.random.default_rng(8)
    log_ratio, variance, apart = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        weights = np.exp(0.6 * rng.normal(size=60))
        one, other = items = toy_pair(weights, own, rng)
        rows = error_modes(items, ("same", "same"))
        log_ratio[i] = np.log(one.band.sigma_ukcmb2 / other.band.sigma_ukcmb2)
        variance[i] = np.sum((rows[0] - rows[1]) ** 2)
        apart[i] = one.budget.total**2 + other.budget.total**2
    assert np.var(log_ratio) == pytest.approx(variance.mean(), rel=3 * np.sqrt(2 / n))
    assert variance.mean() < apart.mean()  # the weather is common whatever the noise does
    if own < 0.1:
        assert np.sqrt(variance.mean()) < np.sqrt(apart.mean()) / 3


# ---------------------------------------------------------------- simulated surveys


def seeds_of(tmp_path, scene, table, n):
    """ln ratio, its paired error and that of independent runs (n,) of two points, for n seeds."""
    path = tmp_path / "pair.toml"
    path.write_text(f"{scene}\n[sweep]\n{table}\n")
    rows = []
    for seed in range(n):
        with shared_expectations():
            found = run_sweep(load_sweep(path, {"seed": seed}), engine=SERIAL).comparison
        ratio = found.ratio[1]
        rows.append((np.log(ratio), found.paired_error[1] / ratio, found.independent_error[1] / ratio))
    return np.array(rows).T


def assert_right(log_ratio, paired):
    """Scatter of n values about their mean, and the mean of variances that each have FLIPS - 1 degrees of freedom."""
    n = len(log_ratio)
    tolerance = 3 * np.sqrt(2 / (n - 1) + 2 / (n * (FLIPS - 1)))
    # Of the logarithm, so that too large an error fails as well as one that is too small.
    assert abs(np.log(np.var(log_ratio, ddof=1) / np.mean(paired**2))) < tolerance


@pytest.mark.slow
def test_paired_error_of_a_small_change(tmp_path, monkeypatch):
    """Half more detector noise with the same photon noise: far better known than from independent runs.

    Detectors share a tenth of the photon noise, so maps of the points are not proportional.
    """
    monkeypatch.setattr("surveysim.results.scored.run_forecast", lambda setup, coadds: None)
    log_ratio, paired, independent = seeds_of(tmp_path, NO_AIR, MORE_DETECTOR_NOISE, 24)
    assert_right(log_ratio, paired)
    assert np.sqrt(np.mean(paired**2)) < np.sqrt(np.mean(independent**2)) / 3
    points = forecast_points(load_sweep(tmp_path / "pair.toml"), lambda done: None)
    expected = np.log(compare_forecasts(points).ratio[1])
    # A forecast of the shared noise is good to 0.1 % of the ratio; without shared noise the ratio is larger by 1.3 %.
    assert log_ratio.mean() == pytest.approx(expected, abs=0.001 + 3 * np.sqrt(np.mean(paired**2) / 24))


@pytest.mark.slow
def test_ratio_of_proportional_maps_is_exact(tmp_path, monkeypatch):
    """White noise of photons and of detectors is one draw: 5 and 6.25 mK^2/Hz make proportional float32 maps."""
    monkeypatch.setattr("surveysim.results.scored.run_forecast", lambda setup, coadds: None)
    scene = NO_AIR.replace("coherent_fraction = 0.1", "coherent_fraction = 0")
    log_ratio, paired, independent = seeds_of(tmp_path, scene, MORE_DETECTOR_NOISE, 2)
    np.testing.assert_allclose(log_ratio, np.log(1.25), atol=1e-5)
    assert (paired < 1e-5).all() and (independent > 0.1).all()


@pytest.mark.slow
def test_paired_error_where_little_is_common(tmp_path, monkeypatch):
    """Another scan speed: other maps of the same streams and skies."""
    monkeypatch.setattr("surveysim.results.scored.run_forecast", lambda setup, coadds: None)
    table = '"scan.speed" = ["4 arcmin / s", "4.5 arcmin / s"]'
    log_ratio, paired, independent = seeds_of(tmp_path, NO_AIR, table, 60)
    assert_right(log_ratio, paired)
    assert np.mean(paired**2) < np.mean(independent**2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "table, gained",
    [
        ('"detector.psd" = ["2.5 mK2 / Hz", "3.5 mK2 / Hz"]', 4),
        ('"excess.spectral_index" = [1.0, 1.2]', 4),
        ('"cleaning.algorithm" = ["average", "planar"]', 1),
    ],
)
def test_paired_error_in_varying_weather(tmp_path, monkeypatch, table, gained):
    """Twenty-four observations in the atmosphere, cleaned: weather and transfer function are common too.

    Ratios of surveys that lose no scans have no long tails: an excess kurtosis of -0.5 +- 0.8 over 40 seeds.
    """
    monkeypatch.setattr("surveysim.results.scored.run_forecast", lambda setup, coadds: None)
    log_ratio, paired, independent = seeds_of(tmp_path, AIR, table, 30)
    assert_right(log_ratio, paired)
    assert np.sqrt(np.mean(paired**2)) < np.sqrt(np.mean(independent**2)) / gained


def test_best_of_equal_toy_surveys_is_drawn_by_lot():
    """60 pairs that differ in nothing but chance: the probability that the first is the best is uniform, as it has
    to be if it is right. Its mean within 4 standard errors; its variance, 1/12, within 3 of sqrt(0.8 / 60).
    """
    rng, n = np.random.default_rng(9), 60
    found = np.empty((n, 2))
    for i in range(n):
        items = toy_pair(np.exp(0.5 * rng.normal(size=60)), 0.3, rng)
        points = tuple(_point(item) for item in items)
        found[i] = compare_runs(points, rng).best_probability
    assert found.sum(axis=1) == pytest.approx(1)
    assert found[:, 0].mean() == pytest.approx(0.5, abs=4 * found[:, 0].std() / np.sqrt(n))
    assert found[:, 0].var() == pytest.approx(1 / 12, rel=0.35)


def _point(item):
    found = Estimate(item.band.sigma_ukcmb2, sigma_response(item))
    metrics = {"actual": {SIGMA_KEY: MetricResult(found, found, "uK2", True, None, "")}}
    return PointResult(100, len(item.weights), {"actual": item}, {}, [], [], {}, [], "same", "", 0.0, metrics, {})


# ---------------------------------------------------------------- surveys of different lengths, and rounds


def toy_points(own, factors, rng, n_obs=128):
    """Return a function of a point and a number of observations: the score of its first ones.

    Points share signs and weather, and all but the fraction `own` of their noise; `factors` multiply its power.
    """
    weights = np.exp(0.6 * rng.normal(size=n_obs))
    shape = (n_obs, N_MODES.sum() // 2)
    common, *apart = (rng.normal(size=(*shape, 2)) @ [1, 1j] / np.sqrt(2) for _ in range(len(factors) + 1))
    signs = rng.choice([-1.0, 1.0], size=(FLIPS, n_obs))

    def score_of(point, n):
        noise = np.sqrt(1 - own) * common[:n] + np.sqrt(own) * apart[point][:n]
        modes = np.sqrt(weights[:n, None] * factors[point]) * noise
        return toy_item(signs[:, :n] @ modes / weights[:n].sum(), weights[:n], n / n_obs)

    return score_of


@pytest.mark.slow
@pytest.mark.parametrize("own", [0.03, 1.0])
@pytest.mark.parametrize("n", [32, 64])
def test_error_of_a_ratio_of_surveys_of_different_lengths(own, n):
    """Of n and 128 observations, of which the first n are common: these cancel, the rest does not."""
    count, rng = 200, np.random.default_rng(8)
    log_ratio, variance, apart = np.empty((3, count))
    for i in range(count):
        score_of = toy_points(own, (1.0, 1.0), rng)
        one, other = items = score_of(0, n), score_of(1, 128)
        rows = error_modes(items, ("same", "same"))
        log_ratio[i] = np.log(one.band.sigma_ukcmb2 / other.band.sigma_ukcmb2)
        variance[i] = np.sum((rows[0] - rows[1]) ** 2)
        apart[i] = one.budget.total**2 + other.budget.total**2
    assert np.var(log_ratio) == pytest.approx(variance.mean(), rel=3 * np.sqrt(2 / count))
    assert variance.mean() < 0.8 * apart.mean()


@pytest.mark.slow
@pytest.mark.parametrize("factors, most", [((1.0, 1.0001), 0.2), ((1.0, 1.1, 1.2), 0.02)])
def test_confidence_of_rounds_holds(monkeypatch, factors, most):
    """200 sweeps of toy surveys in four rounds, with a confidence of 80 %.

    Of two points that are nearly equal, the wrong one is called the best in a fifth of the sweeps at most, over all
    rounds together; where points differ, nearly never. Tolerance: three standard errors of the stated chance.
    """
    monkeypatch.setattr("surveysim.studies.sweep.rounds.round_ends", lambda points: (16, 32, 64, 128))
    monkeypatch.setattr("surveysim.studies.sweep.comparison.DRAWS", 4000)
    count, rng, known, wrong = 200, np.random.default_rng(1), 0, 0
    scene = SimpleNamespace(observations=128)
    sweep = SimpleNamespace(points=[SimpleNamespace(number=place, scene=scene) for place in range(len(factors))])
    for _ in range(count):
        score_of = toy_points(1.0, factors, rng)
        points, rounds = run_rounds(
            sweep,
            SweepLimits(1e-3, 0.8),
            lambda stages, begun, of=score_of: [_point(of(item.point.number, item.observations)) for item in stages],
            lambda points: compare_runs(points, np.random.default_rng(0)),
        )
        if rounds.reason == "confidence":
            known += 1
            wrong += compare_runs(points, np.random.default_rng(0)).best != (0,)
    assert known > 20  # or the test shows nothing
    assert wrong / count < most + 3 * np.sqrt(most * (1 - most) / count)
