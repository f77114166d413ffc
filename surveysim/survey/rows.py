"""Row of each observation: conditions, cleaning, figures of merit and noise."""

import numpy as np

from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.figure_of_merit import TARGETS
from surveysim.reduction.observation_result import ObservationResult

ROW_FIELDS = (
    "observation",
    "b2_mk2",
    "wind_speed_rad_s",
    "wind_angle_rad",
    "pwv_mm",
    "elevation_rad",
    "white_mk2_hz",
    "flagged",
)


def row_of(result: ObservationResult) -> tuple[float, ...]:
    """Return the values of an observation in the order of `row_names`."""
    weather = result.weather
    drawn = (np.nan,) * 4
    if weather is not None:
        drawn = (weather.b2, weather.wind_speed_rad_s, weather.wind_angle_rad, weather.pwv_mm)
    conditions = (result.observation, *drawn, result.elevation_rad, result.white_mk2_hz, result.flagged)
    cleaning = (*result.discarded, *result.iterations, *result.removed)
    figures_of_merit = () if result.figures_of_merit is None else result.figures_of_merit.T.ravel()
    return (*conditions, *cleaning, *figures_of_merit, *result.noise_mk2)


def row_names(analysis: AnalysisSetup) -> list[str]:
    """List the names of the values in a row of `CoAdds.rows`."""
    of_pipelines = [
        f"{what}_{pipeline.data_set}"
        for what in ("discarded", "iterations", "removed")
        for pipeline in analysis.pipelines
    ]
    whole = analysis.whole_pipelines if analysis.chooses else ()
    figures_of_merit = [f"merit_{target}_{pipeline.data_set}" for target in TARGETS for pipeline in whole]
    return [
        *ROW_FIELDS,
        *of_pipelines,
        *figures_of_merit,
        *(f"noise_mk2_{name}" for name in analysis.data_set_names),
    ]
