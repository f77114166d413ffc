"""Findings of the paper that one frozen layer does not reproduce, each a statistic of the values of a survey."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from surveysim.paper.explain.values import CLEANINGS, TRUSTED, Values
from surveysim.paper.published import published
from surveysim.paper.statistics import quarters

RESAMPLES, SEED = 400, 20100102
UNKNOWN = float("nan")


@dataclass(frozen=True)
class Finding:
    """A finding of the paper.

    Attributes
    ----------
    name, title
        Name in files, and for people.
    paper
        Lowest and highest value that the paper allows; equal for a number.
    paper_error
        Published error; NaN for none.
    statistic
        Value of a survey.
    """

    name: str
    title: str
    paper: tuple[float, float]
    paper_error: float
    statistic: Callable[[Values], float]

    def gap(self, value: float) -> float:
        """Return the distance of a value from the paper's."""
        return max(self.paper[0] - value, value - self.paper[1], 0.0)


def findings() -> tuple[Finding, ...]:
    """List the findings, in the order of the paper."""
    index, cleaning = published()["fitted_index"], published()["cleaning"]
    half, count = published()["share_of_good_winds"], index["observations"]
    slope, slope_error = paper_slope()
    raw, raw_error = (published()["table2"][name][-1] for name in ("raw_atmosphere", "raw_atmosphere_error"))
    removed = cleaning["point_source_flux_removed"]
    ratio, change = 2 * (cleaning["higher_order_template_psd_ratio"],), 2 * (published()["b2_change_over_heights"],)
    least, most = cleaning["modes_removed_by_pca"]
    better, poorer = partial(of_half, trusted, 0), partial(of_half, trusted, 1)
    return (
        _share("winds_trusted", "winds trusted [%]", (half, half), trusted),
        _share("winds_trusted_better", "winds trusted, better half of B2 [%]", (half, 1.0), better),
        _share("winds_trusted_poorer", "winds trusted, poorer half of B2 [%]", (0.0, half), poorer),
        _number("index_mean", "index b, mean", index["mean"], _mean("fitted_index"), index["std"] / count**0.5),
        _number("index_std", "index b, scatter", index["std"], _index_std, index["std"] / (2 * count) ** 0.5),
        _number("raw_exponent", "raw noise against B2, exponent", slope, _raw_exponent, slope_error),
        _number("raw_median", "raw noise, median [mK2]", raw, _median("raw_mk2"), raw_error),
        _share("templates_low", "higher over zeroth templates, to 0.5 Hz [%]", ratio, _median("template_ratio_low")),
        _share("templates_all", "higher over zeroth templates, to 5 Hz [%]", ratio, _median("template_ratio_all")),
        _share("pca_best", "PCA best for a CMB spectrum [%]", (0.0, 0.0), partial(_best, "cmb", "pca")),
        Finding("pca_modes", "modes removed by PCA", (least, most), UNKNOWN, _mean("pca_modes")),
        _share("height_change", "B2 change with assumed height [%]", change, _height_change),
        _share("height_change_limited", "the same, model maps of 465 arcmin [%]", change, _limited_height_change),
        *(
            _share(f"flux_{x}", f"flux removed, {x} [%]", 2 * (removed[x],), _mean(f"flux_removed_{x}"))
            for x in CLEANINGS
        ),
    )


def _number(
    name: str, title: str, paper: float, statistic: Callable[[Values], float], paper_error: float = UNKNOWN
) -> Finding:
    return Finding(name, title, (paper, paper), paper_error, statistic)


def _share(name: str, title: str, paper: tuple[float, float], statistic: Callable[[Values], float]) -> Finding:
    """Finding in percent, of a fraction and its published range."""
    low, high = paper
    return Finding(name, title, (100 * low, 100 * high), UNKNOWN, lambda values: 100 * statistic(values))


def bootstrapped(finding: Finding, values: Values) -> np.ndarray:
    """Compute a finding of a survey and of resampled surveys, (1 + RESAMPLES,).

    Surveys of equal length are resampled alike, so that differences between them are paired.
    """
    n_obs = len(values["observation"])
    drawn = np.random.default_rng(SEED).integers(n_obs, size=(RESAMPLES, n_obs))
    samples = [values, *({name: column[index] for name, column in values.items()} for index in drawn)]
    return np.array([finding.statistic(sample) for sample in samples])


def paper_slope() -> tuple[float, float]:
    """Exponent of Table 2's raw noise as a power of B2, and its error, from the medians in four quarters of B2."""
    table = published()["table2"]
    b2, raw, error = (np.array(table[name][:4]) for name in ("b2", "raw_atmosphere", "raw_atmosphere_error"))
    away = np.log(b2) - np.log(b2).mean()
    weight = away / (away @ away)
    return float(weight @ np.log(raw)), float(np.sqrt(weight**2 @ (error / raw) ** 2))


# ---------------------------------------------------------------- statistics


def trusted(values: Values) -> float:
    """Fraction of trusted winds."""
    return float(np.mean(values["wind"] == TRUSTED))


def of_half(statistic: Callable[[Values], float], half: int, values: Values) -> float:
    """Return a statistic of the observations below (0) or above (1) the median of the simulated B2."""
    poorer = values["drawn_b2"] > np.median(values["drawn_b2"])
    return statistic({name: column[poorer == bool(half)] for name, column in values.items()})


def _mean(name: str) -> Callable[[Values], float]:
    return lambda values: float(np.nanmean(values[name]))


def _median(name: str) -> Callable[[Values], float]:
    return lambda values: float(np.nanmedian(values[name]))


def _index_std(values: Values) -> float:
    return float(np.nanstd(values["fitted_index"]))


def _raw_exponent(values: Values) -> float:
    """Exponent of raw noise as a power of B2, as in `paper_slope`; NaN where a quarter is empty."""
    groups = quarters(values["fitted_b2"])
    if not np.all(np.any(groups, axis=1)):
        return UNKNOWN
    b2, raw = (np.array([np.median(values[name][group]) for group in groups]) for name in ("fitted_b2", "raw_mk2"))
    away = np.log(b2) - np.log(b2).mean()
    return float(away @ np.log(np.maximum(raw, 1e-3)) / (away @ away))


def _best(target: str, cleaning: str, values: Values) -> float:
    """Fraction of the observations with the largest figure of merit after a cleaning."""
    merits = np.nan_to_num([values[f"merit_{target}_{name}"] for name in CLEANINGS])
    return float(np.mean(merits.argmax(axis=0) == CLEANINGS.index(cleaning)))


def _height_change(values: Values) -> float:
    """Half of the change of fitted B2 from the highest to the lowest assumed layer, median."""
    change = (values["lowest_layer_b2"] - values["highest_layer_b2"]) / values["fitted_b2"]
    return float(np.nanmedian(change) / 2)


def _limited_height_change(values: Values) -> float:
    """The same, for fits with model maps of limited size."""
    return float(np.nanmedian(values["limited_lowest_ratio"] - values["limited_highest_ratio"]) / 2)
