"""Sweeps as they run: files, the best point, shared errors, workers, interruption and what is kept meanwhile."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from surveysim import SceneError, forecast_sweep, load_scene, load_sweep, run, run_sweep
from surveysim.output.lock import OutputError
from surveysim.output.record import RECORD
from surveysim.report.figures.sweep import _ticks, draw_sweep, sweep_figure
from surveysim.report.terminal.sweep import best_line, forecast_lines
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.runtime.errors import InputError
from surveysim.runtime.numbers import plain, quoted_share
from surveysim.scene.scene import scene_hash
from surveysim.studies.sweep.axes import Axis
from surveysim.studies.sweep.comparison import compare, compare_runs, forecast_points, probability_of_lowest
from surveysim.studies.sweep.point_store import PointResult, load_point, save_point
from surveysim.studies.sweep.summary import sweep_summary
from surveysim.studies.sweep.tables import sweep_table
from surveysim.survey import run as survey
from surveysim.survey.checkpoint import CheckpointError
from surveysim.survey.error_modes import error_modes, gain
from tests.pages import read_page
from tests.scenes import SMALL_SCENE, without_sections

WHITE = (
    without_sections(SMALL_SCENE, "atmosphere", "excess", "photon", "sky")
    .replace('algorithm = "average"', 'algorithm = "none"')
    .replace('noise_only_sets = ["uncorrelated", "white"]', "noise_only_sets = []")
    .replace("mask_separation_f_lambda = 1.3\n", "")
)
LEVELS = '\n[sweep]\n"detector.psd" = ["2.5 mK2 / Hz", "10 mK2 / Hz", "2500000 uK2 / Hz"]\n'
SPEEDS = '\n[sweep]\n"scan.speed" = ["3 arcmin / s", "4 arcmin / s", "5 arcmin / s"]\n'
FILES = [RECORD, "points", "report.html", "scene.json", "scene.toml", "summary.json", "sweep.ecsv", "sweep_pairs.ecsv"]
ROWS = ("ratio", "paired_error", "independent_error", "best_probability")


@pytest.fixture(scope="module")
def levels(write, tmp_path_factory):
    """A finished sweep of the white level, and where its files are."""
    out = tmp_path_factory.mktemp("levels")
    return run_sweep(write(WHITE + LEVELS), out, engine=SERIAL), out


# ---------------------------------------------------------------- common noise


def test_the_same_deviates_scale_exactly(levels):
    """Four times the PSD is four times sigma(A), without an error: nothing else is drawn.

    Transfer functions differ by the rounding of float32 streams, 1e-7 of their noise.
    """
    comparison = levels[0].comparison
    np.testing.assert_allclose(comparison.ratio, [1, 4, 1], rtol=1e-5)
    assert (comparison.paired_error < 1e-5 * comparison.ratio).all()
    relative = comparison.error / comparison.value
    assert (relative > 0.05).all() and comparison.independent_error[0] == 0
    np.testing.assert_allclose(
        comparison.independent_error[1:], [4, 1] * np.hypot(relative[0], relative[1:]), rtol=1e-4
    )


def test_equal_points_share_being_the_best(levels):
    comparison = levels[0].comparison
    np.testing.assert_allclose(comparison.best_probability, [0.5, 0, 0.5], atol=1e-12)
    assert comparison.best == (0, 2) and comparison.reference == 0
    assert best_line(levels[0]).startswith(
        "best: detector.psd = 2.5 mK2 / Hz or detector.psd = 2500000 uK2 / Hz, sigma"
    )
    assert best_line(levels[0]).endswith("uK_CMB^2, each with confidence 50 %")


def test_points_are_plain_runs(levels, write):
    """A point's score is that of the scene run alone."""
    path = write(WHITE)
    alone = run(load_scene(path, {"detector.psd": "10 mK2 / Hz"}), engine=SERIAL).scores["actual"]
    point = levels[0].points[1].scores["actual"]
    assert point.band.sigma_ukcmb2 == alone.band.sigma_ukcmb2 and point.budget == alone.budget
    np.testing.assert_array_equal(point.noise_psds, alone.noise_psds)


def test_modes_hold_each_error_and_that_of_pairs(levels):
    """Norms of rows are the errors; `gain` is the difference of two."""
    items = [point.scores["actual"] for point in levels[0].points[:2]]
    changed = replace(items[1], noise_psds=items[1].noise_psds * [[1.0], [1.2], [0.9], [1.0]])
    for skies in ("aa", "ab"):
        rows = error_modes((items[0], changed), skies)
        budgets = [item.budget for item in (items[0], changed)]
        np.testing.assert_allclose(np.linalg.norm(rows, axis=1), [budget.total for budget in budgets], rtol=1e-12)
    shared, own = (error_modes((items[0], items[1]), skies) for skies in ("aa", "ab"))
    assert np.linalg.norm(shared[0] - shared[1]) < 1e-5
    transfer = np.hypot(items[0].budget.transfer_function, items[1].budget.transfer_function)
    np.testing.assert_allclose(np.linalg.norm(own[0] - own[1]), transfer, rtol=1e-5)
    found = gain(items[1], items[0], 0.5)  # of one survey, whose skies are the same
    assert found.ratio == pytest.approx(2, rel=1e-5) and found.error < 2e-5


@pytest.mark.parametrize("correlation", [1.0, 0.6, 0.0, -1.0])
def test_transfer_functions_of_the_same_skies_share_what_each_sky_does(levels, correlation):
    """Errors of equal size whose deviations correlate: `2 e^2 (1 - correlation)` is left of them in a ratio."""
    item = levels[0].points[0].scores["actual"]
    used, transfer_function = item.band.weight > 0, item.transfer_function
    one, other = np.zeros((2, 2, len(used)))
    scale = transfer_function.transmission[used] / item.band.weight[used]  # bins that weigh alike
    one[:, used] = np.outer([1, 1], scale)
    other[:, used] = np.outer(
        [correlation + np.sqrt(1 - correlation**2), correlation - np.sqrt(1 - correlation**2)], scale
    )
    items = [replace(item, transfer_function=replace(transfer_function, deviations=part)) for part in (one, other)]
    rows = error_modes(items, "aa")
    expected = item.budget.transfer_function * np.sqrt(2 * (1 - correlation))
    assert np.linalg.norm(rows[0] - rows[1]) == pytest.approx(expected, abs=1e-9)


def test_modes_of_surveys_of_different_lengths(levels):
    """n and 4 n observations of like weather: what they share leaves sqrt(1/n - 1/(4 n)) of the scatter."""
    item = replace(levels[0].points[0].scores["actual"], kept=1.0, control=None, plain=None)
    rng = np.random.default_rng(3)
    weights = rng.lognormal(0, 0.5, 4000)
    transfer_function = replace(item.transfer_function, deviations=np.zeros_like(item.transfer_function.deviations))
    rows = []
    for n in (1000, 4000):
        variation = weights[:n].std(ddof=1) / weights[:n].mean() / np.sqrt(n)
        budget = replace(item.budget, noise=0.0, transfer_function=0.0, weather=variation, population=0.0)
        noise = np.repeat(1 / weights[:n, None], len(item.band.weight), axis=1)
        rows.append(
            replace(item, weights=weights[:n], bin_noise=noise, budget=budget, transfer_function=transfer_function)
        )
    one, other = error_modes(rows, "aa")
    variation = weights.std() / weights.mean()
    assert np.linalg.norm(one - other) == pytest.approx(variation * np.sqrt(1 / 1000 - 1 / 4000), rel=0.1)


# ---------------------------------------------------------------- the best point


def test_probability_of_the_lowest_of_two():
    """Two independent normals a distance d apart: Phi(d / (s sqrt(2))), within 4 / sqrt(n) of the draws."""
    from scipy.stats import norm

    modes = 0.1 * np.eye(2)
    found = probability_of_lowest(np.array([0.0, 0.1]), modes, np.random.default_rng(1))
    assert found[0] == pytest.approx(norm.cdf(0.1 / (0.1 * np.sqrt(2))), abs=4 * 0.5 / np.sqrt(20_000))
    assert found.sum() == pytest.approx(1)


def test_what_is_common_does_not_blur_the_best():
    """A common error of 50 % beside own ones of 1 %."""
    modes = np.column_stack([np.full(3, 0.5), 0.01 * np.eye(3)])
    rng = np.random.default_rng(2)
    assert probability_of_lowest(np.array([0.0, 0.06, 0.06]), modes, rng)[0] > 0.999
    equal = probability_of_lowest(np.zeros(3), np.full((3, 1), 0.5), rng)
    np.testing.assert_allclose(equal, 1 / 3)


def test_points_without_a_score_are_never_the_best():
    sigma = np.array([np.nan, 3.0, 2.0, np.nan])
    modes = np.array([[0, 0], [0.01, 0], [0, 0.01], [0, 0]])
    comparison = compare(sigma, modes, np.random.default_rng(1))
    assert comparison.reference == 1 and comparison.best == (2,)
    for name in ROWS:
        assert list(np.isnan(getattr(comparison, name))) == [True, False, False, True]
    np.testing.assert_allclose(comparison.ratio[1:3], [1, 2 / 3])
    np.testing.assert_allclose(comparison.paired_error[1:3], [0, 2 / 3 * 0.01 * np.sqrt(2)])
    none = compare(np.full(2, np.nan), np.zeros((2, 1)), np.random.default_rng(1))
    assert none.reference is None and none.best == () and np.isnan(none.best_probability).all()


def test_comparisons_are_repeatable(levels):
    one, two = (compare_runs(levels[0].points, np.random.default_rng(5)) for _ in range(2))
    for name in ROWS:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


# ---------------------------------------------------------------- files


def test_files_of_a_sweep(levels):
    result, out = levels
    content = json.loads((out / "summary.json").read_text())
    assert content["files"] == ["figures/sweep.png", "report.html", "scene.json", "sweep.ecsv", "sweep_pairs.ecsv"]
    assert sorted(path.name for path in out.iterdir()) == sorted(["figures", *FILES])
    assert content["seed"] == 11 and content["best"] == [0, 2] and content["kind"] == "simulated"
    assert content["axes"][0]["values"] == [["2.5 mK2 / Hz"], ["10 mK2 / Hz"], ["2500000 uK2 / Hz"]]
    assert len({point["scene_sha256"] for point in content["points"]}) == 2  # two points are one scene
    assert content["points"][1]["ratio"] == pytest.approx(4, rel=1e-5)
    assert len(content["run"]["point_s"]) == 3 and content["run"]["wall_s"] > 0
    table = Table.read(out / "sweep.ecsv", format="ascii.ecsv")
    np.testing.assert_allclose(table["detector.psd"], [2.5, 10, 2.5])
    assert str(table["detector.psd"].unit) == "mK2 / Hz" and str(table["sigma_actual"].unit) == "uK2"
    assert table.meta["reference"] == 0 and table.meta["best"] == [0, 2] and list(table["n_det"]) == [18] * 3
    np.testing.assert_array_equal(table["ratio"], result.comparison.ratio)
    assert table["forecast_actual"][1] == pytest.approx(4 * table["forecast_actual"][0])


def test_each_point_has_the_files_of_a_run(levels, tmp_path):
    """Those of its scene run alone, less maps, figures and sums; the page of the sweep leads there."""
    result, out = levels
    run(result.sweep.points[1].scene, tmp_path / "alone", engine=SERIAL, figures=False)
    content = json.loads((out / "points" / "1" / "summary.json").read_text())
    kept = {path.relative_to(out / "points" / "1").as_posix() for path in (out / "points" / "1").rglob("*.*")}
    assert {*content["files"], "scene.toml", "summary.json", RECORD} == kept
    alone = json.loads((tmp_path / "alone" / "summary.json").read_text())
    assert set(alone["files"]) - set(content["files"]) == {"maps/actual.fits"}
    assert content["scores"] == alone["scores"] and content["scene_sha256"] == alone["scene_sha256"]
    for name in content["files"]:
        if name.startswith("tables/"):
            assert (out / "points" / "1" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()
    (link,) = [item for item in read_page(out / "report.html").all("a") if "points/1" in item.attributes["href"]]
    title = read_page(out / "points" / "1" / "report.html").one("h1").text
    assert title.endswith(": detector.psd = 10 mK²/Hz") and content["point"] == "detector.psd = 10 mK2 / Hz"
    assert link.text == "10 mK²/Hz" and link.attributes["href"] == "points/1/report.html"


def test_all_of_a_point_is_kept_if_asked(write, tmp_path, blank_figures):
    run_sweep(write(WHITE + '\n[sweep]\n"scan.scans" = [4]\n'), tmp_path, engine=SERIAL, figures=False, keep_all=True)
    point = tmp_path / "points" / "0"
    assert (point / "maps" / "actual.fits").is_file() and (point / "figures" / "map_psd.png").is_file()
    assert not (point / "checkpoint.h5").exists()


def test_the_scene_of_a_point_is_no_sweep(levels, tmp_path):
    _, out = levels
    again = load_scene(out / "points" / "1" / "scene.toml")
    assert scene_hash(again) == json.loads((out / "points" / "1" / "summary.json").read_text())["scene_sha256"]
    assert "[sweep]" not in (out / "points" / "1" / "scene.toml").read_text()


def test_files_of_the_user_in_place_of_a_point(write, tmp_path):
    """They are found before the work starts, and stay."""
    (tmp_path / "points" / "1").mkdir(parents=True)
    (tmp_path / "points" / "1" / "summary.json").write_text("mine")
    with pytest.raises(OutputError, match="points/1/summary.json: not written by this program"):
        run_sweep(write(WHITE + SPEEDS), tmp_path, engine=SERIAL)
    assert sorted(path.name for path in tmp_path.rglob("*.*") if path.name != ".surveysim.lock") == ["summary.json"]


def test_a_new_run_takes_the_place_of_an_old_one(write, levels, tmp_path):
    path = write(WHITE + SPEEDS)
    run_sweep(path, tmp_path, engine=SERIAL)
    (tmp_path / "points" / "mine.npz").write_text("mine")
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="holds results of .white. with other settings; --force replaces them, --out"):
        run(load_scene(path), tmp_path, engine=SERIAL, figures=False)
    run(load_scene(path), tmp_path, engine=SERIAL, figures=False, force=True)
    assert not (tmp_path / "sweep.ecsv").exists() and not (tmp_path / "figures" / "sweep.png").exists()
    assert [item.name for item in (tmp_path / "points").iterdir()] == ["mine.npz"]
    run_sweep(path, tmp_path, engine=SERIAL, figures=False, force=True)
    assert sorted(item.name for item in tmp_path.iterdir() if item.is_file() or any(item.iterdir())) == sorted(
        ["mine.txt", *FILES]
    )
    run_sweep(write(WHITE + SPEEDS.replace(', "5 arcmin / s"', "")), tmp_path, engine=SERIAL, figures=False, force=True)
    assert sorted(item.name for item in (tmp_path / "points").iterdir()) == ["0", "1", "mine.npz"]


def test_points_without_a_score_are_listed(write, levels, tmp_path):
    """One observation has no sign-flipped noise."""
    result = run_sweep(write(WHITE + "\n[sweep]\nobservations = [1, 4]\n"), tmp_path, engine=SERIAL)
    assert result.comparison.reference == 1 and result.comparison.best == (1,)
    content = json.loads((tmp_path / "summary.json").read_text())
    assert "2 or more are expected" in content["points"][0]["unscored"] and "ratio" not in content["points"][0]
    table = Table.read(tmp_path / "sweep.ecsv", format="ascii.ecsv")
    assert "2 or more are expected" in table["unscored"][0] and np.isnan(table["sigma_actual"][0])
    # One alone is not the best of anything.
    assert best_line(result).startswith("lowest: observations = 4")
    assert result.withheld(1) == content["points"][1]["best_probability_withheld"] == "no other point has a score"
    assert "best_probability" not in content["points"][1]


def test_three_observations_do_not_tell_how_far_the_forecast_is_off(write, tmp_path):
    result = run_sweep(write(WHITE + "\n[sweep]\nobservations = [3]\n"), tmp_path, engine=SERIAL)
    off = result.points[0].off
    assert np.isfinite(off[0]) and np.isnan(off[1])
    said = f"forecast over simulated, less 1: at worst {plain(quoted_share(off[0], None))}, observations = 3"
    assert next(forecast_lines(result)) == said
    kept = json.loads((tmp_path / "summary.json").read_text())["points"][0]["forecast_over_simulated"]
    assert kept == {"sigma": off[0], "sigma_error": None}
    page = (tmp_path / "report.html").read_text()
    assert "± unknown" in page[page.index('id="agreement-table"') :]


def test_nothing_scored_at_all(write, tmp_path):
    result = run_sweep(write(WHITE + '\n[sweep]\nobservations = [1]\n"scan.scans" = [4]\n'), tmp_path, engine=SERIAL)
    assert result.comparison.best == () and not (tmp_path / "figures").exists()


# ---------------------------------------------------------------- workers and interruption


def interrupted(sweep, out, monkeypatch):
    """Run three points of four observations until the third observation of the second point."""
    observe, calls = survey.observe, []

    def stop(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 7:
            raise KeyboardInterrupt
        return observe(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(survey, "observe", stop)
        with pytest.raises(KeyboardInterrupt):
            run_sweep(sweep, out, engine=SERIAL, figures=False)


def test_two_workers_and_an_interruption_give_the_same_table(write, tmp_path, monkeypatch, two_threads):
    path = write(WHITE + SPEEDS)
    one, two, three = (tmp_path / name for name in ("one", "two", "three"))
    run_sweep(path, one, engine=SERIAL, figures=False)
    run_sweep(path, two, engine=Engine(workers=2), figures=False)
    interrupted(path, three, monkeypatch)
    assert sorted(file.name for file in (three / "points").iterdir()) == ["0", "000.npz", "001.checkpoint.h5"]
    observe, calls, seen = survey.observe, [], []

    def count(*arguments, **options):
        calls.append(arguments[1])
        return observe(*arguments, **options)

    monkeypatch.setattr(survey, "observe", count)
    run_sweep(path, three, engine=SERIAL, resume=True, figures=False, progress=seen.append)
    assert calls == [2, 3, 0, 1, 2, 3] and seen == [2, 3]
    assert (one / "sweep.ecsv").read_bytes() == (two / "sweep.ecsv").read_bytes() == (three / "sweep.ecsv").read_bytes()
    assert sorted(item.name for item in three.iterdir()) == FILES
    assert sorted(item.name for item in (three / "points").iterdir()) == ["0", "1", "2"]
    for name in ("scores", "map_psd", "observations", "timestream_psd"):
        for number in range(3):
            tables = [(folder / f"points/{number}/tables/{name}.ecsv").read_bytes() for folder in (one, two, three)]
            assert tables[0] == tables[1] == tables[2]


@pytest.mark.parametrize("kind", ["000.npz", "001.checkpoint.h5"])
@pytest.mark.parametrize("damage", ["damaged", "from another scene", "from another version"])
def test_wrong_files_of_points(write, tmp_path, monkeypatch, kind, damage):
    path = write(WHITE + SPEEDS)
    interrupted(path, tmp_path, monkeypatch)
    file = tmp_path / "points" / kind
    if kind != "000.npz":  # that of the first point would be refused before
        (tmp_path / "points" / "000.npz").unlink()
    if damage == "damaged":
        file.write_bytes(file.read_bytes()[:-100])
    if damage == "from another version":
        for module in ("survey.checkpoint", "studies.sweep.point_store"):
            monkeypatch.setattr(f"surveysim.{module}.__version__", "0.0.1")
    sweep = load_sweep(path, {"scan.scans": 3} if damage == "from another scene" else {})
    if damage == "from another scene":
        with pytest.raises(OutputError, match="holds an unfinished run of .white. with other settings"):
            run_sweep(sweep, tmp_path, engine=SERIAL, resume=True)
        for name in (RECORD, "scene.toml"):
            (tmp_path / name).unlink()
        shutil.rmtree(tmp_path / "points" / "0")
    with pytest.raises(CheckpointError, match=damage) as caught:
        run_sweep(sweep, tmp_path, engine=SERIAL, resume=True)
    hint = "--resume" if damage == "damaged" else "--force"
    assert str(caught.value).startswith(f"{file}: ") and hint in str(caught.value)


def test_points_come_back_from_their_files(levels, tmp_path):
    point = levels[0].points[1]
    save_point(tmp_path / "000.npz", point, scene_hash(levels[0].sweep.points[1].scene))
    again = load_point(tmp_path / "000.npz", levels[0].sweep.points[1], 4)
    assert isinstance(again, PointResult) and again.forecast_ukcmb2 == point.forecast_ukcmb2
    assert (again.n_det, again.skies, again.unscored, again.wall_s) == (18, point.skies, "", point.wall_s)
    one, other = point.scores["actual"], again.scores["actual"]
    assert one.budget == other.budget and one.band.sigma_ukcmb2 == other.band.sigma_ukcmb2
    np.testing.assert_array_equal(error_modes([one], "a"), error_modes([other], "a"))


def test_a_full_disk_leaves_no_half_of_a_point(levels, tmp_path, monkeypatch):
    def full(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OSError, match="No space"):
        save_point(tmp_path / "000.npz", levels[0].points[0], "abc")
    assert not list(tmp_path.iterdir())


def test_failures_name_their_point(write, monkeypatch):
    observe = survey.observe

    def fail(setup, *rest, **options):
        if setup.scene.scan.speed_rad_s > 0.001:
            raise InputError("no strip is long enough")
        return observe(setup, *rest, **options)

    monkeypatch.setattr(survey, "observe", fail)
    with pytest.raises(InputError, match=r"point \(scan.speed = 4 arcmin / s\): no strip is long enough"):
        run_sweep(write(WHITE + SPEEDS), engine=SERIAL)


def test_files_of_a_longer_sweep_are_refused(write, levels, tmp_path):
    (tmp_path / "points").mkdir()
    save_point(tmp_path / "points" / "003.npz", levels[0].points[0], "abc")
    with pytest.raises(CheckpointError, match=r"003.npz: from another sweep \(this one has 3 points\); start anew"):
        run_sweep(write(WHITE + SPEEDS), tmp_path, engine=SERIAL, resume=True)


def test_workers_are_checked(write):
    with pytest.raises(ValueError, match="workers: found 0"):
        run_sweep(write(WHITE + SPEEDS), engine=Engine(workers=0))


# ---------------------------------------------------------------- forecasts and figures


def test_forecasts_take_the_same_points(write, levels, tmp_path):
    seen = []
    result = forecast_sweep(levels[0].sweep, tmp_path, progress=seen.append)
    assert seen == [1, 2, 3] and not result.simulated
    np.testing.assert_allclose(result.comparison.ratio, [1, 4, 1])
    for one, other in zip(result.points, levels[0].points, strict=True):
        assert one.forecast_ukcmb2 == pytest.approx(other.forecast_ukcmb2, rel=1e-12)
    table = Table.read(tmp_path / "sweep.ecsv", format="ascii.ecsv")
    assert "ratio" in table.colnames and not any("error" in name or "sigma" in name for name in table.colnames)
    assert (tmp_path / "figures" / "sweep.png").exists() and best_line(result).endswith("uK_CMB^2 by forecast")
    kinds = [[series.kind for series in panel.series] for panel in sweep_figure(result).panels]
    assert kinds == [["points"]] * 2  # of two equal values: a row of steps
    by_value = _at(result, "2.5 mK2 / Hz", "10 mK2 / Hz", "2600000 uK2 / Hz")
    for panel in sweep_figure(by_value).panels:
        line, points = panel.series
        assert (line.kind, points.kind) == ("line", "points")
        np.testing.assert_array_equal(points.x, [2.5, 2.6, 10])
        np.testing.assert_array_equal(points.y, line.y)


def test_points_that_cannot_be_forecast_say_why(write, levels, monkeypatch):
    def refuse(scene):
        raise SceneError("cleaning.algorithm: found 'pca'")

    monkeypatch.setattr("surveysim.studies.sweep.comparison.forecast", refuse)
    points = forecast_points(levels[0].sweep, lambda done: None)
    assert [(point.unscored, point.forecast_ukcmb2) for point in points] == [
        ("cleaning.algorithm: found 'pca'", {})
    ] * 3


def _spread(result, axes):
    """The same points as if they were on other axes."""
    places = list(np.ndindex(*(len(axis.values) for axis in axes)))
    points = tuple(
        replace(result.sweep.points[0], number=number, place=place, settings={}) for number, place in enumerate(places)
    )
    results = tuple(result.points[number % 2] for number in range(len(points)))
    comparison = compare_runs(results, np.random.default_rng(1))
    return replace(result, sweep=replace(result.sweep, axes=axes, points=points), points=results, comparison=comparison)


def _at(result, *values):
    """The same points as if their first key had these values."""
    axis = replace(result.sweep.axes[0], values=tuple((value,) for value in values))
    return replace(result, sweep=replace(result.sweep, axes=(axis,)))


def test_figure_of_one_axis(levels):
    result = _at(levels[0], "2.5 mK2 / Hz", "10 mK2 / Hz", "2600000 uK2 / Hz")
    figure = sweep_figure(result)
    level, ratio = figure.panels
    assert level.x_label == "detector.psd [mK2 / Hz]" and "2.5 mK2 / Hz" in figure.caption
    forecast, simulated = level.series
    assert (forecast.kind, simulated.kind) == ("line", "points")
    np.testing.assert_allclose(simulated.x, [2.5, 2.6, 10])  # by value, not by number
    sigma, error = (getattr(levels[0].comparison, name)[[0, 2, 1]] for name in ("value", "error"))
    np.testing.assert_array_equal(simulated.y, sigma)
    np.testing.assert_array_equal(simulated.high, sigma + error)
    assert "Bars are Monte Carlo errors" in figure.caption
    unknown = replace(result.comparison, error=np.full(3, np.nan))
    assert "Errors are not known" in sweep_figure(replace(result, comparison=unknown)).caption
    apart, paired = ratio.series
    assert apart.look == "grey" and (paired.high - paired.low <= apart.high - apart.low + 1e-9).all()


def test_figure_keeps_points_of_one_value_apart(levels, tmp_path):
    """2.5 mK^2 / Hz and 2500000 uK^2 / Hz are one number: the steps stand in a row, each with its own tick."""
    level, ratio = sweep_figure(levels[0]).panels
    forecast, simulated = level.series
    assert level.x_label == "detector.psd" and not level.x_log and forecast.kind == "points"
    for series in (*level.series, *ratio.series):
        np.testing.assert_array_equal(series.x, [0, 1, 2])
    np.testing.assert_array_equal(simulated.y, levels[0].comparison.value)
    keys = Axis("camera", ("a.extent", "a.pitch"), (("12 arcmin", 0.8), ("8 arcmin", 0.8), ("12 arcmin", 1.2)))
    result = replace(levels[0], sweep=replace(levels[0].sweep, axes=(keys,)))
    assert _ticks(result) == [f"extent = {a} arcmin\npitch = {b}" for a, b in ((12, 0.8), (8, 0.8), (12, 1.2))]
    np.testing.assert_array_equal(sweep_figure(result).panels[0].series[-1].x, [0, 1, 2])
    assert draw_sweep(tmp_path / "sweep.png", result).exists()


def test_figure_of_two_axes_has_a_line_for_each_value_of_the_second(levels, tmp_path):
    axes = (Axis("algorithm", ("a",), (("average",), ("planar",))), Axis("rings", ("b",), ((2,), (3,), (4,))))
    result = _spread(levels[0], axes)
    labels = [series.label for series in sweep_figure(result).panels[0].series]
    assert [label for label in labels if label] == ["rings = 2", "rings = 3", "rings = 4"]
    assert draw_sweep(tmp_path / "sweep.png", result).exists()


def test_lines_with_one_label_stay_apart(levels):
    """Lists that differ beyond what a label shows."""
    dead = [list(range(n)) for n in (30, 31)]
    axes = (Axis("a", ("a",), ((1,), (2,))), Axis("dead", ("b",), tuple((item,) for item in dead)))
    series = sweep_figure(_spread(levels[0], axes)).panels[0].series
    assert [len(item.x) for item in series] == [2, 2, 2, 2]
    assert [item.label.rpartition(" ")[2] for item in series[1::2]] == ["#0", "#1"]


def test_figure_of_many_lines_has_points_in_a_row(levels):
    axes = (Axis("a", ("a",), ((1,), (2,))), Axis("b", ("b",), tuple((n,) for n in range(11))))
    panel = sweep_figure(_spread(levels[0], axes)).panels[0]
    assert panel.x_label == "point" and len(panel.series[-1].x) == 22


def test_wide_axes_are_logarithmic(levels):
    axes = (Axis("a", ("a",), ((1,), (10,))),)
    assert sweep_figure(_spread(levels[0], axes)).panels[0].x_log
    axes = (Axis("a", ("a",), ((0,), (10,))),)
    assert not sweep_figure(_spread(levels[0], axes)).panels[0].x_log


def test_table_of_text_values(levels):
    result = levels[0]
    points = tuple(
        replace(point, settings={"cleaning.algorithm": ["planar", "local"]}) for point in result.sweep.points
    )
    table = sweep_table(sweep_summary(replace(result, sweep=replace(result.sweep, points=points)), ()))
    assert table.in_files["cleaning.algorithm"].tolist() == ["planar+local"] * 3


def test_a_sweep_in_a_notebook(levels):
    """A few lines, the table of its points, and its figure."""
    result, _ = levels
    assert repr(result).startswith("SweepResult of ") and len(repr(result).splitlines()) == 2 + len(result.points)
    found = result.table()
    assert list(found["sigma_actual"].to_value("uK2")) == list(result.comparison.value)
    assert result._repr_html_().count("<tr>") == 1 + len(result.points) and len(result.plot().axes) == 2
