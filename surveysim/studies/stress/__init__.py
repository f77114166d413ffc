"""Scenes and inputs at the edge of what is allowed, and beyond: what comes out, and what must.

Each case says why its answer is known: a closed form, a scaling, an invariance, or that it must be refused. None may
end in NaN or infinity, hang, or lose more than three digits in silence.
"""

from surveysim.studies.stress.case import Case, Outcome, base_scene, run_case
from surveysim.studies.stress.cases import CASES

__all__ = ["CASES", "Case", "Outcome", "base_scene", "run_case"]
