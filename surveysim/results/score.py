"""The scores: quantities that a survey's co-added maps measure, for each data set."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from surveysim.forecasting.forecast import Forecast
from surveysim.reduction.setup import Setup
from surveysim.results.agreement import run_forecast
from surveysim.results.alternatives import alternatives
from surveysim.results.control_variate import quoted_scores
from surveysim.results.gains import data_set_gains
from surveysim.results.tables import score_table
from surveysim.runtime.table import Table
from surveysim.scene.scene import Scene
from surveysim.survey.coadds import CoAdds
from surveysim.survey.scores import DataSetScore, Gain

Scores = dict[str, DataSetScore]


@dataclass(frozen=True)
class SurveyScore:
    """A score of surveys.

    Parameters
    ----------
    name
    section
        Section of the scene that asks for it.
    measure
        Function that scores the co-adds, by data set, with their errors; raises InsufficientDataError.
    gains
        Function that compares the scores of data sets.
    alternatives
        Function that scores the same data otherwise, a row each.
    forecast
        Function that forecasts the scores of a run's observations; None where there is no closed form.
    table
        Function that makes the table of scores, with titles and units, from the entries of summary.json and the source
        of reference values.
    """

    name: str
    section: str
    measure: Callable[[Setup, CoAdds], Scores]
    gains: Callable[[Setup, Scores], dict[str, Gain]]
    alternatives: Callable[[Setup, CoAdds, Scores], list[dict[str, float | str]]]
    forecast: Callable[[Setup, CoAdds], Forecast | None]
    table: Callable[[dict[str, Any], str], Table]


FLAT_BAND_POWER = SurveyScore(
    "flat_band_power",
    "score",
    measure=quoted_scores,
    gains=data_set_gains,
    alternatives=alternatives,
    forecast=run_forecast,
    table=score_table,
)
SCORES = (FLAT_BAND_POWER,)


def scene_score(scene: Scene) -> SurveyScore | None:
    """Find the score that the scene has a section for; None without one."""
    return next((item for item in SCORES if getattr(scene, item.section) is not None), None)
