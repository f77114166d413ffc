"""Files of a finished run: summary, resolved scene, tables, maps and figures, each written atomically."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapmaker.binning import BinnedMap, write_fits, write_healpix
from mapmaker.files import atomic_write, write_ecsv
from surveysim.output.drawings import Drawings, draw
from surveysim.output.expected_files import SCORES, point_directory
from surveysim.output.sky import write_sky
from surveysim.output.spectra import write_spectra
from surveysim.output.tables import forecast_spectra, run_tables
from surveysim.reduction.setup import Setup, prepare
from surveysim.report.html.page import REPORT, write_report
from surveysim.results.bands import (
    MultiBandForecast,
    MultiBandResult,
    band_table,
    forecast_entries,
    multi_band_summary,
)
from surveysim.results.results import SurveyResult
from surveysim.results.stages import left_out
from surveysim.results.summary import summary
from surveysim.runtime.provenance import made_by, now
from surveysim.runtime.strict_json import strict_json
from surveysim.runtime.table import Table
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
from surveysim.studies.sweep.point_run import point_result
from surveysim.studies.sweep.point_store import save_point
from surveysim.studies.sweep.result import SweepResult, pairs
from surveysim.studies.sweep.summary import sweep_summary
from surveysim.studies.sweep.tables import pair_table, sweep_table

if TYPE_CHECKING:
    from surveysim.forecasting.forecast import Forecast
    from surveysim.studies.convergence import AccuracyResult
    from surveysim.studies.stress import Case, Outcome


def write_outputs(
    directory: Path,
    result: SurveyResult,
    figures: bool,
    timestreams: Sequence[str] = (),
    *,
    maps: bool = True,
    point: str = "",
) -> None:
    """Write all results of a run below `directory`; summary.json lists its files, report.html is made of them all.

    `timestreams` are names of those that workers have written, `point` is the label of a point of a sweep.
    """
    content = summary(result) | ({"point": point} if point else {})
    written = [write_text(directory / "scene.json", resolved(result.setup.scene) + "\n")]
    tables = run_tables(result, content)
    written += [_write_table(directory / "tables" / f"{name}.ecsv", table) for name, table in tables.items()]
    written += _write_scores(directory / SCORES, result)
    written += write_spectra(directory, result.spectra) if result.spectra else []
    written += _write_maps(directory / "maps", result) if maps else []
    written += write_sky(directory / "maps", result.sky, partial(_header, result)) if maps else []
    written += [directory / name for name in timestreams]
    write_summary(directory, content, written, partial(_of_run, result) if figures else None)


def _write_scores(path: Path, result: SurveyResult) -> list[Path]:
    """Write the part of the scores that comparisons with other runs need; no file without a score."""
    if not result.scores:
        return []
    # Without the run time, which summary.json has, the file depends on the scene alone.
    save_point(path, replace(point_result(result), wall_s=0.0), scene_hash(result.setup.scene))
    return [path]


def write_bands(directory: Path, result: MultiBandResult) -> None:
    """Write table, summary and report of all bands of a camera below `directory`; each band has results of its own."""
    _write_of_bands(directory, multi_band_summary(result))


def write_band_sweep(directory: Path, result: MultiBandSweepResult) -> None:
    """As `write_bands`, of a sweep."""
    _write_of_bands(directory, band_sweep_summary(result))


def _write_of_bands(directory: Path, content: dict[str, Any]) -> None:
    run = content["run"] | {"date": now()}
    meta = {"temperature": "CMB", "seed": content["seed"], "scene_sha256": content["scene_sha256"]}
    written = _write_table(directory / "bands.ecsv", band_table(content["bands"], meta))
    write_summary(directory, content | made_by() | {"run": run}, [written])


def write_band_forecasts(directory: Path, result: MultiBandForecast) -> None:
    """Write bands.ecsv, the forecast of sigma(A) in each band of a camera."""
    _write_table(directory / "bands.ecsv", band_table(forecast_entries(result), {"temperature": "CMB"}))


def _of_run(result: SurveyResult) -> Drawings:
    from surveysim.report.figures.survey import drawings

    return drawings(result)


def write_sweep(directory: Path, first: Setup, result: SweepResult, figures: bool) -> None:
    """Write tables, figure, summary and report of a sweep below `directory`, with the scene of its `first` point."""
    of_pairs = pairs(result)
    content = sweep_summary(result, of_pairs) | {"left_out": left_out(first)}
    if result.simulated:
        for entry in content["points"]:
            entry["directory"] = point_directory(entry["point"])
    written = [_write_table(directory / "sweep.ecsv", sweep_table(content))]
    if of_pairs:
        written.append(_write_table(directory / "sweep_pairs.ecsv", pair_table(of_pairs, result.sweep.metric)))
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
    written = [_write_table(directory / "tables" / f"{name}.ecsv", table) for name, table in tables.items()]
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
    written = [_write_table(directory / "tables" / f"{name}.ecsv", table) for name, table in there.items()]
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
    written = _write_table(directory / "tables" / "compare.ecsv", score_rows(content["compared"]))
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
    written.append(_write_table(directory / "accuracy.ecsv", table))
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


def write_summary(
    directory: Path,
    content: dict[str, Any],
    written: Iterable[Path],
    figures: Callable[[], Drawings] | None = None,
) -> None:
    """Write summary.json, which lists the files `written` below `directory`, then `figures`, then report.html.

    The results are safe before anything is drawn, and a figure that can't be drawn costs a warning: summary.json lists
    the figures that are there, and has a warning in place of each other one.
    """
    files, warnings = list(written), list(content.get("warnings", ()))
    _write_record(directory, content, files)
    try:
        draw(directory / "figures", figures, files, warnings)
    finally:  # an interrupt too
        if figures:
            _write_record(directory, content | {"warnings": warnings}, files)
    write_report(directory)


def _write_record(directory: Path, content: dict[str, Any], written: Iterable[Path]) -> None:
    files = sorted(path.relative_to(directory).as_posix() for path in (*written, directory / REPORT))
    write_text(directory / "summary.json", strict_json(content | {"files": files}, indent=2) + "\n")


def write_forecast(directory: Path, forecast: "Forecast") -> Path:
    """Write forecast.ecsv, noise and signal PSDs of the map of each data set; returns its path."""
    return _write_table(directory / "forecast.ecsv", forecast_spectra(forecast))


def write_extremes(path: Path, cases: Sequence["Case"], outcomes: Sequence["Outcome"]) -> Path:
    """Write a row for each extreme case as ECSV; returns its path."""
    from surveysim.report.tables import extreme_table

    return _write_table(path, extreme_table(cases, outcomes))


def write_text(path: Path, text: str) -> Path:
    """Write a text file atomically; returns its path."""
    with atomic_write(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


def _header(result: SurveyResult, data_set: str) -> dict[str, object]:
    """Values of the primary header of a map."""
    scene = result.setup.scene
    return {
        "SCENE": scene.name,
        "DATASET": data_set,
        "SEED": scene.seed,
        "NOBS": result.coadds.done,
        "SHA256": scene_hash(scene),
    }


def _write_maps(directory: Path, result: SurveyResult) -> list[Path]:
    setup, coadds, written = result.setup, result.coadds, []
    for s, name in enumerate(setup.analysis.data_set_names):
        planes = (plane[s][None] for plane in (coadds.sums, coadds.weight, coadds.hits))  # Stokes I
        item = BinnedMap(setup.analysis.geometry, *planes)
        written.append(directory / f"{name}.fits")
        write_fits(written[-1], item, _header(result, name))
        if setup.scene.map.healpix_nside:
            written.append(directory / f"{name}_healpix.fits")
            write_healpix(written[-1], item, setup.scene.map.healpix_nside)
    return written


def _write_table(path: Path, table: Table) -> Path:
    write_ecsv(path, table.in_files, table.units, table.meta)
    return path
