"""Files of a finished run: summary, resolved scene, tables, maps and figures, each written atomically."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.binning import BinnedMap, write_fits, write_healpix
from mapmaker.files import whole_file
from surveysim.coadds import row_names
from surveysim.results import SurveyResult, score_rows, summary
from surveysim.scan import samples_per_scan
from surveysim.scene import resolved, scene_hash

if TYPE_CHECKING:
    from astropy.table import Table


def write_outputs(directory: Path, result: SurveyResult, figures: bool, timestreams: bool) -> None:
    """Write all results of a run below `directory`; summary.json, the last, lists the files of the run."""
    written = [write_text(directory / "scene.json", resolved(result.setup.scene) + "\n")]
    written += _write_tables(directory / "tables", result)
    written += _write_maps(directory / "maps", result)
    if figures:
        from surveysim.report.figures import draw_figures

        written += draw_figures(directory / "figures", result.setup, result.coadds, result.scores)
    if timestreams:
        written += [directory / "timestreams" / f"{number:04d}.h5" for number in range(result.coadds.done)]
    files = sorted(path.relative_to(directory).as_posix() for path in written)
    write_text(directory / "summary.json", json.dumps(summary(result) | {"files": files}, indent=2) + "\n")


def remove_outputs(directory: Path) -> None:
    """Remove the files that an earlier run listed in its summary, so that none stands beside this run's.

    Nothing else in `directory` is touched, nor anything where there is no readable summary.
    """
    summary_file = directory / "summary.json"
    try:
        files = [directory / name for name in json.loads(summary_file.read_text(encoding="utf-8"))["files"]]
    except (OSError, ValueError, KeyError, TypeError):
        return
    for path in (*files, summary_file):
        if path.resolve().is_relative_to(directory.resolve()):
            path.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> Path:
    """Write a text file atomically; returns its path."""
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


def _write_maps(directory: Path, result: SurveyResult) -> list[Path]:
    setup, coadds, written = result.setup, result.coadds, []
    for s, name in enumerate(setup.data_sets):
        item = BinnedMap(setup.geometry, coadds.sums[s], coadds.weight[s], coadds.hits[s])
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
    written = []
    for name, table in tables.items():
        written.append(directory / f"{name}.ecsv")
        with whole_file(written[-1]) as partial:
            table.write(partial, format="ascii.ecsv", overwrite=True)
    return written


def _score_table(result: SurveyResult) -> "Table":
    from astropy.table import Table

    rows = [vars(row) | {"reference_ukcmb2": row.reference_ukcmb2 or np.nan} for row in score_rows(result)]
    table = Table(rows=rows)
    for name in ("sigma_ukcmb2", "error_ukcmb2", "reference_ukcmb2"):
        table[name].unit = "uK2"
    reference = result.setup.scene.score.reference
    table.meta["temperature"] = "CMB"
    table.meta["reference"] = reference.source if reference else "none"
    return table


def _alternative_table(result: SurveyResult) -> "Table":
    from astropy.table import Table

    table = Table(rows=result.alternatives)
    for name in table.colnames:
        if name not in ("weights", "ell_min", "ell_eff", "fwhm_ell"):
            table[name].unit = "uK2"
    table.meta["comment"] = "sigma(A) in uK_CMB^2 of the same data, scored otherwise"
    return table


def _spectrum_table(result: SurveyResult) -> "Table":
    from astropy.table import Table

    rings = result.setup.band.rings
    table = Table({"ell": rings.ell, "n_modes": rings.n_modes, "scored": result.setup.band.selected})
    for name, item in result.scores.items():
        table[f"noise_{name}"] = item.noise_psd
        table[f"noise_{name}"].unit = "uK2 sr"
        table[f"noise_error_{name}"] = item.noise_psds.std(axis=0, ddof=1) / np.sqrt(len(item.noise_psds))
        table[f"signal_{name}"] = item.signal_psd
        table[f"window_{name}"] = item.window.transmission
        table[f"window_error_{name}"] = item.window.error
        table[f"cumulative_{name}"] = item.band.cumulative
        for column, unit in (
            (f"noise_error_{name}", "uK2 sr"),
            (f"signal_{name}", "sr"),
            (f"cumulative_{name}", "uK2"),
        ):
            table[column].unit = unit
    table.meta["temperature"] = "CMB"
    return table


def _timestream_table(result: SurveyResult) -> "Table":
    from astropy.table import Table

    coadds = result.coadds
    rate = result.setup.raster.sample_rate_hz
    n_freq = len(coadds.raw_psd[0])
    table = Table({"frequency": np.arange(n_freq) * rate / samples_per_scan(result.setup.raster)})
    table["frequency"].unit = "Hz"
    compared = np.array(coadds.compared_psd)
    recipes = enumerate(result.setup.whole_recipes[1:])
    psds_of = {"raw": coadds.raw_psd, "clean": coadds.clean_psd}
    psds_of |= {f"clean_{recipe.data_set}": compared[:, place] for place, recipe in recipes}
    for name, psds in psds_of.items():
        for label, level in (("q25", 25), ("median", 50), ("q75", 75)):
            table[f"{name}_{label}"] = np.percentile(psds, level, axis=0)
            table[f"{name}_{label}"].unit = "mK2 / Hz"
    table.meta["comment"] = "quantiles over observations of the mean PSD over detectors"
    return table


def _observation_table(result: SurveyResult) -> "Table":
    from astropy.table import Table

    setup = result.setup
    table = Table(np.array(result.coadds.rows), names=row_names(setup))
    table["start_mjd"] = setup.angles.start_mjd[: result.coadds.done]
    table["start_mjd"].unit = "d"
    units = {"wind_speed_rad_s": "rad / s", "wind_angle_rad": "rad", "pwv_mm": "mm"}
    units |= {"elevation_rad": "rad", "white_mk2_hz": "mK2 / Hz"}
    for name, unit in units.items() | {(f"noise_mk2_{name}", "mK2") for name in setup.data_sets}:
        table[name].unit = unit
    table["observation"] = table["observation"].astype(int)
    if np.isnan(table["pwv_mm"]).all():  # the scene has its own distribution of B2
        table.remove_column("pwv_mm")
    return table
