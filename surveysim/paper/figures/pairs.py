"""Figures 14 and 15 of the paper: correlation coefficients up to 1 Hz after cleaning, by pair and by separation."""

from math import degrees

import numpy as np

from surveysim.paper.excess import excess_noise, pair_noises, white_correlation
from surveysim.paper.measured_survey import MeasuredSurvey
from surveysim.paper.measurement import CORRELATION_EDGES, PAIR_CLEANINGS
from surveysim.paper.published import published
from surveysim.paper.statistics import described, median_error, quarters
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.runtime.errors import InsufficientDataError

PAIRS = {"adjacent": "adjacent_counts", "non-adjacent": "distant_counts"}
WEATHER_LOOKS = {"all observations": "black", "lowest quarter of B2": "blue", "highest quarter of B2": "vermilion"}
CLEANING_LOOKS = {"average": "blue", "quadratic": "vermilion"}
FEWEST_SHARE = 1e-3  # smallest fraction of pairs in the last bin that is shown


def correlation_histogram_figure(survey: MeasuredSurvey) -> PaperFigure:
    """Figure 14: histograms of absolute correlation coefficients of adjacent and other pairs, by cleaning.

    Raises
    ------
    InsufficientDataError
        For fewer than four observations with a fit, or if a cleaning kept no scan in a group of weather.
    """
    groups = _weather(survey)
    panels, highest = {}, 0.0
    for kind, field in PAIRS.items():
        for cleaning in PAIR_CLEANINGS:
            counts = {name: folded(_counts(survey, cleaning, field, which)) for name, which in groups.items()}
            panels[cleaning, kind] = [line for name, each in counts.items() for line in _histogram(name, each)]
            highest = max([highest, *(_end(each) for each in counts.values())])
    signed = {
        (cleaning, kind): _counts(survey, cleaning, field, groups["all observations"]).sum(axis=0)
        for kind, field in PAIRS.items()
        for cleaning in PAIR_CLEANINGS
    }
    bins = survey.bins
    caption = (
        f"{described(survey)} of thin screen, excess noise shared by overlap, photon and detector noise."
        f" Shares of pairs by the magnitude of their correlation coefficient in one observation, from covariances up"
        f" to 1 Hz of cleaned scans: {int(bins.adjacent.sum())} adjacent and {int((~bins.adjacent).sum())} other pairs"
        f" each; shaded the standard error over observations. Negative are {_negative(signed)} of the coefficients."
        f" {_white(survey)}"
    )
    return PaperFigure(
        number=14,
        title="Correlation of detectors below 1 Hz",
        caption=caption,
        panels=tuple(
            Panel(
                title=f"{cleaning} subtraction, {kind} pairs",
                x_label="Magnitude of correlation",
                y_label="Share of pairs",
                series=tuple(lines),
                x_range=(0.0, highest),
            )
            for (cleaning, kind), lines in panels.items()
        ),
        columns=len(PAIR_CLEANINGS),
    )


def _weather(survey: MeasuredSurvey) -> dict[str, np.ndarray]:
    """Masks (n_obs,) of the observations with a fit, by group of weather."""
    parts = quarters(survey.b2_fitted)
    return dict(zip(WEATHER_LOOKS, (np.any(parts, axis=0), parts[0], parts[3]), strict=True))


def _counts(survey: MeasuredSurvey, cleaning: str, field: str, which: np.ndarray) -> np.ndarray:
    """Histograms (n_obs, n_bin) of correlation coefficients, for observations that have them."""
    items = [item for item, used in zip(pair_noises(survey, cleaning), which, strict=True) if used and item]
    if not items:
        raise InsufficientDataError(
            f"found no observation with scans kept by {cleaning} subtraction; one or more is expected"
        )
    return np.array([getattr(item, field) for item in items])


def folded(counts: np.ndarray) -> np.ndarray:
    """Histogram by absolute value (..., n / 2) of a histogram (..., n) in bins symmetric about 0."""
    half = counts.shape[-1] // 2
    return counts[..., half:] + counts[..., half - 1 :: -1]


def _magnitude_edges() -> np.ndarray:
    return CORRELATION_EDGES[len(CORRELATION_EDGES) // 2 :]


def _histogram(name: str, counts: np.ndarray) -> list[Series]:
    """Series of a normalized histogram and its error band, from counts (n_obs, n_bin)."""
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    mean, error = share.mean(axis=0), share.std(axis=0) / np.sqrt(len(share))
    edges, look = _magnitude_edges(), WEATHER_LOOKS[name]
    corners = np.repeat(edges, 2)[1:-1]
    low, middle, high = (np.repeat(each, 2) for each in (mean - error, mean, mean + error))
    return [
        Series("", "band", corners, middle, look, low, high),
        Series(name, "steps", edges, np.append(mean, mean[-1]), look),
    ]


def _end(counts: np.ndarray) -> float:
    """Upper edge of the last bin with enough pairs to show."""
    total = counts.sum(axis=0)
    return float(_magnitude_edges()[1 + np.flatnonzero(total > FEWEST_SHARE * total.sum())[-1]])


def _negative(signed: dict[tuple[str, str], np.ndarray]) -> str:
    half = len(CORRELATION_EDGES) // 2
    each = [
        f"{100 * counts[:half].sum() / counts.sum():.0f} % ({kind} pairs, {cleaning})"
        for (cleaning, kind), counts in signed.items()
    ]
    return ", ".join(each)


def _white(survey: MeasuredSurvey) -> str:
    paper = published()["table2"]["adjacent_white_correlation"][-1]
    each = []
    for cleaning in PAIR_CLEANINGS:
        value, error = median_error(white_correlation(survey, cleaning))
        each.append(f"{100 * value:.1f} ± {100 * error:.1f} % after {cleaning} subtraction")
    return (
        f"Above 2.5 Hz the median correlation of adjacent pairs is {' and '.join(each)} (paper {100 * paper:g} %):"
        f" neighbours share the noise that templates subtract."
    )


# ---------------------------------------------------------------- figure 15


def separation_figure(survey: MeasuredSurvey) -> PaperFigure:
    """Figure 15: median correlation coefficient up to 1 Hz against separation, after average and quadratic subtraction.

    Left panel: all observations; right panel: lowest and highest quarter of B2.

    Raises
    ------
    InsufficientDataError
        As for `correlation_histogram_figure`.
    """
    everything, *weather = _weather(survey).items()
    left = [
        _against_separation(survey, cleaning, everything[1], label=f"{cleaning} subtraction", look=look)
        for cleaning, look in CLEANING_LOOKS.items()
    ]
    right = [
        _against_separation(survey, cleaning, which, label=f"{cleaning}, {name}", look=f"{look} {dashes}")
        for cleaning, look in CLEANING_LOOKS.items()
        for (name, which), dashes in zip(weather, ("--", ":"), strict=True)
    ]
    highest = 1.1 * max(float(np.nanmax(series.high)) for series in left + right)
    lowest = min(-0.1, 1.1 * min(float(np.nanmin(series.low)) for series in left + right))
    fractions = {name: median_error(excess_noise(survey, name).fraction) for name in PAIR_CLEANINGS}
    texts = [f"{value:.3f} ± {error:.3f} ({name})" for name, (value, error) in fractions.items()]
    paper = published()["table2"]["adjacent_correlation_fraction"][-1]
    caption = (
        f"{described(survey)}: the mean correlation coefficient of the pairs of each separation, from covariances up"
        f" to 1 Hz of cleaned scans; the median over observations and its error. The first point is that of adjacent"
        f" pairs. White noise is in these coefficients; without it and without residual atmosphere adjacent pairs"
        f" share {' and '.join(texts)} of the excess noise (paper {paper:g}).{_lobes(survey)} The paper finds very"
        f" little correlation of non-adjacent pairs after quadratic subtraction."
    )
    panels = [
        _separation_panel(title, series, (lowest, highest))
        for title, series in (("all observations", left), ("by weather", right))
    ]
    return PaperFigure(15, "Correlation below 1 Hz against separation", caption, tuple(panels), len(panels))


def _lobes(survey: MeasuredSurvey) -> str:
    """Words for captions on the coherence of pixels beyond their neighbours."""
    excess = survey.setup.scene.excess
    if excess is None or excess.coherence != "field":
        return ""
    return (
        " The simulated excess has the field coherence of a uniformly lit stop, negative from 1.2 to 2.2 (f/#)lambda."
    )


def _against_separation(survey: MeasuredSurvey, cleaning: str, which: np.ndarray, *, label: str, look: str) -> Series:
    items = [item for item, used in zip(pair_noises(survey, cleaning), which, strict=True) if used and item]
    if not items:
        raise InsufficientDataError(
            f"found no observation with scans kept by {cleaning} subtraction; one or more is expected"
        )
    bins = survey.bins
    apart = np.append(bins.separation_rad[bins.adjacent].mean(), bins.theta_rad)
    values = np.array([np.append(item.adjacent_correlation, item.correlation) for item in items])
    median, error = np.array([median_error(column) for column in values.T]).T
    return Series(
        label, "points", np.array([60 * degrees(x) for x in apart]), median, look, median - error, median + error
    )


def _separation_panel(title: str, series: list[Series], y_range: tuple[float, float]) -> Panel:
    ends = series[0].x[[0, -1]]
    zero = Series("", "line", np.array([0.0, ends[1]]), np.zeros(2), "grey :")
    return Panel(title, "Separation [arcmin]", "Correlation below 1 Hz", (zero, *series), y_range=y_range)
