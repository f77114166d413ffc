"""Results of a camera of several bands: those of each band, and one table of all."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from surveysim.forecasting.forecast import Forecast
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.design_warnings import design_warnings
from surveysim.reduction.setup import Setup, prepare
from surveysim.results.control_variate import in_all_weather
from surveysim.results.results import SurveyResult, score_entries
from surveysim.results.tables import rounded_column
from surveysim.runtime.numbers import count, number
from surveysim.runtime.strict_json import known
from surveysim.runtime.table import SIGMA, Table, column, quoted_columns, share_text
from surveysim.scene.bands import MultiBandScene, bands_hash

if TYPE_CHECKING:
    from astropy.table import QTable

Content = Mapping[str, Any]  # of the entry `bands` of summary.json
OF_SCORE = ("sigma_ukcmb2", "error_ukcmb2", "ell_eff", "fwhm_ell", "forecast_ukcmb2")


@dataclass(frozen=True)
class MultiBandResult:
    """Finished runs of the bands of a camera, by name.

    Errors of different bands are not independent, as these see one layer and one sky. Correlations between maps of
    different bands are not computed.
    """

    scenes: MultiBandScene
    bands: dict[str, SurveyResult]
    wall_s: float
    engine: str

    @property
    def is_whole(self) -> bool:
        """Return whether all observations of all bands are finished."""
        return all(item.coadds.done == item.setup.scene.observations for item in self.bands.values())

    @property
    def workers(self) -> int:
        """Largest number of workers of a band."""
        return max(item.workers for item in self.bands.values())

    def table(self) -> "QTable":
        """Return a row for each band with units, as bands.ecsv has it."""
        return self._table().quantities()

    def _table(self) -> Table:
        return band_table(run_entries(self), {})

    def __repr__(self) -> str:
        """A line on the run above its table."""
        return f"MultiBandResult of {self.scenes.name}: {len(self.bands)} bands\n{self._table().text()}"

    def _repr_html_(self) -> str:
        """The table."""
        return self._table().html()


@dataclass(frozen=True)
class MultiBandForecast:
    """Forecasts of the bands of a camera by name, and the reasons of those without one."""

    scenes: MultiBandScene
    bands: dict[str, Forecast]
    reasons: dict[str, str]

    def table(self) -> "QTable":
        """Return a row for each band with units, as bands.ecsv has it."""
        return band_table(forecast_entries(self), {}).quantities()


def run_entries(result: MultiBandResult) -> dict[str, dict[str, Any]]:
    """Return the entry of each band, as summary.json has it: without absent values, None if unknown."""
    return {name: _run_entry(item) for name, item in result.bands.items()}


def _run_entry(item: SurveyResult) -> dict[str, Any]:
    entry = _band_entry(item.setup)
    entry |= {"observations": item.coadds.done, "stopped": item.stopped}
    entry |= {
        "discarded": item.discards.shares[ACTUAL],
        "warnings": [*design_warnings(item.setup), *item.warnings],
    }
    if item.unscored:
        entry["unscored"] = item.unscored
    score = score_entries(item).get(ACTUAL, {}) if item.scores else {}
    return entry | {key: score[key] for key in OF_SCORE if key in score}


def forecast_entries(result: MultiBandForecast) -> dict[str, dict[str, Any]]:
    """Return the entry of each band of a forecast, for the table."""
    found = {}
    for name, scene in result.scenes.bands.items():
        setup = prepare(scene)
        found[name] = _band_entry(setup)
        if name in result.bands:
            band = result.bands[name].scores[ACTUAL].band
            sigma = in_all_weather(setup, result.bands[name]).get(ACTUAL, band.sigma_ukcmb2)
            found[name] |= known({"sigma_ukcmb2": sigma, "ell_eff": band.ell_eff, "fwhm_ell": band.fwhm_ell})
        else:
            found[name]["unscored"] = result.reasons[name]
    return found


def _band_entry(setup: Setup) -> dict[str, Any]:
    band, camera = setup.scene.instrument.band, setup.camera
    entry = {"scene": setup.scene.name, "frequency_hz": band.centre_hz, "width_hz": band.width_hz}
    return entry | {"beam_fwhm_rad": camera.focal_plane.fwhm_rad, "detectors": camera.n_det}


def band_table(bands: Content, meta: Content) -> Table:
    """Return a row for each band: frequency, detectors, observations, sigma(A), discarded scans.

    Parameters
    ----------
    bands : mapping
        Entry `bands` of the summary of runs or of sweeps, or `forecast_entries`. Columns without a value are left out.
    meta : mapping
        Header of the file.
    """
    rows = list(bands.values())

    def values(key: str, scale: float = 1.0) -> list[Any]:
        return [row[key] * scale if row.get(key) is not None else None for row in rows]

    sigma, error = values("sigma_ukcmb2"), values("error_ukcmb2")

    def has(key: str) -> bool:
        return any(key in row for row in rows)

    columns = [column("band", list(bands), "band")]
    if has("frequency_hz"):
        columns.append(column("frequency", values("frequency_hz", 1e-9), "GHz", _four_digits, unit="GHz"))
        columns.append(column("width", values("width_hz", 1e-9), "width [GHz]", _four_digits, unit="GHz"))
    if has("beam_fwhm_rad"):
        arcsec = math.degrees(1) * 3600
        columns.append(
            column("beam_fwhm", values("beam_fwhm_rad", arcsec), "beam [arcsec]", _four_digits, unit="arcsec")
        )
    if has("points"):  # a sweep
        columns.append(column("points", values("points"), "points", count))
        columns.append(column("best", [row.get("best", "") for row in rows], "best point"))
    columns.append(column("n_det", values("detectors"), "detectors", count))
    if has("observations"):
        columns.append(column("observations", values("observations"), "observations", count))
    if has("error_ukcmb2"):
        names = "sigma_ukcmb2", "error_ukcmb2"
        columns += quoted_columns(names, sigma, error, SIGMA, unit="uK2", absent="not scored")
    else:  # a forecast
        columns.append(column("sigma_ukcmb2", sigma, SIGMA, number, unit="uK2"))
    if has("forecast_ukcmb2"):
        columns.append(rounded_column("forecast_ukcmb2", values("forecast_ukcmb2"), error, "forecast"))
    if has("ell_eff"):
        columns.append(column("ell_eff", values("ell_eff"), "ell_eff", count))
        columns.append(column("fwhm_ell", values("fwhm_ell"), "FWHM in ell", count))
    if has("discarded"):
        columns.append(column("discarded", values("discarded"), "discarded scans", share_text))
    return Table("band", "Uncertainty of a flat CMB band power in each band", tuple(columns), meta=meta)


def _four_digits(value: float) -> str:
    return f"{value:.4g}"


def multi_band_summary(result: MultiBandResult) -> dict[str, Any]:
    """Return the content of summary.json above the directories of the bands, without the provenance."""
    first = next(iter(result.bands.values()))
    return {
        "scene": result.scenes.name,
        "title": result.scenes.title,
        "seed": first.setup.scene.seed,
        "scene_sha256": bands_hash(result.scenes),
        "observations_of_survey": first.setup.scene.observations,
        "bands": run_entries(result),
        "warnings": [f"{name}: {line}" for name, item in result.bands.items() for line in item.warnings],
        "run": {"engine": result.engine, "workers": result.workers, "wall_s": result.wall_s},
    }
