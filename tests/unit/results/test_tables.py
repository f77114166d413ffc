"""Tables of results: one content for files, people and notebooks."""

import matplotlib
import numpy as np
import pytest
from astropy.table import QTable

from surveysim import load_scene, run
from surveysim.forecasting.forecast import forecast
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.numbers import plain, quoted
from surveysim.runtime.table import Table, column, file_column, quoted_columns
from tests.scenes import SMALL_SCENE, WHITE_NOISE_SCENE


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("tables") / "small.toml"
    path.write_text(SMALL_SCENE)
    return load_scene(path)


@pytest.fixture(scope="module")
def result(scene):
    return run(scene, engine=SERIAL)


@pytest.fixture
def table():
    columns = (
        column("name", ["a", "<b>"], "data set"),
        *quoted_columns(("sigma", "error"), [221.1, None], [5.2, None], "sigma(A)", unit="uK2", absent="not scored"),
        file_column("plain", [220.0, 1.0], "uK2"),
        column("ratio", [-0.5, None], "ratio", str, in_files=False),
    )
    return Table("score", "Scores", columns)


def test_files_have_numbers_and_units(table):
    assert list(table.in_files) == ["name", "sigma", "error", "plain"] and table.units["error"] == "uK2"
    np.testing.assert_array_equal(table.in_files["sigma"], [221.1, np.nan])
    made = table.quantities()
    assert isinstance(made, QTable) and (made["sigma"] + made["plain"])[0].to_value("uK2") == 441.1


def test_people_see_rounded_numbers(table):
    assert table.rows == [("a", "221.1 ± 5.2", "-0.5"), ("<b>", "not scored", "")]
    assert table.text().splitlines() == [
        "data set      sigma(A)  ratio",
        "a         221.1 +- 5.2   -0.5",
        "<b>         not scored",
    ]
    assert table.text(1).endswith("and 1 more")
    assert "<td>&lt;b&gt;</td>" in table.html() and "<b>" not in table.html()


@pytest.mark.parametrize("error", [None, np.nan, np.inf])
def test_unknown_errors_are_said_to_be_unknown(error):
    assert plain(quoted(221.1, error)) == "221 +- unknown"


@pytest.mark.parametrize(
    "value, error, text",
    [
        (95.2, 104.0, "95.2 +- 104.0"),
        (0.34, 0.37, "0.340 +- 0.370"),
        (281.2, 0.52, "281.20 +- 0.52"),
        (0, 3, "0.0 +- 3.0"),
    ],
)
def test_values_that_are_divided_keep_three_digits(value, error, text):
    """Even where the error is larger, so that readers can follow a ratio."""
    assert plain(quoted(value, error, 3)) == text


def test_a_forecast_has_the_scaled_masked_array(scene):
    """As a run has it, by its share of the detectors; all other rows stay."""
    found = forecast(prepare(scene))
    table = found.table()
    sigma = dict(zip(table["name"], table["sigma_ukcmb2"].value, strict=True))
    (masked,) = (name for name in found.scores if name.startswith("masked"))
    share = found.scores[masked].n_det / found.scores["actual"].n_det
    assert 0 < share < 1 and sigma[f"{masked}_scaled"] == pytest.approx(share * sigma[masked])
    assert list(sigma) == [*found.scores, f"{masked}_scaled"]


def test_a_run_in_a_notebook(result):
    """A few lines, not all arrays; a table with the numbers of the scores."""
    lines = repr(result).splitlines()
    assert lines[0] == "SurveyResult of small: 4 of 4 observations, 18 detectors"
    assert [line.split()[0] for line in lines[2:]] == list(result.table()["name"]) and max(map(len, lines)) < 120
    assert result.table()["sigma_ukcmb2"][0].to_value("uK2") == result.scores["actual"].band.sigma_ukcmb2
    assert result._repr_html_().count("<tr>") == 1 + len(result.table())


def test_a_run_without_a_score_in_a_notebook(tmp_path):
    (tmp_path / "white.toml").write_text(WHITE_NOISE_SCENE)
    found = run(load_scene(tmp_path / "white.toml"), engine=SERIAL)
    assert repr(found).endswith("not scored: no section [score]") and len(found.table()) == 0


def test_a_forecast_in_a_notebook(scene):
    found = forecast(prepare(scene))
    assert len(repr(found)) < 600 and "actual" in found._repr_html_()
    assert found.table()["sigma_ukcmb2"][0].to_value("uK2") == found.scores["actual"].band.sigma_ukcmb2


def test_figures_of_a_run(result):
    figure = result.plot()
    assert isinstance(figure, matplotlib.figure.Figure) and figure.axes
    with pytest.raises(ValueError, match="found 'skies'; one of track, timestream_psd, map, map_psd"):
        result.plot("skies")
