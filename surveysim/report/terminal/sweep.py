"""Sweeps as text: what would run, and tables of points on the terminal."""

from pathlib import Path

import numpy as np
from rich.table import Table
from rich.text import Text

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.survey import percent_off, print_warnings, where_line, with_unknown
from surveysim.studies.sweep.axes import Sweep
from surveysim.studies.sweep.comparison import ESTIMATES, SURE, SweepResult
from surveysim.studies.sweep.plan import SweepPlan
from surveysim.survey.discarded_scans import percent, telling


def print_sweep_plan(sweep: Sweep, plan: SweepPlan, workers: int) -> None:
    """Axes of a sweep and the predicted cost of its points."""
    console = Terminal(160)
    table = Table(title=Text(f"{sweep.name}: {plan.n_points} points"))
    table.add_column("axis")
    table.add_column("values")
    for axis in sweep.axes:
        table.add_row(Text(axis.name), Text(", ".join(axis.labels)))
    console.show(table)
    lines = (
        f"about {plan.wall_s:.0f} s with {workers} worker(s), predicted from the first and the last point",
        f"about {plan.memory_bytes / 1e6:.0f} MB a process",
        f"{plan.detector_samples / 1e6:.4g} million detector-samples",
    )
    console.say("\n".join(lines))


def print_sweep(result: SweepResult, directory: Path) -> None:
    """A row for each point, why points have no score, the reference point, the best one, warnings, and the files."""
    console = Terminal(160)
    console.show(_sweep_table(result))
    for point, item in zip(result.sweep.points, result.points, strict=True):
        if item.unscored:
            console.say(f"Not scored: {point.label}: {item.unscored}")
    if result.comparison.reference is not None:
        reference = result.sweep.points[result.comparison.reference].label
        shared = ", their errors those of runs with one seed" if result.simulated else ""
        console.say(f"Ratios are to {reference}{shared}.")
        if said := ESTIMATES.get(result.estimate):
            console.say(f"sigma(A) {said}.")
        console.say(best_line(result))
    for line in (*discard_lines(result), *_forecast_lines(result)):
        console.say(line)
    print_warnings(console, result.warnings)
    done = f"{len(result.points)} points in {result.wall_s:.1f} s with {result.workers} worker(s)"
    console.say(f"\n{done}\n{where_line(directory)}")


def _forecast_lines(result: SweepResult) -> list[str]:
    """Largest difference of a forecast from its simulation, and a line for each flag of a point's forecast."""
    lines, both = [], list(zip(result.sweep.points, result.points, strict=True))
    compared = [(point, *item.off) for point, item in both if item.off]
    if compared:
        point, off, error = max(compared, key=lambda entry: abs(entry[1]))
        lines.append(f"forecast over simulated, less 1: at worst {percent_off(off, error)}, {point.label}")
    if not result.simulated:
        lines.append("Forecasts are of the weather that the seed draws; a run quotes sigma(A) of all weather.")
    return lines + [f"! forecast of {point.label}: {sentence}" for point, item in both for sentence in item.flags]


def discard_lines(result: SweepResult) -> list[str]:
    """The share of discarded scans of every data set at its best and at its worst point."""
    shares = [item.discarded for item in result.points]
    if not any(shares):
        return ["Shares of discarded scans are not known."]
    lines, kind = [], "scans discarded" if result.simulated else "scans discarded, as predicted from a few"
    for name in telling(shares):
        found = [item[name] for item in shares if name in item]
        least, most = percent(min(found)), percent(max(found))
        lines.append(f"{kind}, {name}: {least if least == most else f'{least} to {most}'}")
    return lines


def best_line(result: SweepResult) -> str:
    """``best: key = value, ... with confidence 93 %``, all points that are equally good, or why there is none."""
    comparison = result.comparison
    labels = " or ".join(result.sweep.points[number].label for number in comparison.best)
    first = comparison.best[0]
    sigma = f"sigma(A) = {comparison.sigma_ukcmb2[first]:.1f}"
    if not result.simulated:
        return f"best: {labels}, {sigma} uK_CMB^2 by forecast"
    sigma = f"sigma(A) = {with_unknown(comparison.sigma_ukcmb2[first], comparison.error_ukcmb2[first])} uK_CMB^2"
    if reason := result.withheld(first):
        return f"lowest: {labels}, {sigma}; the probability that it is the best is withheld: {reason}"
    each = "each " if len(comparison.best) > 1 else ""
    return (
        f"best{_among(result)}: {labels}, {sigma}, {each}with confidence {_chance(comparison.best_probability[first])}"
    )


def _chance(probability: float) -> str:
    """``93 %``; no more than draws can tell."""
    if probability > SURE:
        return f"more than {100 * SURE:g} %"
    return f"{100 * probability:.0f} %" if probability > 1 - SURE else f"less than {100 * (1 - SURE):.1g} %"


def _among(result: SweepResult) -> str:
    """Of how many points the best one is, where others have no known error or lose too many scans to compete."""
    competing, scored = result.comparison.competing.sum(), (result.comparison.ratio > 0).sum()
    if competing == scored:
        return ""
    return f" of the {competing} points that have a known error and lose few scans (of {scored})"


def _sweep_table(result: SweepResult) -> Table:
    sweep, comparison = result.sweep, result.comparison
    table = Table(title=Text(f"{sweep.points[0].scene.title}: uncertainty on a flat CMB band power"))
    for axis in sweep.axes:
        table.add_column(Text(axis.name))
    headings = ["detectors"] + ["sigma(A) [uK_CMB^2]"] * result.simulated + ["forecast", "ratio"]
    for heading in headings + ["best", "discarded"] * result.simulated:
        table.add_column(Text(heading), justify="right")
    for number, (point, item) in enumerate(zip(sweep.points, result.points, strict=True)):
        cells = [Text(axis.labels[step]) for axis, step in zip(sweep.axes, point.place, strict=True)]
        forecast = item.forecast_ukcmb2.get(ACTUAL)
        level = with_unknown(comparison.sigma_ukcmb2[number], comparison.error_ukcmb2[number])
        ratio = f"{comparison.ratio[number]:.3f}"
        if result.simulated and number != comparison.reference:
            error = comparison.paired_error[number]
            ratio += f" +- {error:.3f}" if np.isfinite(error) else " +- unknown"
        scored = comparison.ratio[number] > 0  # NaN is not
        cells += [str(item.n_det)] + [level if scored else "not scored"] * result.simulated
        shown = "" if forecast is None else f"{forecast:.1f}{' !' if item.flags else ''}"
        cells += [shown, ratio if scored else ""]
        if result.simulated:
            best = "withheld" if result.withheld(number) else _chance(comparison.best_probability[number])
            cells += [best if scored else "", percent(item.discarded[ACTUAL])]
        table.add_row(*cells)
    return table
