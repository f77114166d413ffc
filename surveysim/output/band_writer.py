"""Files of a camera of several bands, beside those of each band."""

from pathlib import Path
from typing import Any

from surveysim.output.writer import write_summary, write_table
from surveysim.results.bands import (
    MultiBandForecast,
    MultiBandResult,
    band_table,
    forecast_entries,
    multi_band_summary,
)
from surveysim.runtime.provenance import made_by, now


def write_bands(directory: Path, result: MultiBandResult) -> None:
    """Write table, summary and report of all bands of a camera below `directory`; each band has results of its own."""
    write_of_bands(directory, multi_band_summary(result))


def write_of_bands(directory: Path, content: dict[str, Any]) -> None:
    """Write table, summary and report of all bands below `directory` from the content of their summary.json."""
    run = content["run"] | {"date": now()}
    meta = {"temperature": "CMB", "seed": content["seed"], "scene_sha256": content["scene_sha256"]}
    written = write_table(directory / "bands.ecsv", band_table(content["bands"], meta))
    write_summary(directory, content | made_by() | {"run": run}, [written])


def write_band_forecasts(directory: Path, result: MultiBandForecast) -> None:
    """Write bands.ecsv, the forecast of sigma(A) in each band of a camera."""
    write_table(directory / "bands.ecsv", band_table(forecast_entries(result), {"temperature": "CMB"}))
