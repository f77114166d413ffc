"""The paper command on small scenes: which observations are made, which files come out, what they hold."""

import json
import math
from base64 import b64decode

import numpy as np
import pytest
from astropy.table import Table
from PIL import Image

from surveysim import load_scene
from surveysim import run as run_scene
from surveysim.output.lock import OutputError
from surveysim.paper.reproduce import reproduce
from surveysim.paper.scenes import FIGURES, TABLES, wanted
from surveysim.report.html.paper import Compared
from surveysim.report.html.paper_captions import PAPER
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.runtime.errors import SceneError
from tests.pages import read_page, rows_of, value_of
from tests.scenes import SMALL_SCENE, without_sections

pytestmark = pytest.mark.slow  # all items are made several times

# Streams that are nearly all atmosphere, so that four short scans tell its wind.
SCENE = (
    without_sections(SMALL_SCENE, "excess", "sky")
    .replace("[100, 280, 980]", "[30000, 60000, 90000]")
    .replace('beam_fwhm = "60 arcsec"', 'beam_fwhm = "60 arcsec"\nbandwidth = 0.15')
    .replace("[atmosphere]", '[atmosphere]\nsite = "mauna_kea"')
    .replace("observations = 4", "observations = 8")
    .replace('duration = "6 s"', 'duration = "12 s"')
    .replace("scans = 4", "scans = 8")
)


@pytest.fixture(scope="module")
def scenarios(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenarios")
    for number, name in enumerate(("lynx", "sds1", "cosmos", "acbar_south_pole")):
        text = SCENE.replace("seed = 11", f"seed = {11 + number}")
        (folder / f"{name}.toml").write_text(text.replace("143 GHz", "268 GHz") if name == "cosmos" else text)
    return folder


@pytest.fixture(scope="module")
def made(scenarios, tmp_path_factory):
    out = tmp_path_factory.mktemp("paper")
    counted = []
    written, failed = reproduce(
        wanted(TABLES, FIGURES, scenarios, observations=None), out, SERIAL, progress=lambda: counted.append(1)
    )
    assert failed == []
    return out, written, len(counted)


def read(path):
    return Table.read(path, format="ascii.ecsv")


def test_everything_is_there_and_nothing_else(made):
    out, written, _ = made
    bands = ("143", "268", "151", "282")
    names = {f"{kind}_{band}.ecsv" for kind in ("measurements", "recovered") for band in bands}
    names |= {
        "table1.ecsv",
        "table1_sites.ecsv",
        "table2.ecsv",
        "table2_photons.ecsv",
        "table3.ecsv",
        "table3_gains.ecsv",
    }
    names |= {f"figure{number:02d}.{kind}" for number in FIGURES for kind in ("png", "ecsv")}
    assert {path.name for path in written} == names
    assert {path.name for path in out.iterdir()} == names | {"summary.json", "report.html", ".surveysim.json"}


def test_the_report_has_all_of_it(made):
    out, page = made[0], read_page(made[0] / "report.html")
    shown = [b64decode(image.attributes["src"].partition("base64,")[2]) for image in page.all("img")]
    assert shown == [(out / f"figure{number:02d}.png").read_bytes() for number in FIGURES]
    for number, figure in zip(FIGURES, page.all("figure"), strict=True):
        meta = read(out / f"figure{number:02d}.ecsv").meta
        caption = figure.one("figcaption")
        assert caption.one("h3").text == f"Figure {number}: {meta['title']}" and figure.one("img").attributes["alt"]
        drawn = caption.one("p", class_="drawn").text
        assert drawn[:60] == meta["caption"].replace("/ s", "/s")[:60] and PAPER[number].look_for in caption.text
    for name in ("table1", "table1_sites", "table2", "table2_photons", "table3", "table3_gains"):
        assert len(rows_of(page, f"grid-{name}")) == len(read(out / f"{name}.ecsv"))
    table = read(out / "table3.ecsv")
    for row, cells in zip(table, rows_of(page, "grid-table3"), strict=True):
        assert (value_of(cells[1]), value_of(cells[2])) == (row["sigma_ukcmb2"], row["paper"])
    recovered = {row[0].text: row for row in rows_of(page, "grid-recovered")}
    assert value_of(recovered["share of winds trusted"][1]) == read(out / "recovered_143.ecsv")["ours"][3]


def test_the_overview_counts_what_the_tables_say(made):
    page = read_page(made[0] / "report.html")
    counts = {row[0].text: [value_of(cell) for cell in row[1:5]] for row in rows_of(page, "grid-overview")}
    assert all(values[0] == sum(values[1:]) for values in counts.values())
    for title, values in counts.items():
        section = [item for item in page.all("section", class_="grid") if item.one("h3").text == title]
        if section:
            verdicts = [row.all("td")[3].text for row in section[0].one("tbody").all("tr")]
            assert values[1:] == [verdicts.count(word) for word in ("yes", "nearly", "no")]
    total = [int(sum(values[k] for values in counts.values())) for k in range(4)]
    assert f"{total[0]} values here are in the paper too: {total[1]} agree within errors, {total[2]} more" in page.text


@pytest.mark.parametrize(
    "numbers, verdict",
    [
        ((100, 5, 109, math.nan), "yes"),
        ((100, 5, 111, math.nan), "nearly"),
        ((100, 5, 126, math.nan), "no"),
        ((100, 5, 126, 12), "yes"),
        ((100, math.nan, 119, math.nan), "nearly"),
        ((0.0, 0.0, 1.1, math.nan), "no"),
    ],
)
def test_what_agrees(numbers, verdict):
    assert Compared("it", *numbers).agrees == verdict


def test_the_summary_says_what_each_item_is_made_of(made):
    content = json.loads((made[0] / "summary.json").read_text())
    assert set(content["files"]) == {path.name for path in made[0].iterdir()} - {"summary.json", ".surveysim.json"}
    (run,) = content["runs"]
    assert sorted(name for names in run["items"].values() for name in names) == sorted(path.name for path in made[1])
    assert run["failed"] == {} and run["surveysim"] and run["date"]
    used = [(scene["scene"], scene["seed"], scene["observations"]) for scene in run["scenes"]]
    assert used[:3] == [("lynx", 11, 8), ("sds1", 12, 8), ("cosmos", 13, 8)]
    assert {name for scene in run["scenes"] for name in scene["items"]} == set(run["items"]) - {"figure 1"}
    assert all(len(scene["scene_sha256"]) == 64 for scene in run["scenes"])


def test_items_of_an_earlier_call_stay_with_what_made_them(scenarios, tmp_path):
    reproduce(wanted((), (1, 2), scenarios, observations=None), tmp_path, SERIAL)
    other = wanted((), (2,), scenarios, observations=None, overrides={"seed": 5})
    with pytest.raises(OutputError, match="holds figure 2 of other scenes or settings; --force replaces it"):
        reproduce(other, tmp_path, SERIAL)
    reproduce(other, tmp_path, SERIAL, force=True)
    content = json.loads((tmp_path / "summary.json").read_text())
    assert [list(run["items"]) for run in content["runs"]] == [["figure 1"], ["figure 2"]]
    assert [[scene["seed"] for scene in run["scenes"]] for run in content["runs"]] == [[], [5]]
    assert len(read_page(tmp_path / "report.html").all("img")) == 2
    still = wanted((), (6,), scenarios, observations=1, overrides={"atmosphere.b2": "[0, 0, 0] mK2 rad(-5/3)"})
    reproduce(still, tmp_path, SERIAL, force=True)
    page = read_page(tmp_path / "report.html")
    assert len(page.all("img")) == 2 and "Not made: figure 6" in page.text and "Not made: 143 GHz" in page.text
    before = list(tmp_path.glob("figure*"))
    scene = load_scene(scenarios / "lynx.toml", {"score": None})
    with pytest.raises(OutputError, match="--force"):
        run_scene(scene, tmp_path, engine=SERIAL, figures=False)
    run_scene(scene, tmp_path, engine=SERIAL, figures=False, force=True)
    assert before and not list(tmp_path.glob("figure*"))  # a directory is of one command


def test_each_observation_is_made_once(made):
    assert made[2] == 7 * 8  # lynx twice more: cleaned in three ways, and beside simulated and masked sets


def test_pictures_and_their_points(made):
    for number in FIGURES:
        table = read(made[0] / f"figure{number:02d}.ecsv")
        assert table.colnames == ["panel", "series", "kind", "x", "y", "low", "high"] and len(table) > 5
        assert table.meta["figure"] == number and len(table.meta["caption"]) > 80
        with Image.open(made[0] / f"figure{number:02d}.png") as image:
            assert image.format == "PNG" and min(image.size) > 500


def test_tables_have_the_paper_s_value_ours_and_our_error(made):
    table = read(made[0] / "table1.ecsv")
    assert (
        table.colnames == ["instrument", "band", "quartile", "paper", "ours", "error", "drawn", "expected"]
        and len(table) == 18
    )
    assert list(table["paper"][:3]) == [100, 280, 980]
    ours, error = np.array(table["ours"]), np.array(table["error"])
    assert (ours > 0).all() and (error > 0).all()
    # Bolocam over ACBAR, and the errors of both.
    assert ours[12] == pytest.approx(ours[0] / ours[6])
    assert error[12] / ours[12] == pytest.approx(np.hypot(error[0] / ours[0], error[6] / ours[6]))
    correlated = read(made[0] / "table2.ecsv")
    raw = correlated[correlated["quantity"] == "raw atmosphere"]
    assert list(raw["observations"]) == [4, 4, 4, 4, 16] and list(raw["paper"]) == [77, 131, 310, 1060, 240]
    shared = correlated[correlated["quantity"] == "adjacent correlated noise"]
    assert list(shared["cleaning"]) == ["average"] * 5 + ["quadratic"] * 5
    assert list(shared["paper"]) == 2 * [0.8, 1.1, 1.9, 5.8, 1.9] and np.isfinite(shared["ours"]).all()
    sites = read(made[0] / "table1_sites.ecsv")
    assert list(sites["paper"]) == [16, 12, 21, 3.5, 0.3]


def test_sensitivities_of_the_four_data_sets(made):
    table, gains = read(made[0] / "table3.ecsv"), read(made[0] / "table3_gains.ecsv")
    assert table.colnames == ["data_set", "detectors", "sigma_ukcmb2", "error", "paper", "ratio"]
    assert list(table["paper"]) == [270, 170, 100, 550, 170]
    actual, uncorrelated, white, masked, scaled = table
    assert [actual["data_set"], uncorrelated["data_set"], white["data_set"]] == ["actual", "uncorrelated", "white"]
    share = masked["detectors"] / actual["detectors"]
    assert 0 < share < 1 and scaled["sigma_ukcmb2"] == pytest.approx(share * masked["sigma_ukcmb2"])
    np.testing.assert_allclose(table["ratio"], table["sigma_ukcmb2"] / table["paper"])
    sigma = {row["data_set"]: row["sigma_ukcmb2"] for row in table}
    for row, paper in zip(gains, (1.6, 1.7, 1.0), strict=True):
        worse, better = row["gain"].split(" / ")
        assert row["ours"] == pytest.approx(sigma[worse] / sigma[better]) and row["error"] > 0
        assert row["paper"] == paper and row["ratio"] == pytest.approx(row["ours"] / paper)


def test_measurements_stand_beside_the_truth(made):
    table = read(made[0] / "measurements_143.ecsv")
    assert list(table["scene"]) == ["lynx"] * 8 + ["sds1"] * 8 and list(table["observation"]) == 2 * list(range(8))
    drawn, measured = np.array(table["drawn_b2"]), np.array(table["measured_b2"])
    assert 0.2 < np.median(measured / drawn) < 3
    assert not set(np.round(drawn[:8], 3)) & set(np.round(drawn[8:], 3))  # each scene has its own weather
    assert table["drawn_wind_arcmin_s"].unit == "arcmin / s" and table["raw_below_1_hz_mk2"].unit == "mK2"
    recovered = read(made[0] / "recovered_143.ecsv")
    rows = {row["quantity"]: row for row in recovered}
    assert rows["B2 over the drawn one, median"]["ours"] == pytest.approx(np.median(measured / drawn))
    assert rows["median wind, drawn"]["paper"] == 31


def test_same_bits_whatever_the_workers(scenarios, made, tmp_path, two_threads):
    written, _ = reproduce(wanted((2,), (), scenarios, observations=None), tmp_path, Engine(workers=2))
    for path in written:
        assert path.read_bytes() == (made[0] / path.name).read_bytes()


def test_only_what_is_needed_is_made(scenarios, tmp_path):
    assert wanted((), (13,), scenarios, observations=5).observations == 5
    assert wanted((3,), (16,), scenarios, observations=5).observations == 5  # one run for both
    assert wanted((3,), (13, 16), scenarios, observations=5).observations == 10
    asked = wanted((), (1, 2), scenarios, observations=None)
    assert asked.observations == 0 and asked.items == ["figure 1", "figure 2"]
    assert wanted((1,), (), scenarios, observations=3).observations == 5 * 3
    assert list(wanted((), (6, 9), scenarios, observations=None).scenes) == ["143"]
    assert wanted((2,), (14, 15), scenarios, observations=3).observations == 2 * 3
    assert wanted((), (1,), tmp_path, observations=None).scenes == {}  # needs no scene at all
    (tmp_path / "lynx.toml").write_text(SCENE)
    with pytest.raises(SceneError, match="sds1.toml: can't be read"):
        wanted((2,), (), tmp_path, observations=None)


def test_what_can_t_be_made_is_said_and_the_rest_is_made(scenarios, tmp_path):
    asked = wanted(
        (2,), (1, 6, 9, 14, 15), scenarios, observations=1, overrides={"atmosphere.b2": "[0, 0, 0] mK2 rad(-5/3)"}
    )
    written, failed = reproduce(asked, tmp_path, SERIAL)
    assert {path.name for path in written} >= {"figure01.png", "figure01.ecsv"}
    items = ["143 GHz", "table 2", "figure 6", "figure 9", "figure 14", "figure 15"]
    assert [line.partition(":")[0] for line in failed] == items


def test_a_survey_without_a_score_is_said_for_each_item_of_its_run(scenarios, tmp_path):
    written, failed = reproduce(wanted((3,), (16,), scenarios, observations=1), tmp_path, SERIAL)
    assert written == [] and [line.partition(":")[0] for line in failed] == ["table 3", "figure 16"]
    assert "observations" in failed[0]


@pytest.mark.parametrize("asked", [((3,), ()), ((), (16,))])
@pytest.mark.parametrize(
    "old, new, words",
    [
        ("", "", "score: missing; Table 3 and figure 16 score the maps"),
        ('["uncorrelated", "white"]', '["white"]', "score.noise_only_sets: found white; Table 3 and figure 16 need"),
        ('["uncorrelated", "white"]', "[]", "score.noise_only_sets: found none; Table 3 and figure 16 need"),
        ("mask_separation_f_lambda = 1.3", "", "score.mask_separation_f_lambda: missing; Table 3"),
        ("mask_separation_f_lambda = 1.3", "mask_separation_f_lambda = 9", "lynx.toml: "),
    ],
)
def test_scenes_without_the_four_data_sets(tmp_path, asked, old, new, words):
    text = SCENE.replace(old, new) if old else without_sections(SCENE, "score")
    (tmp_path / "lynx.toml").write_text(text)
    with pytest.raises(SceneError) as caught:
        wanted(*asked, tmp_path, observations=None)
    assert words in str(caught.value) and "lynx.toml" in str(caught.value)


@pytest.mark.parametrize(
    "name, old, new, words",
    [
        ("sds1", "pitch_f_lambda = 0.7", "pitch_f_lambda = 0.8", "sds1.toml: instrument: not that of 'lynx'"),
        ("sds1", 'wind_median = "31', 'wind_median = "20', "sds1.toml: atmosphere: not that of 'lynx'"),
        ("lynx", "143 GHz", "1500 GHz", "lynx.toml: atmosphere.site: found a band"),
        ("lynx", '"1000 m"', '"1234 m"', "lynx.toml: atmosphere: found index 3.667 and layer_height 1234 m"),
        (
            "lynx",
            "[map]",
            '[numerics]\nmax_block_memory = "30 kB"\n\n[map]',
            "max_block_memory: found 0.03 MB, which cuts",
        ),
    ],
)
def test_scenes_that_can_t_be_measured_together(scenarios, tmp_path, name, old, new, words):
    for path in scenarios.iterdir():
        text = path.read_text()
        (tmp_path / path.name).write_text(text.replace(old, new) if path.stem == name else text)
    with pytest.raises(SceneError) as caught:
        wanted((2,), (), tmp_path, observations=None)
    assert words in str(caught.value)
