"""Ladders of settings, their measurement end to end on a tiny scene, and what follows from it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from mapmaker.uncertainty import ErrorBudget
from surveysim import SceneError, load_scene
from surveysim.output.study_writer import write_accuracy
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.report.figures.convergence import accuracy_figure, pareto
from surveysim.report.terminal.convergence import print_accuracy
from surveysim.runtime.engine import SERIAL
from surveysim.studies.convergence import Measured, Setting, ladders, measure_accuracy
from surveysim.studies.convergence.comparison import recommendations, slopes
from surveysim.studies.convergence.runs import Task, run_task
from surveysim.studies.convergence.settings import sub_survey
from surveysim.timestreams.observation import draw_observation
from tests.pages import read_page, rows_of, value_of
from tests.scenes import SMALL_SCENE, without_sections, write_scene

ACTUAL_ALONE = {"score.noise_only_sets": [], "score.mask_separation_f_lambda": None}  # others are not measured


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def result(path):
    settings = {"observations": 8} | ACTUAL_ALONE
    return measure_accuracy(path, settings, engine=SERIAL, reference_error=0.1, seeds=2, observations=4)


def of_parameter(rows, parameter):
    return {row.setting.label: row for row in rows if row.setting.parameter == parameter}


# ---------------------------------------------------------------- ladders


def test_ladders_go_from_coarse_to_fine_and_hold_the_scene(path):
    scene = load_scene(path, {"observations": 160, "score.jackknives": 20, "numerics.screen_step": 3})
    found: dict[str, list[str]] = {}
    for item in ladders(scene):
        found.setdefault(item.parameter, []).append(item.label + "*" * item.own)
    assert found == {
        "observations": ["10", "20", "40", "80", "160*"],
        "noise realizations": ["8", "16", "20*", "32", "64", "128"],
        "signal simulations": ["2*", "4", "8"],
        "observations with simulations": ["2*", "12", "18"],
        "screen step": ["4", "3*", "2", "1", "0.5"],
        "interpolation": ["nearest", "linear*", "cubic"],
        "precision": ["float32*", "float64"],
        "sample rate": ["5 Hz", "10 Hz*", "20 Hz"],
        "numerics together": ["scene's own*", "finest"],
        "forecast": ["closed form"],
    }


def test_all_settings_of_ladders_are_keys_of_a_scene_and_own_ones_change_nothing(path):
    given = {"observations": 160}
    scene = load_scene(path, given)
    base = given | sub_survey(scene, 60)
    whole = load_scene(path, base)
    for item in ladders(scene):
        if item.kind not in ("sampling", "numerical"):
            continue
        made = load_scene(path, base | item.overrides)
        assert (made == whole) == item.own, item


def test_a_sub_survey_has_as_large_a_part_with_signal_simulations(path):
    scene = load_scene(path, {"observations": 500, "score.signal_sims.observations": 100})
    assert sub_survey(scene, 60) == {"observations": 60, "score.signal_sims.observations": 12}
    assert sub_survey(scene, 1000) == {"observations": 500, "score.signal_sims.observations": 100}


@pytest.mark.parametrize(
    ("key", "value"), [("precision", "float16"), ("interpolation", "spline"), ("screen_step", 0.05)]
)
def test_numerics_are_refused_by_name(path, key, value):
    with pytest.raises(SceneError, match=rf"numerics\.{key}: found {value!r}"):
        load_scene(path, {f"numerics.{key}": value})


# ---------------------------------------------------------------- end to end


@pytest.mark.slow
def test_every_setting_has_a_row_with_a_score_or_a_reason(result, path):
    settings = ladders(load_scene(path, {"observations": 8}), 4)
    assert [row.setting for row in result.rows] == list(settings)
    for row in result.rows:
        assert np.isfinite(row.sigma_ukcmb2) != row.note.startswith(("refused: ", "not scored: ")), row
    refused = {(row.setting.parameter, row.setting.label) for row in result.rows if not np.isfinite(row.sigma_ukcmb2)}
    assert refused == {("observations", "0"), ("observations", "1"), ("sample rate", "5 Hz")}
    assert "white_noise_above" in of_parameter(result.rows, "sample rate")["5 Hz"].note


@pytest.mark.slow
def test_parts_of_a_survey_score_the_whole_of_it(result):
    """Not rescaled, sigma(A) of a quarter would be four times that of the whole; errors are a third at most."""
    rows = of_parameter(result.rows, "observations")
    for label in ("2", "4"):
        assert 0.5 < rows[label].sigma_ukcmb2 / rows["8"].sigma_ukcmb2 < 2
    # Two observations do not tell their error.
    assert rows["4"].bias_error > 0.05 and np.isnan(rows["2"].bias_error)
    assert rows["8"].bias == 0 and rows["8"].setting.own
    assert rows["2"].cpu_s < rows["8"].cpu_s


@pytest.mark.slow
def test_seeds_are_pooled_as_far_as_they_are_allowed(result):
    assert result.seeds == 2
    own = of_parameter(result.rows, "observations")["8"]
    assert result.reference_error == pytest.approx(own.relative_error / np.sqrt(2))
    assert result.reference_ukcmb2 == own.sigma_ukcmb2
    assert np.isfinite(result.scatter) and "scatter of 2 seeds" in own.note


@pytest.mark.slow
def test_precision_is_measured_far_below_the_monte_carlo_error(result):
    """float32 keeps 24 bits: what cleaning leaves of streams 1000 times larger is known to 1e-4."""
    row = of_parameter(result.rows, "precision")["float32"]
    assert 0 < abs(row.bias) < 1e-3
    assert row.bias_error < 1e-3 * row.relative_error


@pytest.mark.slow
def test_better_look_ups_are_nearer_to_the_finest(result):
    rows = of_parameter(result.rows, "interpolation")
    assert abs(rows["linear"].bias) < 0.2 * abs(rows["nearest"].bias)
    assert rows["cubic"].bias == rows["cubic"].bias_error == 0
    assert rows["linear"].bias_error < 0.01 * rows["linear"].relative_error


@pytest.mark.slow
def test_other_draws_share_less_noise(result):
    """The layer of another step is drawn apart, all else is shared: far more than a look-up's 0.01 is left.

    Sign flips of few observations know the error of a difference badly: the largest of three steps.
    """
    rows = of_parameter(result.rows, "screen step")
    assert max(rows[step].bias_error / rows[step].relative_error for step in ("4", "2", "1")) > 0.3


@pytest.mark.slow
def test_files_hold_all_rows(result, tmp_path, capsys):
    write_accuracy(tmp_path, result, figures=True)
    table = Table.read(tmp_path / "accuracy.ecsv", format="ascii.ecsv")
    assert len(table) == len(result.rows)
    np.testing.assert_allclose(np.ma.filled(table["bias"], np.nan), [row.bias for row in result.rows])
    assert table.meta["reference_seeds"] == 2 and "process" in table.meta["memory"]
    assert (tmp_path / "figures" / "accuracy.png").read_bytes()[:4] == b"\x89PNG"
    summary = json.loads((tmp_path / "summary.json").read_text(), parse_constant=pytest.fail)
    assert summary["files"] == ["accuracy.ecsv", "figures/accuracy.png", "report.html", "scene.json"]
    page = read_page(tmp_path / "report.html")
    shown = {f"{row[0].text}: {row[1].text}": value_of(row[3]) for row in rows_of(page, "setting-table")}
    scored = [row for row in result.rows if np.isfinite(row.sigma_ukcmb2)]
    assert shown == {f"{row.setting.parameter}: {row.setting.label}": row.sigma_ukcmb2 for row in scored}
    assert len(page.all("img")) == 1 and "sample rate 5 Hz: refused: " in page.text
    write_accuracy(tmp_path, result, figures=False)
    assert read_page(tmp_path / "report.html").all("img") == []  # the figure is not this call's
    print_accuracy(result, tmp_path)
    text = capsys.readouterr().out
    for line in ("sample rate 5 Hz: refused: ", "slope of error against time", "Recommended, with a bias below"):
        assert line in text


@pytest.mark.slow
def test_notebooks_show_the_recommended_settings(result):
    lines = repr(result).splitlines()
    assert lines[0] == f"AccuracyResult of {result.scene.name}: {len(result.rows)} settings"
    assert lines[1].startswith("Reference: sigma(A) = ") and len(lines) == 3 + len(result.recommended)
    assert result._repr_html_().count("<tr>") == 1 + len(result.recommended)
    for item in result.recommended:
        assert any(line.startswith(item.parameter) and item.label in line for line in lines)


@pytest.mark.slow
def test_the_figure_marks_the_scene_and_its_front(result):
    for panel in accuracy_figure(result).panels:
        assert panel.x_log and panel.y_log
        assert any(series.look.endswith("-.") for series in panel.series)
        assert any(series.look == "grey" and series.kind == "line" for series in panel.series)


@pytest.mark.slow
def test_a_scene_without_atmosphere_has_no_screen_to_look_at(tmp_path):
    path = tmp_path / "white.toml"
    text = without_sections(SMALL_SCENE, "atmosphere", "excess", "photon", "sky")
    path.write_text(text.replace('algorithm = "average"', 'algorithm = "none"'))
    result = measure_accuracy(path, ACTUAL_ALONE, seeds=1, observations=4)
    rows = [row for row in result.rows if row.setting.parameter in ("screen step", "interpolation")]
    assert len(rows) == 7 and all("without [atmosphere]" in row.note for row in rows)


def test_a_run_that_fails_says_why(path):
    run = run_task(Task(load_scene(path, {"observations": 1}), (1,)))
    assert not run.scored(1) and run.marks[1].note.startswith("not scored: ")
    run = run_task(Task(load_scene(path, {"score.size": "2 deg"}), (4,)))
    assert run.note.startswith("refused: score.size: found 120 arcmin") and not run.marks


@pytest.mark.parametrize("wrong", [{"reference_error": 0.0}, {"seeds": 0}, {"observations": 1}])
def test_options_out_of_range_are_refused(path, wrong):
    with pytest.raises(ValueError, match="reference error, seeds and observations: found"):
        measure_accuracy(path, {}, **wrong)


# ---------------------------------------------------------------- precision


def test_float64_streams_and_maps_are_float64(path):
    for precision in ("float32", "float64"):
        setup = prepare(load_scene(path, {"numerics.precision": precision}))
        assert draw_observation(setup, 0).data_mk.dtype == np.dtype(precision)
        found = observe(setup, 0, with_signal_sims=True)
        assert found.sums.dtype == found.signal_maps.dtype == np.dtype(precision)
        made = [strip for cache in setup.air.layers[0].strips.caches.values() for strip in cache.strips.values()]
        assert {strip.columns.dtype for strip in made} == {np.dtype(precision)}


def test_streams_of_both_precisions_are_of_the_same_draws(path):
    one, other = (
        draw_observation(prepare(load_scene(path, {"numerics.precision": precision})), 1).data_mk
        for precision in ("float32", "float64")
    )
    # Of 24 bits a strip's transform and the sums over a few hundred factors lose some.
    assert 0 < np.abs(one - other).max() < 1e-4 * np.ptp(other)


# ---------------------------------------------------------------- what follows


def row(parameter, label, kind, own, **values):
    numbers = {"sigma_ukcmb2": 100.0, "error_ukcmb2": 5.0, "bias": 0.0, "bias_error": 0.0, "wall_s": 1.0, "cpu_s": 1.0}
    return Measured(Setting(parameter, label, {}, kind, own), 10, **(numbers | values))


def test_slopes_of_a_monte_carlo_are_minus_a_half():
    counts = np.array([10, 20, 40, 80])
    rows = [
        row(
            "observations", str(n), "survey", n == 80, wall_s=0.1 * n, budget=ErrorBudget(0.3 / n**0.5, 0.4 / n**0.5, 0)
        )
        for n in counts
    ]
    rows = [replace(item, observations=int(n)) for item, n in zip(rows, counts, strict=True)]
    found = {item.name: item for item in slopes(rows)}
    assert found["error against observations"].value == pytest.approx(-0.5)
    assert found["error against time"].value == pytest.approx(-0.5)
    assert found["error against time"].error < 1e-12
    assert "error against CPU time" not in found  # all times are equal
    assert "noise part against noise realizations" not in found


def test_the_fastest_good_setting_is_recommended():
    rows = [
        row("a", "coarse", "numerical", False, bias=0.1, bias_error=0.01, cpu_s=1.0),
        row("a", "medium", "numerical", False, bias=-0.02, bias_error=0.01, cpu_s=2.0),
        row("a", "fine", "numerical", True, cpu_s=3.0),
        row("b", "unknown", "numerical", False, bias=0.1, bias_error=0.2, cpu_s=1.0),
        row("b", "own", "numerical", True, cpu_s=3.0),
        row("c", "hardly faster", "numerical", False, cpu_s=0.95),
        row("c", "own", "numerical", True, cpu_s=1.0),
        row("d", "few", "sampling", False, error_ukcmb2=9.0, cpu_s=0.1),
        row("d", "enough", "sampling", False, error_ukcmb2=5.2, bias=0.2, cpu_s=0.2),
        row("d", "own", "sampling", True, cpu_s=1.0),
        row("d", "refused", "sampling", False, bias=np.nan, cpu_s=np.nan),
    ]
    found = [(item.parameter, item.label, item.is_own, item.resolved) for item in recommendations(rows, 0.03)]
    assert found == [
        ("a", "medium", False, True),
        ("b", "unknown", False, False),
        ("c", "own", True, True),
        ("d", "enough", False, True),
    ]


def test_the_pareto_front_leaves_out_what_is_slower_and_worse():
    time = np.array([1.0, 2.0, 3.0, 1.5, 3.0])
    error = np.array([4.0, 3.0, 1.0, 4.0, 2.0])
    assert list(pareto(time, error)) == [0, 1, 2]
