"""Surveys that one process simulates as soon as workers would have started."""

import pytest

from surveysim.reduction.setup import is_quick, prepare
from surveysim.scene.scene import load_scene
from surveysim.scene.shipped import find_scene


@pytest.mark.parametrize(("name", "observations", "quick"), [("first_light", 12, True), ("lynx", 500, False)])
def test_surveys_of_a_second_are_quick(name, observations, quick):
    scene = load_scene(find_scene(name))
    assert scene.observations == observations and is_quick(prepare(scene)) is quick
