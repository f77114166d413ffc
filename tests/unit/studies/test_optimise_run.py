"""Optimisation of scenes: forecasts with known optima, files, simulated designs, interruption."""

import json
import math

import numpy as np
import pytest
from astropy.table import Table

import surveysim
from surveysim import FinishedError, OutputError, SceneError, optimise
from surveysim.output.record import RECORD
from surveysim.reduction.setup import prepare
from surveysim.report.html.page import write_report
from surveysim.report.terminal.optimum import print_optimum
from surveysim.results.metrics import forecast_metrics
from surveysim.runtime.engine import SERIAL
from surveysim.studies.optimise.evaluation import EvaluationJob
from surveysim.studies.optimise.problem import load_problem
from surveysim.studies.optimise.summary import grouped
from tests.scenes import SMALL_SCENE, without_sections

SIGMA = "flat_band_power.sigma"
WHITE = (
    without_sections(SMALL_SCENE, "atmosphere", "excess", "photon", "sky")
    .replace('algorithm = "average"', 'algorithm = "none"')
    .replace('noise_only_sets = ["uncorrelated", "white"]', "noise_only_sets = []")
    .replace("mask_separation_f_lambda = 1.3\n", "")
)
# The noise is lowest at 700 uK2 of a key that a forecast does not look at, and twice that of the scene there.
ANALYTIC = """
[optimise]

[[optimise.knobs]]
key = "score.signal_sims.band_power"
low = "50 uK2"
high = "20000 uK2"
scale = "log"

[[optimise.derived]]
key = "detector.psd"
value = "2.5 * mK**2 / Hz * (score.signal_sims.band_power / (700 * uK**2) + 700 * uK**2 / score.signal_sims.band_power)"
"""
GRID = np.linspace(0, 1, 13)
FRONT = """
[optimise]
metrics = ["flat_band_power.sigma", "detectors"]

[[optimise.knobs]]
key = "instrument.layout.rings"
low = 1
high = 4
"""


@pytest.fixture(scope="module")
def analytic(write, tmp_path_factory):
    """A finished optimisation, and where its files are."""
    out = tmp_path_factory.mktemp("analytic")
    return optimise(write(WHITE + ANALYTIC), out, engine=SERIAL), out


def test_an_analytic_optimum(analytic):
    """The PSD is 5 cosh(u) mK2/Hz with u = ln(x / 700 uK2): within 1 % where cosh(u) < 1.01."""
    result, _ = analytic
    knob = result.problem.knobs[0]
    assert knob.number_of(result.best["score.signal_sims.band_power"]) == pytest.approx(700, rel=0.01)
    assert float(result.best["detector.psd"].split()[0]) == pytest.approx(5, rel=1e-4)
    item = result.found.ranges[0]
    ends = [math.log(knob.number(end) / 700) for end in (item.low, item.high)]
    np.testing.assert_allclose(ends, [-math.acosh(1.01), math.acosh(1.01)], atol=0.01)
    assert result.found.scatter < 1e-3


def test_simulated_designs_have_paired_errors(analytic):
    """All designs draw the same noise, so ratios are those of the PSDs; only signal simulations differ."""
    result, out = analytic
    comparison, names = result.simulated.comparison, [item.name for item in result.found.designs]
    assert names == ["as it is", "best", "band_power low", "band_power high"]
    np.testing.assert_allclose(comparison.ratio, [1, 2, 2.02, 2.02], rtol=2e-3)
    assert (comparison.paired_error < comparison.independent_error / 3)[1:].all()
    table = Table.read(out / "tables" / "simulated.ecsv")
    assert list(table["design"]) == names


def test_files(analytic):
    result, out = analytic
    summary = json.loads((out / "summary.json").read_text())
    found = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    tables = {f"tables/{name}.ecsv" for name in ("optimum", "designs", "evaluations", "simulated", "simulated_pairs")}
    figures = {"figures/optimum.png", "figures/simulated.png"}
    rest = {RECORD, "evaluations.jsonl", "report.html", "scene.json", "scene.toml", "summary.json"}
    assert found == tables | figures | rest
    assert set(summary["files"]) == tables | figures | {"report.html", "scene.json"}
    evaluations = Table.read(out / "tables" / "evaluations.ecsv")
    assert len(evaluations) == summary["optimum"]["evaluations"] == len(result.found.evaluations)
    assert evaluations[SIGMA].unit == "uK2" and evaluations["score.signal_sims.band_power"].unit == "uK2"
    record = json.loads((out / RECORD).read_text())
    assert record["finished"] and record["files"].keys() == found - {RECORD}
    page = (out / "report.html").read_text()
    assert "within 1 % of the best" in page and "as it is" in page
    write_report(out)
    assert (out / "report.html").read_text() == page


def test_what_people_see(analytic, capsys, tmp_path):
    result, _ = analytic
    print_optimum(result, tmp_path)
    printed = capsys.readouterr().out
    assert "score.signal_sims.band_power" in printed and "designs were forecast; 0 are not allowed" in printed
    assert repr(result).startswith("OptimiseResult of white: ") and "<table>" in result._repr_html_()
    assert result.table()["key"][0] == "score.signal_sims.band_power"
    assert [axes.get_xscale() for axes in result.plot().axes] == ["log"]


def test_a_finished_search_is_not_resumed(analytic):
    result, out = analytic
    with pytest.raises(FinishedError):
        optimise(result.problem, out, engine=SERIAL, resume=True)
    other = result.problem.path
    with pytest.raises(OutputError, match="with other settings"):
        optimise(other, out, overrides={"observations": 5}, engine=SERIAL)


@pytest.mark.slow
def test_simulation_after_a_forecast(write, tmp_path):
    """A search by forecast alone can be resumed: its designs are then simulated, and none is forecast again."""
    path = write(WHITE + ANALYTIC)
    first = optimise(path, tmp_path, engine=SERIAL, simulate=False, figures=False)
    assert first.simulated is None
    kept, new = (tmp_path / "evaluations.jsonl").read_bytes(), []
    result = optimise(path, tmp_path, engine=SERIAL, resume=True, figures=False, progress=new.append)
    assert not new and result.best == first.best and len(result.simulated.points) == 4
    assert (tmp_path / "evaluations.jsonl").read_bytes() == kept


@pytest.mark.slow
def test_a_grid_of_forecasts(write):
    """No design of a grid over rings and speed, with at most 40 detectors, is better than the search by 0.5 %."""
    text = """
[optimise]

[[optimise.knobs]]
key = "instrument.layout.rings"
low = 1
high = 5

[[optimise.knobs]]
key = "scan.speed"
low = "1 arcmin / s"
high = "20 arcmin / s"
scale = "log"

[[optimise.derived]]
key = "scan.duration"
value = "24 * arcmin / scan.speed"

[[optimise.derived]]
key = "observations"
value = "round(4000 * s / (scan.scans * (scan.duration + scan.turnaround)))"

[[optimise.limits]]
quantity = "detectors"
at_most = 40
"""
    result = optimise(write(WHITE + text), engine=SERIAL, simulate=False)
    job, knobs = EvaluationJob(result.problem), result.problem.knobs
    grid = [job({"instrument.layout.rings": n, knobs[1].key: knobs[1].value(x)}) for n in (2, 3, 4) for x in GRID]
    lowest = min(item.metrics[SIGMA] for item in grid if item.allowed)
    best = result.found.evaluations[result.found.best]
    assert best.settings["instrument.layout.rings"] == 3 and best.metrics[SIGMA] < lowest * 1.005
    assert len(result.found.evaluations) < 200


def test_the_front_of_noise_and_detectors(write):
    """More rings are less noise and more detectors: all are on the front, and all were evaluated."""
    result = optimise(write(WHITE + FRONT), engine=SERIAL, simulate=False)
    found = result.found
    rings = [found.evaluations[number].settings["instrument.layout.rings"] for number in found.front]
    assert rings == [4, 3, 2, 1]
    detectors = [found.evaluations[number].metrics["detectors"] for number in found.front]
    assert detectors == [60, 36, 18, 6]  # one is dead
    assert result.plot().axes[0].get_ylabel() == "detectors"


def test_the_actual_data_do_not_depend_on_other_data_sets(write):
    """Evaluations leave out noise-only and masked data sets; the forecast is that of the command."""
    path = write(SMALL_SCENE + FRONT)
    own = EvaluationJob(load_problem(path))({"instrument.layout.rings": 2})
    setup = prepare(surveysim.load_scene(path))
    assert own.metrics[SIGMA] == forecast_metrics(setup, surveysim.forecast(path))["actual"][SIGMA].value


@pytest.mark.parametrize(
    ("limit", "allowed"),
    [
        ('quantity = "detectors"\nat_most = 18', True),
        ('quantity = "detectors"\nat_most = 17', False),
        ('quantity = "data_rate"\nat_most = "180 Hz"', True),
        ('quantity = "observing_time"\nat_most = "2 min"', False),  # 4 observations of 4 scans of 8 s: 128 s
        ('quantity = "observing_time"\nat_least = "2 min"', True),
        ('quantity = "field_of_view"\nat_most = "160 arcsec"', True),  # four pitches of 40 arcsec
        ('quantity = "scan.sample_rate * instrument.beam_fwhm / scan.speed"\nat_least = 2.6', False),
        ('quantity = "flat_band_power.sigma"\nat_most = "1 uK2"', False),
        ('quantity = "flat_band_power.sigma"\nat_most = "1 K2"', True),
        ('quantity = "flat_band_power.sigma / uK2 * detectors"\nat_least = 1', True),
    ],
)
def test_limits(write, limit, allowed):
    text = WHITE + FRONT + f"\n[[optimise.limits]]\n{limit}\n"
    item = EvaluationJob(load_problem(write(text)))({"instrument.layout.rings": 2})
    assert item.allowed is allowed and item.margins


@pytest.mark.parametrize(
    ("limit", "expected"),
    [
        (
            'quantity = "data_rate"\nat_most = 4000',
            "limit of 'data_rate': at_most: found 4000.0; a value in Hz is expected",
        ),
        ('quantity = "detectors"\nat_least = "2 s"', "at_least: found 2.0 s; a number without unit is expected"),
    ],
)
def test_a_limit_of_another_unit(write, limit, expected):
    text = WHITE + FRONT + f"\n[[optimise.limits]]\n{limit}\n"
    item = EvaluationJob(load_problem(write(text)))({"instrument.layout.rings": 2})
    assert not item.allowed and expected in item.reason


def test_a_refused_design_has_its_reason(write):
    text = WHITE + FRONT.replace("instrument.layout.rings", "map.healpix_nside").replace("high = 4", "high = 3")
    item = EvaluationJob(load_problem(write(text)))({"map.healpix_nside": 3})
    assert not item.allowed and item.reason.startswith("map.healpix_nside: found 3")


def test_the_page_of_a_camera_whose_beam_follows_from_its_optics(write, tmp_path):
    text = WHITE.replace('beam_fwhm = "60 arcsec"\nf_lambda = "57.142857 arcsec"\n', "")
    optics = '\n[optics]\naperture = "8 m"\n'
    few = {"optimise.evaluations": 10, "optimise.metrics": [SIGMA]}
    optimise(write(text + optics + FRONT), tmp_path, overrides=few, engine=SERIAL, simulate=False, figures=False)
    assert "(f/#)λ is 54.05 arcsec" in (tmp_path / "report.html").read_text()  # 299.79 / 143 mm over 8 m


def test_reasons_that_differ_in_numbers_count_together():
    reasons = ["beyond a limit", "less than 2.5 Hz is expected", "less than 7e-05 Hz is expected", "no scan is kept"]
    found = grouped(reasons)
    assert found == {reasons[1]: 2, "beyond a limit": 1, "no scan is kept": 1} and next(iter(found)) == reasons[1]


def test_a_scene_without_the_section(write):
    with pytest.raises(SceneError, match="optimise: missing"):
        optimise(write(WHITE))
