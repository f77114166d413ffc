"""Figures 5 and 6 of the paper: correlation between detectors against separation, with fitted index and height."""

from dataclasses import replace

import numpy as np

from mapmaker.correlations import PairBins, Profile, scan_covariances
from surveysim.atmosphere.turbulence_fit import KOLMOGOROV, fitted_profile
from surveysim.paper.measured_survey import KNOWN, MeasuredSurvey
from surveysim.paper.published import published
from surveysim.paper.statistics import described, without_fit
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.runtime.errors import InsufficientDataError
from surveysim.timestreams.observation import draw_observation

TYPICAL_CENTILE = 30.0  # centile of chi^2 of the paper's examples
FAMILY_LOOKS = ("sky", "green --", "blue -.", "purple :")
BEST_LOOK = "vermilion"
# Grid points of a family around the best fit: steps of b from it, and heights.
INDEX_STEPS = (-2, -1, 1, 2)
HEIGHTS = (0, 3, 5, 8)


def correlation_figure(survey: MeasuredSurvey) -> PaperFigure:
    """Figure 5: correlation against separation in better and worse than average weather, with families of fits.

    Raises
    ------
    InsufficientDataError
        Without any observation with a fit and a trusted wind.
    """
    better, worse = typical_observations(survey)
    panels, texts, median = [], [], np.nanmedian(survey.b2_fitted)
    for name, k in (("better", better), ("worse", worse)):
        fit, item = survey.fits[k], survey.measurements[k]
        i_b, i_h = fit.best
        index, height = survey.grid.index[i_b], survey.grid.height_m[i_h]
        indices = [(i_b + step, i_h) for step in INDEX_STEPS if 0 <= i_b + step < len(survey.grid.index)]
        heights = [(i_b, h) for h in HEIGHTS if h < len(survey.grid.height_m) and h != i_h]
        panels.append(
            _profile_panel(
                survey,
                k,
                f"{name} weather: best height {height:g} m",
                points=indices,
                name="b = {b:.2f}",
                extra=_adjacent(survey, k),
            )
        )
        title = f"{name} weather: best index {index:.2f}"
        panels.append(_profile_panel(survey, k, title, points=heights, name="h = {h:g} m", extra=()))
        texts.append(
            f"observation {item.observation} of {survey.scene_of[k]} ({name}): B2 drawn {item.layer_b2:.0f}, fitted"
            f" {survey.b2_fitted[k]:.0f} mK^2 rad^(-5/3), smallest chi^2 {fit.chi2[fit.best]:.1f}"
        )
    scene = survey.setup.scene
    caption = (
        f"{described(survey)}, of which two in better and in worse weather than the median fitted B2 of {median:.0f}"
        f" mK^2 rad^(-5/3), each of the chi^2 closest to the {TYPICAL_CENTILE:.0f}th centile (which the paper's have)"
        f" among the quarter of trusted observations near a quartile of B2: {'; '.join(texts)};"
        f" the layers drawn have b = {scene.atmosphere.spectral_index:.2f} at"
        f" {scene.atmosphere.layer_height_m:g} m. As C falls by about a thousandth of itself over the array while"
        f" gains scatter by percents, the profile of ln C is solved for together with the gains; it is shown times"
        f" the level of C, with errors from leaving out one scan at a time, less the low-frequency noise that pixels"
        f" share through their overlap, as the best fit has it, and every curve with an offset of its own. Adjacent"
        f" pairs are not fitted; they are shown with the gains that the other pairs have. Left: indices at the best"
        f" height; right: heights at the best index, on a scale without adjacent pairs."
    )
    return PaperFigure(5, "Correlation between detectors against separation", caption, tuple(panels), 2)


def typical_observations(survey: MeasuredSurvey) -> tuple[int, int]:
    """Indices of two typical observations, in better and in worse than median weather.

    Candidates are observations of the first scene with a fit and a trusted wind. Of the quarter with B2 nearest to the
    quartile on each side of the median, the one with chi^2 nearest to the published centile is chosen.

    Raises
    ------
    InsufficientDataError
        Without any candidate.
    """
    smallest = np.array([np.nan if fit is None else fit.chi2[fit.best] for fit in survey.fits])
    first = np.array(survey.scene_of) == survey.scene_of[0]
    usable = np.flatnonzero(first & survey.wind_good & np.isfinite(smallest))
    if len(usable) == 0:
        raise InsufficientDataError("found no observation with a wind to be trusted and a fit; one or more is expected")
    target, log_b2 = np.nanpercentile(smallest, TYPICAL_CENTILE), np.log(survey.b2_fitted)
    low, middle, high = np.nanpercentile(log_b2, (25.0, 50.0, 75.0))
    chosen = []
    for quartile, on_side in ((low, log_b2[usable] < middle), (high, log_b2[usable] >= middle)):
        side = usable[on_side] if on_side.any() else usable
        near = side[np.argsort(np.abs(log_b2[side] - quartile), kind="stable")][: max(1, len(side) // 4)]
        chosen.append(int(near[np.argmin(np.abs(smallest[near] - target))]))
    return chosen[0], chosen[1]


def without_overlap(survey: MeasuredSurvey, k: int) -> Profile:
    """Correlation profile of an observation without the noise correlated by overlap, as fitted."""
    if survey.overlap is None:
        return survey.measurements[k].profile
    profile, best = survey.measurements[k].profile, survey.fits[k].best
    theory = np.log(survey.theory(k)[best])
    shared = fitted_profile(profile, theory, survey.overlap)[0] - theory
    amplitude = np.polyfit(survey.overlap, shared, 1)[0]
    return replace(profile, log_profile=profile.log_profile - amplitude * survey.overlap)


def _profile_panel(
    survey: MeasuredSurvey,
    k: int,
    title: str,
    *,
    points: list[tuple[int, int]],
    name: str,
    extra: tuple[Series, ...],
) -> Panel:
    profile, best = without_overlap(survey, k), survey.fits[k].best
    theory = np.log(survey.theory(k))
    curves, error = fitted_profile(profile, theory, None)
    level, arcmin = np.exp(profile.log_level), np.degrees(survey.bins.theta_rad) * 60
    looks = iter(FAMILY_LOOKS)
    lines = [
        Series(
            label=name.format(b=survey.grid.index[point[0]], h=survey.grid.height_m[point[1]])
            + (" (best)" if point == best else ""),
            kind="line",
            x=arcmin,
            y=level * curves[point],
            look=BEST_LOOK if point == best else next(looks),
        )
        for point in sorted({*points, best})
    ]
    measured, error = level * profile.log_profile, level * error
    data = Series("measured", "points", arcmin, measured, "black", measured - error, measured + error)
    ends = np.concatenate([end for series in (data, *extra) for end in (series.low, series.high)])
    margin = 0.2 * np.ptp(ends)
    return Panel(
        title=title,
        x_label="Separation of detectors [arcmin]",
        y_label=r"$C(\theta)$ less its mean [mK$^2$]",
        series=(*lines, data, *extra),
        y_range=(float(ends.min() - margin), float(ends.max() + margin)),
    )


def _adjacent(survey: MeasuredSurvey, k: int) -> tuple[Series, ...]:
    """Series of the point of adjacent pairs on the scale of the profile; none without such pairs."""
    bins, item = survey.bins, survey.measurements[k]
    if not bins.adjacent.any():
        return ()
    streams = draw_observation(survey.setup, item.observation)
    value, error = adjacent_profile(scan_covariances(streams.data_mk, streams.scan_bounds), bins)
    apart = np.sqrt(np.mean(bins.separation_rad[bins.adjacent] ** 2))
    x, y, error = np.array([[np.degrees(apart) * 60], *(np.exp(item.profile.log_level) * np.array([[value], [error]]))])
    return (Series("adjacent pairs", "points", x, y, "grey --", y - error, y + error),)


def adjacent_profile(covariances_mk2: np.ndarray, bins: PairBins) -> tuple[float, float]:
    """Mean ln C of adjacent pairs on the scale of `Profile.log_profile`, and its jackknife error over scans.

    Gains of the detectors are removed as estimated from the profile of the other pairs.

    Parameters
    ----------
    covariances_mk2
        Covariances of each scan, (n_scan, n_det, n_det) [mK^2].
    bins
        Pairs by separation.
    """
    n_scan, n_det = covariances_mk2.shape[:2]
    pairs = covariances_mk2[:, bins.first, bins.second]
    logs = np.log(np.vstack([pairs.mean(axis=0), (pairs.sum(axis=0) - pairs) / (n_scan - 1)]))
    distant = ~bins.adjacent
    design = np.zeros((len(bins.first), n_det))
    design[np.arange(len(bins.first)), bins.first] = 1.0
    design[np.arange(len(bins.first)), bins.second] = 1.0
    left = logs[:, distant] - (logs[:, distant] @ bins.solve.T)[:, bins.bin[distant]]
    gains = np.linalg.lstsq(design[distant], left.T, rcond=None)[0]
    values = (logs[:, bins.adjacent] - (design[bins.adjacent] @ gains).T).mean(axis=1)
    return float(values[0]), float(values[1:].std() * np.sqrt(n_scan - 1))


def index_height_figure(survey: MeasuredSurvey) -> PaperFigure:
    """Figure 6: histograms of the best-fit index and of the best-fit height.

    Raises
    ------
    InsufficientDataError
        Without a fit.
    """
    best = np.array([fit.best for fit in survey.fits if fit is not None])
    if len(best) == 0:
        raise InsufficientDataError("found no observation with a fit; one or more is expected")
    counts = np.bincount(best[:, 1], minlength=len(survey.grid.height_m))
    uniform = len(best) / len(counts)
    chi2 = float(np.sum((counts - uniform) ** 2) / uniform)
    air, paper = survey.setup.scene.atmosphere, published()["fitted_index"]
    caption = (
        f"{described(survey)}, {without_fit(survey)}. Every observation is fitted on the paper's grid of indices and"
        f" heights with its measured wind, or with the scene's median one where that is not known to"
        f" {100 * KNOWN:.0f} % ({int((~survey.wind_known).sum())} observations). All layers are drawn with"
        f" b = {air.spectral_index:.2f} at {air.layer_height_m:g} m; the paper fits"
        f" {paper['observations']} observations. The"
        f" paper's heights are uniform; these differ from that by chi^2 = {chi2:.1f} for {len(counts) - 1} degrees"
        f" of freedom, but with {100 * counts.max() / len(best):.0f} % at the commonest of {len(counts)} heights a"
        f" single observation hardly tells the height."
    )
    return PaperFigure(
        number=6,
        title="Index and height of the layer that fit best",
        caption=caption,
        panels=(_index_panel(survey.grid.index, best[:, 0]), _height_panel(survey.grid.height_m, counts, uniform)),
        columns=2,
    )


def _index_panel(grid: np.ndarray, best: np.ndarray) -> Panel:
    counts, step, index = np.bincount(best, minlength=len(grid)), grid[1] - grid[0], grid[best]
    paper = published()["fitted_index"]
    label = f"best fits: {index.mean():.2f} ± {index.std():.2f} (paper {paper['mean']:g} ± {paper['std']:g})"
    edges = np.append(grid, grid[-1] + step) - step / 2
    return Panel(
        title="index",
        x_label="Best-fit index b",
        y_label="Observations",
        series=(
            Series(label, "steps", edges, np.append(counts, 0).astype(float), "blue"),
            Series("11/3", "line", np.full(2, grid[KOLMOGOROV]), np.array([0.0, 1.05 * counts.max()]), "vermilion"),
        ),
    )


def _height_panel(height_m: np.ndarray, counts: np.ndarray, uniform: float) -> Panel:
    between = np.sqrt(height_m[1:] * height_m[:-1])
    edges = np.concatenate([[height_m[0] ** 2 / between[0]], between, [height_m[-1] ** 2 / between[-1]]])
    return Panel(
        title="height",
        x_label="Best-fit height [m]",
        y_label="Observations",
        series=(
            Series("best fits", "steps", edges, np.append(counts, 0).astype(float), "blue"),
            Series("uniform", "line", edges[[0, -1]], np.full(2, uniform), "vermilion --"),
        ),
        x_log=True,
        y_range=(0.0, 1.3 * float(max(counts.max(), uniform))),
    )
