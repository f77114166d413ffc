"""Files of a finished study: those of sweeps, budgets, searches, comparisons and measurements of accuracy."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from surveysim.output.band_writer import write_of_bands
from surveysim.output.drawings import Drawings
from surveysim.output.expected_study_files import point_directory
from surveysim.output.writer import write_summary, write_table, write_text
from surveysim.reduction.setup import Setup, prepare
from surveysim.results.stages import left_out
from surveysim.runtime.provenance import made_by, now
from surveysim.scene.scene import resolved, scene_hash
from surveysim.studies.budget.result import BudgetResult
from surveysim.studies.budget.summary import budget_summary
from surveysim.studies.compare.comparison import RunComparison
from surveysim.studies.compare.summary import comparison_summary
from surveysim.studies.compare.tables import score_rows
from surveysim.studies.optimise.result import OptimiseResult
from surveysim.studies.optimise.summary import optimum_summary
from surveysim.studies.optimise.tables import design_table, evaluation_table, front_table, optimum_table
from surveysim.studies.sweep.band_results import MultiBandSweepResult, band_sweep_summary
from surveysim.studies.sweep.result import SweepResult, pairs
from surveysim.studies.sweep.summary import sweep_summary
from surveysim.studies.sweep.tables import pair_table, sweep_table

if TYPE_CHECKING:
    from surveysim.studies.convergence import AccuracyResult
    from surveysim.studies.stress import Case, Outcome


def write_band_sweep(directory: Path, result: MultiBandSweepResult) -> None:
    """Write table, summary and report of all bands of a sweep below `directory`; each band has results of its own."""
    write_of_bands(directory, band_sweep_summary(result))


def write_sweep(directory: Path, first: Setup, result: SweepResult, figures: bool) -> None:
    """Write tables, figure, summary and report of a sweep below `directory`, with the scene of its `first` point."""
    of_pairs = pairs(result)
    content = sweep_summary(result, of_pairs) | {"left_out": left_out(first)}
    if result.simulated:
        for entry in content["points"]:
            entry["directory"] = point_directory(entry["point"])
    written = [write_table(directory / "sweep.ecsv", sweep_table(content))]
    if of_pairs:
        written.append(write_table(directory / "sweep_pairs.ecsv", pair_table(of_pairs, result.sweep.metric)))
    written.append(write_text(directory / "scene.json", resolved(first.scene) + "\n"))
    drawn = partial(_of_sweep, result) if figures and result.comparison.best else None
    write_summary(directory, content, written, drawn)


def _of_sweep(result: SweepResult) -> Drawings:
    from surveysim.report.figures.sweep import draw_sweep

    return {"sweep": lambda path: draw_sweep(path, result)}


def write_budget(directory: Path, whole: Setup, result: BudgetResult, figures: bool) -> None:
    """Write tables, figure, summary and report of a budget below `directory`, with its `whole` scene."""
    from surveysim.studies.budget.tables import budget_table, pair_table, point_table

    content = budget_summary(result) | {"left_out": left_out(whole)}
    tables = {"budget": budget_table(content), "budget_points": point_table(content)}
    if result.pairs:
        tables["budget_pairs"] = pair_table(content)
    written = [write_table(directory / "tables" / f"{name}.ecsv", table) for name, table in tables.items()]
    written.append(write_text(directory / "scene.json", resolved(whole.scene) + "\n"))
    drawn = partial(_of_budget, result) if figures and result.is_scored else None
    write_summary(directory, content, written, drawn)


def _of_budget(result: BudgetResult) -> Drawings:
    from surveysim.report.figures.budget import draw_budget

    return {"budget": lambda path: draw_budget(path, result)}


def write_optimum(directory: Path, result: OptimiseResult, figures: bool) -> None:
    """Write tables, figures, summary and report of a search below `directory`, with the scene as it is."""
    content = optimum_summary(result)
    tables = {
        "optimum": optimum_table(content),
        "designs": design_table(content),
        "evaluations": evaluation_table(result),
        "front": front_table(content),
    }
    if result.simulated is not None:
        tables["simulated"] = sweep_table(content["simulated"])
        if of_pairs := pairs(result.simulated):
            tables["simulated_pairs"] = pair_table(of_pairs)
    there = {name: table for name, table in tables.items() if table is not None}
    written = [write_table(directory / "tables" / f"{name}.ecsv", table) for name, table in there.items()]
    setup = prepare(result.problem.scene)
    written.append(write_text(directory / "scene.json", resolved(setup.scene) + "\n"))
    content |= {"left_out": left_out(setup)}
    write_summary(directory, content, written, partial(_of_optimum, result) if figures else None)


def _of_optimum(result: OptimiseResult) -> Drawings:
    from surveysim.report.figures.optimum import draw_optimum
    from surveysim.report.figures.sweep import draw_sweep

    found: Drawings = {"optimum": lambda path: draw_optimum(path, result)}
    simulated = result.simulated
    if simulated is not None and simulated.comparison.best:
        found["simulated"] = lambda path: draw_sweep(path, simulated)
    return found


def write_comparison(directory: Path, result: RunComparison, figures: bool) -> None:
    """Write table, figures, summary and report of a comparison of runs below `directory`."""
    content = comparison_summary(result)
    written = write_table(directory / "tables" / "compare.ecsv", score_rows(content["compared"]))
    drawn = partial(_of_comparison, result) if figures else None
    write_summary(directory, content | made_by() | {"run": {"date": now()}}, [written], drawn)


def _of_comparison(result: RunComparison) -> Drawings:
    from surveysim.report.figures.compare import drawings

    return drawings(result)


def write_accuracy(directory: Path, result: "AccuracyResult", figures: bool) -> None:
    """Write table, figure, summary and report of a measurement of accuracy below `directory`, with its scene."""
    from surveysim.report.tables import setting_meta, setting_rows, setting_table
    from surveysim.report.terminal.convergence import reference_lines
    from surveysim.studies.convergence.records import TOLERATED

    written = [write_text(directory / "scene.json", resolved(result.scene) + "\n")]
    table = setting_table(setting_rows(result), setting_meta(result))
    written.append(write_table(directory / "accuracy.ecsv", table))
    content = {
        "scene": result.scene.name,
        "title": result.scene.title,
        "seed": result.scene.seed,
        "scene_sha256": scene_hash(result.scene),
        **made_by(),
        "accuracy": {
            "reference": reference_lines(result),
            "reference_ukcmb2": result.reference_ukcmb2,
            "reference_error": result.reference_error,
            "reference_seeds": result.seeds,
            "tolerated_bias": result.own_error * TOLERATED,
            "slopes": [vars(item) for item in result.slopes],
            "recommended": [vars(item) for item in result.recommended],
        },
        "left_out": left_out(result.setup),
        "warnings": [],
        "detectors": result.setup.camera.n_det,
        "run": {"date": now(), "workers": result.workers, "wall_s": result.wall_s},
    }
    write_summary(directory, content, written, partial(_of_accuracy, result) if figures else None)


def _of_accuracy(result: "AccuracyResult") -> Drawings:
    from surveysim.report.figures.convergence import draw_accuracy

    return {"accuracy": lambda path: draw_accuracy(path, result)}


def write_extremes(path: Path, cases: Sequence["Case"], outcomes: Sequence["Outcome"]) -> Path:
    """Write a row for each extreme case as ECSV; returns its path."""
    from surveysim.report.tables import extreme_table

    return write_table(path, extreme_table(cases, outcomes))
