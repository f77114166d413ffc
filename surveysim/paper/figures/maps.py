"""Figure 13 of the paper: noise of the co-added map by cleaning algorithm, and its sensitivity to a flat band power."""

import numpy as np

from surveysim.paper.published import published
from surveysim.reduction.cleaning_pipelines import ACTUAL, OPTIMAL
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.results.results import SurveyResult
from surveysim.runtime.errors import InsufficientDataError
from surveysim.survey.error_modes import gain
from surveysim.survey.rows import row_names
from surveysim.survey.scores import DataSetScore, rescore

LOOKS = ("blue", "green", "vermilion", "purple", "orange", "sky")  # colours of the pipelines, in their order
OPTIMAL_LOOK = "black --"
LOWEST_ELL = 500  # bins below it have few modes, mostly the mean and the gradient of the map
ARCMIN2_IN_SR = np.degrees(60.0) ** 2  # square arcminutes in a steradian: PSDs get plain numbers
ELL, UNCERTAINTY = r"Multipole $\ell$", r"$\sigma(A)$ [$\mu$K$_\mathrm{CMB}^2$]"
FROM_ELL = r"Lowest multipole $\ell$ used"


def map_psd_figure(result: SurveyResult) -> PaperFigure:
    """Figure 13: map noise PSDs by algorithm, PSDs over transfer functions, and cumulative sensitivity.

    Raises
    ------
    InsufficientDataError
        For a result without scores or with one cleaning pipeline only.
    """
    if not result.setup.analysis.chooses or not result.scores:
        found = result.unscored or "cleaning.compare is empty"
        raise InsufficientDataError(
            f"found no scores of several pipelines: {found}; a scored run that compares some is expected"
        )
    names = pipeline_names(result)
    return PaperFigure(
        number=13,
        title="Noise of the co-added map and sensitivity to a flat CMB band power",
        caption=_caption(result, names),
        panels=(
            _psd_panel(result, names),
            _sensitivity_panel(result, names),
            _cumulative_panel(result, names),
            _ratio_panel(result, names),
        ),
        columns=2,
    )


def pipeline_names(result: SurveyResult) -> dict[str, str]:
    """Labels and data sets of all pipelines of the whole array, and of the best pipeline of each observation."""
    return {pipeline.label: pipeline.data_set for pipeline in result.setup.analysis.whole_pipelines} | {
        OPTIMAL: OPTIMAL
    }


def winners(result: SurveyResult, target: str, data_sets: tuple[str, ...]) -> dict[str, float]:
    """Fraction of the observations in which each data set has the highest figure of merit.

    Parameters
    ----------
    result
        Scored run.
    target
        One of `surveysim.reduction.figure_of_merit.TARGETS`.
    data_sets
        Names of the data sets. Observations without any figure of merit are left out.

    Raises
    ------
    InsufficientDataError
        For a data set without figures of merit, or without any such observation.
    """
    names = row_names(result.setup.analysis)
    wanted = [f"merit_{target}_{data_set}" for data_set in data_sets]
    missing = [name for name in wanted if name not in names]
    if missing:
        raise InsufficientDataError(
            f"found no {', '.join(missing)} in the rows; data sets that are compared are allowed"
        )
    figures_of_merit = np.array(result.coadds.rows)[:, [names.index(name) for name in wanted]]
    figures_of_merit = figures_of_merit[np.nan_to_num(figures_of_merit).max(axis=1) > 0]
    if len(figures_of_merit) == 0:
        raise InsufficientDataError("found no observation with a figure of merit; one or more is expected")
    best = np.nanargmax(figures_of_merit, axis=1)
    return {data_set: float(np.mean(best == place)) for place, data_set in enumerate(data_sets)}


# ---------------------------------------------------------------- panels


def _psd_panel(result: SurveyResult, names: dict[str, str]) -> Panel:
    used, rings = _usable(result), result.setup.analysis.region.rings
    psds = {label: ARCMIN2_IN_SR * result.scores[name].noise_psd[used] for label, name in names.items()}
    return _panel("noise", ELL, r"Map PSD [$\mu$K$_\mathrm{CMB}^2$ arcmin$^2$]", _lines(rings.ell[used], psds))


def _sensitivity_panel(result: SurveyResult, names: dict[str, str]) -> Panel:
    used, rings = _usable(result), result.setup.analysis.region.rings
    sigmas = {label: log_bin_sigma(result, result.scores[name])[used] for label, name in names.items()}
    y_label = r"$\sigma(A)$ of $\Delta\ln\ell = 1$ [$\mu$K$_\mathrm{CMB}^2$]"
    return _panel("noise over transfer function", ELL, y_label, _lines(rings.ell[used], sigmas))


def log_bin_sigma(result: SurveyResult, item: DataSetScore) -> np.ndarray:
    """Uncertainty (n_bin,) of a flat band power from each bin, scaled to a width of one in ln ell.

    It is ``N / M (2 dlnell / n)^(1/2)``: noise PSD over the PSD of unit band power after beam and cleaning, with n
    modes in the bin.
    """
    rings = result.setup.analysis.region.rings
    # d ln ell as d ell / ell: the lowest bin starts at 0, where the logarithm has no value.
    width = np.diff(rings.edges_ell) / rings.ell
    return item.quoted_psd / item.signal_psd * np.sqrt(2 * width / rings.n_modes)


def _cumulative_panel(result: SurveyResult, names: dict[str, str]) -> Panel:
    starts, series = _starts(result), []
    for label, name in names.items():
        bands = [rescore(result.setup.analysis, result.scores[name], start).band for start in starts]
        sigma, error = (np.array([getattr(band, key) for band in bands]) for key in ("sigma_ukcmb2", "error_ukcmb2"))
        series += _with_error(label, starts, sigma, error=error, look=_look(label, names))
    return _panel("cumulative sensitivity", FROM_ELL, UNCERTAINTY, series)


def _ratio_panel(result: SurveyResult, names: dict[str, str]) -> Panel:
    """Panel of the cumulative sensitivity relative to the scene's own cleaning, with errors of the ratios."""
    starts, series = _starts(result), []
    own = [rescore(result.setup.analysis, result.scores[ACTUAL], start) for start in starts]
    first = next(iter(names))
    for label, name in names.items():
        other = [rescore(result.setup.analysis, result.scores[name], start) for start in starts]
        ratios = [gain(one, base) for one, base in zip(other, own, strict=True)]
        ratio, error = (np.array([getattr(item, key) for item in ratios]) for key in ("ratio", "error"))
        series += _with_error(label, starts, ratio, error=error, look=_look(label, names))
    y_label = rf"$\sigma(A)$ over that of {first}"
    return _panel(f"cumulative sensitivity over that of {first}", FROM_ELL, y_label, series, y_log=False)


def _with_error(label: str, x: np.ndarray, y: np.ndarray, *, error: np.ndarray, look: str) -> list[Series]:
    colour = look.split()[0]
    return [Series("", "band", x, y, colour, y - error, y + error), Series(label, "line", x, y, look)]


def _lines(ell: np.ndarray, curves: dict[str, np.ndarray]) -> list[Series]:
    return [Series(label, "line", ell, y, _look(label, curves)) for label, y in curves.items()]


def _look(label: str, names: dict) -> str:
    return OPTIMAL_LOOK if label == OPTIMAL else LOOKS[list(names).index(label) % len(LOOKS)]


def _panel(title: str, x_label: str, y_label: str, series: list[Series], *, y_log: bool = True) -> Panel:
    ends = float(series[0].x[0]), float(series[0].x[-1])
    return Panel(title, x_label, y_label, tuple(series), x_log=True, y_log=y_log, x_range=ends)


def _usable(result: SurveyResult) -> np.ndarray:
    """Mask (n_bin,) of the bins from `LOWEST_ELL` to the end of the scored range."""
    edges = result.setup.analysis.region.rings.edges_ell
    return (edges[:-1] >= LOWEST_ELL) & (edges[1:] <= result.setup.scene.score.ell_max)


def _starts(result: SurveyResult) -> np.ndarray:
    """Lowest multipoles of the scored ranges: lower edges of the usable bins."""
    return result.setup.analysis.region.rings.edges_ell[:-1][_usable(result)]


# ---------------------------------------------------------------- caption


def _caption(result: SurveyResult, names: dict[str, str]) -> str:
    scene, first = result.setup.scene, next(iter(names))
    pipelines = {label: name for label, name in names.items() if label != OPTIMAL}
    own = result.scores[ACTUAL]
    against = {label: gain(result.scores[name], own) for label, name in names.items() if name != ACTUAL}
    ratios = ", ".join(f"{item.ratio:.3f} ± {item.error:.3f} ({label})" for label, item in against.items())
    removed = {label: result.flux_removed[name] for label, name in pipelines.items()}
    flux = _percentages(removed, published()["cleaning"]["point_source_flux_removed"])
    return (
        f"{result.coadds.done} simulated observations of {scene.name}, co-added after each algorithm, and after the one"
        f" that is best in each observation for a flat CMB spectrum in the scored range (optimal). Noise from"
        f" co-adds with random signs."
        f" Top right: noise PSD over that of unit flat band power behind beam, pixel and transfer function, as"
        f" the uncertainty that bins of one unit of ln l would have; bottom: from all data from a multipole up to"
        f" {scene.score.ell_max}, with Monte Carlo errors; right, of the ratio. In the scored range from"
        f" {scene.score.ell_min} it is {own.band.sigma_ukcmb2:.0f} ± {own.band.error_ukcmb2:.0f} uK_CMB^2 with {first},"
        f" times {ratios}. Best for a flat CMB spectrum: {_shares(result, 'cmb', pipelines)} %; for a point source:"
        f" {_shares(result, 'point_source', pipelines)} % of observations."
        f" Flux of a faint point source removed: {flux} %."
        f" The paper finds average, planar and optimal alike within errors, and quadratic subtraction less sensitive."
    )


def _shares(result: SurveyResult, target: str, pipelines: dict[str, str]) -> str:
    best = winners(result, target, tuple(pipelines.values()))
    return _percentages(
        {label: best[name] for label, name in pipelines.items()}, published()["cleaning"][f"optimal_{target}"]
    )


def _percentages(shares: dict[str, float], paper: dict[str, float]) -> str:
    """Words for captions: percentages by label, with published ones."""
    theirs = {label: f" (paper {100 * value:.0f})" for label, value in paper.items()}
    return ", ".join(f"{label} {100 * share:.1f}{theirs.get(label, '')}" for label, share in shares.items())
