"""Files of a finished run or forecast: summary, resolved scene, tables, maps and figures, each written atomically."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapmaker.binning import BinnedMap, write_fits, write_healpix
from mapmaker.files import atomic_write, write_ecsv
from surveysim.output.drawings import Drawings, draw
from surveysim.output.expected_files import SCORES
from surveysim.output.sky import write_sky
from surveysim.output.spectra import write_spectra
from surveysim.output.tables import forecast_spectra, run_tables
from surveysim.report.html.page import REPORT, write_report
from surveysim.results.results import SurveyResult
from surveysim.results.summary import summary
from surveysim.runtime.strict_json import strict_json
from surveysim.runtime.table import Table
from surveysim.scene.scene import resolved, scene_hash

if TYPE_CHECKING:
    from surveysim.forecasting.forecast import Forecast


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
    written += [write_table(directory / "tables" / f"{name}.ecsv", table) for name, table in tables.items()]
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
    from surveysim.studies.sweep.point_run import point_result
    from surveysim.studies.sweep.point_store import save_point

    # Without the run time, which summary.json has, the file depends on the scene alone.
    save_point(path, replace(point_result(result), wall_s=0.0), scene_hash(result.setup.scene))
    return [path]


def _of_run(result: SurveyResult) -> Drawings:
    from surveysim.report.figures.survey import drawings

    return drawings(result)


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
    return write_table(directory / "forecast.ecsv", forecast_spectra(forecast))


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


def write_table(path: Path, table: Table) -> Path:
    """Write a table as ECSV; returns its path."""
    write_ecsv(path, table.in_files, table.units, table.meta)
    return path
