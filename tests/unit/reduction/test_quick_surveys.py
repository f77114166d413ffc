"""Surveys that one process simulates as soon as workers would have started."""

import pytest

from surveysim.reduction.setup import is_quick, prepare
from surveysim.scene.scene import load_scene
from surveysim.scene.shipped import find_scene


@pytest.mark.parametrize(
    ("name", "observations", "target_error", "quick"),
    [
        ("first_light", 12, None, True),
        ("lynx", 500, None, False),
        ("lynx", 500, 0.03, True),
        ("lynx", 500, 0.01, False),
    ],
)
def test_surveys_of_a_second_are_quick(name, observations, target_error, quick):
    scene = load_scene(find_scene(name))
    assert scene.observations == observations and is_quick(prepare(scene), target_error) is quick
