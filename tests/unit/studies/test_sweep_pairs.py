"""Any two points of a sweep: ratios and paired errors, the reference, estimates of one kind, unknown errors."""

import json
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from mapmaker.uncertainty import ratio_error
from surveysim import run_sweep
from surveysim.report.terminal.sweep import best_line, print_sweep
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.numbers import plain, quoted
from surveysim.studies.sweep.comparison import compare, compare_runs
from surveysim.studies.sweep.result import pairs
from surveysim.survey.error_modes import error_modes
from tests.pages import read_page, rows_of
from tests.scenes import TURBULENT_SCENE, without_sections
from tests.unit.studies.test_sweep_run import LEVELS, SPEEDS, WHITE

# A cleaning of two steps has no forecast.
MIXED = (
    without_sections(TURBULENT_SCENE, "sky")
    .replace("observations = 4\n", "observations = 6\n", 1)
    .replace("mask_separation_f_lambda = 1.3\n", "")
    .replace('noise_only_sets = ["uncorrelated", "white"]', "noise_only_sets = []")
    .replace("max_iterations = 100", "max_iterations = 100\nneighbour_radius = 1.2")
    + '\n[sweep]\n"cleaning.algorithm" = ["average", "planar", ["average", "local"]]\n'
)


@pytest.fixture(scope="module")
def levels(write):
    """A finished sweep of the white level; the first and the last point are one scene."""
    return run_sweep(write(WHITE + LEVELS), engine=SERIAL)


@pytest.fixture(scope="module")
def speeds(write, tmp_path_factory):
    """A finished sweep of the scan speed, whose points share a part of their errors, and where its files are."""
    out = tmp_path_factory.mktemp("speeds")
    return run_sweep(write(WHITE + SPEEDS), out, engine=SERIAL, figures=False), out


def test_pairs_are_differences_of_responses(speeds):
    """Every pair by hand from `error_modes`, and no pair twice."""
    result, out = speeds
    items = [point.scores["actual"] for point in result.points]
    rows = error_modes(items, [point.skies for point in result.points])
    found = Table.read(out / "sweep_pairs.ecsv", format="ascii.ecsv")
    assert [(row["point"], row["other"]) for row in found] == [(1, 0), (2, 0), (2, 1)] and all(found["comparable"])
    for row in found:
        i, j = row["point"], row["other"]
        ratio = items[i].band.sigma_ukcmb2 / items[j].band.sigma_ukcmb2
        assert row["ratio"] == pytest.approx(ratio, rel=1e-12)
        assert row["ratio_error"] == pytest.approx(ratio * np.linalg.norm(rows[i] - rows[j]), rel=1e-9)
        apart = np.hypot(*(item.budget.total for item in (items[i], items[j])))
        assert row["independent_error"] == pytest.approx(ratio * apart, rel=1e-9)
        assert row["ratio_error"] > 0
    content = json.loads((out / "summary.json").read_text())
    assert [pair["ratio"] for pair in content["pairs"]] == list(found["ratio"])


def test_equal_scenes_have_the_ratio_one_without_an_error(levels):
    """Points 0 and 2 are one scene."""
    pair = next(pair for pair in pairs(levels) if (pair.point, pair.other) == (2, 0))
    assert (pair.ratio, pair.paired_error) == (1.0, 0.0) and pair.independent_error > 0.05
    assert levels.comparison.ratio[2] == 1 and levels.comparison.paired_error[2] == 0


def test_any_point_may_be_the_reference(speeds, tmp_path):
    """The same points with another reference: its column of the pairs, and no other probability."""
    result, _ = speeds
    other = run_sweep(replace(result.sweep, reference=2), tmp_path, engine=SERIAL, figures=False)
    assert other.comparison.reference == 2 and other.comparison.best == result.comparison.best
    np.testing.assert_array_equal(other.comparison.best_probability, result.comparison.best_probability)
    sigma, found = result.comparison.value, other.comparison
    np.testing.assert_array_equal(found.ratio, sigma / sigma[2])
    of_pairs = {(pair.point, pair.other): pair for pair in pairs(result)}
    assert found.paired_error[2] == found.independent_error[2] == 0
    for number in (0, 1):
        pair = of_pairs[2, number]
        assert found.paired_error[number] == pytest.approx(pair.paired_error / pair.ratio**2, rel=1e-9)
    assert json.loads((tmp_path / "summary.json").read_text())["reference"] == 2


def test_a_reference_without_a_score_is_replaced_and_told(write, tmp_path):
    path = write(WHITE + "\n[sweep]\nreference = 1\nobservations = [4, 1, 5]\n")
    result = run_sweep(path, tmp_path, engine=SERIAL, figures=False)
    assert result.comparison.reference == 0
    assert result.warnings == [
        "the reference point that was chosen, observations = 1, has no score; ratios are to observations = 4"
    ]


def test_many_points_have_no_pairs(levels, monkeypatch):
    monkeypatch.setattr("surveysim.studies.sweep.result.MOST_PAIRED", 2)
    assert pairs(levels) == []


# ---------------------------------------------------------------- kinds of estimates


@pytest.fixture(scope="module")
def mixed(write, tmp_path_factory):
    """A finished sweep of six observations; two of its three points can be forecast."""
    out = tmp_path_factory.mktemp("mixed")
    return run_sweep(write(MIXED), out, engine=SERIAL, figures=False), out


def test_estimates_of_a_sweep_are_of_one_kind(mixed, levels):
    """Without control variate if a point has none; their weather is common, hence out of their ratios."""
    result, out = mixed
    assert (levels.estimate, result.estimate) == ("controlled", "plain")
    items = [point.scores["actual"] for point in result.points]
    assert all(item.control is None for item in items)
    table = Table.read(out / "sweep.ecsv", format="ascii.ecsv")
    np.testing.assert_array_equal(table["sigma_actual"], table["plain_sigma_actual"])
    assert json.loads((out / "summary.json").read_text())["estimate"] == "plain"
    shared = [
        replace(item, budget=replace(item.budget, weather=np.sqrt(5 / 3) * ratio_error(item.information, np.ones(6))))
        for item in items
    ]
    rows = error_modes(shared, [point.skies for point in result.points])
    for pair in pairs(result):
        expected = pair.ratio * np.linalg.norm(rows[pair.point] - rows[pair.other])
        assert pair.paired_error == pytest.approx(expected, rel=1e-9)


def test_an_error_may_be_unknown_where_that_of_the_ratio_is_known(mixed, capsys):
    """Six observations without a forecast do not tell how well they sample the weather; the ratio need not know."""
    result, out = mixed
    assert np.isnan(result.comparison.error).tolist() == [False, False, True]
    assert np.isfinite(result.comparison.paired_error).all() and np.isnan(result.comparison.independent_error[2])
    assert np.isfinite(result.comparison.best_probability).all()
    content = json.loads((out / "summary.json").read_text(), parse_constant=pytest.fail)
    point = content["points"][2]
    assert point["scores"]["actual"]["error_ukcmb2"] is None and point["independent_error"] is None
    print_sweep(result, out)
    assert plain(quoted(point["scores"]["actual"]["sigma_ukcmb2"], None)) in capsys.readouterr().out
    row = rows_of(read_page(out / "report.html"), "point-table")[2]
    assert row[2].text.endswith("± unknown") and "unknown" not in row[5].text


def test_unknown_errors_are_no_probabilities(write, tmp_path):
    """Three observations tell nothing of how they sample the weather, even with a forecast."""
    result = run_sweep(
        write(WHITE.replace("observations = 4\n", "observations = 3\n") + LEVELS), tmp_path, engine=SERIAL
    )
    found = result.comparison
    assert np.isnan(found.error).all() and np.isnan(found.best_probability).all()
    np.testing.assert_allclose(found.ratio, [1, 4, 1], rtol=1e-5)
    assert best_line(result).startswith("lowest: ") and "+- unknown" in best_line(result)
    assert best_line(result).endswith("its error is unknown, as there are too few observations")
    json.loads((tmp_path / "summary.json").read_text(), parse_constant=pytest.fail)
    assert "± unknown" in read_page(tmp_path / "report.html").one("header").text


def test_a_point_of_unknown_error_does_not_compete():
    modes = np.array([[0.01, 0.0], [np.nan, 0.0], [0.0, 0.01]])
    found = compare(np.array([2.0, 3.0, 2.1]), modes, np.random.default_rng(1))
    assert found.competing.tolist() == [True, False, True] and np.isnan(found.best_probability[1])
    assert found.best_probability[[0, 2]].sum() == pytest.approx(1) and np.isnan(found.paired_error[1])


def test_controlled_scores_keep_what_their_modes_say(levels):
    """With a forecast nothing is put in place of the errors of the weather."""
    items = [point.scores["actual"] for point in levels.points]
    assert all(item.control is not None for item in items)
    rows = error_modes(items, [point.skies for point in levels.points])
    found = compare_runs(levels.points, np.random.default_rng(1))
    np.testing.assert_allclose(found.modes, rows, rtol=1e-12, atol=1e-14)


def test_the_terminal_names_points_by_their_axes(write, tmp_path, capsys):
    keys = ('"detector.psd" = ["2.5 mK2 / Hz", "10 mK2 / Hz"]', '"map.pixel" = ["24 arcsec", "30 arcsec"]')
    path = write("\n".join([WHITE, "[sweep.noise]", *keys, ""]))
    print_sweep(run_sweep(path, tmp_path, engine=SERIAL), tmp_path)
    screen = capsys.readouterr().out
    heading, *_ = (line for line in screen.splitlines() if "sigma(A) [" in line)
    assert heading.split("┃")[1].strip() == "noise" and "10 mK2 / Hz │" in screen
    assert "detector.psd" not in screen and "map.pixel" not in screen
    assert {"detector.psd", "map.pixel"} <= set(Table.read(tmp_path / "sweep.ecsv").colnames)
