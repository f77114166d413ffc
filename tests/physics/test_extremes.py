"""Every extreme case has its expected outcome; why, and to which tolerance, stands with the case."""

from dataclasses import replace

import numpy as np
import pytest

from surveysim.runtime.errors import SceneError
from surveysim.studies.stress import CASES, Case, Outcome, base_scene, run_case

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")  # of numpy: none may reach a user


@pytest.mark.parametrize(
    "case", [pytest.param(case, id=case.name, marks=[pytest.mark.slow] if case.slow else []) for case in CASES]
)
def test_case(case):
    outcome = run_case(case)
    assert outcome.ok, (case.why, outcome)


def test_names_are_distinct():
    assert len({case.name for case in CASES}) == len(CASES)


def test_nothing_found_is_not_a_number():
    """Whatever is wrong with a case, a number is found or words are."""
    nan = Case("", "", lambda scene: Outcome(np.nan, 0.0, 1.0, bool(abs(np.nan) <= 1.0)))
    assert not run_case(nan).ok


def test_a_refusal_is_an_outcome():
    found = [case for case in CASES if case.name == "detectors on a line, planar"][0]
    assert run_case(found).ok and run_case(found).note == "refused"
    assert not run_case(replace(found, refusal="")).ok
    assert not run_case(replace(found, refusal="something else")).ok
    answered = [case for case in CASES if case.name == "detectors on a line, average"][0]
    assert not run_case(replace(answered, refusal="independent templates")).ok


def test_other_failures_are_raised():
    def broken(scene):
        raise TypeError("broken")

    with pytest.raises(TypeError, match="broken"):
        run_case(Case("", "", broken))


def test_base_scene_takes_overrides():
    assert base_scene({"scan.scans": 7}).scan.scans == 7
    with pytest.raises(SceneError, match="scan.scans"):
        base_scene({"scan.scans": 0})
