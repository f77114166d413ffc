"""Results of studies: the files that each may write, and a hash of everything that they depend on."""

from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import Any

from surveysim.output.expected_files import COMMON, OF_BANDS, beside_checkpoint
from surveysim.output.record import Results
from surveysim.output.scene_copy import bands_files, scene_files, sweep_files
from surveysim.scene.scene import Scene, scene_hash
from surveysim.studies.budget.points import Budget
from surveysim.studies.compare.comparison import RunComparison
from surveysim.studies.convergence.records import MOST_SEEDS, REFERENCE_ERROR, SUB_SURVEY
from surveysim.studies.optimise.problem import Problem
from surveysim.studies.optimise.store import FILE as EVALUATIONS
from surveysim.studies.sweep.axes import Sweep, sweep_hash
from surveysim.studies.sweep.bands import MultiBandSweep, band_sweep_hash
from surveysim.studies.sweep.point_run import Stage
from surveysim.studies.sweep.rounds import SweepLimits, round_ends

COMPARISON_FIGURES = ("map_psd", "transfer_function", "timestream_psd")
_PARTS = {"1": ("sites",), "2": ("photons",), "3": ("gains",)}  # parts of a table with separate files


def point_directory(number: int) -> str:
    """Directory of the results of a point, within that of its sweep."""
    return f"points/{number}"


def of_band_sweep(sweep: MultiBandSweep, command: str) -> Results:
    """Return the results of a sweep of a camera of several bands beside the directories of the bands."""
    return Results(command, sweep.name, band_sweep_hash(sweep), OF_BANDS, bands_files(sweep))


def of_sweep(sweep: Sweep, command: str, figures: bool, limits: SweepLimits | None = None) -> Results:
    """Return the results of a sweep; simulated sweeps keep the scores and sums of their points until the end."""
    names = [*COMMON, "sweep.ecsv", "sweep_pairs.ecsv", *(["figures/sweep.png"] if figures else [])]
    if command == "run":
        names += _kept_points(sweep)
    identity = sweep_hash(sweep)
    if limits is not None:
        stages = [Stage(point, end) for point in sweep.points for end in round_ends(sweep.points)]
        names += [f"points/{stage.file}" for stage in stages if stage.observations < stage.point.scene.observations]
        identity = sha256(f"{identity} {limits}".encode()).hexdigest()
    return Results(command, sweep.name, identity, tuple(names), sweep_files(sweep))


def of_budget(budget: Budget, simulate: bool, figures: bool) -> Results:
    """Return the results of a budget; a simulated one keeps its points until the end."""
    names = [*COMMON, *(f"tables/{name}.ecsv" for name in ("budget", "budget_points", "budget_pairs"))]
    names += ["figures/budget.png"] if figures else []
    if simulate:
        names += _kept_points(budget.sweep)
    command = "budget" if simulate else "budget --forecast"
    return Results(command, budget.name, sweep_hash(budget.sweep), tuple(names), sweep_files(budget.sweep))


def _kept_points(sweep: Sweep) -> list[str]:
    names = [f"points/{point.number:03d}.{kind}" for point in sweep.points for kind in ("npz", "checkpoint.h5")]
    for point in sweep.points:
        names += [f"points/{point.number:03d}.{name}" for name in beside_checkpoint(point.scene)]
    return names


def of_optimise(problem: Problem, figures: bool) -> Results:
    """Return the results of a search for the best design; simulated designs are kept until the end."""
    tables = ("optimum", "designs", "front", "evaluations", "simulated", "simulated_pairs")
    names = [*COMMON, EVALUATIONS, *(f"tables/{name}.ecsv" for name in tables)]
    names += [f"figures/{name}.png" for name in ("optimum", "simulated") if figures]
    for number in range(problem.options.rivals + 2):
        names += [f"points/{number:03d}.{kind}" for kind in ("npz", "checkpoint.h5")]
    return Results("optimise", problem.scene.name, problem.identity, tuple(names), scene_files(problem.scene))


def accuracy_settings(reference_error: float, seeds: int, observations: int) -> dict[str, Any]:
    """Return the options of a convergence study that differ from their defaults, by key."""
    told = {"reference_error": reference_error, "seeds": seeds, "observations": observations}
    usual = {"reference_error": REFERENCE_ERROR, "seeds": MOST_SEEDS, "observations": SUB_SURVEY}
    return {f"accuracy.{key}": value for key, value in told.items() if value != usual[key]}


def of_accuracy(scene: Scene, settings: Mapping[str, Any], figures: bool) -> Results:
    """Return the results of a convergence study, with its `accuracy_settings`."""
    names = (*COMMON, "accuracy.ecsv", *(["figures/accuracy.png"] if figures else []))
    identity = sha256(f"{scene_hash(scene)} {sorted(settings.items())}".encode()).hexdigest()
    return Results("accuracy", scene.name, identity, names, scene_files(scene))


def of_comparison(result: RunComparison, figures: bool) -> Results:
    """Return the results of a comparison of runs."""
    drawn = (f"figures/{name}.png" for name in COMPARISON_FIGURES) if figures else ()
    names = ("summary.json", "report.html", "tables/compare.ecsv", *drawn)
    identity = sha256(" ".join(run.summary["scene_sha256"] for run in result.runs).encode()).hexdigest()
    return Results("compare", " ".join(run.label for run in result.runs), identity, names)


EXTREMES = Results("accuracy --extremes", "", "", ("extremes.ecsv",))


def of_paper(items: Sequence[str]) -> Results:
    """Return the results of items such as "table 1", "figure 5" and "143 GHz"; their record names the scenes."""
    names = ["summary.json", "report.html"]
    for item in items:
        kind, _, number = item.partition(" ")
        if kind == "figure":
            names += [f"figure{int(number):02d}.{ending}" for ending in ("png", "ecsv")]
        elif kind == "table":
            names += [f"table{number}.ecsv", *(f"table{number}_{part}.ecsv" for part in _PARTS.get(number, ()))]
        else:
            names += [f"{part}_{kind}.ecsv" for part in ("measurements", "recovered")]
    return Results("paper", "", "", tuple(names), piecewise=True)


def of_explanation(ingredients: Sequence[str], identity: str) -> Results:
    """Return the results of an explanation of the paper's findings with some ingredients; `identity` is their hash."""
    names = ["summary.json", "report.html", "explain.ecsv", "second_layer.ecsv", "second_layer.png"]
    names += [f"observations_{name}.ecsv" for name in ingredients]
    return Results("paper --explain", "", identity, tuple(names), piecewise=True)
