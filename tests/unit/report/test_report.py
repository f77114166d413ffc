"""Reports of small runs: every figure and number is in them, nothing from outside, and bad directories are refused."""

import json
import os
import re
import shutil
from base64 import b64decode

import matplotlib
import numpy as np
import pytest
from PIL import Image

from mapmaker.report.page import units
from surveysim import forecast_sweep, load_scene, run, run_sweep
from surveysim.report.figures.survey import TITLES
from surveysim.report.html.captions import RUN
from surveysim.report.html.page import NoResultsError, write_report
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.numbers import as_known, count, duration, number, short, with_error
from tests.pages import read_page, rows_of, value_of
from tests.scenes import SCHEDULE, SMALL_SCENE, TURBULENT_SCENE, WHITE_NOISE_SCENE, without_sections

REFERENCE = """
[score.reference]
source = "A paper"
values = { actual = "6000 uK2", white = "900 uK2" }

[score.reference.gains]
"actual / uncorrelated" = 1.6
"""
WITHOUT = {"sky", "spectra"}  # figures of sections that the scene does not have
STRANGE = """<b>Tom</b> & "Jerry's" {{ 7 * 7 }} <script>alert(1)</script>"""
SPEEDS = '\n[sweep]\n"scan.speed" = ["3 arcmin / s", "4 arcmin / s"]\n"cleaning.algorithm" = ["average", "planar"]\n'


@pytest.fixture(scope="module")
def scene_text():
    title = STRANGE.replace("\\", "\\\\").replace('"', '\\"')
    text = SMALL_SCENE.replace("A small camera over a small field", title).replace(
        "seed = 11", "seed = 11 # assumed: any"
    )
    return without_sections(text, "sky") + REFERENCE


@pytest.fixture(scope="module")
def finished(tmp_path_factory, scene_text):
    """The folder of a small run with figures, beside one of the user's own."""
    folder = tmp_path_factory.mktemp("report")
    (folder / "small.toml").write_text(scene_text)
    out = folder / "out"
    (out / "figures").mkdir(parents=True)
    (out / "figures" / "mine.png").write_bytes(b"mine")
    style = dict(matplotlib.rcParams)
    run(load_scene(folder / "small.toml"), out, engine=SERIAL)
    assert dict(matplotlib.rcParams) == style
    return out


@pytest.fixture(scope="module")
def page(finished):
    return read_page(finished / "report.html")


@pytest.fixture(scope="module")
def summary(finished):
    return json.loads((finished / "summary.json").read_text())


@pytest.fixture
def copy(finished, tmp_path):
    """The run's files elsewhere, to be changed."""
    return shutil.copytree(finished, tmp_path / "copy")


def printed(text):
    """A text as the page has it, without the mark-up of its exponents."""
    return re.sub(r"\^\(([^)]*)\)", r"\1", text)


# ---------------------------------------------------------------- a run


def test_every_figure_is_there_once_with_a_caption(finished, page, summary):
    drawn = {name: (finished / name).read_bytes() for name in summary["files"] if name.endswith(".png")}
    assert {name.removeprefix("figures/").removesuffix(".png") for name in drawn} == {*RUN} - WITHOUT
    assert {*RUN} == {*TITLES, "run_time"}
    shown = [b64decode(image.attributes["src"].partition("base64,")[2]) for image in page.all("img")]
    assert sorted(shown) == sorted(drawn.values())
    for figure in page.all("figure"):
        image = figure.one("img").attributes
        assert len(image["alt"]) > 30 and int(image["width"]) > 500 < int(image["height"]) + 200
        caption = figure.one("figcaption").text
        assert "Across" in caption and "Look for" in caption and "{" not in caption


def test_figures_are_whole_pictures(finished, summary):
    names = {name.removeprefix("figures/") for name in summary["files"] if name.startswith("figures/")}
    assert names | {"mine.png"} == {path.name for path in (finished / "figures").iterdir()}  # and nothing unfinished
    for name in names:
        with Image.open(finished / "figures" / name) as image:
            assert image.format == "PNG"
            assert image.info["dpi"] == pytest.approx((150, 150), abs=0.1)
            assert np.ptp(np.asarray(image.convert("L")).astype(int)) > 200


def test_the_score_table_has_the_numbers_of_the_summary(page, summary):
    rows = {row[0].text: row for row in rows_of(page, "score-table")}
    assert list(rows) == list(summary["scores"])
    for name, entry in summary["scores"].items():
        _, detectors, sigma, ell_eff, fwhm, forecast, published, ratio = rows[name]
        assert value_of(sigma) == entry["sigma_ukcmb2"] and value_of(forecast) == entry["forecast_ukcmb2"]
        assert sigma.text == printed(with_error(entry["sigma_ukcmb2"], entry["error_ukcmb2"]))
        assert [value_of(cell) for cell in (detectors, ell_eff, fwhm)] == [
            entry["n_det"],
            entry["ell_eff"],
            entry["fwhm_ell"],
        ]
        if "reference_ukcmb2" in entry:
            assert value_of(published) == entry["reference_ukcmb2"] and value_of(ratio) == entry["ratio_to_reference"]
        else:
            assert published.text == ratio.text == ""
    assert sum(row[6].text != "" for row in rows.values()) == 2
    gains = {row[0].text: value_of(row[1]) for row in rows_of(page, "gain-table")}
    assert gains == {name: entry["ratio"] for name, entry in summary["gains"].items()}


def test_the_result_is_said_first(page, summary):
    lead, row = page.one("header").one("p", class_="lead").text, summary["scores"]["actual"]
    assert f"σ(A) = {printed(with_error(row['sigma_ukcmb2'], row['error_ukcmb2']))} µK²CMB" in lead
    assert "A paper has 6000 µK²CMB" in lead and "18 detectors at 143 GHz" in lead


def test_what_was_simulated_and_what_was_not(page, summary):
    terms = {item.one("dt").text: item.one("dd").text for block in page.all("dl") for item in block.all("div")}
    assert terms["sky"] == "no section [sky]: noise alone" and "Sky" not in terms
    assert {name: terms[name] for name in summary["left_out"]} == summary["left_out"]
    assert terms["Observations"].startswith("4 observations of 4 scans of 6 s at 4 arcmin/s, turnarounds of 2 s.")
    assert "right ascension 08h 49m 12s, declination +44° 50′ 24″" in terms["Field"]
    assert "One frozen layer 1000 m above" in terms["Atmosphere"] and "(9.02 m/s at 1000 m)" in terms["Atmosphere"]
    assert "masked to 1.3 (f/#)λ" in terms["Score"] and terms["Cleaning"].startswith("Average subtraction.")


def test_sources_and_provenance(page, summary):
    ((value, source),) = rows_of(page, "source-table")
    assert value.text.startswith("seed = 11") and source.text == "assumed: any"
    text = page.text
    for key in ("scene_sha256", "surveysim", "python"):
        assert summary[key] in text
    assert summary["run"]["date"].replace("T", " ").replace("+00:00", " UTC") in text
    assert "Engineserial" in text.replace(" ", "") and f"numpy {summary['packages']['numpy']}" in text
    assert "tables/scores.ecsv" in text and "mine.png" not in text
    stages = {row[0].text: value_of(row[1]) for row in rows_of(page, "stage-table")}
    assert stages.pop("in all") == pytest.approx(sum(stages.values()))
    assert stages == summary["run"]["stage_s"]


def test_error_against_run_time(page, summary):
    rows = [[cell.text for cell in row] for row in rows_of(page, "answer-table")]
    (own,) = [row for row in rows if row[0].endswith("this run")]
    assert page.one("section", id="answer-table").one("thead").all("th")[1].text == "simulation time"
    run = summary["run"]
    assert own[1] == duration(sum(run["stage_s"].values()) / run["workers"])
    assert re.search(f"wall time of the run ?{re.escape(duration(run['wall_s']))}", page.text)
    assert own[2:] == ["4", "4", "2"] and len(rows) == 1 + len(summary["time_to_precision"])
    budget = {row[0].text: row for row in rows_of(page, "budget-table")}
    assert set(budget) == set(summary["error_budget"])
    assert value_of(budget["actual"][1]) == pytest.approx(100 * summary["error_budget"]["actual"]["noise"])


def test_truth_stands_beside_what_was_measured(page, summary):
    shown = [row for anchor in ("closure-table", "weather-table") for row in rows_of(page, anchor)]
    by_name = {row[0].text: row for row in shown}
    assert len(by_name) == len(summary["closure"]) >= 7
    for item in summary["closure"]:
        row = by_name[item["quantity"]]
        assert (value_of(row[2]), value_of(row[3])) == (item["expected"], item["found"])


def test_texts_are_escaped(page):
    assert page.one("h1").text == STRANGE and STRANGE in page.one("title").text


def test_the_table_of_contents_names_all_parts(page):
    links = [link.attributes["href"] for link in page.one("nav").all("a")]
    headings = [section.one("h2").attributes["id"] for section in page.one("main").all("section") if section.all("h2")]
    assert [link[1:] for link in links if link[1:] in headings] == headings
    figures = [figure.attributes["id"] for figure in page.all("figure") if "run_time" not in figure.attributes["id"]]
    assert [link[1:] for link in links if link.startswith("#figure-")] == figures


def test_a_rebuilt_page_is_the_same(call, copy):
    before = (copy / "report.html").read_bytes()
    assert call("report", copy) == (0, f"{copy / 'report.html'}\n", "")
    (copy / "report.html").write_text("damaged")
    assert call("report", copy)[0] == 2  # the user may have changed it
    assert call("report", copy, "--force") == (0, f"{copy / 'report.html'}\n", "")
    assert (copy / "report.html").read_bytes() == before and not list(copy.glob("*.part"))


def test_figures_that_are_gone_are_left_out(copy):
    (copy / "figures" / "map.png").unlink()
    page = read_page(write_report(copy))
    assert len(page.all("img")) == len({*RUN} - WITHOUT) - 1 and not page.all("figure", id="figure-map")


# ---------------------------------------------------------------- runs with less


def page_of(tmp_path, text, settings=None, **options):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    run(load_scene(path, settings), tmp_path / "out", engine=SERIAL, figures=False, **options)
    return read_page(tmp_path / "out" / "report.html")


def test_white_noise_has_a_short_page(tmp_path):
    page = page_of(tmp_path, WHITE_NOISE_SCENE)
    assert page.all("img") == [] and page.all("section", id="score-table") == []
    assert "There is no score: the scene has no section [score]." in page.one("header").text
    assert "no section [atmosphere]: no layer, no weather" in page.text and "Detector noise" in page.text


@pytest.mark.parametrize("settings", [{"observations": 1}, {"cleaning.max_iterations": 1}])
def test_a_run_without_a_score_says_why(tmp_path, settings):
    page = page_of(tmp_path, SMALL_SCENE, settings)
    unscored = json.loads((tmp_path / "out" / "summary.json").read_text())["unscored"]
    assert f"There is no score: {unscored}." in page.one("header").text and page.all("img") == []


def test_a_run_that_stopped_early_says_so(tmp_path):
    page = page_of(tmp_path, SMALL_SCENE, {"observations": 40}, time_budget_s=1e-3)
    assert "2 of the survey's observations were simulated" in page.one("header").text
    assert "The run ended when the time budget of 1.0 ms was spent." in page.text


def test_cleanings_beside_each_other(tmp_path):
    page = page_of(tmp_path, SMALL_SCENE, {"cleaning.compare": ["planar"]})
    assert [row[0].text for row in rows_of(page, "cleaning-table")] == ["average", "planar"]
    assert "optimal: the best cleaning of each observation" in page.text
    assert "planar: planar subtraction in place of the scene's own" in page.text
    assert "The optimal set takes for each observation the pipeline" in page.text


def test_a_page_names_the_assumption_on_shared_photon_noise(tmp_path):
    text = without_sections(SMALL_SCENE, "score")
    field = page_of(tmp_path, text, {"observations": 1})
    assert (
        "10 % of it common to neighbours as far as the fields of overlapping beams are coherent (hypothesis of Sayers"
        in field.text
    )
    keys = {"observations": 1, "photon.coherence": "hbt", "photon.bose_fraction": 0.69}
    shutil.rmtree(tmp_path / "out")
    bunching = page_of(tmp_path, text, keys)
    assert "69 % of it from bunching, 10 % of the load through the beam; neighbours share" in bunching.text


def test_a_scene_of_a_site_in_words(tmp_path):
    text = without_sections(SMALL_SCENE, "score", "photon", "detector", "fixed_pointing", "excess") + SCHEDULE
    text += '\n[photon]\ncoherence = "hbt"\n[photon.load]\noptics = "10 K"\n'
    text += '\n[detector]\nnep = "3e-17 W / Hz(1/2)"\n'
    page = page_of(
        tmp_path,
        text.replace('illuminated_aperture = "8 m"', 'illuminated_aperture = "8 m"\nsite = "alma"'),
        {
            "instrument.bandwidth": 0.15,
            "instrument.efficiency": 0.3,
            "instrument.polarizations": 2,
            "instrument.horn_f_lambda": 0.6,
            "observations": 2,
            "atmosphere.outer_scale": "2000 m",
            "cleaning.algorithm": ["average", "pca"],
            "cleaning.sigma_cut": 3,
        },
    )
    for words in (
        "Water and water fluctuations are those of Chajnantor (ALMA).",
        "From the load of the site's water and warm optics of 10 K.",
        "Neighbours share its bunching part as far as light from common sources is coherent",
        "a noise-equivalent power of 3.0 × 10−17 W/Hz1/2",
        "Observed from latitude 19.8°, longitude −155.5°, 4070 m high, in 1 night from 2003-10-28",
        "Horns are 0.6 (f/#)λ wide. The efficiency from window to detector is 30 %. Detectors absorb 2 polarizations.",
        "Its outer scale is 2000 m.",
        "Average subtraction, then adaptive PCA.",
        "A CMB of flat band power, 1000 µK²CMB, on the plane. 1 point source of 5 mK",
    ):
        assert words in page.text


# ---------------------------------------------------------------- sweeps


@pytest.fixture(scope="module")
def sweep_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep") / "small.toml"
    path.write_text(without_sections(TURBULENT_SCENE, "sky") + SPEEDS)
    return path


def test_page_of_a_sweep(sweep_file, tmp_path):
    result = run_sweep(sweep_file, tmp_path, engine=SERIAL)
    page, summary = read_page(tmp_path / "report.html"), json.loads((tmp_path / "summary.json").read_text())
    rows = rows_of(page, "point-table")
    assert [(row[0].text, row[1].text) for row in rows] == [
        (speed, cleaning) for speed in ("3 arcmin/s", "4 arcmin/s") for cleaning in ("average", "planar")
    ]
    for row, point in zip(rows, summary["points"], strict=True):
        detectors, sigma, forecast, discarded, ratio, best = row[2:]
        assert value_of(sigma) == point["scores"]["actual"]["sigma_ukcmb2"] and value_of(detectors) == 18
        assert value_of(forecast) == point["forecast_ukcmb2"]["actual"] and value_of(best) == point["best_probability"]
        assert value_of(discarded) == point["discarded"]["actual"]
        assert value_of(ratio) == point["ratio"]
    pairs = rows_of(page, "pair-table")
    for i, row in enumerate(pairs):
        for j, item in enumerate(row[1:]):
            ratio = summary["points"][i]["ratio"] / summary["points"][j]["ratio"]
            assert value_of(item) == pytest.approx(ratio, rel=1e-12) and ("±" in item.text) == (i != j)
    marked = [row.one("th").text for row in page.one("section", id="point-table").all("tr", class_="best")]
    assert marked == [rows[number][0].text for number in result.comparison.best]
    (image,) = page.all("img")
    assert b64decode(image.attributes["src"].partition("base64,")[2]) == (tmp_path / "figures/sweep.png").read_bytes()
    assert f"the best is {result.sweep.points[result.comparison.best[0]].label}".replace(" / s", "/s") in page.text
    assert all(point["scene_sha256"] in page.text for point in summary["points"])


def test_page_of_a_sweep_by_forecast(sweep_file, tmp_path):
    forecast_sweep(sweep_file, tmp_path, figures=False)
    page = read_page(tmp_path / "report.html")
    assert "the best by forecast is scan.speed = " in page.text and page.all("img") == []
    assert [len(row) for row in rows_of(page, "point-table")] == [5] * 4
    assert not page.all("section", id="agreement-table")


def test_points_without_a_score_say_why(sweep_file, tmp_path):
    path = tmp_path / "one.toml"
    path.write_text(sweep_file.read_text().partition("[sweep]")[0] + "[sweep]\nobservations = [1, 4]\n")
    run_sweep(path, tmp_path / "out", engine=SERIAL, figures=False)
    page = read_page(tmp_path / "out" / "report.html")
    assert (
        rows_of(page, "point-table")[0][2].text == "not scored"
        and "observations = 1: observations with data: found 1" in page.text
    )


# ---------------------------------------------------------------- directories without results


@pytest.mark.parametrize(
    "prepare, words",
    [
        (lambda path: None, "no such directory"),
        (lambda path: path.write_text("mine"), "not a directory"),
        (lambda path: path.mkdir(), "found no results"),
        (lambda path: (path.mkdir(), (path / "summary.json").write_text('{"scores": ')), "summary.json: can't be read"),
        (lambda path: (path.mkdir(), (path / "summary.json").write_text("[1]")), "a JSON object is expected"),
        (
            lambda path: (path.mkdir(), (path / "summary.json").write_text('{"surveysim": "0.5.1", "scores": {}}')),
            "scene.json: can't be read",
        ),
        (
            lambda path: (path.mkdir(), (path / "summary.json").write_text('{"surveysim": "0.4.0", "scores": {}}')),
            "summary.json: written by surveysim 0.4.0; 0.5 or later is expected",
        ),
        (
            lambda path: (path.mkdir(), (path / "summary.json").write_text('{"points": []}')),
            "summary.json: written by surveysim of unknown version; 0.5 or later is expected",
        ),
        (
            lambda path: (path.mkdir(), [(path / f"{name}.json").write_text(NOTHING_SCORED) for name in NAMES]),
            "results that can't be read (KeyError 'cleaning')",
        ),
    ],
)
def test_directories_without_results(call, tmp_path, prepare, words):
    out = tmp_path / "out"
    prepare(out)
    code, text, error = call("report", out)
    assert (code, text) == (2, "") and words in error and len(error.splitlines()) == 1
    assert str(out) in error and "expected" in error and not (out / "report.html").exists()
    with pytest.raises(NoResultsError):
        write_report(out)


NOTHING_SCORED = '{"surveysim": "0.6.0", "scores": {}}'
NAMES = ("summary", "scene")

# ---------------------------------------------------------------- numbers and units


@pytest.mark.parametrize(
    "value, error, text",
    [
        (221.0527, 5.206, "221.1 ± 5.2"),
        (87.457, 1.2395, "87.5 ± 1.2"),
        (12156.9, 1082.1, "12\u202f200 ± 1100"),
        (0.95020, 0.02104, "0.950 ± 0.021"),
        (1.0, 0.0996, "1.00 ± 0.10"),
        (-0.0094, 0.0233, "−0.009 ± 0.023"),
        (3.66666666, 4e-16, "3.67"),
        (2.0, None, "2.00"),
        (5.2e-5, 1.2e-6, "(5.20 ± 0.12) × 10^(−5)"),
    ],
)
def test_numbers_are_rounded_to_their_errors(value, error, text):
    assert with_error(value, error) == text


def test_numbers_without_errors():
    assert [number(value) for value in (0, 0.81871, 218.98, 2860.9, 12345, 155.25e6, -4.2e-5)] == [
        "0", "0.819", "219", "2860", "12\u202f300", "1.55 × 10^(8)", "−4.20 × 10^(−5)",
    ]  # fmt: skip
    assert [short(value) for value in (0.0, 1.6, 270.0, 14000.0, 0.05)] == ["0", "1.6", "270", "14\u202f000", "0.05"]
    assert (count(1234), count(12345), as_known(218.98, 5.2)) == ("1234", "12\u202f345", "219.0")
    assert [duration(s) for s in (0.0097, 16.3, 100, 5400, 9 * 86400)] == [
        "9.7 ms",
        "16 s",
        "1.7 min",
        "1.5 h",
        "9.0 days",
    ]


@pytest.mark.parametrize(
    "text, written",
    [
        ("µK²_CMB and uK_CMB^2", "µK²<sub>CMB</sub> and µK²<sub>CMB</sub>"),
        ("NET [mK_RJ √s], [mK_CMB √s]", "NET [mK<sub>RJ</sub> √s], [mK<sub>CMB</sub> √s]"),
        ("280 mK^2 rad^(-5/3)", "280 mK² rad<sup>−5/3</sup>"),
        ("[mK2 rad(-5/3)]", "[mK² rad<sup>−5/3</sup>]"),
        ("4 arcmin / s, W / Hz(1/2)", "4 arcmin/s, W/Hz<sup>1/2</sup>"),
        ("B2 < 3 & ell_eff +- 1", "B<sup>2</sup> &lt; 3 &amp; ℓ<sub>eff</sub> ± 1"),
        ("0.7 (f/#)lambda", "0.7 (f/#)λ"),
        ("scan.sample_rate", "scan.<wbr>sample_<wbr>rate"),
    ],
)
def test_units_as_they_are_printed(text, written):
    assert str(units(text)) == written


ODD = [None, [], {}, "x\u202e\x1b\ud800", -1, float("inf"), True, [[]], {"a": None}, 10**400, "<script>"]


def nodes(content, path=()):
    """Paths of all nodes of a JSON document."""
    yield path
    for key, value in content.items() if isinstance(content, dict) else enumerate(content):
        if isinstance(value, dict | list):
            yield from nodes(value, (*path, key))
        else:
            yield (*path, key)


def spoiled(content, path, value):
    if not path:
        return value
    copy = dict(content) if isinstance(content, dict) else list(content)
    copy[path[0]] = spoiled(content[path[0]], path[1:], value)
    return copy


@pytest.mark.parametrize("name", ["summary.json", "scene.json"])
def test_damaged_results_are_refused_in_a_line(call, copy, name):
    """Values of any type, wherever they are: a page, or one line; never another error. The old page stays."""
    content = json.loads((copy / name).read_text())
    random = np.random.default_rng(1)
    places = list(nodes(content))
    chosen = [("scores",)] * len(ODD) if name == "summary.json" else [()]
    chosen += [places[number] for number in random.integers(len(places), size=5)]
    refused = 0
    for turn, path in enumerate(chosen):
        (copy / "report.html").write_text("old")
        (copy / name).write_text(json.dumps(spoiled(content, path, ODD[turn % len(ODD)])))
        code, out, error = call("report", copy)
        if code == 0:
            assert (copy / "report.html").read_text().endswith("</html>\n")
            continue
        refused += 1
        assert (code, out) == (2, "") and error[:-1].isprintable() and len(error) < 500
        assert (copy / "report.html").read_text() == "old"
    assert refused > len(chosen) // 3


def test_no_control_characters_are_in_a_page(call, copy):
    content = json.loads((copy / "summary.json").read_text())
    content["files"].append("maps/a\0\x07\x1b[31mred\x85\u202eb.fits")
    (copy / "summary.json").write_text(json.dumps(content))
    assert call("report", copy)[0] == 0
    page = (copy / "report.html").read_text()
    assert r"a\x00\x07\x1b[31mred\x85\u202eb.fits" in page
    assert not set(page) & set("\0\x07\x1b\x85\u202e")


def test_results_that_are_no_files(call, copy):
    for prepare in (os.mkfifo, os.mkdir):
        (copy / "summary.json").unlink()
        prepare(copy / "summary.json")
        code, out, error = call("report", copy)
        words = "found no file" if prepare is os.mkdir else "not a regular file"
        assert (code, out) == (2, "") and f"summary.json: {words}" in error and len(error.splitlines()) == 1
