"""Metrics of a run: the list, agreement with sigma(A), and the options of a scene."""

import json
import math

import pytest

from surveysim import run
from surveysim.metrics.registry import METRICS, metric_functions
from surveysim.reduction.setup import prepare
from surveysim.report.terminal.survey import stop_lines
from surveysim.results.metric_tables import metric_table
from surveysim.results.metrics import forecast_metrics
from surveysim.results.results import survey_result
from surveysim.results.stopping import FEWEST, parsed_limits
from surveysim.results.summary import summary
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.errors import InputError, InsufficientDataError, SceneError
from surveysim.runtime.strict_json import strict_json
from surveysim.scene.metrics import METRIC_SECTIONS, SIGMA_KEY, FlatBandPower, metric_keys
from surveysim.scene.scene import load_scene
from surveysim.survey.run import run_observations
from tests.scenes import SMALL_SCENE, write_scene

METRICS_TEXT = """
[[score.metrics]]
kind = "band_powers"
edges = [2000, 6000, 12000]
spectrum = "flat"
band_power = "1000 uK2"

[[score.metrics]]
kind = "largest_scale"

[[score.metrics]]
kind = "array_net"

[[score.metrics]]
kind = "time_to"
of = "flat_band_power.sigma"
value = 1000
"""


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    path = write_scene(tmp_path_factory.mktemp("metrics"), SMALL_SCENE + METRICS_TEXT)
    setup = prepare(load_scene(path, {"observations": 16}))
    return survey_result(setup, run_observations(setup, None), wall_s=0.0, workers=1)


def test_every_kind_has_a_row_and_a_section():
    kinds = {item.model_fields["kind"].annotation.__args__[0]: item for item in (FlatBandPower, *METRIC_SECTIONS)}
    assert {kind: row.section for kind, row in METRICS.items()} == kinds


def test_flat_band_power_is_the_score(result):
    """To the last bit, with the error of the score, as quoted and without control variate."""
    for name, item in result.scores.items():
        found = result.metrics[name][SIGMA_KEY]
        assert found.value == item.band.sigma_ukcmb2
        assert found.plain.value == item.plain_band.sigma_ukcmb2
        assert found.error == pytest.approx(item.band.error_ukcmb2, rel=1e-12)
        assert found.plain.error == pytest.approx(item.plain_band.error_ukcmb2, rel=1e-12)
        assert vars(found.quoted.response.budget) == pytest.approx(vars(item.budget), rel=1e-12)


def test_results_have_the_keys_of_the_scene(result):
    score = result.setup.scene.score
    assert {name: tuple(found) for name, found in result.metrics.items()} == dict.fromkeys(
        result.scores, metric_keys(score.metrics)
    )
    assert list(metric_functions(score)) == ["flat_band_power", *(item.label for item in score.metrics)]


def test_forecasts_of_a_run_and_of_a_scene_agree(result):
    """sigma(A) of a forecast is that of its table, and all data sets have all metrics."""
    expected = result.expected
    found = forecast_metrics(result.setup, expected)
    for name, item in expected.scores.items():
        assert found[name][SIGMA_KEY].drawn == pytest.approx(item.band.sigma_ukcmb2, rel=1e-12)
        assert set(found[name]) == set(result.metrics[name])


def test_a_survey_that_cannot_be_scored_keeps_the_reason(result, monkeypatch):
    def refuse(setup, coadds):
        raise InsufficientDataError("too few")

    monkeypatch.setattr("surveysim.results.scored.quoted_scores", refuse)
    found = survey_result(result.setup, result.coadds, wall_s=0.0, workers=1)
    assert (found.scores, found.metrics, found.unscored, found.expected) == ({}, {}, "too few", None)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('kind = "magic"', "score.metrics.0.kind: found 'magic'; one of 'band_powers', 'largest_scale', "),
        ('name = "one"', "score.metrics.0.kind: missing; one of 'band_powers', "),
        ('kind = "array_net"\nname = "A b"', "score.metrics.0.name: found 'A b'; up to 40 small letters"),
        ('kind = "array_net"\nname = "flat_band_power"', "found the name 'flat_band_power' more than once"),
        ('kind = "array_net"\nvalue = 1', "score.metrics.0.value: unknown key; allowed are kind, name"),
        ('kind = "time_to"\noff = "x"\nvalue = 1', "score.metrics.0.off: unknown key; did you mean score.metrics.of?"),
        (
            'kind = "time_to"\nof = "a.b"\nvalue = 1',
            "found 'a.b' as 'of' of 'time_to'; one of flat_band_power.sig",
        ),
        ('kind = "time_to"\nof = "time_to.hours"\nvalue = 1', "found 'time_to.hours' as 'of'"),
        ('kind = "band_powers"\nedges = [2000, 4000]', "score.metrics.0.spectrum: missing; this key is expected"),
        (
            'kind = "band_powers"\nedges = [2000, 4000]\nspectrum = "flat.ecsv"',
            "flat.ecsv: no such file in the folder of the scene; a table of ell and cl is expected",
        ),
        (
            'kind = "band_powers"\nedges = [2000, 4000]\nspectrum = "steep"',
            "score.metrics.0.spectrum: found 'steep'; 'flat', 'poisson', 'clustered' or the name of a file is expected",
        ),
        (
            'kind = "band_powers"\nedges = [2000, 4000]\nspectrum = "flat"',
            "score.metrics.0.band_power: missing; spectrum 'flat' needs it",
        ),
        (
            'kind = "band_powers"\nedges = [4000, 2000]\nspectrum = "flat"\nband_power = "1 uK2"',
            "score.metrics.0.edges: found [4000, 2000]; increasing multipoles are expected",
        ),
        (
            'kind = "band_powers"\nedges = [2000, 2500]\nspectrum = "flat"\nband_power = "1 uK2"',
            "found the edge 2500 in 'band_powers'; multiples of ell_bin = 2000 up to 12000 are expected",
        ),
    ],
)
def test_errors_name_key_and_choices(tmp_path, entry, message):
    path = write_scene(tmp_path, f"{SMALL_SCENE}\n[[score.metrics]]\n{entry}\n")
    with pytest.raises(SceneError) as error:
        load_scene(path)
    assert message in str(error.value)


def test_a_target_error_may_be_of_any_metric(tmp_path):
    """A run ends at the first boundary where this metric is known, which may not be that of sigma(A)."""
    scene = load_scene(write_scene(tmp_path, SMALL_SCENE + METRICS_TEXT), {"observations": 40, "score.jackknives": 64})
    key = "largest_scale.ell"
    found = run(scene, engine=SERIAL, target_error=0.05, target_metric=key)
    assert found.stopped == "target" and found.coadds.done == FEWEST
    assert found.relative_error == found.metrics["actual"][key].error / found.metrics["actual"][key].value <= 0.05
    assert found.estimate.relative_error > 0.05
    assert stop_lines(found)[0].endswith(f"{key} is known to {100 * found.relative_error:.1f} %")


def test_the_target_metric_is_one_of_the_scene(result):
    with pytest.raises(SceneError, match="target metric: found 'cluster.depth_y0'; one of flat_band_power.sigma, band"):
        run(result.setup.scene, target_error=0.1, target_metric="cluster.depth_y0")
    with pytest.raises(InputError, match="--target-metric: found no --target-error"):
        parsed_limits(None, None, SIGMA_KEY)


@pytest.mark.parametrize("value, hours", [(20_000, 0.0), (1, math.inf)])
def test_a_time_that_is_no_number_is_told(tmp_path, value, hours):
    """A scale that time does not change is reached at any time, or never."""
    entries = METRICS_TEXT.replace("flat_band_power.sigma", "largest_scale.ell").replace("1000\n", f"{value}\n")
    setup = prepare(load_scene(write_scene(tmp_path, SMALL_SCENE + entries)))
    found = survey_result(setup, run_observations(setup, None), wall_s=0.0, workers=1)
    item = found.metrics["actual"]["time_to.hours"]
    assert (item.value, item.forecast) == (hours, hours) and item.note
    entry = json.loads(strict_json(summary(found)["metrics"]["actual"]["time_to.hours"]))
    assert entry["value"] == (None if hours else 0.0) and entry["error"] in (None, 0.0)
    assert ("never" if hours else "at any time") in str(metric_table(summary(found)["metrics"]).rows) or not hours
