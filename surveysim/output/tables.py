"""Tables that are written to files only: observations, spectra of maps and time-streams, forecasts."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from surveysim.results.metric_tables import metric_file_table
from surveysim.results.results import SurveyResult
from surveysim.results.sensitivity import sensitivity_tables
from surveysim.results.sky_tables import flux_table, sky_transfer_table
from surveysim.results.spectra import split_spectra_table
from surveysim.results.tables import alternative_table, score_table
from surveysim.runtime.table import Column, Table, file_column
from surveysim.survey.rows import row_names
from surveysim.telescope.scans import samples_per_scan

if TYPE_CHECKING:
    from surveysim.forecasting.forecast import Forecast

_QUANTILES = (("q25", 25), ("median", 50), ("q75", 75))


def run_tables(result: SurveyResult, summary: dict[str, Any]) -> dict[str, Table]:
    """Return all tables of a run by name of the file, `summary` being the content of its summary.json."""
    tables = {"observations": observation_table(result), "timestream_psd": timestream_table(result)}
    if result.scores:
        from surveysim.results.metrics import metric_tables

        reference = result.setup.scene.score.reference
        meta = {"temperature": "CMB", "reference": reference.source if reference else "none"}
        tables["scores"] = score_table(summary["scores"], meta=meta | _survey_part(result))
        tables["metrics"] = metric_file_table(summary["metrics"], {"temperature": "CMB"} | _survey_part(result))
        tables |= metric_tables(result.setup, result.scores)
        tables["map_psd"] = spectrum_table(result)
    if result.sky:
        scored = result.setup.analysis.region.selected
        tables["sky_transfer"] = sky_transfer_table(result.sky, scored, _survey_part(result))
        if any(item.fluxes for item in result.sky.values()):
            tables["sky_fluxes"] = flux_table(result.sky, _survey_part(result))
    if result.spectra:
        tables["split_spectra"] = split_spectra_table(result.spectra, {"temperature": "CMB"} | _survey_part(result))
    if "sensitivity" in summary:
        tables |= {table.name: table for table in sensitivity_tables(summary["sensitivity"])}
    if result.alternatives:
        tables["alternatives"] = alternative_table(summary["alternatives"])
    return tables


def _survey_part(result: SurveyResult) -> dict[str, int]:
    """Numbers of simulated observations and of observations in the survey."""
    return {
        "observations_simulated": result.coadds.done,
        "observations_of_survey": result.setup.scene.observations,
    }


def spectrum_table(result: SurveyResult) -> Table:
    """Return noise and signal PSDs of the map and the transfer function of each data set, by bin of multipoles."""
    band, rings = result.setup.analysis.region, result.setup.analysis.region.rings
    columns = [
        file_column("ell", rings.ell),
        file_column("n_modes", rings.n_modes),
        file_column("scored", band.selected),
        file_column("correlation_with_next", np.append(band.correlation, np.nan)),
    ]
    for name in result.scores:
        columns += _spectra(result, name)
    meta = {"temperature": "CMB"} | _survey_part(result)
    return Table("map_psd", "Spectra of the co-added maps", tuple(columns), meta=meta)


def _spectra(result: SurveyResult, name: str) -> Iterator[Column]:
    """Columns of one data set."""
    item = result.scores[name]
    error = item.noise_psds.std(axis=0, ddof=1) / np.sqrt(len(item.noise_psds))
    yield file_column(f"noise_{name}", item.noise_psd, "uK2 sr")
    yield file_column(f"noise_error_{name}", error, "uK2 sr")
    yield file_column(f"signal_{name}", item.signal_psd, "sr")
    yield file_column(f"transfer_function_{name}", item.transfer_function.transmission)
    yield file_column(f"transfer_function_error_{name}", item.transfer_function.error)
    yield file_column(f"cumulative_{name}", item.band.cumulative, "uK2")
    if result.expected and name in result.expected.scores:
        expected = result.expected.scores[name]
        yield file_column(f"noise_forecast_{name}", expected.noise_psd, "uK2 sr")
        yield file_column(f"transfer_function_forecast_{name}", expected.transmission)


def timestream_table(result: SurveyResult) -> Table:
    """Return quantiles over observations of the time-streams' PSDs, before and after each cleaning."""
    coadds, scans = result.coadds, result.setup.observing.scans
    frequency = np.arange(len(coadds.raw_psd[0])) * scans.sample_rate_hz / samples_per_scan(scans)
    compared = np.array(coadds.compared_psd)
    pipelines = enumerate(result.setup.analysis.whole_pipelines[1:])
    psds_of: dict[str, Sequence[np.ndarray] | np.ndarray]
    psds_of = {"raw": coadds.raw_psd, "clean": coadds.clean_psd}
    psds_of |= {f"clean_{pipeline.data_set}": compared[:, place] for place, pipeline in pipelines}
    columns = [file_column("frequency", frequency, "Hz")]
    for name, psds in psds_of.items():
        for label, level in _QUANTILES:
            columns.append(file_column(f"{name}_{label}", np.percentile(psds, level, axis=0), "mK2 / Hz"))
    meta = {"comment": "quantiles over observations of the mean PSD over detectors"}
    return Table("timestream_psd", "PSDs of the time-streams", tuple(columns), meta=meta)


def observation_table(result: SurveyResult) -> Table:
    """Return weather, pointing, discarded scans and map noise of each observation."""
    setup = result.setup
    units = {"wind_speed_rad_s": "rad / s", "wind_angle_rad": "rad", "pwv_mm": "mm", "elevation_rad": "rad"}
    units |= {"white_mk2_hz": "mK2 / Hz"} | {f"noise_mk2_{name}": "mK2" for name in setup.analysis.data_set_names}
    columns = dict(zip(row_names(setup.analysis), np.array(result.coadds.rows).T, strict=True))
    if np.isnan(columns["pwv_mm"]).all():  # the scene has its own distribution of B2
        del columns["pwv_mm"]
    if not setup.scene.losses:
        del columns["flagged"]
    columns["observation"] = columns["observation"].astype(int)
    made = [file_column(name, values, units.get(name, "")) for name, values in columns.items()]
    made.append(file_column("start_mjd", setup.observing.angles.start_mjd[: result.coadds.done], "d"))
    return Table("observations", "Observations", tuple(made))


def forecast_spectra(forecast: "Forecast") -> Table:
    """Return forecast noise and signal PSDs of the map of each data set, by bin of multipoles."""
    columns = [file_column("ell", forecast.ell)]
    for name, item in forecast.scores.items():
        columns.append(file_column(f"noise_{name}", item.noise_psd, "uK2 sr"))
        columns.append(file_column(f"signal_{name}", item.signal_psd, "sr"))
    return Table("forecast", "Forecast spectra of the maps", tuple(columns), meta={"temperature": "CMB"})
