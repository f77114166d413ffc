"""Recovery of the weather: measured against drawn values of each observation, and their agreement."""

from collections.abc import Callable
from math import degrees, pi, remainder
from typing import TYPE_CHECKING

import numpy as np

from surveysim.paper.measured_survey import MeasuredSurvey
from surveysim.paper.published import published
from surveysim.paper.statistics import bootstrap

if TYPE_CHECKING:
    from astropy.table import Table

SPREAD = (15.865, 84.135)  # centiles a standard deviation from the median of a normal distribution


def measurement_table(survey: MeasuredSurvey) -> "Table":
    """Table with a row for each observation: drawn and measured B2, wind, index and height, and measured variances."""
    from astropy.table import Table

    rows = [_row(survey, k) for k in range(len(survey.measurements))]
    table = Table(rows=rows)
    units = {"_b2": "mK2 rad(-5/3)", "_arcmin_s": "arcmin / s", "_deg": "deg", "_mm": "mm", "_m": "m", "_mk2": "mK2"}
    for name in table.colnames:
        unit = next((unit for ending, unit in units.items() if name.endswith(ending)), None)
        table[name].unit = unit
    table.meta["title"] = f"{survey.band_ghz} GHz: measured and drawn values of each observation"
    return table


def _row(survey: MeasuredSurvey, k: int) -> dict[str, float | str]:
    item, fit = survey.measurements[k], survey.fits[k]
    best = (np.nan, np.nan) if fit is None else (survey.grid.index[fit.best[0]], survey.grid.height_m[fit.best[1]])
    return {
        "scene": survey.scene_of[k],
        "observation": item.observation,
        "elevation_deg": degrees(item.elevation_rad.mean()),
        "drawn_b2": survey.b2_drawn[k],
        "measured_b2": survey.b2_fitted[k],
        "drawn_pwv_mm": item.truth.pwv_mm,
        "drawn_wind_arcmin_s": survey.wind_drawn_arcmin_s[k],
        "measured_wind_arcmin_s": survey.wind_arcmin_s[k],
        "wind_error_arcmin_s": degrees(item.wind.speed_error_rad_s) * 60,
        "drawn_wind_angle_deg": degrees(item.truth.wind_angle_rad),
        "measured_wind_angle_deg": degrees(wind_angle(survey, k)) % 360,
        "wind_angle_error_deg": degrees(item.wind.angle_error_rad),
        "wind_goodness": item.wind.goodness,
        "wind_flag": item.wind.flag,
        "fitted_index": best[0],
        "fitted_height_m": best[1],
        "chi2": np.nan if fit is None else fit.chi2[fit.best],
        "raw_below_1_hz_mk2": item.raw_mk2,
        "map_mk2": item.map_mk2,
        "map_white_mk2": item.map_white_mk2,
    }


def wind_angle(survey: MeasuredSurvey, k: int) -> float:
    """Measured wind direction [rad], from increasing azimuth towards increasing elevation."""
    item = survey.measurements[k]
    return item.wind.angle_rad + item.camera_angle_rad


def recovery_table(survey: MeasuredSurvey) -> "Table":
    """Table of the recovery of wind, B2, index and height, with bootstrap errors and the published values."""
    from astropy.table import Table

    rows = [*_wind_rows(survey), *_b2_rows(survey)]
    # Index and height need more bins of separation than there are parameters: level, overlap, index and height.
    if len(survey.bins.count) > 4:
        rows += _index_rows(survey)
    table = Table(rows=rows)
    table.rename_columns(table.colnames, ("quantity", "unit", "paper", "ours", "error", "observations"))
    table.meta["title"] = f"{survey.band_ghz} GHz: values measured from the time-streams against drawn values"
    return table


def _entry(
    quantity: str, unit: str, paper: float, values: np.ndarray, *, statistic: Callable[[np.ndarray], float]
) -> tuple:
    return quantity, unit, paper, *bootstrap(values, statistic), len(values)


def _half_spread(values: np.ndarray) -> float:
    low, high = np.percentile(values, SPREAD)
    return (high - low) / 2


def _wind_rows(survey: MeasuredSurvey) -> list[tuple]:
    good = survey.wind_good
    ratio = survey.wind_arcmin_s[good] / survey.wind_drawn_arcmin_s[good] - 1
    turned = [
        degrees(abs(remainder(wind_angle(survey, k) - survey.measurements[k].truth.wind_angle_rad, 2 * pi)))
        for k in np.flatnonzero(good).tolist()
    ]
    paper = published()["wind_median_arcmin_s"].get(str(survey.band_ghz), np.nan)
    share = published()["share_of_good_winds"] if np.isfinite(paper) else np.nan
    return [
        _entry("median wind, drawn", "arcmin / s", paper, survey.wind_drawn_arcmin_s, statistic=np.median),
        _entry(
            "median wind, measured where trusted", "arcmin / s", paper, survey.wind_arcmin_s[good], statistic=np.median
        ),
        _entry("the same winds, drawn", "arcmin / s", np.nan, survey.wind_drawn_arcmin_s[good], statistic=np.median),
        _entry("share of winds trusted", "", share, good.astype(float), statistic=np.mean),
        _entry("wind speed, median relative error", "", np.nan, ratio, statistic=np.median),
        _entry("wind speed, relative scatter (68 %)", "", np.nan, ratio, statistic=_half_spread),
        _entry(
            "wind direction, 68 % within", "deg", np.nan, np.array(turned), statistic=lambda x: np.percentile(x, 68.27)
        ),
    ]


def _b2_rows(survey: MeasuredSurvey) -> list[tuple]:
    fitted = np.isfinite(survey.b2_fitted)
    ratio = survey.b2_fitted[fitted] / survey.b2_drawn[fitted]
    i_b, _ = survey.fixed
    heights = survey.grid.height_m
    changes = np.array([survey.b2_at((i_b, i_h))[fitted] / survey.b2_fitted[fitted] - 1 for i_h in range(len(heights))])
    change = published()["b2_change_over_heights"]  # plus or minus
    return [
        _entry("B2 over the drawn one, median", "", np.nan, ratio, statistic=np.median),
        _entry("B2 over the drawn one, scatter (68 %)", "", np.nan, ratio, statistic=_half_spread),
        _entry(f"B2 change, {heights[0]:g} m assumed, median", "", change, changes[0], statistic=np.median),
        _entry(f"B2 change, {heights[-1]:g} m assumed, median", "", change, changes[-1], statistic=np.median),
    ]


def _index_rows(survey: MeasuredSurvey) -> list[tuple]:
    fits = [fit for fit in survey.fits if fit is not None]
    index = np.array([survey.grid.index[fit.best[0]] for fit in fits])
    fixed = np.array([survey.grid.index[fit.chi2[:, survey.fixed[1]].argmin()] for fit in fits])
    heights = np.array([survey.grid.height_m[fit.best[1]] for fit in fits])
    paper = published()["fitted_index"]
    counts = np.array([np.mean(heights == height) for height in survey.grid.height_m])
    most, error = counts.max(), np.sqrt(counts.max() / len(fits))
    return [
        _entry("index b, mean", "", paper["mean"], index, statistic=np.mean),
        _entry("index b, median", "", np.nan, index, statistic=np.median),
        _entry("index b, standard deviation", "", paper["std"], index, statistic=np.std),
        _entry("index b at the scene's height, mean", "", np.nan, fixed, statistic=np.mean),
        _entry("index b at the scene's height, standard deviation", "", np.nan, fixed, statistic=np.std),
        ("largest share of one of nine heights", "", np.nan, most, error, len(fits)),
    ]
