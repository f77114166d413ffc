"""A forecast on the terminal: its scores and warnings; all effects with --verbose."""

from surveysim.forecasting.forecast import Forecast
from surveysim.forecasting.table import forecast_table
from surveysim.reduction.setup import Setup
from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.survey import effect_warnings, print_warnings
from surveysim.report.terminal.tables import show_table
from surveysim.results.control_variate import in_all_weather
from surveysim.results.metric_tables import metric_forecast_notes, metric_forecast_table
from surveysim.results.metrics import forecast_metrics
from surveysim.results.tables import effect_table


def print_forecast(setup: Setup, forecast: Forecast, verbose: bool = False) -> None:
    """Print the forecast of each data set with the reference, and warnings.

    Parameters
    ----------
    setup : Setup
        The scene, prepared.
    forecast : Forecast
        Its forecast.
    verbose : bool
        Also print all effects that the forecast neglects, with their sizes.
    """
    console, scene = Terminal(), setup.scene
    reference = scene.score.reference
    table = forecast_table(
        forecast.scores,
        in_all_weather(setup, forecast),
        source=reference.source if reference else "",
        published=dict(reference.values_ukcmb2) if reference else {},
    )
    show_table(console, table, title=f"{scene.title}: forecast of the uncertainty of a flat CMB band power")
    metrics = forecast_metrics(setup, forecast)
    if further := metric_forecast_table(metrics):
        show_table(console, further, title=f"{scene.title}: forecast of the metrics, over all weather")
        for line in metric_forecast_notes(metrics):
            console.say(line)
    effects = {name: [vars(effect) for effect in item.effects] for name, item in forecast.scores.items()}
    if verbose:
        drawn = f"the weather drawn is that of {scene.observations} observations"
        console.say(f"sigma(A) is for all weather, as a run quotes it; {drawn}.")
        show_table(console, effect_table({name: {"effects": found} for name, found in effects.items()}))
    print_warnings(console, effect_warnings(effects))
