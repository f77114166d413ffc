"""The Python interface of forecasts of scenes of one band."""

from pathlib import Path

from surveysim.api.surveys import scene_as_given
from surveysim.forecasting.forecast import Forecast
from surveysim.forecasting.forecast import forecast as forecast_scene
from surveysim.output.directory import claimed, replacing
from surveysim.output.expected_files import of_forecast
from surveysim.output.writer import write_forecast
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import Scene


def forecast_survey(scene: Scene | str | Path, out: str | Path | None = None, *, force: bool = False) -> Forecast:
    """Forecast the scores of a scene of one band; parameters and errors are those of `surveysim.forecast`."""
    scene = scene_as_given(scene)
    found = forecast_scene(prepare(scene))
    if out is not None:
        with claimed(Path(out), of_forecast(scene), force) as place, replacing(place) as new:
            write_forecast(new, found)
    return found
