"""Sweeps whose points are compared by another metric than sigma(A)."""

import json
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from surveysim import forecast_sweep, load_sweep, run_sweep
from surveysim.report.terminal.sweep import best_line, print_sweep
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.errors import SceneError
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.studies.sweep.axes import sweep_hash
from surveysim.studies.sweep.comparison import Compared, compare, compare_runs
from tests.unit.studies.test_sweep_run import LEVELS, WHITE

METRICS = """
[[score.metrics]]
kind = "array_net"

[[score.metrics]]
kind = "largest_scale"
"""
NET = "array_net.detector_rj"


def scene(metric=NET):
    return f"{WHITE}{METRICS}{LEVELS}".replace("[sweep]\n", f'[sweep]\nmetric = "{metric}"\n')


@pytest.fixture(scope="module")
def finished(write, tmp_path_factory):
    """A finished sweep of the white level, whose first and last point are one scene, and its folder."""
    out = tmp_path_factory.mktemp("net")
    return run_sweep(write(scene()), out, engine=SERIAL), out


def test_points_are_compared_by_the_metric(finished):
    """Twice the NET for four times the PSD of the same noise."""
    result, _ = finished
    found = result.comparison
    assert found.quantity == Compared(NET, "mK s(1/2)") and found.best == (0, 2)
    np.testing.assert_array_equal(found.value, [point.metrics["actual"][NET].value for point in result.points])
    np.testing.assert_array_equal(found.error, [point.metrics["actual"][NET].error for point in result.points])
    np.testing.assert_allclose(found.ratio, [1, 2, 1], rtol=1e-5)
    assert (found.paired_error < 1e-4).all() and found.independent_error[1] > 0.05
    by_sigma = compare_runs(result.points, np.random.default_rng(1))
    assert by_sigma.quantity.key == SIGMA_KEY
    np.testing.assert_allclose(by_sigma.ratio, [1, 4, 1], rtol=1e-5)
    assert found.independent_error[1] == pytest.approx(by_sigma.independent_error[1] / 4, rel=1e-3)


def test_metrics_are_in_files_and_pages(finished, capsys):
    result, out = finished
    table = Table.read(out / "sweep.ecsv", format="ascii.ecsv")
    content = json.loads((out / "summary.json").read_text())
    assert table.meta["metric"] == content["metric"]["key"] == NET
    for name, value in ((NET, "value"), (f"error_{NET}", "error"), (f"forecast_{NET}", "forecast")):
        assert str(table[name].unit) == "mK s(1/2)"
        assert list(table[name]) == [point["metrics"][NET][value] for point in content["points"]]
    assert {"largest_scale.ell", "error_largest_scale.ell", "sigma_actual"} <= set(table.colnames)
    assert best_line(result).startswith("best: detector.psd = ") and f"{NET} = " in best_line(result)
    assert "mK sqrt(s), each with confidence 50 %" in best_line(result)
    print_sweep(result, out)
    assert NET in capsys.readouterr().out
    page = (out / "report.html").read_text().replace("<wbr>", "")
    assert f"Ratios are of {NET}." in page and f"{NET} [mK sqrt(s)]" in page


def test_forecast_sweeps_compare_by_the_metric(write):
    found = forecast_sweep(write(scene())).comparison
    np.testing.assert_allclose(found.ratio, [1, 2, 1], rtol=1e-9)
    assert found.quantity.key == NET and found.best == (0, 2)


def test_higher_may_be_better():
    """The same points, the other way round."""
    value, modes = np.array([1.0, 4.0, 3.9, np.nan]), 0.1 * np.eye(4)
    low = compare(1 / value, modes, np.random.default_rng(1))
    high = compare(value, modes, np.random.default_rng(1), quantity=Compared("speed", "", lower_is_better=False))
    assert low.best == high.best == (1,)
    np.testing.assert_array_equal(low.best_probability, high.best_probability)
    np.testing.assert_allclose(low.ratio, 1 / high.ratio)
    np.testing.assert_allclose(low.paired_error / low.ratio, high.paired_error / high.ratio)


def test_a_metric_without_a_value_is_no_score(write):
    """Scans without cleaning leave more than half of the power at all multipoles of a forecast."""
    result = forecast_sweep(write(scene("largest_scale.ell")))
    assert result.comparison.best == () and result.comparison.reference is None


@pytest.mark.parametrize("metric", ["array_net.depth", "nothing", "cluster.depth_y0"])
def test_unknown_metrics_are_refused(write, metric):
    expected = f"sweep.metric: found {metric!r}; one of flat_band_power.sigma, array_net.array_rj, "
    with pytest.raises(SceneError, match=expected):
        load_sweep(write(scene(metric)))


def test_the_default_metric_changes_no_hash(write):
    sweep = load_sweep(write(scene(SIGMA_KEY)))
    assert sweep_hash(sweep) == sweep_hash(load_sweep(write(f"{WHITE}{METRICS}{LEVELS}")))
    assert sweep_hash(sweep) != sweep_hash(replace(sweep, metric=NET))
