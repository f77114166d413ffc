"""The table of what many detectors and samples cost: its script runs, on next to nothing."""

from tests.benchmark.scaling import measure


def test_a_point_is_measured():
    row = measure(rings=2, wafers=1, rate_hz=50, scans=2)
    assert row["detectors"] == 19 and row["10^6 samples"] == 19 * 2 * 500 / 1e6
    assert row["ns"] > 0 and row["simulations [ns]"] > 0 and row["MB"] > 50
