"""Shares of discarded scans: by data set and weather, warnings, and which points of a sweep may be compared."""

import json
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from surveysim import forecast_sweep, load_scene, run, run_sweep
from surveysim.reduction.cleaning_pipelines import OPTIMAL
from surveysim.reduction.setup import prepare
from surveysim.report.figures.sweep import sweep_figure
from surveysim.report.html.sweep import _discarded
from surveysim.report.terminal.survey import closing_line, print_result
from surveysim.report.terminal.sweep import best_line, discard_lines, print_sweep
from surveysim.results.summary import best_pipeline
from surveysim.runtime.engine import SERIAL
from surveysim.studies.sweep.comparison import compare
from surveysim.studies.sweep.result import FORECAST_WEATHER, pairs
from surveysim.survey import run as survey
from surveysim.survey.discarded_scans import (
    Discards,
    competing,
    discards,
    listed_data_sets,
    sweep_warnings,
    why_withheld,
)
from surveysim.survey.rows import row_names
from surveysim.survey.run import run_observations
from surveysim.survey.scores import score_survey
from tests.pages import read_page, rows_of
from tests.scenes import SMALL_SCENE, TURBULENT_SCENE, without_sections

N_SCANS = 4
REMEDIES = ('cleaning.responsivities = "observation" or "survey"', "longer scans", '"pca"')
LEVELS = '\n[sweep]\n"detector.psd" = ["2.5 mK2 / Hz", "2.6 mK2 / Hz", "2.7 mK2 / Hz", "2.8 mK2 / Hz"]\n'
TWO_LEVELS = '\n[sweep]\n"detector.psd" = ["2.5 mK2 / Hz", "2.6 mK2 / Hz"]\n'


def losing(monkeypatch, lost):
    """Observations that lose so many scans of the actual data, and none of other data, by number (and scene)."""
    observe = survey.observe

    def losing(setup, observation, *rest, **options):
        result = observe(setup, observation, *rest, **options)
        count = lost(setup.scene, observation)
        return replace(result, discarded=(count, *(0 for _ in result.discarded[1:])))

    monkeypatch.setattr(survey, "observe", losing)


@pytest.fixture
def small(tmp_path):
    def small(settings, text=SMALL_SCENE):
        path = tmp_path / "small.toml"
        path.write_text(text)
        return load_scene(path, settings)

    return small


# ---------------------------------------------------------------- of a run


def test_shares_by_data_set_and_weather(small, monkeypatch):
    """Every third observation loses two of its four scans: counted by hand in the order of B2."""
    losing(monkeypatch, lambda scene, observation: 2 * (observation % 3 == 0))
    setup = prepare(small({"observations": 10}))
    coadds = run_observations(setup, None)
    found, b2 = discards(setup, coadds), coadds.column("b2_mk2")
    assert found.shares == {"actual": 0.2, "uncorrelated": 0.2, "white": 0.2, "masked_7": 0.0}
    order = sorted(range(10), key=lambda observation: b2[observation])
    quarters = [order[:3], order[3:6], order[6:8], order[8:]]
    assert [part["observations"] for part in found.by_weather] == [3, 3, 2, 2]
    for part, numbers in zip(found.by_weather, quarters, strict=True):
        assert (part["b2_min_mk2"], part["b2_max_mk2"]) == (b2[numbers[0]], b2[numbers[-1]])
        expected = sum(2 * (number % 3 == 0) for number in numbers) / (N_SCANS * len(numbers))
        assert part["discarded"]["actual"] == part["discarded"]["white"] == pytest.approx(expected)
        assert part["discarded"]["masked_7"] == 0
    calm = 100 * found.by_weather[0]["discarded"]["actual"]
    (line,) = found.warnings
    assert line.startswith(f"actual: 20.0 % of the scans are discarded, {calm:.1f} % in the calmest quarter")
    assert all(remedy in line for remedy in REMEDIES)


def test_the_optimal_set_loses_the_scans_of_the_best_pipeline(small, monkeypatch):
    """The actual data lose a scan of each observation; the other pipeline, which loses none, is mostly the best."""
    losing(monkeypatch, lambda scene, observation: 1)
    setup = prepare(small({"observations": 6, "cleaning.algorithm": "planar", "cleaning.compare": ["average"]}))
    coadds = run_observations(setup, None)
    columns = dict(zip(row_names(setup.analysis), np.array(coadds.rows).T, strict=True))
    best = best_pipeline(setup, columns, "cmb")
    assert discards(setup, coadds).shares[OPTIMAL] == pytest.approx(np.mean(best == 0) / N_SCANS)
    kept = score_survey(setup, coadds)[OPTIMAL].kept
    assert kept == pytest.approx(1 - (best == 0) / N_SCANS) and (best == 1).any()


def test_no_weather_without_an_atmosphere(small):
    text = without_sections(SMALL_SCENE, "atmosphere", "excess")
    setup = prepare(small({"cleaning.algorithm": "none"}, text))
    found = discards(setup, run_observations(setup, None))
    assert found.by_weather == [] and set(found.shares) == set(setup.analysis.data_set_names)


@pytest.mark.parametrize("lost, warned", [(0, False), (4, False), (5, True)])
def test_a_run_warns_above_five_percent(small, monkeypatch, tmp_path, capsys, lost, warned):
    """Twenty observations of four scans: four lost scans are 5 %, five are more."""
    losing(monkeypatch, lambda scene, observation: int(observation < lost))
    result = run(small({"observations": 20}), tmp_path / "out", engine=SERIAL, figures=False)
    content = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert content["discarded"]["actual"] == lost / 80 and content["scans_discarded"] == lost
    assert len(content["discarded_by_weather"]) == 4 and bool(content["warnings"]) == warned
    print_result(result, tmp_path / "out")
    screen, page = capsys.readouterr().out, read_page(tmp_path / "out" / "report.html")
    assert ("Warning: actual: 6.2 % of the scans are discarded" in screen) == warned
    assert ("Warning: actual: 6.2 % of the scans are discarded" in page.one("header").text) == warned
    share = f" ({100 * lost / 80:.1f} %; masked_7: 0.0 %)" if lost else ""
    assert f"{lost} of 80 scans discarded{share}, " in closing_line(content)
    if not lost:
        assert "No scan was discarded." in page.text
        return
    rows = rows_of(page, "discarded-table")
    assert [row[0].text for row in rows] == ["1st quarter", "2nd quarter", "3rd quarter", "4th quarter", "all"]
    assert [row[3].text for row in rows][-1] == f"{100 * lost / 80:.1f}"


def test_data_sets_that_are_told():
    assert listed_data_sets([{"actual": 0.1, "white": 0.1, "planar": 0.0}]) == ["actual", "planar"]
    assert listed_data_sets([{"actual": 0.0, "masked_7": 0.0}, {"actual": 0.0, "masked_9": 0.0}]) == [
        "actual", "masked_7", "masked_9",
    ]  # fmt: skip


# ---------------------------------------------------------------- of a sweep: the rule


@pytest.mark.parametrize(
    "shares, expected",
    [
        ([0.0, 0.0], [True, True]),
        ([0.05, 0.05], [True, True]),
        ([0.051, 0.051], [False, False]),
        ([0.0, 0.02, 0.021], [True, True, False]),
        ([0.03, 0.05, 0.01], [True, False, True]),  # 0.03 - 0.01 is 0.02 but for its rounding
        ([0.01, 0.2, 0.3], [True, False, False]),
        ([0.04], [True]),
        ([0.06], [False]),
        ([], []),
    ],
)
def test_points_that_compete(shares, expected):
    assert competing(np.array(shares)).tolist() == expected


def test_why_a_probability_is_withheld():
    assert why_withheld(0.184, 0.0) == "18.4 % of its scans are discarded, more than 5 %"
    assert why_withheld(0.04, 0.01) == "4.0 % of its scans are discarded, at another point 1.0 %"
    assert why_withheld(0.01, 0.01) == "other points can't be compared with it (it loses 1.0 % of its scans)"


@pytest.mark.parametrize(
    "shares, many, apart",
    [([0.0, 0.02], False, False), ([0.0, 0.03], False, True), ([0.06, 0.07], True, False), ([0.0, 0.3], True, True)],
)
def test_warnings_of_a_sweep(shares, many, apart):
    lines = sweep_warnings("ab", [{"actual": share, "white": share} for share in shares])
    assert len(lines) == (many or apart)
    for line in lines:
        assert line.startswith("actual: ") and all(remedy in line for remedy in REMEDIES)
        assert ("more than 5 % of the scans are discarded at" in line) == many
        assert ("differs by more than 2 % between points" in line) == apart and "at b" in line


def test_only_points_that_lose_few_scans_compete():
    """Of three points the one that loses more has no probability; the others share it."""
    sigma, modes = np.array([2.0, 2.0, 3.0, np.nan]), np.zeros((4, 1))
    found = compare(sigma, modes, np.random.default_rng(1), discarded=np.array([0.0, 0.01, 0.04, 0.0]))
    np.testing.assert_array_equal(found.best_probability, [0.5, 0.5, np.nan, np.nan])
    assert found.competing.tolist() == [True, True, False, False] and found.best == (0, 1)
    none = compare(sigma, modes, np.random.default_rng(1), discarded=np.array([0.1, 0.2, 0.3, 0.0]))
    assert np.isnan(none.best_probability).all() and not none.competing.any()
    # If the one that loses more is the lowest all the same, nobody is known to be the best.
    sigma[2] = 1.0
    lowest = compare(sigma, modes, np.random.default_rng(1), discarded=np.array([0.0, 0.01, 0.04, 0.0]))
    assert lowest.best == (2,) and not lowest.competing.any() and np.isnan(lowest.best_probability).all()
    # One alone is not the best of anything.
    one = compare(sigma, modes, np.random.default_rng(1), discarded=np.array([0.0, 0.03, 0.03, 0.0]))
    assert not one.competing.any()
    # A point without a score says nothing of those that have one.
    alone = compare(sigma, modes, np.random.default_rng(1), discarded=np.array([0.04, 0.04, 0.04, 0.0]))
    assert alone.competing.tolist() == [True, True, True, False]


# ---------------------------------------------------------------- of a sweep: files, screen, page


@pytest.fixture(scope="module")
def lossy(tmp_path_factory):
    """A sweep of four points that lose 0, 0, 1 and 4 of their 16 scans."""
    counts = {2.5: 0, 2.6: 0, 2.7: 1, 2.8: 4}
    path = tmp_path_factory.mktemp("lossy") / "lossy.toml"
    path.write_text(without_sections(TURBULENT_SCENE, "sky").replace("mask_separation_f_lambda = 1.3\n", "") + LEVELS)
    with pytest.MonkeyPatch.context() as patch:
        losing(patch, lambda scene, observation: counts[round(scene.detector.psd_mk2_hz, 6)] > observation)
        return run_sweep(path, path.parent / "out", engine=SERIAL, figures=False), path.parent / "out"


def test_files_of_a_sweep_that_loses_scans(lossy):
    result, out = lossy
    table = Table.read(out / "sweep.ecsv", format="ascii.ecsv")
    np.testing.assert_allclose(table["discarded"], [0, 0, 1 / 16, 1 / 4])
    assert not any(name.startswith("discarded_") for name in table.colnames)
    assert np.isnan(table["best_probability"]).tolist() == [False, False, True, True]
    assert sum(table["best_probability"][:2]) == pytest.approx(1)
    content = json.loads((out / "summary.json").read_text())
    assert ["best_probability" in point for point in content["points"]] == [True, True, False, False]
    assert content["points"][3]["best_probability_withheld"] == "25.0 % of its scans are discarded, more than 5 %"
    assert [point["discarded"]["actual"] for point in content["points"]] == [0, 0, 1 / 16, 1 / 4]
    assert [len(point["discarded_by_weather"]) for point in content["points"]] == [4] * 4
    (line,) = content["warnings"]
    assert "at 2 of 4 points, 25.0 % at detector.psd = 2.8 mK2 / Hz" in line
    of_pairs = Table.read(out / "sweep_pairs.ecsv", format="ascii.ecsv")
    *_, marked = sweep_figure(result).panels[1].series
    np.testing.assert_allclose(marked.x, [2.7, 2.8])
    comparable = {(row["point"], row["other"]) for row in of_pairs if row["comparable"]}
    assert comparable == {(1, 0)} and [pair.comparable for pair in pairs(result)] == list(of_pairs["comparable"])


def test_screen_and_page_of_a_sweep_that_loses_scans(lossy, capsys):
    result, out = lossy
    print_sweep(result, out)
    screen, page = capsys.readouterr().out, read_page(out / "report.html")
    assert screen.count("withheld │") == 2 and "25.0 %" in screen and "Warning: actual: more than 5 %" in screen
    assert discard_lines(result) == ["scans discarded, actual: 0.0 % to 25.0 %"]
    assert result.comparison.best == (0,)
    assert best_line(result).startswith(
        "best of the 2 points that have a known error and lose few scans (of 4): detector.psd = 2.5 mK2 / Hz"
    )
    rows = rows_of(page, "point-table")
    assert [row[6].text for row in rows][2:] == ["withheld"] * 2
    assert [row[4].text for row in rows] == ["0.0 %", "0.0 %", "6.2 %", "25.0 %"]
    assert "2 points that lose too many scans are not counted." in page.one("header").text
    assert "Warning: actual: more than 5 %" in page.one("header").text
    assert [len(row) for row in rows_of(page, "discarded-table")] == [1 + 1 + 4] * 4
    marked = ["*" in cell.text for row in rows_of(page, "pair-table") for cell in row[1:]]
    assert marked == [i != j and {i, j} != {0, 1} for i in range(4) for j in range(4)]


def test_a_lowest_point_that_loses_scans_is_not_called_the_best(tmp_path, monkeypatch):
    losing(monkeypatch, lambda scene, observation: int(observation == 0))
    path = tmp_path / "lossy.toml"
    path.write_text(without_sections(SMALL_SCENE, "sky") + TWO_LEVELS)
    result = run_sweep(path, tmp_path / "out", engine=SERIAL, figures=False)
    why = "6.2 % of its scans are discarded, more than 5 %"
    assert best_line(result).startswith("lowest: ") and best_line(result).endswith(f"the best is withheld: {why}")
    assert "confidence" not in best_line(result)
    header = read_page(tmp_path / "out" / "report.html").one("header").text
    assert f"The probability that it is the best is withheld: {why}." in header and "confidence" not in header


@pytest.mark.slow
def test_forecasts_predict_shares_and_compare_none(tmp_path):
    """In calm weather, where fits to single scans lose more than half of the 16 scans."""
    path = tmp_path / "small.toml"
    path.write_text(without_sections(SMALL_SCENE, "sky").replace("[100, 280, 980]", "[4, 9, 20]") + LEVELS)
    result = forecast_sweep(path, tmp_path / "out", figures=False)
    assert discard_lines(result)[0].startswith("scans discarded, as predicted from a few, actual: ")
    table = Table.read(tmp_path / "out" / "sweep.ecsv", format="ascii.ecsv")
    assert list(table["discarded"]) == [point.discarded["actual"] for point in result.points]
    assert max(table["discarded"]) > 0.05 and result.warnings == []


def test_forecasts_say_that_they_know_no_shares(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("surveysim.forecasting.pilot._MOST_SAMPLES", 0)
    path = tmp_path / "small.toml"
    path.write_text(without_sections(SMALL_SCENE, "sky") + TWO_LEVELS)
    result = forecast_sweep(path, tmp_path / "out", figures=False)
    assert discard_lines(result) == ["Shares of discarded scans are not known."] and result.warnings == []
    print_sweep(result, tmp_path / "out")
    screen = capsys.readouterr().out
    assert "forecast sigma(A) [uK_CMB^2]" in screen and FORECAST_WEATHER in screen
    assert "discarded" not in Table.read(tmp_path / "out" / "sweep.ecsv", format="ascii.ecsv").colnames


@pytest.mark.parametrize(
    "kind, said", [("simulated", "No scan was discarded."), ("forecast", "By forecast no scan is discarded.")]
)
def test_a_page_names_the_points_whose_share_is_unknown(kind, said):
    known, unknown = {"label": "psd = 1", "discarded": {"actual": 0.0}}, {"label": "psd = 2"}
    (text,) = _discarded({"kind": kind, "axes": [], "points": [known, unknown]})
    assert text.paragraphs == (said, "The fraction is unknown for psd = 2.")
    (text,) = _discarded({"kind": kind, "axes": [], "points": [known]})
    assert text.paragraphs == (said,)


def test_few_observations_have_no_quarters():
    part = {"b2_min_mk2": 1.0, "b2_max_mk2": 2.0, "observations": 1, "discarded": {"actual": 1.0}}
    (line,) = Discards({"actual": 1.0}, [part]).warnings
    assert "quarter" not in line and line.startswith("actual: 100.0 % of the scans are discarded; ")
