"""Results and files of a run: stable keys, readable tables and maps, numbers that agree with each other."""

import json
import math
import os

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable, Table
from astropy.wcs import WCS

from surveysim import load_scene, run
from surveysim.forecasting.forecast import forecast
from surveysim.report.terminal.survey import print_result
from surveysim.results.control_variate import in_all_weather
from surveysim.results.results import score_rows
from surveysim.results.summary import summary
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.numbers import plain, quoted
from surveysim.scene.scene import scene_hash
from surveysim.survey.coadds import kept_shares
from tests.scenes import SMALL_SCENE, WHITE_NOISE_SCENE, write_scene

KEYS = {
    "scene", "title", "seed", "scene_sha256", "surveysim", "python", "packages", "observations", "detectors",
    "detector_samples", "stages_left_out", "scans", "scans_discarded", "mean_iterations", "scores", "run", "cleaning",
    "files", "stopped", "stages", "left_out", "closure", "discarded", "discarded_by_weather", "warnings",
}  # fmt: skip
SCORED_KEYS = {
    "estimate", "time_to_precision", "forecast_over_simulated", "forecast", "error_budget", "gains",
    "alternatives", "bin_correlation", "metrics", "own_sky",
}  # fmt: skip
SETS = ("actual", "uncorrelated", "white", "masked_7")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """(result, folder) of a small run."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "small.toml").write_text(SMALL_SCENE)
    result = run(load_scene(folder / "small.toml"), folder / "out", engine=SERIAL, figures=False)
    return result, folder / "out"


@pytest.fixture(scope="module")
def content(finished):
    return json.loads((finished[1] / "summary.json").read_text(), parse_constant=pytest.fail)


def test_files(finished):
    names = sorted(str(path.relative_to(finished[1])) for path in finished[1].rglob("*.*"))
    assert names == [
        ".surveysim.json",
        "checkpoint.h5",
        *(f"maps/{name}.fits" for name in sorted((*SETS, "sky_actual", "sky_masked_7"))),
        "report.html",
        "scene.json",
        "scene.toml",
        "scores.npz",
        "summary.json",
        *(
            f"tables/{name}.ecsv"
            for name in (
                *("alternatives", "map_psd", "metrics", "observations", "scores"),
                *("sky_fluxes", "sky_transfer", "timestream_psd"),
            )
        ),
    ]


def test_summary(finished, content):
    result, _ = finished
    assert set(content) == KEYS | SCORED_KEYS
    assert (content["scene"], content["seed"], content["observations"], content["detectors"]) == (
        "small",
        11,
        4,
        18,
    )
    assert content["detector_samples"] == 4 * 18 * 4 * 60 and content["scans"] == 16
    assert content["scene_sha256"] == scene_hash(result.setup.scene)
    assert content["stages_left_out"] == [] and 0 <= content["scans_discarded"] < 16
    assert set(content["scores"]) == {*SETS, "masked_7_scaled"}
    for entry in content["scores"].values():
        assert set(entry) == {
            "kind",
            "n_det", "sigma_ukcmb2", "error_ukcmb2", "plain_sigma_ukcmb2", "ell_eff", "fwhm_ell", "forecast_ukcmb2",
        }  # fmt: skip
        assert all(0 < value < math.inf for key, value in entry.items() if key != "kind")
        assert 4000 < entry["ell_eff"] < 12000
    assert set(content["run"]["stage_s"]) >= {"atmosphere", "cleaning", "binning", "transfer_function"}
    assert json.dumps(summary(result)["scores"]) == json.dumps(content["scores"])


def test_one_estimate_is_quoted_everywhere(finished, content, capsys):
    """Summary, tables, screen and the report's headline; the plain value stands beside it."""
    result, folder = finished
    best, row, item = content["estimate"], content["scores"]["actual"], result.scores["actual"]
    assert best["kind"] == "controlled" == content["stopped"]["estimate"]
    assert best["sigma_ukcmb2"] == row["sigma_ukcmb2"] == item.band.sigma_ukcmb2
    assert best["error_ukcmb2"] == row["error_ukcmb2"] == item.band.sigma_ukcmb2 * item.budget.total
    assert best["plain_sigma_ukcmb2"] == row["plain_sigma_ukcmb2"] != best["sigma_ukcmb2"]
    assert row["forecast_ukcmb2"] / best["sigma_ukcmb2"] == pytest.approx(
        result.expected.scores["actual"].band.sigma_ukcmb2 / best["plain_sigma_ukcmb2"]
    )
    print_result(result, folder)
    shown = plain(quoted(best["sigma_ukcmb2"], best["error_ukcmb2"]))
    assert shown in capsys.readouterr().out
    page = (folder / "report.html").read_text()
    assert page.count(quoted(best["sigma_ukcmb2"], best["error_ukcmb2"])) >= 3  # lead, key figures, table


def test_short_and_verbose_output(finished, capsys):
    """Scores, gains, warnings and files always; all else with --verbose."""
    result, folder = finished
    details = ("Forecast over simulation", "The same data scored otherwise", "Choices of the scoring", "Weather drawn")
    print_result(result, folder)
    short = capsys.readouterr().out
    print_result(result, folder, verbose=True)
    whole = capsys.readouterr().out
    assert not any(text in short for text in details) and all(text in whole for text in details)
    for text in ("masked_7_scaled / uncorrelated", "Warning: ", f"Results in {folder}"):
        assert text in short and whole.count(text) == short.count(text)
    assert set(short.splitlines()) <= set(whole.splitlines())


def test_a_forecast_alone_tells_what_a_run_quotes(finished):
    """Of the scans that the run kept, over all weather: what stands beside the run's own result, within 1 %."""
    setup = finished[0].setup
    alone = in_all_weather(setup, forecast(setup, kept_shares(setup, finished[0].coadds)))
    quoted = {row.name: row.forecast_ukcmb2 for row in score_rows(finished[0])}
    drawn = finished[0].expected.scores
    for name in SETS:
        assert alone[name] == pytest.approx(quoted[name], rel=0.01)
    assert abs(alone["actual"] / drawn["actual"].band.sigma_ukcmb2 - 1) > 0.02


def test_an_unknown_error_is_said_to_be_unknown(tmp_path, capsys):
    """Two observations: None in JSON, NaN in tables, "unknown" on screen and in the report."""
    path = write_scene(tmp_path)
    result = run(load_scene(path, {"observations": 2}), tmp_path / "out", engine=SERIAL, figures=False)
    content = json.loads((tmp_path / "out" / "summary.json").read_text(), parse_constant=pytest.fail)
    assert content["estimate"]["error_ukcmb2"] is content["stopped"]["relative_error"] is None
    assert content["scores"]["white"]["error_ukcmb2"] is content["gains"]["uncorrelated / white"]["error"] is None
    assert np.isnan(Table.read(tmp_path / "out" / "tables" / "scores.ecsv")["error_ukcmb2"]).all()
    print_result(result, tmp_path)
    out = capsys.readouterr().out
    assert plain(quoted(content["estimate"]["sigma_ukcmb2"], None)) in out and "found 2 observations" in out
    assert "± unknown" in (tmp_path / "out" / "report.html").read_text()


def test_scaled_rows_and_gains(finished, content):
    scores = content["scores"]
    share = scores["masked_7"]["n_det"] / 18
    assert scores["masked_7_scaled"]["sigma_ukcmb2"] == pytest.approx(share * scores["masked_7"]["sigma_ukcmb2"])
    ratio = scores["actual"]["sigma_ukcmb2"] / scores["uncorrelated"]["sigma_ukcmb2"]
    assert content["gains"]["actual / uncorrelated"]["ratio"] == pytest.approx(ratio)
    assert set(finished[0].gains) == {
        "actual / uncorrelated", "uncorrelated / white", "masked_7_scaled / uncorrelated",
    }  # fmt: skip


def test_references(finished, tmp_path):
    path = tmp_path / "small.toml"
    reference = '\n[score.reference]\nsource = "A paper"\nvalues = { actual = "100 uK2" }\n'
    path.write_text(SMALL_SCENE + reference)
    rows = {row.name: row for row in score_rows(run(load_scene(path), engine=SERIAL))}
    assert rows["actual"].reference_ukcmb2 == pytest.approx(100) and rows["white"].reference_ukcmb2 is None
    assert rows["actual"].sigma_ukcmb2 == score_rows(finished[0])[0].sigma_ukcmb2


KINDS = {"actual": "actual", "uncorrelated": "noise-only", "white": "noise-only"}


def test_score_table(finished, content):
    table = Table.read(finished[1] / "tables" / "scores.ecsv")
    assert str(table["sigma_ukcmb2"].unit) == "uK2" and table.meta["temperature"] == "CMB"
    assert list(table["name"]) == list(content["scores"])
    for row in table:
        entry = dict(content["scores"][row["name"]])
        assert entry.pop("kind") == ("masked" if row["name"].startswith("masked") else KINDS[row["name"]])
        for key, value in entry.items():
            assert row[key] == value


def test_spectrum_table(finished):
    result, folder = finished
    table = Table.read(folder / "tables" / "map_psd.ecsv")
    assert {f"{kind}_{name}" for kind in ("noise", "transfer_function", "signal") for name in SETS} <= set(
        table.colnames
    )
    assert str(table["noise_actual"].unit) == "uK2 sr"
    np.testing.assert_array_equal(table["noise_white"], result.scores["white"].noise_psd)
    assert (np.diff(table["ell"]) > 0).all() and table["scored"].sum() == result.setup.analysis.region.selected.sum()
    assert (table["n_modes"] > 0).all()


def test_observation_table(finished, content):
    result, folder = finished
    table = Table.read(folder / "tables" / "observations.ecsv")
    assert list(table["observation"]) == [0, 1, 2, 3]
    assert table["discarded_actual"].sum() == content["scans_discarded"]
    assert table["iterations_actual"].mean() == pytest.approx(content["mean_iterations"])
    np.testing.assert_allclose(table["elevation_rad"], math.radians(55))
    noise = np.column_stack([table[f"noise_mk2_{name}"] for name in SETS])
    np.testing.assert_array_equal(noise, result.coadds.noise_mk2())


def test_timestream_table(finished):
    table = Table.read(finished[1] / "tables" / "timestream_psd.ecsv")
    assert table["frequency"][-1] == 5 and str(table["frequency"].unit) == "Hz"
    assert (table["raw_q25"] <= table["raw_median"]).all() and (table["clean_median"] <= table["clean_q75"]).all()
    low = table["frequency"] < 0.5
    assert table["clean_median"][low].sum() < table["raw_median"][low].sum()


def test_alternative_table(finished, content):
    table = Table.read(finished[1] / "tables" / "alternatives.ecsv")
    assert len(table) == len(content["alternatives"])
    for row, entry in zip(table, content["alternatives"], strict=True):
        assert {key: row[key] for key in entry} == entry


@pytest.mark.parametrize("name", SETS)
def test_maps(finished, name):
    result, folder = finished
    coadds, s = result.coadds, result.setup.analysis.data_set_names.index(name)
    with fits.open(folder / "maps" / f"{name}.fits") as file:
        file.verify("exception")
        planes = {hdu.name.lower(): hdu for hdu in file}
        signal, weight, hits = (planes[key].data for key in ("signal", "weight", "hits"))
        header = file[0].header
        assert (header["SCENE"], header["SEED"], header["NOBS"], header["DATASET"]) == ("small", 11, 4, name)
        wcs = WCS(planes["signal"].header)
    np.testing.assert_array_equal(hits, coadds.hits[s])
    np.testing.assert_allclose(weight, coadds.weight[s], rtol=1e-6)
    seen = coadds.weight[s] > 0
    np.testing.assert_allclose(signal[seen], (coadds.sums[s][seen] / coadds.weight[s][seen]), rtol=1e-5, atol=1e-6)
    middle = wcs.pixel_to_world_values((signal.shape[1] - 1) / 2, (signal.shape[0] - 1) / 2)
    np.testing.assert_allclose(middle, [132.3, 44.84], atol=1e-4)


def test_resolved_scene(finished):
    scene = json.loads((finished[1] / "scene.json").read_text())
    assert scene["scan"]["duration_s"] == 6 and scene["instrument"]["frequency_hz"] == 143e9


def test_white_noise_run(tmp_path):
    """Without a score there are maps, and of the tables those that need none."""
    path = tmp_path / "white.toml"
    path.write_text(WHITE_NOISE_SCENE)
    result = run(load_scene(path), tmp_path / "out", engine=SERIAL, figures=False)
    content = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert set(content) == KEYS and content["scores"] == {} and result.scores == {}
    assert content["stages_left_out"] == ["atmosphere", "excess", "sky", "photon", "score"]
    assert sorted(p.name for p in (tmp_path / "out" / "tables").iterdir()) == [
        "observations.ecsv",
        "timestream_psd.ecsv",
    ]
    assert np.isnan(Table.read(tmp_path / "out" / "tables" / "observations.ecsv")["b2_mk2"]).all()


def _strict_json(text):
    """The content of a JSON text, which has no NaN."""

    def refuse(constant):
        raise ValueError(f"found {constant}")

    return json.loads(text, parse_constant=refuse)


@pytest.mark.parametrize(
    "setting, reason",
    [
        ({"observations": 1}, "observations with data: found 1"),
        ({"cleaning.max_iterations": 1}, "cleaning discarded all scans"),
    ],
)
def test_runs_that_cannot_be_scored(tmp_path, capsys, setting, reason):
    """One observation, or all scans discarded: the maps are written, and it is said why there is no score."""
    path = write_scene(tmp_path)
    result = run(load_scene(path, setting), tmp_path / "out", engine=SERIAL, figures=False)
    content = _strict_json((tmp_path / "out" / "summary.json").read_text())
    assert content["scores"] == {} and content["unscored"] == result.unscored
    assert result.unscored.startswith(reason)
    print_result(result, tmp_path)
    assert f"Not scored: {result.unscored}" in capsys.readouterr().out.replace("\n", " ").replace("  ", " ")


def test_a_forced_run_replaces_an_earlier_one(tmp_path, blank_figures):
    path = write_scene(tmp_path)
    out = tmp_path / "out"
    run(load_scene(path), out, engine=SERIAL, save_timestreams=True)
    for name in ("notes.txt", "figures/mine.png", "tables/mine.ecsv"):
        (out / name).write_text("mine")
    assert "report.html" in json.loads((out / "summary.json").read_text())["files"]
    run(load_scene(path, {"observations": 2}), out, engine=SERIAL, figures=False, force=True)
    assert [path.name for path in (out / "figures").glob("*")] == ["mine.png"]
    assert "<img" not in (out / "report.html").read_text()
    assert not list((out / "timestreams").glob("*")) and (out / "tables" / "mine.ecsv").exists()
    assert json.loads((out / "summary.json").read_text())["observations"] == 2
    assert (out / "notes.txt").read_text() == "mine"


def test_units_of_tables(finished):
    _, out = finished
    table = QTable.read(out / "tables" / "map_psd.ecsv")
    assert (table["noise_actual"] + table["noise_error_actual"]).unit == "uK2 sr"
    assert QTable.read(out / "tables" / "observations.ecsv")["noise_mk2_actual"].unit == "mK2"


GONE = 2**30  # no process has this number


def test_half_written_files_of_a_killed_run_go(tmp_path):
    """Those of a run's own files and folders; nothing of the user's."""
    path, out = tmp_path / "small.toml", tmp_path / "out"
    path.write_text(SMALL_SCENE)
    names = [f"{name}.{GONE}.part" for name in ("checkpoint.h5", "timestreams/0003.h5", "maps/actual.fits")]
    mine = ["mine.part", "figures/movie.part", f"figures/movie.{GONE}.part", f"maps/actual.fits.{os.getppid()}.part"]
    for name in names + mine:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("half")
    run(load_scene(path), out, engine=SERIAL, resume=True, figures=False)
    assert [name for name in names + mine if (out / name).exists()] == mine


@pytest.mark.parametrize("name", ["control_variate.score_survey", "scored.forecast"])
def test_faults_in_scoring_are_no_refusals(scene_file, monkeypatch, name):
    """An error of numpy passes on; a run that says "not scored" instead would hide it."""

    def fail(*arguments):
        return np.zeros(3) + np.zeros(4)

    monkeypatch.setattr(f"surveysim.results.{name}", fail)
    with pytest.raises(ValueError, match="broadcast"):
        run(load_scene(scene_file), engine=SERIAL)
