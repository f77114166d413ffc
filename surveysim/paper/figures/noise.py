"""Figures 7, 8 and 9 of the paper: amplitude of atmospheric noise, its dependence on water vapour, residuals in
maps."""

from collections.abc import Sequence

import numpy as np

from surveysim.paper.measured_survey import MeasuredSurvey
from surveysim.paper.published import published
from surveysim.paper.statistics import QUARTILES, Binned, binned, cumulative, described, scale_to, without_fit
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.runtime.errors import InsufficientDataError

BAND_LOOKS = ("blue", "vermilion", "green", "purple")  # colours of the surveys, in their order
B2_LABEL = r"$B_\nu^2$ [mK$^2$ rad$^{-5/3}$]"


def b2_distribution_figure(surveys: Sequence[MeasuredSurvey]) -> PaperFigure:
    """Figure 7: cumulative distributions of fitted and drawn B2 in each band, with published quartiles."""
    series, texts = [], []
    for survey, look in zip(surveys, BAND_LOOKS, strict=False):
        fitted = _fitted(survey)
        band = f"{survey.band_ghz} GHz"
        series.append(Series(f"{band}, fitted", "line", *cumulative(fitted), look))
        series.append(Series(f"{band}, drawn", "line", *cumulative(survey.b2_drawn), f"{look} :"))
        series += _paper_quartiles(survey, look)
        texts.append(
            f"{described(survey)}, {without_fit(survey)}: quartiles {_numbers(fitted)}"
            f" fitted and {_numbers(survey.b2_drawn)} drawn"
        )
    caption = (
        f"{'; '.join(texts)} mK^2 rad^(-5/3). B2 is fitted to the level of the correlation between detectors at b ="
        f" 11/3 and the scene's layer height, with the measured wind where that is known. Points: the paper's"
        f" quartiles (Table 1), with its {published()['calibration_uncertainty'] * 100:g} % uncertainty of"
        f" calibration."
    )
    panel = Panel("", B2_LABEL, "Share of observations below", tuple(series), x_log=True, y_range=(0.0, 1.0))
    return PaperFigure(7, "Cumulative distribution of the atmospheric noise amplitude", caption, (panel,))


def _fitted(survey: MeasuredSurvey) -> np.ndarray:
    return survey.b2_fitted[np.isfinite(survey.b2_fitted)]


def _numbers(values: np.ndarray) -> str:
    first, second, third = (
        f"{value:.3g}" if value < 1000 else f"{value:.0f}" for value in np.percentile(values, QUARTILES)
    )
    return f"{first}, {second} and {third}"


def _paper_quartiles(survey: MeasuredSurvey, look: str) -> tuple[Series, ...]:
    """Series of the published quartiles with calibration errors; none for other bands."""
    quartiles = published()["table1"].get(str(survey.band_ghz))
    if quartiles is None:
        return ()
    b2, share = np.array(quartiles), np.array(QUARTILES) / 100
    relative = published()["calibration_uncertainty"]
    ends = np.column_stack([b2 * (1 - relative), b2 * (1 + relative), np.full(3, np.nan)]).ravel()
    return (
        Series(f"{survey.band_ghz} GHz, paper", "points", b2, share, f"{look} --"),
        Series("", "line", ends, np.repeat(share, 3), look),
    )


def b2_water_figure(surveys: Sequence[MeasuredSurvey]) -> PaperFigure:
    """Figure 8: B2 against precipitable water vapour in each band, with a model of constant fractional fluctuations.

    Raises
    ------
    InsufficientDataError
        For a survey without a site.
    """
    panels, texts = [], []
    for survey in surveys:
        if survey.setup.air.water is None:
            raise InsufficientDataError(f"found no site at {survey.band_ghz} GHz; one with water is expected")
        fitted = np.isfinite(survey.b2_fitted)
        points = binned(survey.pwv_mm[fitted], survey.b2_fitted[fitted])
        model = survey.setup.air.water.response
        factor = scale_to(points.median, model(points.x))
        water = np.geomspace(points.x[0], points.x[-1], 60)
        line = Series("constant fractional fluctuations, scaled", "line", water, factor * model(water), "vermilion")
        panels.append(
            Panel(
                title=f"{survey.band_ghz} GHz",
                x_label="Precipitable water [mm]",
                y_label=B2_LABEL,
                series=(*_bands(points), line, _medians(points)),
                y_log=True,
            )
        )
        texts.append(
            f"{described(survey)}, in {len(points.x)} bins of water with {points.count.min()} or more each; the line"
            f" is {factor:.2e} rad^(-5/3) times the prediction"
        )
    caption = (
        f"{'; '.join(texts)} (C d tau / dC)^2 B_atm^2 of the site's opacity, by least squares in the logarithms of"
        f" the medians. B2 is measured from the time-streams; the water is the zenith column that was"
        f" drawn.{_ranked(surveys)} Error bars are those of the medians, shaded the ranges of 10 to 90 and of 25 to"
        f" 75 % of the observations."
    )
    return PaperFigure(8, "Atmospheric noise amplitude against precipitable water", caption, tuple(panels), len(panels))


def _ranked(surveys: Sequence[MeasuredSurvey]) -> str:
    """Words for captions on scenes with both quantiles of B2 and a site."""
    bands = [f"{survey.band_ghz}" for survey in surveys if survey.setup.scene.atmosphere.b2]
    given = f" At {' and '.join(bands)} GHz only the rank of B2 follows from the water, its quantiles are the scene's."
    return given if bands else ""


def _bands(points: Binned) -> tuple[Series, Series]:
    p10, p25, median, p75, p90 = points.centile
    return (
        Series("10th to 90th centile", "band", points.x, median, "sky", p10, p90),
        Series("25th to 75th centile", "band", points.x, median, "blue", p25, p75),
    )


def _medians(points: Binned) -> Series:
    low, high = points.median - points.median_error, points.median + points.median_error
    return Series("median and its error", "points", points.x, points.median, "black", low, high)


def map_variance_figure(survey: MeasuredSurvey) -> PaperFigure:
    """Figure 9: residual variance of single-observation maps against B2, and its cumulative distribution."""
    to_cmb = survey.setup.scene.instrument.cmb_per_rj**2
    whole = [item for item in survey.measurements if np.isfinite(item.map_mk2)]
    if not whole:
        raise InsufficientDataError("found no map without gaps; one or more is expected")
    residual = to_cmb * np.array([item.map_mk2 - item.map_white_mk2 for item in survey.measurements])
    left = residual[np.isfinite(residual)]
    white = to_cmb * float(np.median([item.map_white_mk2 for item in whole]))
    used = np.isfinite(survey.b2_fitted) & np.isfinite(residual)
    points = binned(survey.b2_fitted[used], residual[used])
    factor = scale_to(points.median, points.x)
    label = r"$\sigma^2_\mathrm{map} - \sigma^2_\mathrm{white}$ [mK$_\mathrm{CMB}^2$]"
    line = Series("proportional to $B_\\nu^2$", "line", points.x, factor * points.x, "vermilion")
    series = (*_bands(points), line, _medians(points))
    shares = (Series("simulated observations", "line", *cumulative(left), "blue"),)
    caption = (
        f"{described(survey)}: variance of each observation's map after average subtraction, less the white level of"
        f" its highest multipoles, in thermodynamic temperature over the band;"
        f" {len(survey.measurements) - len(whole)} maps have gaps and are left out. The median white level is"
        f" {white:.2g} mK_CMB^2 (paper about {published()['map_white_variance_mkcmb2']:g}), the median residual"
        f" {np.median(left):.2g} mK_CMB^2, {np.percentile(left, 10):.2g} and {np.percentile(left, 90):.2g} at the"
        f" 10th and 90th centile. Top: {len(points.x)} bins of fitted B2 with {points.count.min()} or more"
        f" observations each ({without_fit(survey)}); from the first to the last the median grows by"
        f" {points.median[-1] / points.median[0]:.1f} while B2 grows by {points.x[-1] / points.x[0]:.0f}; the line,"
        f" by least squares in the logarithms, would have it proportional. What is left holds all low-frequency"
        f" noise, not the atmosphere's alone."
    )
    return PaperFigure(
        number=9,
        title="Residual variance of single maps",
        caption=caption,
        panels=(
            Panel("", B2_LABEL, label, series, x_log=True, y_log=True),
            Panel("", label, "Share of observations below", shares, x_log=True, y_range=(0.0, 1.0)),
        ),
    )
