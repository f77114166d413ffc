"""The command `budget`: files, points by themselves, resumption, and what it refuses."""

import os

import pytest
from astropy.table import Table

from surveysim.runtime.numbers import number, plain
from tests.scenes import SMALL_SCENE, without_sections

FILES = {".surveysim.json", "figures", "report.html", "scene.json", "scene.toml", "summary.json", "tables"}


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "plain.toml"
    path.write_text(without_sections(SMALL_SCENE, "excess", "sky"))
    return path


def refused(call, *arguments):
    code, out, error = call(*arguments)
    assert code == 2 and out == "", out
    return error


def test_budget_by_forecast(call, scene, monkeypatch):
    """Its default directory has the settings in its name; a stage's options are those of `forecast`."""
    monkeypatch.chdir(scene.parent)
    code, text, error = call("budget", scene, "--forecast", "--set", "seed=5", "--verbose")
    out = scene.parent / "outputs" / "plain_budget_forecast+seed=5"
    assert code == 0 and set(os.listdir(out)) == FILES, error
    for words in ("Cost of each stage".lower(), "Least scene, Detector noise alone: ", "Scenes without a stage"):
        assert words in text
    assert "surveysim forecast" in text and f"Results in outputs/{out.name}" in text
    points = Table.read(out / "tables" / "budget_points.ecsv")
    row = points[list(points["label"]).index("without photon.coherence")]
    assert row["options"] == "--set seed=5 --set photon.coherence=none"
    code, text, _ = call("forecast", scene, *row["options"].split())
    assert code == 0 and f" {plain(number(row['value']))} " in text
    assert "holds results of 'surveysim budget --forecast'" in refused(call, "budget", scene, "--out", out)


@pytest.mark.slow
def test_budget_by_simulation(call, scene):
    out = scene.parent / "out"
    arguments = ("budget", scene, "--out", out, "--workers", 1, "--no-figures")
    code, text, error = call(*arguments, "--resume")
    assert code == 0 and set(os.listdir(out)) == FILES - {"figures"}
    assert error.startswith(f"no points in {out}: starting with the first\n")
    assert "plain: 7 stages, 14 points, about " in text and "14 points in " in text
    before = (out / "summary.json").read_bytes()
    code, text, error = call(*arguments, "--resume")
    assert code == 0 and error == f"{out}: the run is finished; there is nothing to resume\n"
    assert (out / "summary.json").read_bytes() == before
    code, text, _ = call("report", out)
    assert (code, text) == (0, f"{out / 'report.html'}\n")


def test_budgets_that_are_refused(call, scene):
    assert "--resume: found with --forecast" in refused(call, "budget", scene, "--forecast", "--resume")
    assert f"{scene}: " in refused(call, "budget", scene, "--set", "score=")
    assert "'exces': unknown key" in refused(call, "budget", scene, "--set", "exces=")
    polynomial = ("cleaning.algorithm=polynomial", "cleaning.order=1", "cleaning.regions=1")
    options = [word for item in polynomial for word in ("--set", item)]
    assert "'polynomial'" in refused(call, "budget", scene, "--forecast", *options)
    alone = ("cleaning.algorithm=none", "photon=", "atmosphere=", "instrument.responsivity_scatter=0")
    error = refused(call, "budget", scene, *(word for item in alone for word in ("--set", item)))
    assert error == f"{scene}: found detector alone; two stages or more are expected\n"
