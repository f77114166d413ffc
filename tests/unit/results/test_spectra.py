"""Band powers and null tests of a run: summary, tables, sentences, files, page, figure."""

import json
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from mapmaker.spectrum_files import read_band_powers
from surveysim import load_scene
from surveysim.output.spectra import write_spectra
from surveysim.reduction.design_warnings import design_warnings
from surveysim.reduction.setup import prepare
from surveysim.report.figures.split_spectra import split_spectra
from surveysim.report.html.survey import spectra_blocks
from surveysim.results.results import survey_result
from surveysim.results.spectra import band_power_table, spectra_warnings, split_sentences, split_table
from surveysim.results.stages import stages_that_run
from surveysim.results.summary import summary
from surveysim.runtime.strict_json import strict_json
from surveysim.survey.run import run_observations
from tests.scenes import SCHEDULE, SMALL_SCENE, SPECTRA, without_sections, write_scene

KEYS = {"observations": 12, "schedule.nights": 4, "score.noise_only_sets": [], "score.mask_separation_f_lambda": None}


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    text = without_sections(SMALL_SCENE, "fixed_pointing", "sky") + SPECTRA + SCHEDULE
    return prepare(load_scene(write_scene(tmp_path_factory.mktemp("scene"), text), KEYS))


@pytest.fixture(scope="module")
def result(setup):
    return survey_result(setup, run_observations(setup, None), wall_s=1.0, workers=1)


@pytest.fixture(scope="module")
def entry(result):
    return json.loads(strict_json(summary(result)["split_spectra"]))


def test_summary_has_the_reported_band_powers(result, entry):
    item = result.spectra.reported
    assert entry["reported"] == "night" and entry["realizations"] == 16
    assert [row["power_uk2"] for row in entry["bins"]] == pytest.approx(item.powers.power_uk2)
    assert [row["ell_low"] for row in entry["bins"]] == [4000, 6000, 8000, 10000]
    assert [row["input_uk2"] for row in entry["bins"]] == [0] * 4  # there is no sky
    night = entry["splits"]["night"]
    assert (night["observations"], night["nights"], night["shares_weather"]) == ([6, 6], [2, 2], False)
    assert entry["splits"]["array"]["shares_weather"] and entry["splits"]["direction"]["null_bins"] == 4


def test_tables_for_people(entry):
    assert [column.heading for column in band_power_table(entry).shown][0] == "ell"
    assert band_power_table(entry).rows[0][0] == "4000-6000"
    rows = split_table(entry).rows
    assert [row[0] for row in rows] == ["night", "direction", "array"] and rows[1][1] == "2"


def test_sentences_say_what_the_parts_share(entry):
    night, direction, array = split_sentences(entry)
    assert night.startswith("night: 2 parts of 2 and 2 nights, dealt out in turn.") and "share the weather" in night
    for line in (direction, array):
        assert "share the atmosphere" in line and "It is removed." in line


def test_few_observations_are_warned_of(setup, result):
    found = spectra_warnings(result.spectra)
    assert any("the split 'night' is that of" in line and "16 or more" in line for line in found)
    assert set(found) <= set(result.warnings)
    assert "spectra: a part has 6 observations; 8 or more" in "\n".join(design_warnings(setup))
    few = setup.scene.spectra.model_copy(update={"realizations": 5})
    scene = setup.scene.model_copy(update={"spectra": few})
    assert "spectra.realizations: 5 realizations" in "\n".join(design_warnings(replace(setup, scene=scene)))


def test_steep_skies_are_warned_of(result):
    """The transfer function is that of flat spectra."""
    for power, warned in (([500.0, 500, 510, 490], False), ([900.0, 600, 500, 450], True), ([0.0] * 4, False)):
        lines = spectra_warnings(replace(result.spectra, input_uk2=np.array(power)))
        assert any("changes by up to a factor of 1.5 from one bin" in line for line in lines) == warned


def test_a_survey_that_has_begun_says_why_it_has_no_spectra(setup, result):
    begun = run_observations(setup, None, stops=lambda sums: sums.done == 2)
    found = survey_result(setup, begun, wall_s=1.0, workers=1)
    assert found.spectra is None and "split_spectra" not in summary(found)
    assert any(line.startswith("spectra: not measured: ") for line in found.warnings)


def test_files(tmp_path, result):
    written = write_spectra(tmp_path, result.spectra)
    assert all(path.is_file() for path in written)
    powers, covariance = read_band_powers(tmp_path / "spectra.ecsv")
    np.testing.assert_array_equal(powers.power_uk2, result.spectra.reported.powers.power_uk2)
    np.testing.assert_array_equal(covariance.matrix_uk4, result.spectra.reported.monte_carlo.matrix_uk4)
    nulls = Table.read(tmp_path / "tables" / "nulls.ecsv")
    assert nulls.meta["array_pte"] == result.spectra.splits["array"].null.chi_squared.pte


def test_page_and_figure(result, entry):
    powers, tests, parts = spectra_blocks(entry)
    assert len(powers.rows) == 4 and len(tests.rows) == 3 and len(parts.items) == 3
    left, right = split_spectra(result.spectra).axes
    assert {text.get_text() for text in left.get_legend().get_texts()} == {
        "spectrum of the simulated sky",
        "split by night",
    }
    pulls = result.spectra.splits["array"].null
    drawn = next(line for line in right.lines if line.get_label().startswith("array"))
    np.testing.assert_allclose(drawn.get_ydata(), pulls.power_uk2 / pulls.error_uk2)


def test_stages_name_the_splits(setup):
    assert stages_that_run(setup)["spectra"].endswith("night (2 parts), direction (2 parts) and array (2 parts)")
