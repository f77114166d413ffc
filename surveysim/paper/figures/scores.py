"""Table 3 and figure 16 of the paper: effect of correlations and low-frequency noise on the sensitivity."""

import re
from typing import TYPE_CHECKING

import numpy as np

from surveysim.paper.figures.maps import ARCMIN2_IN_SR, ELL, LOWEST_ELL
from surveysim.paper.published import published
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.results.results import SurveyResult, score_rows
from surveysim.runtime.errors import InsufficientDataError
from surveysim.survey.scores import DataSetScore, bin_errors

if TYPE_CHECKING:
    from astropy.table import Table

LOOKS = {
    "actual": "black",
    "uncorrelated": "vermilion :",
    "white": "green --",
    "masked": "blue -.",
}  # as published
FLAT_LOOK = "grey"


def sensitivity_table(result: SurveyResult) -> "Table":
    """Table 3: uncertainty sigma(A) of a flat CMB band power [uK_CMB^2] for each data set, with its Monte Carlo error.

    For the masked array there is also sigma(A) times its fraction of the detectors.

    Raises
    ------
    InsufficientDataError
        For a result without scores.
    """
    from astropy.table import Table

    _check(result)
    paper = published()["table3"]
    rows = [
        (row.name, row.n_det, row.sigma_ukcmb2, row.error_ukcmb2, paper[_kind(row.name)])
        for row in score_rows(result)
        if _kind(row.name) in paper
    ]
    table = Table(rows=rows, names=("data_set", "detectors", "sigma_ukcmb2", "error", "paper"))
    table["ratio"] = table["sigma_ukcmb2"] / table["paper"]
    table.meta["title"] = _title(result, "Uncertainty on the amplitude of a flat CMB power spectrum [uK_CMB2]")
    return table


def gain_table(result: SurveyResult) -> "Table":
    """Ratios of sigma(A) in Table 3, with Monte Carlo errors.

    Raises
    ------
    InsufficientDataError
        For a result without scores.
    """
    from astropy.table import Table

    _check(result)
    paper = published()["gains"]
    rows = [(name, item.ratio, item.error, paper[_kind(name)]) for name, item in result.gains.items()]
    table = Table(rows=rows, names=("gain", "ours", "error", "paper"))
    table["ratio"] = table["ours"] / table["paper"]
    table.meta["title"] = _title(result, "Uncertainty of one data set over that of another")
    return table


def _check(result: SurveyResult) -> None:
    if not result.scores:
        raise InsufficientDataError(
            f"found no scores: {result.unscored or 'the scene has none'}; a scored run is expected"
        )


def _kind(name: str) -> str:
    """Name of a data set, or of several, without the number of detectors of a mask."""
    return re.sub(r"masked_\d+", "masked", name)


def _title(result: SurveyResult, what: str) -> str:
    paper = published()["table3"]["observations"]
    return f"{what}, {result.coadds.done} observations of {result.setup.scene.name} (the paper's: about {paper})"


def data_set_psd_figure(result: SurveyResult) -> PaperFigure:
    """Figure 16: noise of the co-added map of each data set, and a flat band power for comparison.

    Raises
    ------
    InsufficientDataError
        For a result without scores.
    """
    _check(result)
    lines = [series for name, item in result.scores.items() for series in _noise_series(result, name, item)]
    panel = Panel(
        title="",
        x_label=ELL,
        y_label=r"Map noise, PSD$^{1/2}$ [$\mu$K$_\mathrm{CMB}$ arcmin]",
        series=(*lines, _flat_band_power(result)),
        x_log=True,
        y_log=True,
        x_range=(float(LOWEST_ELL), float(result.setup.analysis.region.rings.edges_ell[-1])),
        y_range=(
            0.7 * min(float(np.nanmin(series.low)) for series in lines if series.low is not None),
            1.5 * max(float(np.nanmax(series.high)) for series in lines if series.high is not None),
        ),
    )
    return PaperFigure(16, "Noise of the co-added map with and without correlations", _caption(result), (panel,))


def _share(result: SurveyResult, item: DataSetScore) -> float:
    return item.n_det / result.setup.camera.n_det


def _used(result: SurveyResult) -> np.ndarray:
    return result.setup.analysis.region.rings.edges_ell[:-1] >= LOWEST_ELL


def _noise_series(result: SurveyResult, name: str, item: DataSetScore) -> list[Series]:
    """Series of the square root of the noise PSD times the fraction of detectors, with its error band."""
    used, share = _used(result), _share(result, item)
    relative = bin_errors(result.setup.analysis, item)[used]
    y = np.sqrt(share * ARCMIN2_IN_SR * item.noise_psd[used])
    ell, look = result.setup.analysis.region.rings.ell[used], LOOKS[_kind(name)]
    label = name if share == 1 else rf"masked, $\times$ ({item.n_det}/{result.setup.camera.n_det})$^{{1/2}}$"
    # The relative error of the root is half the error of the power.
    ends = y * (1 - relative / 2), y * (1 + relative / 2)
    return [Series("", "band", ell, y, look.split()[0], *ends), Series(label, "line", ell, y, look)]


def _flat_band_power(result: SurveyResult) -> Series:
    used, own = _used(result), result.scores["actual"]
    power = own.band.sigma_ukcmb2 * own.signal_psd[used] * ARCMIN2_IN_SR
    label = rf"flat CMB of {own.band.sigma_ukcmb2:.0f} $\mu$K$_\mathrm{{CMB}}^2$ in the map"
    return Series(label, "line", result.setup.analysis.region.rings.ell[used], np.sqrt(power), FLAT_LOOK)


def _caption(result: SurveyResult) -> str:
    score = result.setup.scene.score
    ratios = ", ".join(f"{name} {item.ratio:.2f} ± {item.error:.2f}" for name, item in result.gains.items())
    paper = ", ".join(f"{value:g}" for value in published()["gains"].values())
    at = int(np.flatnonzero(result.setup.analysis.region.selected)[-1])
    noise = {_kind(name): np.sqrt(_share(result, item) * item.noise_psd[at]) for name, item in result.scores.items()}
    ends = ", ".join(f"{noise['actual'] / value:.2f} ({kind})" for kind, value in noise.items() if kind != "actual")
    return (
        f"{result.coadds.done} simulated observations of {result.setup.scene.name}, co-added: the survey itself"
        f" (actual); streams drawn from each detector's measured spectrum in each observation, but uncorrelated; white"
        f" streams at the measured level; the actual streams of detectors at least"
        f" {score.mask_separation_f_lambda:g} (f/#)lambda apart, cleaned by themselves. Noise from co-adds with random"
        f" signs, shaded its standard error in each bin. Uncertainties of a flat band power from l = {score.ell_min} to"
        f" {score.ell_max}: {ratios} (paper {paper}). In the highest of these bins the noise of the actual set is"
        f" {ends} times that of the others; in the paper it is alike above l = 10000."
    )
