"""Tables of the paper beside what simulated observations give: every row with its Monte Carlo error."""

from typing import TYPE_CHECKING

import numpy as np

from surveysim.atmosphere.opacity import BandOpacity, band_opacity, fluctuation_factor_mk2
from surveysim.paper.campaign import MeasuredSurvey
from surveysim.paper.published import published
from surveysim.paper.statistics import centile_errors
from surveysim.sites import median_water_mm
from surveysim.weather import b2_quantile

if TYPE_CHECKING:
    from astropy.table import Table

QUARTILES = (25.0, 50.0, 75.0)
# The bands of section 3.4: centre [Hz], width over centre.
BOLOCAM = {150: (143e9, 0.15), 275: (268e9, 0.15)}
ACBAR = {150: (151e9, 0.2), 275: (282e9, 0.18)}


def amplitude_table(surveys: dict[str, MeasuredSurvey]) -> "Table":
    """Table 1: quartiles of B2 [mK^2 rad^(-5/3)] measured in each band, and what Bolocam's are over ACBAR's.

    `surveys` by band in GHz: 143, 268 (Bolocam), 151, 282 (ACBAR). `drawn` are the quartiles of what the weather
    had, `expected` those of its distribution; errors are those of sampling so many observations. Raises ValueError
    where a band has no fit.
    """
    from astropy.table import Table
    from scipy.special import ndtri

    rows, found = [], {}
    for band, survey in surveys.items():
        fitted = survey.b2_fitted[np.isfinite(survey.b2_fitted)]
        if not len(fitted):
            raise ValueError(f"found no fit of B2 at {band} GHz; one or more is expected")
        values, drawn = np.percentile(fitted, QUARTILES), np.percentile(survey.b2_drawn, QUARTILES)
        expected = b2_quantile(survey.setup.scene.atmosphere, survey.setup.water, ndtri(np.array(QUARTILES) / 100))
        found[band] = values, centile_errors(fitted, QUARTILES)
        name = "Bolocam" if band in ("143", "268") else "ACBAR"
        for k, paper in enumerate(published()["table1"][band]):
            rows.append((name, f"{band} GHz", k + 1, paper, values[k], found[band][1][k], drawn[k], expected[k]))
    for label, ours, theirs in (("150", "143", "151"), ("275", "268", "282")):
        for k, paper in enumerate(published()["table1"][f"{label}_ratio"]):
            pair = [(found[band][0][k], found[band][1][k]) for band in (ours, theirs)]
            ratio = pair[0][0] / pair[1][0]
            error = ratio * np.hypot(*(sigma / value for value, sigma in pair))
            rows.append(("Bolocam/ACBAR", f"{ours}/{theirs} GHz", k + 1, paper, ratio, error, np.nan, np.nan))
    table = Table(rows=rows, names=("instrument", "band", "quartile", "paper", "ours", "error", "drawn", "expected"))
    table.meta["title"] = "Atmospheric noise amplitude B2 [mK2 rad(-5/3)]; ratios without unit"
    table.meta["observations"] = {band: len(survey.measurements) for band, survey in surveys.items()}
    return table


def site_table() -> "Table":
    """What the opacities of the sites predict for B2 in median weather, beside the paper's prediction (section 3.4).

    Ratios of (d eps / dC C)^2 B_atm^2; computed, not drawn, so without a Monte Carlo error.
    """
    from astropy.table import Table

    paper = published()["site_scaling"]
    kea = _median_factor("mauna_kea", *BOLOCAM[150])
    ratios = {
        "band_268_over_143": _median_factor("mauna_kea", *BOLOCAM[275]) / kea,
        "mauna_kea_over_south_pole_150": kea / _median_factor("south_pole", *ACBAR[150]),
        "mauna_kea_over_south_pole_275": (
            _median_factor("mauna_kea", *BOLOCAM[275]) / _median_factor("south_pole", *ACBAR[275])
        ),
        "mauna_kea_over_alma": kea / _median_factor("alma", *BOLOCAM[150]),
        "ccat_below_alma": 1 - _median_factor("ccat", *BOLOCAM[150]) / _median_factor("alma", *BOLOCAM[150]),
    }
    table = Table(rows=[(name, paper[name], value, 0.0) for name, value in ratios.items()])
    table.rename_columns(table.colnames, ("ratio", "paper", "ours", "error"))
    table.meta["title"] = "(d eps / dC C)^2 B_atm^2 of sites and bands in median weather, predicted from opacities"
    return table


def _median_factor(site: str, frequency_hz: float, bandwidth: float) -> float:
    band: BandOpacity = band_opacity(site, frequency_hz, bandwidth)
    return float(fluctuation_factor_mk2(band, median_water_mm(site)))


def raw_atmosphere_table(survey: MeasuredSurvey) -> "Table":
    """Table 2, first two rows: medians of B2 and of the raw atmosphere below 1 Hz in quarters of B2, and of all data.

    Columns for B2 [mK^2 rad^(-5/3)] and the variance [mK^2] that mean-removed scans have below 1 Hz, the white
    level's share taken off.
    """
    from astropy.table import Table

    b2 = survey.b2_fitted
    raw = np.array([item.raw_mk2 for item in survey.measurements])
    used = np.isfinite(b2)
    if used.sum() < 4:
        raise ValueError(f"found {used.sum()} fits of B2 at {survey.band_ghz} GHz; 4 or more make quarters")
    quarter = np.searchsorted(np.percentile(b2[used], QUARTILES), b2, side="right")
    groups = [used & (quarter == k) for k in range(4)] + [used]
    paper, rows = published()["table2"], []
    for k, (label, rows_in) in enumerate(zip(("bin 1", "bin 2", "bin 3", "bin 4", "all data"), groups, strict=True)):
        row = [label, int(rows_in.sum())]
        for name, values in (("b2", b2), ("raw_atmosphere_mk2", raw)):
            error_name = name.replace("_mk2", "") + ("_error_mk2" if name.endswith("_mk2") else "_error")
            row += [paper[name][k], paper[error_name][k], np.median(values[rows_in])]
            row += [float(centile_errors(values[rows_in], (50.0,))[0])]
        rows.append(row)
    names = [f"{what}{part}" for what in ("b2", "raw") for part in ("_paper", "_paper_error", "_ours", "_ours_error")]
    table = Table(rows=rows, names=["bin", "observations", *names])
    for name in names:
        table[name].unit = "mK2 rad(-5/3)" if name.startswith("b2") else "mK2"
    table.meta["title"] = "143 GHz, f <= 1 Hz: medians in quarters of B2 (its rows of correlated noise are not made)"
    return table
