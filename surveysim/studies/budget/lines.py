"""Sentences on a budget, from the content of its summary.json, for terminals and pages."""

from collections.abc import Iterator, Mapping
from typing import Any

from surveysim.results.metric_tables import label
from surveysim.runtime.numbers import joined, plural
from surveysim.studies.budget.costs import FLAT, SMALL
from surveysim.studies.budget.tables import NOT_COMPARABLE, time_text

Content = Mapping[str, Any]  # content of summary.json
MOST_NAMED = 3  # interactions in a sentence
OF_FORECASTS = " Errors of forecasts come from the predicted fractions of discarded scans."
SURE = 3  # standard errors beyond which an interaction is named: pairs are many


def measure_line(summary: Content) -> str:
    """Define the survey time that costs are measured in."""
    metric = summary["budget"]["metric"]
    name, power = label(metric["key"]), metric["exponent"]
    if power is None or abs(power) < FLAT:
        return f"{name} does not depend on the noise, so that costs have no survey time."
    how = "" if power == 1 else f" to the power {power:.3g}"
    return (
        f"Times are survey times that give the same {name}, as shares of the whole scene's. {name} goes as the noise"
        f" power of the map{how}; the noise power goes as one over the survey time. The powers of independent noises"
        f" add up, and so do times; ratios do not.{'' if summary['kind'] == 'simulated' else OF_FORECASTS}"
    )


def place_line(summary: Content) -> str:
    """Define the two places of a stage, and its interaction."""
    name = label(summary["budget"]["metric"]["key"])
    return (
        f"Removed alone: {name} of the whole scene over that without the stage; both scenes lack stages that need it."
        f" Added alone: {name} of the least scene with the stage over that without it; both scenes have the stages that"
        " it needs. So noise costs what it costs without correlation, and its correlation has a row of its own."
        " Interaction: the time that the stage costs in the whole scene less the time that it costs in the least one."
    )


def least_title(summary: Content) -> str:
    """Title of the least scene: its only noise."""
    floor = summary["budget"]["floor"]
    titles = {item["name"]: item["title"] for item in summary["budget"]["stages"]}
    return f"{titles.get(floor, 'nothing')} alone"


def total_lines(summary: Content) -> Iterator[str]:
    """Yield the time of the least scene, the sums of all costs, and their difference from the whole."""
    total = summary["budget"]["total"]
    if total["least"]["value"] is None:
        yield "The least scene has no survey time, so there are no sums."
        return
    yield (
        f"Least scene, {least_title(summary)}: {time_text(total['least'])} of the survey time. With the costs of all"
        f" additions: {time_text(total['added'])}, of all removals: {time_text(total['removed'])}. Interactions of all"
        f" stages beyond their additions: {time_text(total['together'])}."
    )
    if total["missing"]:
        yield f"Not in the sums: {joined(total['missing'])}."


def small_line(summary: Content) -> str:
    """Name the stages that cost less than their errors, with their costs."""
    simulated = summary["kind"] == "simulated"
    small = [f"{item['title']}, {_cost_text(item)}" for item in summary["budget"]["stages"] if item["small"]]
    limit = f"{100 * SMALL:g} %"
    if not small:
        return f"Every stage costs more than {'its error' if simulated else limit}."
    what = "their errors, which more observations lower" if simulated else f"{limit} or than their errors"
    return f"Stages that cost less than {what}: {'; '.join(small)}."


def _cost_text(stage: Content) -> str:
    """Cost of a stage in the whole scene, or else in the least one."""
    parts = [stage[name]["time"] for name in ("removed", "added") if name in stage]
    return next(filter(None, map(time_text, parts)), "")


def interaction_line(summary: Content) -> str:
    """Name the largest interactions, of pairs where they are known; empty without any beyond its error."""
    stages = summary["budget"]["stages"]
    titles = {item["name"]: item["title"] for item in stages}
    if pairs := summary["budget"]["pairs"]:
        found = [(" with ".join(titles[name] for name in item["stages"]), item) for item in pairs]
    else:
        found = [(item["title"], item["interaction"]) for item in stages if item["interaction"]["value"] is not None]
    large = [(title, item) for title, item in found if abs(item["value"]) > max(SURE * (item["error"] or 0), SMALL)]
    large.sort(key=lambda entry: -abs(entry[1]["value"]))
    if not large:
        return ""
    return f"Largest interactions: {'; '.join(f'{title}, {time_text(item)}' for title, item in large[:MOST_NAMED])}."


def reason_lines(summary: Content) -> Iterator[str]:
    """Yield the reason for each missing cost, and the meaning of the mark of costs that are not comparable."""
    for item in summary["budget"]["stages"]:
        if "reason" in item:
            yield f"{item['title']}: {item['reason']}."
    parts = [item[part] for item in summary["budget"]["stages"] for part in ("removed", "added") if part in item]
    if not all(part["comparable"] for part in parts):
        yield f"{NOT_COMPARABLE.strip()} The scenes with and without the stage lose different fractions of their scans."


def flag_lines(summary: Content) -> Iterator[str]:
    """Yield the flags of the first forecast that has some, and name the other points that have flags."""
    flagged = [point for point in summary["budget"]["points"] if point["forecast_flags"]]
    if summary["kind"] == "simulated" or not flagged:
        return
    first, *others = flagged
    for sentence in first["forecast_flags"]:
        yield f"the forecast ({first['label']}) may be off. {sentence}"
    if others:
        yield (
            f"the forecasts of {plural(len(others), 'other point')} may be off, too; forecast_flags of summary.json"
            " have the reasons."
        )
