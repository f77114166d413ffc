"""Error against run time on the page of a run."""

from collections.abc import Iterator, Mapping
from typing import Any

from surveysim.report.html.components import Block, Cell, Grid, Text, cell
from surveysim.results.metric_tables import label
from surveysim.runtime.numbers import duration, number, percent, plural

Content = Mapping[str, Any]  # content of summary.json or scene.json


def time_blocks(summary: Content, scene: Content) -> Iterator[Block]:
    """Return the run time, the parts of the error, and the cost of smaller errors."""
    run, stopped = summary["run"], summary["stopped"]
    each_s = sum(run["stage_s"].values()) / summary["observations"]
    ns = sum(run["stage_ns_per_detector_sample"].values())
    reasons = {
        "all": "all observations of the survey were simulated",
        "target": f"the target error of {percent(stopped.get('target_error') or 0)} was reached",
        "budget": f"the time budget of {duration(stopped.get('time_budget_s') or 0)} was spent",
        "sweep": "the sweep needed no more observations of this point",
    }
    text = (
        f"{plural(summary['observations'], 'observation')} took {duration(run['wall_s'])} of wall time with"
        f" {plural(run['workers'], 'worker')}, from start to score. The simulation alone took {duration(each_s)} of one"
        f" worker for each observation, or {number(ns, 2)} ns for each of"
        f" {number(summary['detector_samples'] / 1e6)} million detector-samples."
        f" The run ended when {reasons[stopped['reason']]}."
    )
    if stopped.get("relative_error") is not None:
        name = label(stopped["metric"]).replace("sigma", "σ")
        text += f" {name} is known to {percent(stopped['relative_error'])}."
    yield Text((text,))
    if summary.get("error_budget"):
        yield _budget_grid(summary)
    if summary.get("time_to_precision"):
        yield _answer_grid(summary, scene)


def _budget_grid(summary: Content) -> Grid:
    """Relative errors of sigma(A) as quoted, by origin."""
    kinds = ("noise", "weather", "transfer_function", "population")
    rows = []
    for name, entry in summary["error_budget"].items():
        parts = [_share(entry[kind]) for kind in kinds]
        total = None if None in entry.values() else sum(value**2 for value in entry.values()) ** 0.5
        rows.append((cell(name), *parts, _share(total)))
    columns = ("estimate", *(f"{kind.replace('_', ' ')} [%]" for kind in kinds), "in all [%]")
    left = " that the forecast does not explain" if summary["estimate"]["kind"] == "controlled" else ""
    note = (
        f"Noise: its realizations; weather: the sample of observations, their weather and discarded scans{left};"
        " transfer function: simulated skies; population: the forecast's sample of all weather. They add in quadrature."
    )
    return Grid("budget-table", "Relative error of σ(A), by origin", columns, tuple(rows), (note,))


def _share(value: float | None) -> Cell:
    return Cell("unknown") if value is None else Cell(number(100 * value, 2), 100 * value)


def _answer_grid(summary: Content, scene: Content) -> Grid:
    score, run, best = scene["score"], summary["run"], summary["estimate"]
    answers = summary["time_to_precision"]
    here = {
        "relative_error": None if best["error_ukcmb2"] is None else best["error_ukcmb2"] / best["sigma_ukcmb2"],
        "seconds": sum(run["stage_s"].values()) / run["workers"],
        "observations": summary["observations"],
        "jackknives": score["jackknives"],
        "skies": score["signal_sims"]["skies"],
    }
    rows: list[tuple[Cell, ...]] = []
    mark = 0
    known = [answer for answer in (here, *answers) if answer["relative_error"] is not None]
    for answer in sorted(known, key=lambda answer: -answer["relative_error"]):
        if answer is here:
            mark = len(rows)
        name = f"{percent(answer['relative_error'])}{', this run' if answer is here else ''}"
        numbers = [cell(answer[key]) for key in ("observations", "jackknives", "skies")]
        rows.append((cell(name), Cell(duration(answer["seconds"]), answer["seconds"]), *numbers))
    note = (
        f"Simulation time with {plural(run['workers'], 'worker')}, extrapolated from this run's own errors and times. "
        "The wall time also contains starting, compiling kernels and scoring."
    )
    columns = ("error of σ(A)", "simulation time", "observations", "sign-flipped co-adds", "simulated skies")
    return Grid("answer-table", "Cost of a smaller error", columns, tuple(rows), (note,), (mark,))
