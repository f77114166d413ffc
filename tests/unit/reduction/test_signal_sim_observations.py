"""Observations that carry the signal simulations."""

import numpy as np
import pytest

from surveysim.reduction.setup import signal_sim_observations
from surveysim.scene.scene import load_scene
from surveysim.scene.shipped import find_scene


def carriers(observations, wanted):
    keys = {"observations": observations, "score.signal_sims.observations": wanted}
    return np.flatnonzero(signal_sim_observations(load_scene(find_scene("lynx"), keys)))


def test_first_pairs_and_then_every_fifth_carry_simulations():
    assert carriers(40, 100).tolist() == [*range(8), 16, 17, 26, 27, 36, 37]
    assert carriers(6, 100).tolist() == [*range(6)]


@pytest.mark.parametrize("wanted", [2, 8, 10, 100])
def test_as_many_as_wanted_carry_simulations_of_a_long_survey(wanted):
    found = carriers(500, wanted)
    assert len(found) == wanted and (found[1::2] == found[::2] + 1).all()


def test_both_scan_directions_carry_simulations_of_a_single_one():
    assert carriers(500, 1).tolist() == [0, 1]


def test_longer_surveys_have_the_same():
    longer = carriers(500, 100)
    assert np.array_equal(carriers(123, 100), longer[longer < 123])


def test_all_nights_of_lynx_carry_simulations():
    gaps = np.diff([0, *carriers(500, 100), 500])
    assert gaps.max() < 50  # four of its forty nights
