"""Results of a sweep on the terminal: points, the best one and warnings; all else with --verbose."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from surveysim.report.terminal.layout import Terminal
from surveysim.report.terminal.survey import print_warnings, where_line
from surveysim.report.terminal.tables import show_table
from surveysim.results.bands import band_table
from surveysim.results.metric_tables import label, with_unit
from surveysim.runtime.numbers import number, plain, plural, quoted, quoted_share
from surveysim.runtime.table import Table
from surveysim.studies.sweep.axes import Axis
from surveysim.studies.sweep.band_results import MultiBandSweepResult, sweep_entries
from surveysim.studies.sweep.result import ESTIMATES, FORECAST_WEATHER, SweepResult
from surveysim.studies.sweep.summary import sweep_summary
from surveysim.studies.sweep.tables import chance_text, stop_sentence, sweep_table
from surveysim.survey.discarded_scans import listed_data_sets, percent


def print_sweep(result: SweepResult, directory: Path, verbose: bool = False) -> None:
    """Print a row for each point, the best point, warnings and where the files are.

    Parameters
    ----------
    result : SweepResult
        The sweep.
    directory : Path
        Folder of its files.
    verbose : bool
        Also print the kind of estimate, fractions of discarded scans, and the forecasts.
    """
    console = Terminal(160)
    summary = sweep_summary(result, ())
    table = _named_by_axes(sweep_table(summary), result.sweep.axes)
    show_table(console, table, marked="best")
    for point, item in zip(result.sweep.points, result.points, strict=True):
        if item.unscored:
            console.say(f"Not scored: {point.label}: {item.unscored}")
    if result.comparison.reference is not None:
        reference = result.sweep.points[result.comparison.reference].label
        console.say(f"Ratios are to {reference}{', with paired errors' if result.simulated else ''}.")
        console.say(best_line(result))
    if stopped := stop_sentence(summary):
        console.say(plain(stopped))
    if not result.simulated:
        console.say(FORECAST_WEATHER)
    if verbose:
        for line in (*estimate_lines(result), *discard_lines(result), *forecast_lines(result)):
            console.say(line)
    print_warnings(console, [*result.warnings, *flag_lines(result)])
    done = f"{len(result.points)} points in {result.wall_s:.1f} s with {result.workers} worker(s)"
    console.say(f"\n{done}\n{where_line(directory)}")


def print_sweeps(result: MultiBandSweepResult, directory: Path, verbose: bool = False) -> None:
    """Print the sweep of each band that was run, then the best point of every band."""
    console = Terminal(160)
    for name, item in result.bands.items():
        print_sweep(item, directory / "bands" / name, verbose)
        console.say("")
    table = band_table(sweep_entries(result), {})
    show_table(console, table, title=f"{result.sweep.title}: best point of each band")
    where = where_line(directory, "with a page for each band behind")
    console.say(f"\n{plural(len(result.summaries), 'band')} in {result.wall_s:.1f} s\n{where}")


def _named_by_axes(table: Table, axes: Sequence[Axis]) -> Table:
    """Show only the keys that distinguish the points; a single key of an axis has the axis as its heading."""
    headings = {
        key: axis.name if len(axis.distinguishing_keys) == 1 else key
        for axis in axes
        for key in axis.distinguishing_keys
    }
    hidden = {key for axis in axes for key in axis.keys} - headings.keys()
    columns = [
        replace(item, heading=headings.get(item.name, item.heading), cells=None if item.name in hidden else item.cells)
        for item in table.columns
    ]
    return replace(table, columns=tuple(columns))


def estimate_lines(result: SweepResult) -> Iterator[str]:
    """Yield the kind of estimate."""
    if said := ESTIMATES.get(result.estimate):
        yield f"sigma(A) {said}."


def forecast_lines(result: SweepResult) -> Iterator[str]:
    """Yield the largest difference of a forecast from its simulation."""
    both = zip(result.sweep.points, result.points, strict=True)
    compared = [(point, item.off) for point, item in both if item.off]
    if compared:
        point, (off, error) = max(compared, key=lambda entry: abs(entry[1][0]))
        yield f"forecast over simulated, less 1: at worst {plain(quoted_share(off, error))}, {point.label}"


def flag_lines(result: SweepResult) -> list[str]:
    """Return a line for each flag of forecasts, with the first point that has it and the number of others."""
    labels: dict[str, list[str]] = {}
    for point, item in zip(result.sweep.points, result.points, strict=True):
        for sentence in item.flags:
            labels.setdefault(sentence, []).append(point.label)
    lines = []
    for sentence, (first, *others) in labels.items():
        more = f" and {plural(len(others), 'other point')}" if others else ""
        lines.append(f"the forecast of {first}{more} may be off. {sentence}")
    return lines


def discard_lines(result: SweepResult) -> list[str]:
    """Return the fractions of discarded scans of each data set at its best and worst point."""
    shares = [item.discarded for item in result.points]
    if not any(shares):
        return ["Shares of discarded scans are not known."]
    lines, kind = [], "scans discarded" if result.simulated else "scans discarded, as predicted from a few"
    for name in listed_data_sets(shares):
        found = [item[name] for item in shares if name in item]
        least, most = percent(min(found)), percent(max(found))
        lines.append(f"{kind}, {name}: {least if least == most else f'{least} to {most}'}")
    return lines


def best_line(result: SweepResult) -> str:
    """Return ``best: key = value, ... with confidence 93 %``, all equally good points, or the reason for none."""
    comparison = result.comparison
    labels = " or ".join(result.sweep.points[number].label for number in comparison.best)
    first = comparison.best[0]
    quantity, value, error = comparison.quantity, comparison.value[first], comparison.error[first]
    text = plain(quoted(value, error) if result.simulated else number(value))
    found = f"{label(quantity.key)} = {with_unit(text, quantity.unit)}"
    if not result.simulated:
        return f"best: {labels}, {found} by forecast"
    if reason := result.withheld(first):
        side = "lowest" if quantity.lower_is_better else "highest"
        return f"{side}: {labels}, {found}; the probability that it is the best is withheld: {reason}"
    each, chance = "each " * (len(comparison.best) > 1), chance_text(comparison.best_probability[first])
    return f"best{_among(result)}: {labels}, {found}, {each}with confidence {chance}"


def _among(result: SweepResult) -> str:
    """Number of points that are compared, if others have no known error or lose too many scans."""
    competing, scored = result.comparison.competing.sum(), (result.comparison.ratio > 0).sum()
    if competing == scored:
        return ""
    return f" of the {competing} points that have a known error and lose few scans (of {scored})"
