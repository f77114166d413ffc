"""Smooth random processes in time: their correlation, and their repeatability."""

import numpy as np
import pytest

from surveysim.runtime.rng import normal_deviates
from surveysim.telescope.smooth_process import smooth_process

N = 4000


def _drawn(n, duration_s=60.0, time_scale_s=5.0):
    return smooth_process(n, duration_s, time_scale_s, normal_deviates(3, "test"))


def test_correlation():
    """exp(-t^2 / 2 T^2) at any lag and start, also at the two ends; straight lines between knots lose 0.3 %."""
    time_s = np.array([0.0, 0.3, 2.8, 5.3, 10.3, 60.0])
    values = _drawn(N).at(time_s)
    lag = time_s[:, None] - time_s
    expected = np.exp(-(lag**2) / (2 * 5.0**2))
    found = values.T @ values / N
    error = np.sqrt((1 + expected**2) / N)
    assert (np.abs(found - expected) < 4 * error + 0.004).all()


@pytest.mark.parametrize("duration_s", [0.5, 60.0])
def test_realizations_do_not_depend_on_their_number(duration_s):
    """Detectors keep their drifts in a larger camera; parts of the time are parts of the whole."""
    many, few = _drawn(5, duration_s), _drawn(2, duration_s)
    time_s = np.linspace(0, duration_s, 50)
    np.testing.assert_array_equal(many.at(time_s)[:2], few.at(time_s))
    np.testing.assert_array_equal(many.at(time_s[20:], slice(1, 3)), many.at(time_s)[1:3, 20:])
