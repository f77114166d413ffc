"""Results of a run on the terminal: score table, gains and warnings; all else with --verbose."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from mapmaker.uncertainty import FEWEST, draws
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.report.html.page import REPORT
from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.tables import show_table
from surveysim.results.method import CONTROLLED, PLAIN, method
from surveysim.results.metric_tables import label, metric_notes, metric_table
from surveysim.results.results import GOOD_SIGMA, SurveyResult
from surveysim.results.sky_tables import recovery_sentences, source_table
from surveysim.results.spectra import band_power_table, split_sentences, split_table
from surveysim.results.stopping import UNLIMITED, Estimate
from surveysim.results.summary import summary
from surveysim.results.tables import (
    agreement_table,
    alternative_table,
    cleaning_table,
    closure_table,
    effect_table,
    gain_table,
    score_table,
)
from surveysim.runtime.numbers import duration, plain, plural, quoted
from surveysim.survey.discarded_scans import listed_data_sets, percent
from surveysim.survey.scores import FEWEST_CONTROLLED

Content = Mapping[str, Any]  # of summary.json


def print_result(result: SurveyResult, directory: Path, verbose: bool = False) -> None:
    """Print score table, gains, warnings and where the files are.

    Parameters
    ----------
    result : SurveyResult
        The run.
    directory : Path
        Folder of its files.
    verbose : bool
        Also print the cleaning pipelines, the forecast, alternatives, method and assumptions.
    """
    console, content = Terminal(), summary(result)
    for line in stop_lines(result):
        console.say(f"{line}\n")
    if result.scores:
        reference = result.setup.scene.score.reference
        table = score_table(content["scores"], reference.source if reference else "")
        show_table(console, table, title=f"{content['title']}: uncertainty of a flat CMB band power")
        if content["gains"]:
            show_table(console, gain_table(content["gains"], dict(reference.gains) if reference else {}))
        if metrics := metric_table(content["metrics"]):
            show_table(console, metrics)
            for line in metric_notes(content["metrics"]):
                console.say(line)
    if "own_sky" in content:
        _print_sky(console, content["own_sky"])
    if "split_spectra" in content:
        show_table(console, band_power_table(content["split_spectra"]))
        show_table(console, split_table(content["split_spectra"]))
        for line in split_sentences(content["split_spectra"]):
            console.say(f"  {line}")
    if result.unscored:
        console.say(f"Not scored: {result.unscored}")
    if verbose:
        _print_details(console, result, content)
    print_warnings(console, [*content["warnings"], *error_warnings(result), *forecast_warnings(content)])
    console.say(f"\n{closing_line(content)}\n{where_line(directory)}")


def _print_sky(console: Terminal, entry: Content) -> None:
    """Print the sources of the scene's sky that come back, and the share of the sky over the transfer function."""
    if "sources" in entry:
        show_table(console, source_table(entry))
    for line in recovery_sentences(entry):
        console.say(f"  sky, {plain(line)}")


def _print_details(console: Terminal, result: SurveyResult, content: Content) -> None:
    """Print tables and lines that the short output leaves to the report page."""
    if len(result.setup.analysis.whole_pipelines) > 1:
        show_table(console, cleaning_table(content["cleaning"]))
    if result.scores:
        for line in (*survey_lines(result), *cost_lines(result)):
            console.say(line)
        if content["alternatives"]:
            show_table(console, alternative_table(content["alternatives"]))
        if content["forecast"]:
            show_table(console, agreement_table(content["forecast_over_simulated"]))
            show_table(console, effect_table(content["forecast"]))
    for kind in ("measured", "drawn"):
        if any(item["kind"] == kind for item in content["closure"]):
            show_table(console, closure_table(content["closure"], kind))
    if result.scores:
        analysis, bandwidth = result.setup.analysis, result.setup.scene.instrument.band.width_hz
        lines = method(analysis.chooses, bandwidth, analysis.region.scored_correlation)
        print_list(console, "Choices of the scoring that the reference leaves open:", lines)
    print_list(console, "Assumed or calibrated in the scene:", result.setup.scene.assumed)


def print_list(console: Terminal, title: str, lines: Sequence[str]) -> None:
    """Print lines below a title; nothing without lines."""
    if lines:
        console.say("\n".join([f"\n{title}", *(f"  - {line}" for line in lines)]))


def print_warnings(console: Terminal, warnings: Sequence[str]) -> None:
    """Print a paragraph for each warning."""
    for line in warnings:
        console.say(f"\nWarning: {line}")


def error_warnings(result: SurveyResult) -> list[str]:
    """Warn of unknown errors from too few observations."""
    estimate = result.estimate
    if estimate is None or not math.isnan(estimate.error_ukcmb2):
        return []
    fewest = FEWEST_CONTROLLED if estimate.kind == "controlled" else FEWEST
    block, done = result.setup.air.block(result.coadds.done), result.coadds.done
    found = (
        plural(done, "observation")
        if block is None
        else f"{plural(draws(done, block), 'block')} of independent weather"
    )
    return [f"errors are unknown: found {found}; {fewest} or more are needed to estimate them."]


def forecast_warnings(content: Content) -> list[str]:
    """Warn of forecasts of sigma(A) that the run contradicts, and of flagged effects, with their data sets."""
    far = [
        f"the forecast of sigma(A) of {name} is off by more than {100 * GOOD_SIGMA:.0f} %."
        for name, item in content.get("forecast_over_simulated", {}).items()
        if abs(item["sigma"]) > GOOD_SIGMA + 2 * (math.inf if item["sigma_error"] is None else item["sigma_error"])
    ]
    effects = {name: item["effects"] for name, item in content.get("forecast", {}).items()}
    return [*far, *effect_warnings(effects)]


def effect_warnings(effects: Mapping[str, Sequence[Content]]) -> list[str]:
    """Warn once of each flagged effect on forecasts, with its data sets and the sentence of the first."""
    names: dict[str, list[str]] = {}
    sentences: dict[str, str] = {}
    for name, found in effects.items():
        for effect in found:
            if effect["flagged"]:
                names.setdefault(effect["name"], []).append(name)
                sentences.setdefault(effect["name"], effect["sentence"])
    return [f"the forecast may be off ({', '.join(names[key])}). {text}" for key, text in sentences.items()]


def closing_line(content: Content) -> str:
    """Return one line on the work done and the time taken, from the content of summary.json."""
    run = content["run"]
    scans = f"{content['scans_discarded']} of {content['scans']} scans discarded{_shares(content['discarded'])}"
    lost = f", {percent(content['samples_lost'])} of the samples lost" if "samples_lost" in content else ""
    return (
        f"{content['observations']} observations, {content['detector_samples'] / 1e6:.4g} million "
        f"detector-samples, {scans}{lost}, {run['wall_s']:.1f} s with {run['workers']} worker(s)"
    )


def _shares(discarded: Mapping[str, float]) -> str:
    """Format fractions of discarded scans as `` (18.4 %; masked_36: 2.0 %)``: the actual data and sets that differ."""
    shown = [f"{name}: {percent(discarded[name])}" for name in listed_data_sets([discarded])]
    return f" ({'; '.join(shown).removeprefix(f'{ACTUAL}: ')})" if any(discarded.values()) else ""


def where_line(directory: Path, page: str = "all on one page in") -> str:
    """Return the line with the place of the results and their report page."""
    return f"Results in {directory}, {page} {directory / REPORT}"


def survey_lines(result: SurveyResult) -> Iterator[str]:
    """Yield the simulated fraction of the survey and the kind of the quoted estimate."""
    n_obs = result.setup.scene.observations
    if result.coadds.done < n_obs:
        yield f"  of the whole survey of {n_obs} observations, judged by {result.coadds.done}"
    if result.estimate is not None:
        yield f"  {estimate_line(result.estimate)}"


def estimate_line(estimate: Estimate) -> str:
    """Return the kind of the quoted estimate, with the plain estimate if it is controlled."""
    if estimate.kind != "controlled":
        return f"{PLAIN}."
    plain_value = plain(quoted(estimate.plain_sigma_ukcmb2, estimate.plain_error_ukcmb2))
    return f"{CONTROLLED}. Plain ({ACTUAL}): {plain_value}"


def cost_lines(result: SurveyResult) -> list[str]:
    """Return the cost of an error of 1 %, if the error of the run is larger."""
    cost, score = result.fine_cost, result.setup.scene.score
    if cost is None or not result.estimate.relative_error > cost.relative_error:
        return []
    needs = [f"{cost.observations} observations"]
    needs += [f"{cost.jackknives} sign-flipped co-adds (score.jackknives)"] * (cost.jackknives > score.jackknives)
    needs += [f"{cost.skies} simulated skies (score.signal_sims.skies)"] * (cost.skies > score.signal_sims.skies)
    share = 100 * cost.relative_error
    time = f"about {duration(cost.seconds)} with {plural(result.workers, 'worker')}"
    return [f"  an error of {share:g} % would take {time}: {', '.join(needs)}"]


def stop_lines(result: SurveyResult) -> list[str]:
    """Return the reason for the end of a run that had limits."""
    limits, error = result.limits, result.relative_error
    if limits == UNLIMITED:
        return []
    reasons = {"target": "the target error was reached", "budget": "the time budget was spent"}
    reason = reasons.get(result.stopped, "all observations were done")
    line = f"Stopped: {reason}, {result.coadds.done} of {result.setup.scene.observations} observations simulated"
    if error is not None:
        known = math.isfinite(error)
        line += f"; {label(limits.metric)} is known to {100 * error:.1f} %" if known else "; its error is unknown"
    return [line]
