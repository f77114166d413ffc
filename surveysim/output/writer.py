"""Files of a finished run: summary, resolved scene, tables, maps and figures, each written atomically."""

import logging
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings, simplefilter

import numpy as np

from mapmaker.binning import BinnedMap, write_fits, write_healpix
from mapmaker.files import atomic_write, write_ecsv
from surveysim.reduction.setup import prepare
from surveysim.report.html.page import REPORT, write_report
from surveysim.results.results import SurveyResult, score_rows, summary
from surveysim.results.stages import left_out
from surveysim.results.table import Table
from surveysim.runtime.provenance import made_by, now
from surveysim.runtime.strict_json import strict_json
from surveysim.runtime.text_files import one_line
from surveysim.scene.scene import resolved, scene_hash
from surveysim.studies.sweep.comparison import SweepResult, pairs
from surveysim.studies.sweep.tables import pair_table, sweep_summary, sweep_table
from surveysim.survey.coadds import row_names
from surveysim.telescope.raster import samples_per_scan

if TYPE_CHECKING:
    from surveysim.forecasting.forecast import Forecast
    from surveysim.studies.convergence import AccuracyResult


Drawings = dict[str, Callable[[Path], Any]]  # what draws a figure as a PNG, by its name

REASON = 120  # letters of the reason why a figure can't be drawn
log = logging.getLogger("surveysim")


def write_outputs(directory: Path, result: SurveyResult, figures: bool, timestreams: Sequence[str] = ()) -> None:
    """Write all results of a run below `directory`; summary.json lists its files, report.html is made of them all.

    `timestreams` are names of those that workers have written.
    """
    written = [write_text(directory / "scene.json", resolved(result.setup.scene) + "\n")]
    written += _write_tables(directory / "tables", result)
    written += _write_maps(directory / "maps", result)
    written += [directory / name for name in timestreams]
    write_summary(directory, summary(result), written, partial(_of_run, result) if figures else None)


def _of_run(result: SurveyResult) -> Drawings:
    from surveysim.report.figures.survey import drawings

    drawn = drawings(result.setup, result.coadds, result.scores, result.expected)
    if result.estimate is not None and np.isfinite(result.estimate.relative_error):
        from surveysim.report.figures.run_time import draw_time

        drawn["run_time"] = lambda path: draw_time(path, result)
    return drawn


def write_sweep(directory: Path, result: SweepResult, figures: bool) -> None:
    """Write tables, figure, summary and report of a sweep below `directory`, with the scene of its first point."""
    written = [_write_table(directory / "sweep.ecsv", sweep_table(result))]
    if of_pairs := pairs(result):
        written.append(_write_table(directory / "sweep_pairs.ecsv", pair_table(of_pairs)))
    written.append(write_text(directory / "scene.json", resolved(result.sweep.points[0].scene) + "\n"))
    drawn = partial(_of_sweep, result) if figures and result.comparison.best else None
    write_summary(directory, sweep_summary(result, of_pairs), written, drawn)


def _of_sweep(result: SweepResult) -> Drawings:
    from surveysim.report.figures.sweep import draw_sweep

    return {"sweep": lambda path: draw_sweep(path, result)}


def write_accuracy(directory: Path, result: "AccuracyResult", figures: bool) -> None:
    """Write table, figure, summary and report of a measurement of accuracy below `directory`, with its scene."""
    from surveysim.report.terminal.convergence import accuracy_table, reference_lines
    from surveysim.studies.convergence.records import TOLERATED

    written = [directory / "accuracy.ecsv", write_text(directory / "scene.json", resolved(result.scene) + "\n")]
    with atomic_write(written[0]) as unfinished:
        accuracy_table(result).write(unfinished, format="ascii.ecsv", overwrite=True)
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
        "left_out": left_out(prepare(result.scene)),
        "warnings": [],
        "detectors": prepare(result.scene).camera.n_det,
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
        _draw(directory / "figures", figures, files, warnings)
    finally:  # an interrupt too
        if figures:
            _write_record(directory, content | {"warnings": warnings}, files)
    write_report(directory)


def _draw(directory: Path, figures: Callable[[], Drawings] | None, files: list[Path], warnings: list[str]) -> None:
    """Draw what can be drawn; adds to the `files`, or to the `warnings`."""
    try:
        drawings = figures() if figures else {}
    except Exception as error:  # of a library for figures that can't be loaded
        warnings.append(undrawn("figures", error))
        return
    for name, draw in drawings.items():
        path = directory / f"{name}.png"
        try:
            with catch_warnings():
                simplefilter("ignore")  # of letters that no font has, and labels that have no room
                draw(path)
        except Exception as error:  # matplotlib raises a wide range: of fonts, formulas, sizes
            warnings.append(undrawn(f"figure {name!r}", error))
        else:
            files.append(path)


def _write_record(directory: Path, content: dict[str, Any], written: Iterable[Path]) -> None:
    files = sorted(path.relative_to(directory).as_posix() for path in (*written, directory / REPORT))
    write_text(directory / "summary.json", strict_json(content | {"files": files}, indent=2) + "\n")


def undrawn(what: str, error: Exception) -> str:
    """Warn that something could not be drawn; returns the line."""
    told = f": {one_line(error, REASON)}" if str(error).strip() else ""
    line = f"{what} can't be drawn ({type(error).__name__}{told}); all else is written"
    log.warning(line)
    return line


def write_forecast(directory: Path, forecast: "Forecast") -> Path:
    """Write forecast.ecsv, noise and signal PSDs of the map of each data set; returns its path."""
    table = Table({"ell": forecast.ell}, meta={"temperature": "CMB"})
    for name, item in forecast.scores.items():
        table.columns.update({f"noise_{name}": item.noise_psd, f"signal_{name}": item.signal_psd})
        table.units.update({f"noise_{name}": "uK2 sr", f"signal_{name}": "sr"})
    return _write_table(directory / "forecast.ecsv", table)


def write_text(path: Path, text: str) -> Path:
    """Write a text file atomically; returns its path."""
    with atomic_write(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


def _write_maps(directory: Path, result: SurveyResult) -> list[Path]:
    setup, coadds, written = result.setup, result.coadds, []
    for s, name in enumerate(setup.analysis.data_set_names):
        item = BinnedMap(setup.analysis.geometry, coadds.sums[s], coadds.weight[s], coadds.hits[s])
        header = {
            "SCENE": setup.scene.name,
            "DATASET": name,
            "SEED": setup.scene.seed,
            "NOBS": coadds.done,
            "SHA256": scene_hash(setup.scene),
        }
        written.append(directory / f"{name}.fits")
        write_fits(written[-1], item, header)
        if setup.scene.map.healpix_nside:
            written.append(directory / f"{name}_healpix.fits")
            write_healpix(written[-1], item, setup.scene.map.healpix_nside)
    return written


def _write_tables(directory: Path, result: SurveyResult) -> list[Path]:
    tables = {"observations": _observation_table(result), "timestream_psd": _timestream_table(result)}
    if result.scores:
        tables |= {"scores": _score_table(result), "map_psd": _spectrum_table(result)}
    if result.alternatives:
        tables["alternatives"] = _alternative_table(result)
    return [_write_table(directory / f"{name}.ecsv", table) for name, table in tables.items()]


def _write_table(path: Path, table: Table) -> Path:
    write_ecsv(path, table.columns, table.units, table.meta)
    return path


def _score_table(result: SurveyResult) -> Table:
    unknown = {"forecast_ukcmb2": np.nan, "reference_ukcmb2": np.nan}
    rows = [vars(row) | {k: vars(row)[k] or nan for k, nan in unknown.items()} for row in score_rows(result)]
    reference = result.setup.scene.score.reference
    return Table(
        columns={name: [row[name] for row in rows] for name in rows[0] if name != "kind"},
        units=dict.fromkeys(("sigma_ukcmb2", "error_ukcmb2", "plain_sigma_ukcmb2", *unknown), "uK2"),
        meta={"temperature": "CMB", "reference": reference.source if reference else "none"} | _part(result),
    )


def _part(result: SurveyResult) -> dict[str, int]:
    """What a table of the whole survey is judged by."""
    return {
        "observations_simulated": result.coadds.done,
        "observations_of_survey": result.setup.scene.observations,
    }


def _alternative_table(result: SurveyResult) -> Table:
    columns = {name: [row[name] for row in result.alternatives] for name in result.alternatives[0]}
    sigmas = [name for name in columns if name not in ("weights", "ell_min", "ell_eff", "fwhm_ell")]
    comment = "sigma(A) in uK_CMB^2 of the same data, scored otherwise"
    return Table(columns, dict.fromkeys(sigmas, "uK2"), {"comment": comment})


def _spectrum_table(result: SurveyResult) -> Table:
    band, rings = result.setup.analysis.region, result.setup.analysis.region.rings
    columns = {"ell": rings.ell, "n_modes": rings.n_modes, "scored": band.selected}
    columns["correlation_with_next"] = np.append(band.correlation, np.nan)
    units = {}
    for name, item in result.scores.items():
        columns |= {
            f"noise_{name}": item.noise_psd,
            f"noise_error_{name}": item.noise_psds.std(axis=0, ddof=1) / np.sqrt(len(item.noise_psds)),
            f"signal_{name}": item.signal_psd,
            f"window_{name}": item.window.transmission,
            f"window_error_{name}": item.window.error,
            f"cumulative_{name}": item.band.cumulative,
        }
        units |= dict.fromkeys((f"noise_{name}", f"noise_error_{name}"), "uK2 sr")
        units |= {f"signal_{name}": "sr", f"cumulative_{name}": "uK2"}
        if result.expected and name in result.expected.scores:
            columns[f"noise_forecast_{name}"] = result.expected.scores[name].noise_psd
            columns[f"window_forecast_{name}"] = result.expected.scores[name].transmission
            units[f"noise_forecast_{name}"] = "uK2 sr"
    return Table(columns, units, {"temperature": "CMB"} | _part(result))


def _timestream_table(result: SurveyResult) -> Table:
    coadds = result.coadds
    rate = result.setup.observing.raster.sample_rate_hz
    n_freq = len(coadds.raw_psd[0])
    frequency = np.arange(n_freq) * rate / samples_per_scan(result.setup.observing.raster)
    comment = "quantiles over observations of the mean PSD over detectors"
    table = Table({"frequency": frequency}, {"frequency": "Hz"}, {"comment": comment})
    compared = np.array(coadds.compared_psd)
    pipelines = enumerate(result.setup.analysis.whole_pipelines[1:])
    psds_of = {"raw": coadds.raw_psd, "clean": coadds.clean_psd}
    psds_of |= {f"clean_{pipeline.data_set}": compared[:, place] for place, pipeline in pipelines}
    for name, psds in psds_of.items():
        for label, level in (("q25", 25), ("median", 50), ("q75", 75)):
            table.columns[f"{name}_{label}"] = np.percentile(psds, level, axis=0)
            table.units[f"{name}_{label}"] = "mK2 / Hz"
    return table


def _observation_table(result: SurveyResult) -> Table:
    setup = result.setup
    columns = dict(zip(row_names(setup), np.array(result.coadds.rows).T, strict=True))
    columns |= {
        "observation": columns["observation"].astype(int),
        "start_mjd": setup.observing.angles.start_mjd[: result.coadds.done],
    }
    units = {"start_mjd": "d", "wind_speed_rad_s": "rad / s", "wind_angle_rad": "rad", "pwv_mm": "mm"}
    units |= {"elevation_rad": "rad", "white_mk2_hz": "mK2 / Hz"}
    units |= {f"noise_mk2_{name}": "mK2" for name in setup.analysis.data_set_names}
    if np.isnan(columns["pwv_mm"]).all():  # the scene has its own distribution of B2
        del columns["pwv_mm"], units["pwv_mm"]
    return Table(columns, units)
