"""Stress cases: scenes and inputs at the limits of their ranges and beyond, with known answers.

Each case states why its answer is known: a closed form, a scaling, an invariance, or a refusal. No case may end in NaN
or infinity, hang, or silently lose more than three digits.
"""

from surveysim.studies.stress.case import Case, Outcome, base_scene, run_case
from surveysim.studies.stress.cases import CASES

__all__ = ["CASES", "Case", "Outcome", "base_scene", "run_case"]
