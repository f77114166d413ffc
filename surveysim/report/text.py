"""Results and plans as text: tables on the terminal."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from surveysim.forecast import NEGLECTED
from surveysim.plan import Plan, SweepPlan
from surveysim.recipes import ACTUAL
from surveysim.report.page import REPORT
from surveysim.results import (
    COMPARED_ELL,
    Row,
    SurveyResult,
    forecast_agreement,
    method,
    score_rows,
    summary,
)
from surveysim.scene import Scene
from surveysim.stopping import UNLIMITED
from surveysim.sweep import Sweep
from surveysim.trade import SURE, SweepResult

if TYPE_CHECKING:
    from astropy.table import Table as AstropyTable

    from surveysim.forecast import Forecast

# What a forecast is good to; a report says where one is worse.
FORECAST_SIGMA, FORECAST_PSD = 0.1, 0.15


def print_result(result: SurveyResult, directory: Path) -> None:
    """Score table beside the reference, gains, what is assumed, time taken and where the files are."""
    console = _console()
    for line in stop_lines(result):
        console.print(f"{line}\n", highlight=False, markup=False)
    if len(result.setup.whole_recipes) > 1:
        console.print(_cleaning_table(result))
    if result.scores:
        console.print(_score_table(result))
        for line in (*survey_lines(result), *gain_lines(result), *agreement_lines(result)):
            console.print(line, highlight=False)
        console.print()
        if result.alternatives:
            console.print(_alternative_table(result))
        console.print("\nMethod, where the reference leaves it open:", highlight=False)
        setup = result.setup
        for line in method(setup.chooses, setup.scene.instrument.bandwidth, setup.band.scored_correlation):
            console.print(f"  - {line}", highlight=False, markup=False)
    if result.unscored:
        console.print(f"Not scored: {result.unscored}", highlight=False, markup=False)
    if result.setup.scene.assumed:
        console.print("\nAssumed or calibrated in the scene:", highlight=False)
        for line in result.setup.scene.assumed:
            console.print(f"  - {line}", highlight=False, markup=False)
    console.print(f"\n{closing_line(result)}\n{where_line(directory)}", highlight=False, markup=False)


def _console() -> Console:
    # Off a terminal rich takes 80 columns, in which the tables would break.
    return Console(soft_wrap=True, width=None if sys.stdout.isatty() else 120)


def closing_line(result: SurveyResult) -> str:
    """What was done and how long it took."""
    content = summary(result)
    scans = f"{content['scans_discarded']} of {content['scans']} scans discarded"
    return (
        f"{content['observations']} observations, {content['detector_samples'] / 1e6:.4g} million "
        f"detector-samples, {scans}, {result.wall_s:.1f} s with {result.workers} worker(s)"
    )


def where_line(directory: Path) -> str:
    """Where the results are, and the page that has them all."""
    return f"Results in {directory}, all on one page in {directory / REPORT}"


def agreement_lines(result: SurveyResult) -> list[str]:
    """How far the forecast is from the simulation, and where that is more than it should be and than chance."""
    found, (low, high) = forecast_agreement(result), COMPARED_ELL
    if not found:
        return []
    off = ", ".join(f"{name} {100 * item.sigma:+.0f} +- {100 * item.sigma_error:.0f} %" for name, item in found.items())
    lines = [f"  forecast of sigma(A) over simulated, less 1: {off}"]
    lines += [
        f"  forecast of {name}: sigma(A) is worse than {100 * FORECAST_SIGMA:.0f} %"
        for name, item in found.items()
        if abs(item.sigma) > FORECAST_SIGMA + 2 * item.sigma_error
    ]
    worse = [
        f"  forecast of {name}: noise PSD is {100 * item.psd:+.0f} +- {100 * item.psd_error:.0f} % off at"
        f" ell = {item.worst_ell:.0f}"
        for name, item in found.items()
        if abs(item.psd) > FORECAST_PSD + 2 * item.psd_error
    ]
    if all(item.psd != item.psd for item in found.values()):  # no bin was compared
        return lines
    return lines + (worse or [f"  its noise PSDs: within {100 * FORECAST_PSD:.0f} % in all bins from {low} to {high}"])


def survey_lines(result: SurveyResult) -> list[str]:
    """What part of the survey was simulated, sigma(A) with the forecast as control variate, the cost of 1 %."""
    lines, n_obs = [], result.setup.scene.observations
    if result.coadds.done < n_obs:
        lines.append(f"  of the whole survey of {n_obs} observations, judged by {result.coadds.done}")
    if ACTUAL in result.controlled:
        item, band = result.controlled[ACTUAL], result.scores[ACTUAL].band
        plain = f"plain {band.sigma_ukcmb2:.1f} +- {band.error_ukcmb2:.1f}"
        value = f"{item.sigma_ukcmb2:.1f} +- {item.error_ukcmb2:.1f}"
        lines.append(f"  {ACTUAL}, with the forecast as control variate: {value} ({plain})")
    return [*lines, *cost_lines(result)]


def cost_lines(result: SurveyResult) -> list[str]:
    """What an answer to 1 % would take, where this one is not as good."""
    cost, score = result.fine_cost, result.setup.scene.score
    if cost is None or result.estimate.relative_error <= cost.relative_error:
        return []
    needs = [f"{cost.observations} observations"]
    needs += [f"{cost.jackknives} sign flips"] * (cost.jackknives > score.jackknives)
    needs += [f"{cost.skies} window skies"] * (cost.skies > score.window.skies)
    time = f"{cost.seconds / 60:.2g} min" if cost.seconds >= 60 else f"{cost.seconds:.0f} s"
    percent = 100 * cost.relative_error
    return [f"  a {percent:g} % answer would take about {time} with {result.workers} worker(s) ({', '.join(needs)})"]


def stop_lines(result: SurveyResult) -> list[str]:
    """What ended a run that had limits."""
    limits, estimate = result.limits, result.estimate
    if limits == UNLIMITED:
        return []
    reasons = {"target": "the target error was reached", "budget": "the time budget was spent"}
    reason = reasons.get(result.stopped, "all observations were done")
    line = f"Stopped: {reason}, {result.coadds.done} of {result.setup.scene.observations} observations simulated"
    if estimate:
        line += f"; sigma(A) is known to {100 * estimate.relative_error:.1f} % ({estimate.kind})"
    return [line]


def gain_lines(result: SurveyResult) -> list[str]:
    """Gains between data sets, beside the reference's."""
    reference = result.setup.scene.score.reference
    published = dict(reference.gains) if reference else {}
    lines = []
    for name, item in result.gains.items():
        beside = f"   (reference {published[name]:g})" if name in published else ""
        lines.append(f"  {name} = {item.ratio:.2f} +- {item.error:.2f}{beside}")
    return lines


def _score_table(result: SurveyResult) -> Table:
    reference = result.setup.scene.score.reference
    # As Text: a plain string's square brackets would be taken for markup.
    table = Table(title=Text(f"{result.setup.scene.title}: uncertainty on a flat CMB band power"))
    headings = ["data set", "detectors", "sigma(A) [uK_CMB^2]", "ell_eff", "FWHM"]
    for heading in headings + ["forecast"] * (result.expected is not None):
        table.add_column(Text(heading), justify="left" if heading == "data set" else "right")
    if reference:
        table.add_column(Text(reference.source), justify="right")
        table.add_column("ratio", justify="right")
    for row in score_rows(result):
        table.add_row(*_cells(row, result.expected is not None, reference is not None))
    return table


def _cells(row: Row, with_forecast: bool, with_reference: bool) -> list[str]:
    cells = [
        row.name,
        str(row.n_det),
        f"{row.sigma_ukcmb2:.1f} +- {row.error_ukcmb2:.1f}",
        f"{row.ell_eff:.0f}",
        f"{row.fwhm_ell:.0f}",
    ]
    if with_forecast:
        cells.append("" if row.forecast_ukcmb2 is None else f"{row.forecast_ukcmb2:.1f}")
    if with_reference and row.reference_ukcmb2 is not None:
        cells += [f"{row.reference_ukcmb2:g}", f"{row.sigma_ukcmb2 / row.reference_ukcmb2:.2f}"]
    return cells


def _cleaning_table(result: SurveyResult) -> Table:
    """What each way of cleaning costs and leaves, and of how many observations it is the best."""
    table = Table(title=Text("Cleaning: what it costs, and what it leaves"))
    entries = {recipe.label: summary(result)["cleaning"][recipe.data_set] for recipe in result.setup.whole_recipes}
    first = next(iter(entries.values()))
    shares = {"point_source_flux_removed": "flux removed", "best_for_cmb": "best: CMB"}
    shares["best_for_point_source"] = "best: source"
    headings = ["cleaning", "scans discarded", "iterations", "templates"]
    headings += [f"PSD / high, {hz}" for hz in first["psd_over_white"]]
    for heading in headings + [heading for name, heading in shares.items() if name in first]:
        table.add_column(heading, justify="left" if heading == "cleaning" else "right")
    for label, entry in entries.items():
        cells = [str(entry["scans_discarded"]), f"{entry['mean_iterations']:.1f}", f"{entry['mean_removed']:.2f}"]
        cells += [f"{ratio:.3g}" for ratio in entry["psd_over_white"].values()]
        table.add_row(label, *cells, *(f"{100 * entry[name]:.1f} %" for name in shares if name in entry))
    return table


def _alternative_table(result: SurveyResult) -> Table:
    rows = result.alternatives
    table = Table(title=Text("The same data scored otherwise: sigma(A) [uK_CMB^2]"))
    for name in rows[0]:
        table.add_column(name.replace("_", " "), justify="right")
    for row in rows:
        table.add_row(*(value if isinstance(value, str) else f"{value:.0f}" for value in row.values()))
    return table


def print_plan(scene: Scene, plan: Plan, workers: int) -> None:
    """Stages, what is left out and why, and the predicted cost."""
    console = _console()
    table = Table(title=Text(f"{scene.name}: {scene.title}"))
    for heading in ("stage", "what"):
        table.add_column(heading)
    for name, what in plan.stages.items():
        table.add_row(name, what)
    for name, reason in plan.left_out.items():
        table.add_row(Text(name, style="dim"), Text(f"left out: {reason}", style="dim"))
    console.print(table)
    made = "one block of an observation" if "blocks" in plan.stages else "a few observations"
    lines = (
        f"about {_seconds(plan.wall_s)} s with {workers} worker(s), {_seconds(plan.figures_s)} s of it for figures, "
        f"predicted from {made} made here",
        f"about {plan.memory_bytes / 1e6:.0f} MB a process",
        f"about {plan.output_bytes / 1e6:.1f} MB of results",
        f"about {plan.timestream_bytes / 1e6:.0f} MB of time-streams, if saved",
        f"{plan.detector_samples / 1e6:.4g} million detector-samples",
    )
    console.print("\n".join(lines), highlight=False)


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f}" if seconds < 10 else f"{seconds:.0f}"


def print_sweep_plan(sweep: Sweep, plan: SweepPlan, workers: int) -> None:
    """Axes of a sweep and the predicted cost of its points."""
    console = _console()
    table = Table(title=Text(f"{sweep.name}: {plan.n_points} points"))
    table.add_column("axis")
    table.add_column("values")
    for axis in sweep.axes:
        table.add_row(Text(axis.name), Text(", ".join(axis.labels)))
    console.print(table)
    lines = (
        f"about {plan.wall_s:.0f} s with {workers} worker(s), predicted from the first and the last point",
        f"about {plan.memory_bytes / 1e6:.0f} MB a process",
        f"{plan.detector_samples / 1e6:.4g} million detector-samples",
    )
    console.print("\n".join(lines), highlight=False)


def print_sweep(result: SweepResult, directory: Path) -> None:
    """A row for each point, why points have no score, the reference point, the best one, and where the files are."""
    console = _console()
    console.print(_sweep_table(result))
    for point, item in zip(result.sweep.points, result.points, strict=True):
        if item.unscored:
            console.print(f"Not scored: {point.label}: {item.unscored}", highlight=False, markup=False)
    if result.comparison.reference is not None:
        reference = result.sweep.points[result.comparison.reference].label
        shared = ", their errors those of runs with one seed" if result.simulated else ""
        console.print(f"Ratios are to {reference}{shared}.", highlight=False, markup=False)
        console.print(best_line(result), highlight=False, markup=False)
    for line in _forecast_lines(result):
        console.print(line, highlight=False, markup=False)
    done = f"{len(result.points)} points in {result.wall_s:.1f} s with {result.workers} worker(s)"
    console.print(f"\n{done}\n{where_line(directory)}", highlight=False, markup=False)


def _forecast_lines(result: SweepResult) -> list[str]:
    """How far forecasts are from the simulation at worst, or what they neglect where they stand alone."""
    if not result.simulated:
        return ["The forecast neglects:", *(f"  - {line}" for line in NEGLECTED)]
    comparison, worst = result.comparison, (0.0, "")
    for number, (point, item) in enumerate(zip(result.sweep.points, result.points, strict=True)):
        forecast, sigma = item.forecast_ukcmb2.get(ACTUAL), comparison.sigma_ukcmb2[number]
        if forecast is not None and sigma > 0 and abs(forecast / sigma - 1) >= abs(worst[0]):
            error = 100 * forecast / sigma * comparison.error_ukcmb2[number] / sigma
            off = forecast / sigma - 1
            worst = (off, f"forecast over simulated, less 1: at worst {100 * off:+.0f} +- {error:.0f} %, {point.label}")
    return [worst[1]] if worst[1] else []


def best_line(result: SweepResult) -> str:
    """``best: key = value, ... with confidence 93 %``, or all points that are equally good."""
    comparison = result.comparison
    labels = " or ".join(result.sweep.points[number].label for number in comparison.best)
    first = comparison.best[0]
    sigma = f"sigma(A) = {comparison.sigma_ukcmb2[first]:.1f}"
    if not result.simulated:
        return f"best: {labels}, {sigma} uK_CMB^2 by forecast"
    probability = comparison.best_probability[first]
    confidence = f"more than {100 * SURE:g} %" if probability > SURE else f"{100 * probability:.0f} %"
    error = f"+- {comparison.error_ukcmb2[first]:.1f} uK_CMB^2"
    return f"best: {labels}, {sigma} {error}, {'each ' if len(comparison.best) > 1 else ''}with confidence {confidence}"


def _sweep_table(result: SweepResult) -> Table:
    sweep, comparison = result.sweep, result.comparison
    table = Table(title=Text(f"{sweep.points[0].scene.title}: uncertainty on a flat CMB band power"))
    for axis in sweep.axes:
        table.add_column(Text(axis.name))
    headings = ["detectors"] + ["sigma(A) [uK_CMB^2]"] * result.simulated + ["forecast", "ratio"]
    for heading in headings + ["best"] * result.simulated:
        table.add_column(Text(heading), justify="right", no_wrap=True)
    for number, (point, item) in enumerate(zip(sweep.points, result.points, strict=True)):
        cells = [Text(axis.labels[step]) for axis, step in zip(sweep.axes, point.place, strict=True)]
        forecast = item.forecast_ukcmb2.get(ACTUAL)
        level = f"{comparison.sigma_ukcmb2[number]:.1f} +- {comparison.error_ukcmb2[number]:.1f}"
        ratio = f"{comparison.ratio[number]:.3f}"
        if result.simulated and number != comparison.reference:
            ratio += f" +- {comparison.paired_error[number]:.3f}"
        scored = comparison.ratio[number] > 0  # NaN is not
        cells += [str(item.n_det)] + [level if scored else "not scored"] * result.simulated
        cells += ["" if forecast is None else f"{forecast:.1f}", ratio if scored else ""]
        if result.simulated:
            cells.append(f"{100 * comparison.best_probability[number]:.0f} %" if scored else "")
        table.add_row(*cells)
    return table


def print_forecast(scene: Scene, forecast: "Forecast") -> None:
    """The forecast of each data set, beside the reference if there is one, and what it neglects."""
    console = _console()
    reference = scene.score.reference
    published = dict(reference.values_ukcmb2) if reference else {}
    table = Table(title=Text(f"{scene.title}: forecast of the uncertainty on a flat CMB band power"))
    for heading in ("data set", "detectors", "sigma(A) [uK_CMB^2]", "ell_eff", "FWHM"):
        table.add_column(Text(heading), justify="left" if heading == "data set" else "right")
    if reference:
        table.add_column(Text(reference.source), justify="right")
        table.add_column("ratio", justify="right")
    for name, item in forecast.scores.items():
        band = item.band
        cells = [name, str(item.n_det), f"{band.sigma_ukcmb2:.1f}", f"{band.ell_eff:.0f}", f"{band.fwhm_ell:.0f}"]
        if name in published:
            cells += [f"{published[name]:g}", f"{band.sigma_ukcmb2 / published[name]:.2f}"]
        table.add_row(*cells)
    console.print(table)
    console.print("Neglected:", highlight=False)
    for line in forecast.neglected:
        console.print(f"  - {line}", highlight=False, markup=False)


def print_paper(written: list[Path]) -> None:
    """The tables that were made, figures as their captions, and where the files are."""
    from astropy.table import Table as AstropyTable

    console = _console()
    for path in written:
        if path.suffix == ".ecsv" and not path.stem.startswith("measurements"):
            made = AstropyTable.read(path, format="ascii.ecsv")
            if path.stem.startswith("figure"):
                console.print(f"\n{made.meta['title']}: {made.meta['caption']}", highlight=False, markup=False)
            else:
                console.print(_plain_table(made))
    if written:
        console.print(f"\n{len(written)} files. {where_line(written[0].parent)}", highlight=False, markup=False)


def _plain_table(made: "AstropyTable") -> Table:
    table = Table(title=Text(made.meta["title"]))
    for name in made.colnames:
        numbers = made[name].dtype.kind in "fi"
        table.add_column(Text(name.replace("_", " ")), justify="right" if numbers else "left")
    for row in made:
        cells = ("" if value != value else value for value in row)
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in cells))
    return table
