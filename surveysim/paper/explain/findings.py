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
    paper, paper_error
        Published value and its error; NaN for none.
    statistic
        Value of a survey.
    """

    name: str
    title: str
    paper: float
    paper_error: float
    statistic: Callable[[Values], float]


def findings() -> tuple[Finding, ...]:
    """List the findings, in the order of the paper."""
    index, cleaning = published()["fitted_index"], published()["cleaning"]
    half, count = published()["share_of_good_winds"], index["observations"]
    slope, slope_error = paper_slope()
    ratio = cleaning["higher_order_template_psd_ratio"]
    raw = published()["table2"]["raw_atmosphere"][-1], published()["table2"]["raw_atmosphere_error"][-1]
    change = published()["b2_change_over_heights"]
    removed = cleaning["point_source_flux_removed"]
    return (
        Finding("winds_trusted", "winds trusted", half, UNKNOWN, trusted),
        Finding(
            "winds_trusted_better", "winds trusted, better half of B2", UNKNOWN, UNKNOWN, partial(of_half, trusted, 0)
        ),
        Finding(
            "winds_trusted_poorer", "winds trusted, poorer half of B2", UNKNOWN, UNKNOWN, partial(of_half, trusted, 1)
        ),
        Finding("index_mean", "index b, mean", index["mean"], index["std"] / count**0.5, _mean("fitted_index")),
        Finding(
            "index_std", "index b, standard deviation", index["std"], index["std"] / (2 * count) ** 0.5, _index_std
        ),
        Finding("raw_exponent", "raw noise against B2, exponent", slope, slope_error, _raw_exponent),
        Finding("raw_median", "raw noise, median [mK2]", *raw, _median("raw_mk2")),
        Finding(
            "templates_low", "higher templates / zeroth, below 0.5 Hz", ratio, UNKNOWN, _median("template_ratio_low")
        ),
        Finding(
            "templates_all", "higher templates / zeroth, all frequencies", ratio, UNKNOWN, _median("template_ratio_all")
        ),
        Finding("pca_best", "PCA best for a CMB spectrum", 0.0, UNKNOWN, partial(_best, "cmb", "pca")),
        Finding(
            "pca_modes",
            "modes removed by PCA",
            float(np.mean(cleaning["modes_removed_by_pca"])),
            UNKNOWN,
            _mean("pca_modes"),
        ),
        Finding("height_change", "B2 change with assumed height, half range", change, UNKNOWN, _height_change),
        Finding(
            "height_change_limited",
            "the same, from model maps of 465 arcmin",
            change,
            UNKNOWN,
            _limited_height_change,
        ),
        *(
            Finding(f"flux_{name}", f"flux removed, {name}", removed[name], UNKNOWN, _mean(f"flux_removed_{name}"))
            for name in CLEANINGS
        ),
    )


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
    """Exponent of raw noise as a power of B2, as in `paper_slope`."""
    groups = quarters(values["fitted_b2"])
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
