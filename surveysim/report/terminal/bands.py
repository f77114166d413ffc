"""Results of a camera of several bands on the terminal: a row for each band; those of each band with --verbose."""

from pathlib import Path
from typing import TYPE_CHECKING

from surveysim.reduction.setup import prepare
from surveysim.report.terminal.forecast import print_forecast
from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.plan import print_plan
from surveysim.report.terminal.survey import error_warnings, print_result, print_warnings, stop_lines, where_line
from surveysim.report.terminal.tables import show_table
from surveysim.results.bands import MultiBandForecast, MultiBandResult, band_table, forecast_entries, run_entries
from surveysim.scene.bands import MultiBandScene

if TYPE_CHECKING:
    from surveysim.studies.resources import Plan


def print_bands(result: MultiBandResult, directory: Path, verbose: bool = False) -> None:
    """Print a row for each band, warnings and where the files are.

    Parameters
    ----------
    result : MultiBandResult
        The runs.
    directory : Path
        Folder of their files.
    verbose : bool
        Also print all tables of each band.
    """
    console = Terminal()
    for name, item in result.bands.items():
        for line in stop_lines(item):
            console.say(f"{name}: {line}\n")
        if verbose:
            print_result(item, directory / "bands" / name, verbose)
            console.say("")
    table = band_table(run_entries(result), {})
    show_table(console, table, title=f"{result.scenes.title}: uncertainty of a flat CMB band power")
    for name, item in result.bands.items():
        if item.unscored:
            console.say(f"Not scored: {name}: {item.unscored}")
        print_warnings(console, [f"{name}: {line}" for line in (*item.warnings, *error_warnings(item))])
    done = f"{len(result.bands)} bands in {result.wall_s:.1f} s with {result.workers} worker(s)"
    console.say(f"\n{done}\n{where_line(directory, 'with a page for each band behind')}")


def print_band_forecasts(result: MultiBandForecast, verbose: bool = False) -> None:
    """Print a row for each band, and the forecast of each band with `verbose`."""
    console = Terminal()
    if verbose:
        for name, item in result.bands.items():
            print_forecast(prepare(result.scenes.bands[name]), item, verbose)
    title = f"{result.scenes.title}: forecast of the uncertainty of a flat CMB band power"
    show_table(console, band_table(forecast_entries(result), {}), title=title)
    for name, reason in result.reasons.items():
        console.say(f"No forecast: {name}: {reason}")


def print_band_plans(scenes: MultiBandScene, plans: "dict[str, Plan]", workers: int) -> None:
    """Print the stages and the predicted cost of each band, and the cost of all."""
    for name, plan in plans.items():
        print_plan(scenes.bands[name], plan, workers)
    seconds = sum(plan.wall_s for plan in plans.values())
    memory, output = (
        max(plan.memory_bytes for plan in plans.values()),
        sum(plan.output_bytes for plan in plans.values()),
    )
    Terminal().say(
        f"all {len(plans)} bands, one after another: about {seconds:.0f} s with {workers} worker(s),"
        f" {memory / 1e6:.0f} MB a process, {output / 1e6:.1f} MB of results"
    )
