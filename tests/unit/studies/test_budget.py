"""Budgets of scenes: stages and what they need, costs with known answers, points that are runs, files and pages."""

import json
import shlex
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from surveysim import NotForecastableError, SceneError, budget, forecast, load_scene, run
from surveysim.cli.options import settings
from surveysim.report.figures.budget import _steps
from surveysim.report.html.page import write_report
from surveysim.runtime.engine import SERIAL
from surveysim.studies.budget.costs import Measured
from surveysim.studies.budget.lines import interaction_line, measure_line, reason_lines, small_line, total_lines
from surveysim.studies.budget.points import load_budget
from surveysim.studies.budget.stages import stages_of
from surveysim.studies.budget.summary import budget_summary
from surveysim.timestreams import component
from tests.scenes import SMALL_SCENE, without_sections

# Three white noises of one beam: costs follow from their PSDs, 2.5 of photons and 7.5 of detectors.
WHITE = (
    without_sections(SMALL_SCENE, "atmosphere", "excess", "sky")
    .replace('algorithm = "average"', 'algorithm = "none"')
    .replace("responsivity_scatter = 0.05", "responsivity_scatter = 0.0")
    .replace('coherence = "field"', 'coherence = "none"')
    .replace('[detector]\npsd = "2.5 mK2 / Hz"', '[detector]\npsd = "7.5 mK2 / Hz"')
)
STAGES = [
    *("cleaning", "atmosphere", "cleaning.responsivities", "excess", "excess.coherence", "sky"),
    *("photon", "photon.coherence", "detector", "instrument.responsivity_scatter"),
]


@pytest.fixture(scope="module")
def small(write):
    return write(SMALL_SCENE)


@pytest.fixture(scope="module")
def simulated(small, tmp_path_factory):
    """A finished budget of the small scene, and where its files are."""
    out = tmp_path_factory.mktemp("budget")
    return budget(small, out, engine=SERIAL), out


def options(text):
    """Settings by key of options as a budget prints them."""
    words = shlex.split(text)
    assert words[::2] == ["--set"] * (len(words) // 2)
    return settings(words[1::2])


# ---------------------------------------------------------------- stages


def test_stages_follow_from_the_scene(small, monkeypatch):
    found = stages_of(load_scene(small))
    assert list(found.stages) == STAGES and found.floor == "detector"
    assert found.dependent("atmosphere") == {"cleaning.responsivities"}
    assert found.dependent("cleaning") == set(STAGES) - {"cleaning", "detector"}
    assert found.required("photon.coherence") == {"photon", "cleaning"} and not found.required("detector")
    assert found.removal(["excess", "excess.coherence"]) == {"excess": None}
    assert found.removal(["photon"]) == {"photon.psd": "0 mK2 / Hz", "photon.coherence": "none"}
    assert found.removal(["cleaning", "cleaning.responsivities"])["cleaning.responsivities"] == "scan"
    known = stages_of(load_scene(small, {"cleaning.responsivities": "known", "detector": None, "sky": None}))
    assert list(known.stages) == [n for n in STAGES if n not in ("cleaning.responsivities", "detector", "sky")]
    assert known.floor == "photon"
    hum = replace(component.COMPONENTS[-1], name="sky", title="Hum", switch="cmb_band_power")
    monkeypatch.setattr("surveysim.studies.budget.stages.present_components", lambda scene: (hum,))
    assert stages_of(load_scene(small)).stages["sky"].removal == {"sky.cmb_band_power": "none"}


def test_points_without_noise_or_refused_by_the_schema_do_not_exist(write, small):
    path = write(without_sections(WHITE, "photon") + '\n[sky]\ncmb_band_power = "1000 uK2"\n')
    found = load_budget(path)
    row = found.rows[list(found.stages.stages).index("detector")]
    assert row.removed.absent is None and row.reason == "sky alone has no noise"
    summary = budget_summary(budget(path, simulate=False))
    assert "Detector noise: sky alone has no noise." in list(reason_lines(summary))
    assert not any(line.startswith("Not in the sums: Detector") for line in total_lines(summary))
    with pytest.raises(SceneError, match="white.toml: found detector alone; two stages or more are expected"):
        load_budget(write(without_sections(WHITE, "photon")))
    with pytest.raises(SceneError, match="score: missing"):
        load_budget(small, {"score": None})
    with pytest.raises(SceneError, match="sweep: found a sweep; a scene of one band, without"):
        load_budget(write(SMALL_SCENE + '\n[sweep]\n"scan.scans" = [3, 4]\n'))
    with pytest.raises(SceneError, match="bands: found a camera of several bands"):
        load_budget("three_bands")
    with pytest.raises(SceneError, match="a scene that is not as its file has it"):
        load_budget(load_scene(small).model_copy(update={"seed": 3}))


# ---------------------------------------------------------------- costs


@pytest.mark.parametrize("simulate", [True, False])
def test_white_noises_add_up_in_survey_time(write, simulate):
    """Of PSDs 2.5 and 7.5 the photons cost a quarter of the survey time, wherever they are removed or added."""
    result = budget(write(WHITE), simulate=simulate, engine=SERIAL)
    photon, detector = result.costs
    assert photon.removed_time.value == pytest.approx(0.25, rel=1e-4)
    assert photon.added_time.value == pytest.approx(0.25, rel=1e-4)
    assert photon.removed_ratio.value == pytest.approx(10 / 7.5, rel=1e-4)
    assert detector.removed_time.value == pytest.approx(0.75, rel=1e-4) and not detector.added_time.is_known
    assert not photon.interaction.is_known  # the whole scene and the least one differ by the photons alone
    total = result.total
    assert total.least.value == pytest.approx(0.75, rel=1e-4) and not total.missing
    assert total.added.value == pytest.approx(1, rel=1e-4) == total.removed.value
    errors = [photon.removed_time.error, photon.added_ratio.error, total.together.error]
    assert max(errors) < 1e-4


@pytest.mark.parametrize("simulate", [True, False])
def test_a_metric_with_another_exponent(write, simulate):
    """The depth of a source goes as the root of the noise power: ratios are roots, and times are the same."""
    metrics = '\n[[score.metrics]]\nkind = "point_source"\n\n[[score.metrics]]\nkind = "largest_scale"\n'
    ready = load_budget(write(WHITE + metrics), metric="point_source.depth_mk")
    result = budget(ready, simulate=simulate, engine=SERIAL)
    photon = result.costs[0]
    assert result.exponent == pytest.approx(0.5, rel=1e-3)
    assert photon.removed_ratio.value == pytest.approx((10 / 7.5) ** 0.5, rel=1e-3)
    assert photon.removed_time.value == pytest.approx(0.25, rel=3e-3)
    summary = budget_summary(result)
    assert "point_source.depth_mk goes as the noise power of the map to the power 0.5;" in measure_line(summary)
    with pytest.raises(SceneError, match="white.toml: metric: found 'nothing.else'; one of flat_band_power.sigma, "):
        load_budget(ready.sweep.path, metric="nothing.else")
    flat = replace(result, exponent=0.0)
    assert not flat.costs[0].removed_time.is_known and flat.costs[0].removed_ratio.is_known
    assert "does not depend on the noise" in measure_line(budget_summary(flat))


def test_sections_of_the_response_are_stages(small):
    """They come after what detectors see, and are cleaned like all others."""
    found = stages_of(load_scene(small, {"crosstalk.neighbour_fraction": 0.01, "time_constants.value": "20 ms"}))
    assert found.stages["crosstalk"].removal == {"crosstalk": None}
    assert found.stages["time_constants"].title == "Time constants"
    # Without the filter, but with the draws of photon and detector noise apart.
    removal = found.removal(["time_constants"])
    assert removal == {
        "time_constants.value": "0 s",
        "time_constants.scatter": 0.0,
        "time_constants.deconvolution_error": None,
    }
    assert load_scene(small, removal).time_constants.value_s == 0
    assert found.required("crosstalk") == {"cleaning"}


def test_errors_of_times_are_those_of_their_modes():
    """Times of value^(1/p): by draws of the deviates that the points share."""
    rng = np.random.default_rng(1)
    values, modes = np.array([4.0, 3.0, 2.5, 1.0]), 1e-3 * rng.standard_normal((4, 5))
    found = Measured(values, modes, 0.5, True)
    time = found.time((1, 2, 3), (1, -1, 2))
    assert time.value == pytest.approx((9 - 6.25 + 2) / 16)
    drawn = values * np.exp(rng.standard_normal((40_000, 5)) @ modes.T)
    shares = (drawn / drawn[:, :1]) ** 2
    assert time.error == pytest.approx(np.std(shares[:, 1] - shares[:, 2] + 2 * shares[:, 3]), rel=0.02)
    ratio = found.ratio(0, 1)
    assert (ratio.value, ratio.error) == (4 / 3, pytest.approx(np.std(drawn[:, 0] / drawn[:, 1]), rel=0.02))
    assert found.time((1,), (1,)).error > 0 == found.time((0,), (1,)).error


def test_points_are_plain_runs(simulated, small):
    """The printed options of a row give its sigma(A) with the command `run`, bit for bit."""
    points = budget_summary(simulated[0])["budget"]["points"]
    for label in ("all stages", "without atmosphere, cleaning.responsivities", "without excess, excess.coherence"):
        point = next(item for item in points if item["label"] == label)
        alone = run(load_scene(small, options(point["options"])), engine=SERIAL)
        assert alone.scores["actual"].band.sigma_ukcmb2 == point["value"]
    least = next(item for item in points if item["label"] == "cleaning, photon, photon.coherence, detector alone")
    scene = load_scene(small, options(least["options"]))
    assert (scene.excess, scene.atmosphere.turbulence, scene.sky) == (None, "none", None)
    assert run(scene, engine=SERIAL).scores["actual"].band.sigma_ukcmb2 == least["value"]


def test_forecast_points_are_plain_forecasts(small):
    given = {"seed": 12, "sky": None, "excess": None}
    scene = load_scene(small, given)
    result, found = budget(scene, simulate=False), stages_of(scene)
    points = budget_summary(result)["budget"]["points"]
    point = next(item for item in points if item["label"] == "without photon, photon.coherence")
    assert options(point["options"]) == given | found.removal(["photon"])
    alone = forecast(load_scene(small, options(point["options"])))
    assert alone.scores["actual"].band.sigma_ukcmb2 == point["value"]
    with pytest.raises(NotForecastableError, match="cleaning by polynomial is no projection|'polynomial'"):
        polynomial = {"cleaning.algorithm": "polynomial", "cleaning.order": 1, "cleaning.regions": 1}
        budget(load_scene(small, given | polynomial), simulate=False)


def test_costs_of_the_small_scene(simulated):
    """Sums, small stages, and stages whose cost is known."""
    result, _ = simulated
    costs = {item.row.name: item for item in result.costs}
    assert costs["cleaning"].removed_time == costs["cleaning"].added_time and not costs["cleaning"].small
    assert not costs["cleaning"].interaction.is_known
    photon = costs["photon"].added_ratio  # of the same deviates, and of equal PSDs
    assert photon.value == pytest.approx(2, rel=1e-5) and photon.error < 1e-5
    assert costs["excess"].added_time.value > costs["atmosphere"].added_time.value > 0
    for item in costs.values():
        time = item.removed_time
        assert item.small == (item.row.name != "cleaning" and abs(time.value) <= time.error)
    summary = budget_summary(result)
    named = [item.row.title for item in costs.values() if item.small]
    assert all(title in small_line(summary) for title in named)
    total = result.total
    parts = [item.added_time.value for item in costs.values() if item.added_time.is_known]
    assert total.added.value == pytest.approx(total.least.value + sum(parts))
    assert total.together.value == pytest.approx(1 - total.added.value)


def test_pairs(small):
    """A pair's interaction is a difference of four points, and no stage has one with another that it needs."""
    result = budget(load_budget(small, {"sky": None, "cleaning.responsivities": "known"}, pairs=True), simulate=False)
    names = [item.names for item in result.pairs]
    assert ("atmosphere", "photon") in names and not any("cleaning" in item for item in names)
    assert ("photon", "photon.coherence") not in names
    sizes = [abs(item.interaction.value) for item in result.pairs]
    assert sizes == sorted(sizes, reverse=True)
    row = next(item for item in result.budget.pairs if item.names == ("photon", "detector"))
    both, one, other, none = result.measured.values[list(row.points)] / result.measured.values[0]
    found = result.pairs[names.index(row.names)].interaction.value
    assert found == pytest.approx(both - one - other + none)
    assert interaction_line(budget_summary(result)).startswith("Largest interactions: ")


# ---------------------------------------------------------------- files, figure, page


def test_files(simulated):
    result, out = simulated
    summary = json.loads((out / "summary.json").read_text())
    files = ["figures/budget.png", "report.html", "scene.json", "tables/budget.ecsv", "tables/budget_points.ecsv"]
    assert summary["files"] == files and not (out / "points").exists()
    table = Table.read(out / "tables" / "budget.ecsv")
    assert list(table["stage"]) == STAGES == list(result.table()["stage"])
    photon = next(item for item in result.costs if item.row.name == "photon")
    row = table[STAGES.index("photon")]
    assert row["removed_time"] == photon.removed_time.value and row["added_ratio_error"] == photon.added_ratio.error
    assert np.isnan(table["added_time"][STAGES.index("detector")])
    points = Table.read(out / "tables" / "budget_points.ecsv")
    with_it, without = points[[row["removed_with"], row["removed_without"]]]["value"]
    assert with_it / without == pytest.approx(row["removed_ratio"])
    assert repr(result).startswith("BudgetResult of white: 20 runs\nstage ") and "<table>" in result._repr_html_()


def test_page_is_made_of_the_files_alone(simulated):
    _, out = simulated
    first = (out / "report.html").read_bytes()
    assert write_report(out).read_bytes() == first
    text = first.decode()
    for part in (
        "Cost of each stage",
        "Options that remove each stage",
        "--set excess=",
        "data:image/png",
        "Options of each point",
        "0 mK2 / Hz",
    ):
        assert part in text


def test_waterfall_ends_at_the_whole_scene(simulated):
    """Bars between the grey ones lead from the least scene to the whole."""
    steps = _steps(simulated[0])
    assert steps[0][0] == "Detector noise alone" and steps[-1][0] == "whole scene"
    assert sum(found.value for _, found, _ in steps[:-1]) == pytest.approx(1)
    assert len(simulated[0].plot().axes) == 2


@pytest.mark.slow
def test_errors_are_the_scatter_of_seeds(write):
    """Costs of shared photon noise in 20 surveys: chi^2 per degree of freedom, 19 of them, is 0.47 to 1.73 in 95 %."""
    text = WHITE.replace('coherence = "none"', 'coherence = "field"').replace("jackknives = 4", "jackknives = 32")
    path = write(
        text.replace("coherent_fraction = 0.1", "coherent_fraction = 0.9").replace(
            "observations = 4", "observations = 8", 1
        )
    )
    costs = []
    for seed in range(20):
        result = budget(load_budget(path, {"seed": seed}), engine=SERIAL)
        row = next(item for item in result.costs if item.row.name == "photon.coherence")
        costs.append((row.added_time.value, row.added_time.error))
    value, error = np.array(costs).T
    weight = error**-2
    chi2 = weight @ (value - weight @ value / weight.sum()) ** 2 / (len(value) - 1)
    assert 0.47 < chi2 < 1.73, (chi2, value.mean(), value.std(), error.mean())
