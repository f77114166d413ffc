"""Tables of the paper, each row with the simulated value and its Monte Carlo error."""

import math
from typing import TYPE_CHECKING

import numpy as np

from surveysim.atmosphere.opacity import BandOpacity, band_opacity, fluctuation_factor_mk2
from surveysim.atmosphere.weather import b2_quantile
from surveysim.paper.excess import excess_noise, white_correlation
from surveysim.paper.measured_survey import MeasuredSurvey
from surveysim.paper.measurement import PAIR_CLEANINGS
from surveysim.paper.published import published
from surveysim.paper.statistics import QUARTILES, centile_errors, median_error, quarters
from surveysim.runtime.errors import InsufficientDataError
from surveysim.scene.passband import top_hat
from surveysim.scene.place import shipped_place
from surveysim.scene.sites import median_water_mm
from surveysim.telescope.photon_noise import photon_noise

if TYPE_CHECKING:
    from astropy.table import Table

BINS = ("bin 1", "bin 2", "bin 3", "bin 4", "all data")  # columns of Table 2
# The bands of section 3.4: centre [Hz], width over centre.
BOLOCAM = {150: (143e9, 0.15), 275: (268e9, 0.15)}
ACBAR = {150: (151e9, 0.2), 275: (282e9, 0.18)}


def amplitude_table(surveys: dict[str, MeasuredSurvey]) -> "Table":
    """Table 1: quartiles of measured B2 [mK^2 rad^(-5/3)] in each band, and their ratios, Bolocam over ACBAR.

    Columns `drawn` and `expected` are the quartiles of the drawn values and of their distribution. Errors are sampling
    errors for the number of observations.

    Parameters
    ----------
    surveys
        Measured surveys by band in GHz: 143, 268 (Bolocam), 151, 282 (ACBAR).

    Raises
    ------
    InsufficientDataError
        If a band has no fit.
    """
    from astropy.table import Table
    from scipy.special import ndtri

    rows, found = [], {}
    for band, survey in surveys.items():
        fitted = survey.b2_fitted[np.isfinite(survey.b2_fitted)]
        if not len(fitted):
            raise InsufficientDataError(f"found no fit of B2 at {band} GHz; one or more is expected")
        values, drawn = np.percentile(fitted, QUARTILES), np.percentile(survey.b2_drawn, QUARTILES)
        expected = b2_quantile(survey.setup.scene.atmosphere, survey.setup.air.water, ndtri(np.array(QUARTILES) / 100))
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
    """Predicted B2 of the sites in median weather relative to each other, and the published predictions (section 3.4).

    They are ratios of (C d tau / dC)^2 B_atm^2, in temperature above the atmosphere. The paper has (d eps / dC C)^2
    B_atm^2, with eps printed as 1 - exp(tau). They are computed from opacities and have no Monte Carlo error.
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
    table.meta["title"] = "(C d tau / dC)^2 B_atm^2 of sites and bands in median weather, predicted from opacities"
    return table


def _median_factor(site: str, frequency_hz: float, bandwidth: float) -> float:
    band: BandOpacity = band_opacity(shipped_place(site), top_hat(frequency_hz, bandwidth))
    return float(fluctuation_factor_mk2(band, median_water_mm(site)))


def correlated_noise_table(survey: MeasuredSurvey) -> "Table":
    """Table 2: noise up to 1 Hz and covariance of adjacent pairs, medians in quarters of fitted B2 and of all data.

    Rows are B2, raw atmosphere before cleaning without white noise, and for average and quadratic subtraction the
    excess covariance of adjacent pairs and its ratio to the excess variance (`surveysim.paper.excess`). For all data
    there is also the correlation above 2.5 Hz. Column `sigmas` is the difference to the paper over both errors in
    quadrature. The paper does not say after which cleaning the excess is measured; its figures show both.

    Raises
    ------
    InsufficientDataError
        For fewer than four observations with a fit of B2.
    """
    from astropy.table import Table

    groups = quarters(survey.b2_fitted)
    groups.append(np.any(groups, axis=0))
    raw = np.array([item.raw_mk2 for item in survey.measurements])
    rows = _group_rows("b2", "none", survey.b2_fitted, groups)
    rows += _group_rows("raw_atmosphere", "none", raw, groups)
    for cleaning in PAIR_CLEANINGS:
        excess = excess_noise(survey, cleaning)
        rows += _group_rows("adjacent_correlated_noise", cleaning, excess.covariance_mk2, groups)
        rows += _group_rows("adjacent_correlation_fraction", cleaning, excess.fraction, groups)
        shared = white_correlation(survey, cleaning)
        rows += _group_rows("adjacent_white_correlation", cleaning, shared, groups)[-1:]
    names = ["quantity", "cleaning", "bin", "observations", "paper", "paper_error", "ours", "error", "sigmas"]
    table = Table(rows=rows, names=names)
    table.meta["title"] = "143 GHz, up to 1 Hz: medians in quarters of B2 [mK2 rad(-5/3)] and of all data; noise in mK2"
    return table


def _group_rows(quantity: str, cleaning: str, values: np.ndarray, groups: list[np.ndarray]) -> list[tuple]:
    """Rows of Table 2 for each group of observations, with published values or NaN."""
    table, name, rows = published()["table2"], quantity.replace("_", " "), []
    paper, paper_error = table[quantity], table[f"{quantity}_error"]
    for k, group in enumerate(groups):
        ours, error = median_error(values[group])
        sigmas = (ours - paper[k]) / np.hypot(error, paper_error[k])
        count = int(np.isfinite(values[group]).sum())
        rows.append((name, cleaning, BINS[k], count, paper[k], paper_error[k], ours, error, sigmas))
    return rows


def photon_noise_table() -> "Table":
    """Photon noise of Bolocam's load (`surveysim.telescope.photon_noise`) and the published values (section 1.1).

    It holds for two polarizations: the published loads in pW and K then agree, and shot and Bose noise are equal.
    """
    from astropy.table import Table

    rows = []
    for band, (frequency_hz, bandwidth) in (("143", BOLOCAM[150]), ("268", BOLOCAM[275])):
        paper = published()["blip"][band]
        found = photon_noise(paper["load_k"], frequency_hz, bandwidth, paper["efficiency"], polarizations=2)
        shot, bose = (math.sqrt(psd) for psd in (found.shot_psd_mk2_hz, found.bose_psd_mk2_hz))
        rows += [
            (f"{band} GHz", "absorbed power", "pW", paper["load_pw"], 1e12 * found.power_w),
            (f"{band} GHz", "photon NEP", "1e-17 W / Hz(1/2)", math.nan, 1e17 * found.nep_w_rthz),
            (f"{band} GHz", "its shot part", "mK / Hz(1/2)", math.nan, shot),
            (f"{band} GHz", "its Bose part", "mK / Hz(1/2)", math.nan, bose),
            (f"{band} GHz", "photon NET", "mK / Hz(1/2)", paper["net_mk_rthz"], found.net_mk_rthz),
            (f"{band} GHz", "photon NET, CMB", "mK / Hz(1/2)", paper["net_mkcmb_rthz"], found.net_mkcmb_rthz),
        ]
    table = Table(rows=rows, names=("band", "quantity", "unit", "paper", "formula"))
    table["over paper"] = table["formula"] / table["paper"]
    table.meta["title"] = "Photon noise of 80 K at the window, 15 % bands, two polarizations (computed, not drawn)"
    return table
