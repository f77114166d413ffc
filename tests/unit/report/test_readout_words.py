"""Readout noise and lost data on the page of a run, in a check, in summary and tables, and none of it without them."""

import json

import pytest
from astropy.table import Table

from surveysim import run
from surveysim.reduction.setup import prepare
from surveysim.report.html.scene import scene_terms
from surveysim.report.terminal.camera import camera_lines
from surveysim.report.terminal.survey import closing_line
from surveysim.results.stages import left_out, stages_that_run
from surveysim.runtime.engine import SERIAL
from surveysim.scene.readout import ReadoutSections
from surveysim.scene.scene import load_scene, resolved
from tests.pages import read_page
from tests.scenes import SMALL_SCENE, write_scene

EFFECTS = """
[readout_noise.detector]
knee = "0.2 Hz"
slope = 1.5

[readout_noise.array]
knee = "0.1 Hz"
slope = 2
psd = "3 mK2 / Hz"

[[lines]]
frequency = "1.4 Hz"
width = "0.01 Hz"
rms = "0.5 mK"
shared = "group"
group_size = 6

[glitches]
rate = "20 / h"
amplitude = "10 mK"
largest_amplitude = "1000 mK"
slope = 2
decay_time = "50 ms"
threshold = 5

[dropped_samples]
rate = "100 / h"
length = "1 s"
shared = "array"

[dead_time]
detectors = 0.1
"""
WORDS = {
    "Readout noise": "1/f noise of each detector: its PSD equals the white noise at 0.2 Hz and falls as f^(-1.5)."
    " 1/f noise common to all detectors: its PSD equals 3 mK2 / Hz at 0.1 Hz and falls as f^(-2).",
    "Lines": "0.5 mK rms at 1.4 Hz, 0.01 Hz wide, common to a readout group.",
    "Glitches": "20 an hour in each detector, of 10 to 1000 mK, that decay in 0.05 s. Those above 5 standard deviations"
    " of a sample are found and flagged.",
    "Dropped samples": "Gaps of 1 s, 100 an hour, common to all detectors.",
    "Dead time": "10 % of the detectors and 0 % of the scans are lost, others in each observation.",
}


@pytest.mark.parametrize("text", [EFFECTS, ""])
def test_each_effect_is_told_where_it_is_present(tmp_path, text):
    setup = prepare(load_scene(write_scene(tmp_path, SMALL_SCENE + text)))
    terms = dict(scene_terms(json.loads(resolved(setup.scene)), setup.camera.n_det))
    assert {title: words for title, words in terms.items() if title in WORDS} == (WORDS if text else {})
    names = list(ReadoutSections.model_fields) if text else []
    assert [name for name in stages_that_run(setup) if name in ReadoutSections.model_fields] == names
    assert not set(left_out(setup)) & set(ReadoutSections.model_fields)
    assert [line.partition(": ")[0].replace(" ", "_") for line in list(camera_lines(setup))[1:]] == names


@pytest.mark.parametrize("text", [EFFECTS, ""])
def test_a_run_tells_the_lost_samples(tmp_path, text):
    scene = load_scene(write_scene(tmp_path, SMALL_SCENE + text))
    result = run(scene, tmp_path / "out", engine=SERIAL, figures=False)
    content = json.loads((tmp_path / "out" / "summary.json").read_text())
    table = Table.read(tmp_path / "out" / "tables" / "observations.ecsv")
    told = "of the samples lost" in closing_line(content), "samples_lost" in content, "flagged" in table.colnames
    page = read_page(tmp_path / "out" / "report.html").one("main").text
    assert (*told, "of the samples of all detectors are lost" in page) == (bool(text),) * 4
    if text:
        assert (
            content["samples_lost"] == pytest.approx(table["flagged"].mean()) and 0.05 < content["samples_lost"] < 0.3
        )
        assert result.coadds.column("flagged").tolist() == pytest.approx(table["flagged"].tolist())
