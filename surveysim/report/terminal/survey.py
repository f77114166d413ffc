"""Results and plans as text: tables on the terminal."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from mapmaker.uncertainty import FEWEST
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import prepare
from surveysim.report.html.page import REPORT
from surveysim.report.terminal.layout import Terminal
from surveysim.results.agreement import GOOD_PSD, GOOD_SIGMA, KNOWN, Agreement
from surveysim.results.control_variate import in_all_weather
from surveysim.results.results import (
    CONTROLLED,
    PLAIN,
    Row,
    SurveyResult,
    forecast_agreement,
    method,
    score_rows,
    summary,
)
from surveysim.results.stopping import UNLIMITED, Estimate
from surveysim.scene.scene import Scene
from surveysim.studies.resources import Plan
from surveysim.survey.discarded_scans import percent, telling
from surveysim.survey.scores import FEWEST_CONTROLLED

if TYPE_CHECKING:
    from astropy.table import Table as AstropyTable

    from surveysim.forecasting.forecast import DataSetForecast, Forecast


def print_result(result: SurveyResult, directory: Path) -> None:
    """Score table beside the reference, gains, what is assumed, time taken and where the files are."""
    console = Terminal()
    for line in stop_lines(result):
        console.say(f"{line}\n")
    if len(result.setup.analysis.whole_pipelines) > 1:
        console.show(_cleaning_table(result))
    if result.scores:
        console.show(_score_table(result))
        for line in (*survey_lines(result), *gain_lines(result), *agreement_lines(result)):
            console.say(line)
        console.say("")
        if result.alternatives:
            console.show(_alternative_table(result))
        console.say("\nMethod, where the reference leaves it open:")
        setup = result.setup
        for line in method(
            setup.analysis.chooses, setup.scene.instrument.bandwidth, setup.analysis.region.scored_correlation
        ):
            console.say(f"  - {line}")
    if result.unscored:
        console.say(f"Not scored: {result.unscored}")
    if result.setup.scene.assumed:
        console.say("\nAssumed or calibrated in the scene:")
        for line in result.setup.scene.assumed:
            console.say(f"  - {line}")
    print_warnings(console, result.discards.warnings)
    console.say(f"\n{closing_line(result)}\n{where_line(directory)}")


def print_warnings(console: Terminal, warnings: Sequence[str]) -> None:
    """A paragraph for each warning."""
    for line in warnings:
        console.say(f"\nWarning: {line}")


def closing_line(result: SurveyResult) -> str:
    """What was done and how long it took."""
    content = summary(result)
    scans = f"{content['scans_discarded']} of {content['scans']} scans discarded{_shares(result.discards.shares)}"
    return (
        f"{content['observations']} observations, {content['detector_samples'] / 1e6:.4g} million "
        f"detector-samples, {scans}, {result.wall_s:.1f} s with {result.workers} worker(s)"
    )


def _shares(discarded: dict[str, float]) -> str:
    """`` (18.4 %; masked_36: 2.0 %)``: the actual data's share, and those that differ; nothing if all are 0."""
    shown = [f"{name}: {percent(discarded[name])}" for name in telling([discarded])]
    return f" ({'; '.join(shown).removeprefix(f'{ACTUAL}: ')})" if any(discarded.values()) else ""


def where_line(directory: Path) -> str:
    """Where the results are, and the page that has them all."""
    return f"Results in {directory}, all on one page in {directory / REPORT}"


def agreement_lines(result: SurveyResult) -> list[str]:
    """Differences of the forecast from the simulation, with warnings of large ones, and its flags."""
    found = forecast_agreement(result)
    if not found:
        return []
    off = ", ".join(f"{name} {percent_off(item.sigma, item.sigma_error)}" for name, item in found.items())
    lines = [f"  forecast of sigma(A) over simulated, less 1: {off}"]
    lines += [
        f"  forecast of {name}: sigma(A) is worse than {100 * GOOD_SIGMA:.0f} %"
        for name, item in found.items()
        if abs(item.sigma) > GOOD_SIGMA + 2 * item.sigma_error
    ]
    flags = [f"  ! forecast of {line}" for line in effect_lines(result.expected.scores, flagged=True)]
    return [*lines, *_psd_lines(found), *flags]


def _psd_lines(found: dict[str, Agreement]) -> list[str]:
    """Number of bins whose noise PSD is forecast well enough, and the bin that is furthest beyond its error."""
    bins, within = (sum(getattr(item, key) for item in found.values()) for key in ("bins", "within"))
    if bins == 0:
        return []
    some, unknown = next(iter(found.values())), sum(item.unknown for item in found.values())
    good, known = f"{100 * GOOD_PSD:.0f} %", f"{100 * KNOWN:g} %"
    where = f"from ell = {some.low_ell:.0f} to {some.high_ell:.0f}"
    if within == bins:
        return [f"  its noise PSDs: within {good} in all {bins} bins {where}, each known to {known} or better"]
    line = f"  its noise PSDs: within {good} in {within} of {bins} bins {where}"
    line += f", {unknown} are not known to {known}" if unknown else ""
    known_at_all = {name: item for name, item in found.items() if math.isfinite(item.psd_error)}
    if not known_at_all:
        return [line]
    name, worst = max(known_at_all.items(), key=lambda entry: abs(entry[1].psd) - 2 * entry[1].psd_error)
    if abs(worst.psd) <= 2 * worst.psd_error:
        return [f"{line}; none is off by more than two standard errors"]
    off = f"{name} by {percent_off(worst.psd, worst.psd_error)} at ell = {worst.worst_ell:.0f}"
    return [f"{line}; furthest beyond two standard errors, as one in twenty is by chance: {off}"]


def percent_off(off: float, error: float) -> str:
    """``+3 +- 5 %``, or ``+3 % +- unknown`` for an error that is NaN."""
    return f"{100 * off:+.0f} % +- unknown" if math.isnan(error) else f"{100 * off:+.0f} +- {100 * error:.0f} %"


def effect_lines(scores: "dict[str, DataSetForecast]", flagged: bool = False) -> list[str]:
    """Effects on forecasts, a line each with the data sets that have it: all of the first set, flagged ones of others.

    With `flagged`, flagged ones alone.
    """
    lines: dict[str, list[str]] = {}
    for place, (name, item) in enumerate(scores.items()):
        for effect in item.effects:
            if effect.flagged or (place == 0 and not flagged):
                lines.setdefault(effect.sentence, []).append(name)
    return [f"{', '.join(names)}: {sentence}" for sentence, names in lines.items()]


def survey_lines(result: SurveyResult) -> list[str]:
    """Share of the survey that was simulated, the kind of estimate that is quoted, the cost of 1 %."""
    lines, n_obs = [], result.setup.scene.observations
    if result.coadds.done < n_obs:
        lines.append(f"  of the whole survey of {n_obs} observations, judged by {result.coadds.done}")
    if result.estimate is not None:
        lines += [f"  {line}" for line in estimate_lines(result.estimate, result.coadds.done)]
    return [*lines, *cost_lines(result)]


def estimate_lines(estimate: Estimate, done: int) -> list[str]:
    """Kind of the estimate that is quoted, the plain one beside a controlled one, and why an error is unknown."""
    if estimate.kind == "controlled":
        plain = with_unknown(estimate.plain_sigma_ukcmb2, estimate.plain_error_ukcmb2)
        lines = [f"{CONTROLLED}. Plain ({ACTUAL}): {plain}"]
    else:
        lines = [PLAIN]
    if math.isnan(estimate.error_ukcmb2):
        fewest = FEWEST_CONTROLLED if estimate.kind == "controlled" else FEWEST
        lines.append(f"errors are unknown: found {done} observations; {fewest} or more tell how far theirs is typical")
    return lines


def with_unknown(sigma: float, error: float) -> str:
    """``221.1 +- 5.2``, or ``221.1 +- unknown`` for an error that is NaN."""
    return f"{sigma:.1f} +- {'unknown' if math.isnan(error) else format(error, '.1f')}"


def cost_lines(result: SurveyResult) -> list[str]:
    """What an answer to 1 % would take, where this one is not as good."""
    cost, score = result.fine_cost, result.setup.scene.score
    if cost is None or not result.estimate.relative_error > cost.relative_error:
        return []
    needs = [f"{cost.observations} observations"]
    needs += [f"{cost.jackknives} sign flips"] * (cost.jackknives > score.jackknives)
    needs += [f"{cost.skies} window skies"] * (cost.skies > score.signal_sims.skies)
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
        known = math.isfinite(estimate.relative_error)
        line += f"; sigma(A) is known to {100 * estimate.relative_error:.1f} %" if known else "; its error is unknown"
    return [line]


def gain_lines(result: SurveyResult) -> list[str]:
    """Gains between data sets, beside the reference's."""
    reference = result.setup.scene.score.reference
    published = dict(reference.gains) if reference else {}
    lines = []
    for name, item in result.gains.items():
        beside = f"   (reference {published[name]:g})" if name in published else ""
        error = "unknown" if math.isnan(item.error) else f"{item.error:.2f}"
        lines.append(f"  {name} = {item.ratio:.2f} +- {error}{beside}")
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
        with_unknown(row.sigma_ukcmb2, row.error_ukcmb2),
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
    entries = {
        pipeline.label: summary(result)["cleaning"][pipeline.data_set]
        for pipeline in result.setup.analysis.whole_pipelines
    }
    first = next(iter(entries.values()))
    shares = {"point_source_flux_removed": "flux removed", "best_for_cmb": "best: CMB"}
    shares["best_for_point_source"] = "best: source"
    headings = ["cleaning", "scans discarded", "iterations", "templates"]
    headings += [f"PSD / high, {hz}" for hz in first["psd_over_white"]]
    for heading in headings + [heading for name, heading in shares.items() if name in first]:
        table.add_column(heading, justify="left" if heading == "cleaning" else "right")
    for label, entry in entries.items():
        cells = [str(entry["scans_discarded"]), f"{entry['mean_iterations']:.1f}", f"{entry['mean_removed']:.2f}"]
        cells += ["" if ratio is None else f"{ratio:.3g}" for ratio in entry["psd_over_white"].values()]
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
    console = Terminal()
    table = Table(title=Text(f"{scene.name}: {scene.title}"))
    for heading in ("stage", "what"):
        table.add_column(heading)
    for name, what in plan.stages.items():
        table.add_row(name, what)
    for name, reason in plan.left_out.items():
        table.add_row(Text(name, style="dim"), Text(f"left out: {reason}", style="dim"))
    console.show(table)
    made = "one block of an observation" if "blocks" in plan.stages else "a few observations"
    lines = (
        f"about {_seconds(plan.wall_s)} s with {workers} worker(s), {_seconds(plan.figures_s)} s of it for figures, "
        f"predicted from {made} made here",
        f"about {plan.memory_bytes / 1e6:.0f} MB a process",
        f"about {plan.output_bytes / 1e6:.1f} MB of results",
        f"about {plan.timestream_bytes / 1e6:.0f} MB of time-streams, if saved",
        f"{plan.detector_samples / 1e6:.4g} million detector-samples",
    )
    console.say("\n".join(lines))


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f}" if seconds < 10 else f"{seconds:.0f}"


def print_forecast(scene: Scene, forecast: "Forecast") -> None:
    """The forecast of each data set, beside the reference if there is one, and effects on it with their sizes."""
    console, everywhere = Terminal(), in_all_weather(prepare(scene), forecast)
    reference = scene.score.reference
    published = dict(reference.values_ukcmb2) if reference else {}
    table = Table(title=Text(f"{scene.title}: forecast of the uncertainty on a flat CMB band power"))
    for heading in ("data set", "detectors", "sigma(A) [uK_CMB^2]", "in the weather drawn", "ell_eff", "FWHM"):
        table.add_column(Text(heading), justify="left" if heading == "data set" else "right")
    if reference:
        table.add_column(Text(reference.source), justify="right")
        table.add_column("ratio", justify="right")
    for name, item in forecast.scores.items():
        band = item.band
        sigma = everywhere.get(name, band.sigma_ukcmb2)
        cells = [name, str(item.n_det), f"{sigma:.1f}", f"{band.sigma_ukcmb2:.1f}"]
        cells += [f"{band.ell_eff:.0f}", f"{band.fwhm_ell:.0f}"]
        if name in published:
            cells += [f"{published[name]:g}", f"{sigma / published[name]:.2f}"]
        table.add_row(*cells)
    console.show(table)
    drawn = f"that of the weather drawn for {scene.observations} observations stands beside it"
    console.say(f"sigma(A) is that of all weather, as a run quotes it; {drawn}.")
    console.say("Effects on the forecast, with their sizes; those marked ! may put it off:")
    flagged = effect_lines(forecast.scores, flagged=True)
    for line in effect_lines(forecast.scores):
        console.say(f"  {'!' if line in flagged else '-'} {line}")


def print_paper(written: list[Path]) -> None:
    """The tables that were made, figures as their captions, and where the files are."""
    from astropy.table import Table as AstropyTable

    console = Terminal()
    for path in written:
        if path.suffix == ".ecsv" and not path.stem.startswith("measurements"):
            made = AstropyTable.read(path, format="ascii.ecsv")
            if path.stem.startswith("figure"):
                console.say(f"\n{made.meta['title']}: {made.meta['caption']}")
            else:
                console.show(_plain_table(made))
    if written:
        console.say(f"\n{len(written)} files. {where_line(written[0].parent)}")


def _plain_table(made: "AstropyTable") -> Table:
    table = Table(title=Text(made.meta["title"]))
    for name in made.colnames:
        numbers = made[name].dtype.kind in "fi"
        table.add_column(Text(name.replace("_", " ")), justify="right" if numbers else "left")
    for row in made:
        cells = ("" if value != value else value for value in row)
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in cells))
    return table
