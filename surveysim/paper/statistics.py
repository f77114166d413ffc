"""Statistics of many observations: centiles with errors, medians in bins, distributions."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from surveysim.paper.measured_survey import MeasuredSurvey
from surveysim.runtime.errors import InsufficientDataError

RESAMPLES = 400
SEED = 20100101
QUARTILES = (25.0, 50.0, 75.0)
CENTILES = (10.0, 25.0, 50.0, 75.0, 90.0)
FEWEST = 15  # values in a bin that has centiles
MOST_BINS = 8


@dataclass(frozen=True)
class Binned:
    """Centiles of y in bins of x with equal numbers of observations.

    Attributes
    ----------
    x
        Medians of x, (n_bin,).
    count
        Numbers of observations, (n_bin,).
    centile
        Centiles of y, (5, n_bin), those of `CENTILES`.
    median_error
        Standard errors of the medians of y, (n_bin,).
    """

    x: np.ndarray
    count: np.ndarray
    centile: np.ndarray
    median_error: np.ndarray

    @property
    def median(self) -> np.ndarray:
        """Median of y in each bin, (n_bin,)."""
        return self.centile[2]


def bootstrap(values: np.ndarray, statistic: Callable[[np.ndarray], float]) -> tuple[float, float]:
    """Statistic of values (n,) and its bootstrap standard error; the resampling is the same in every call.

    Raises
    ------
    InsufficientDataError
        Without values.
    """
    values = _some(values)
    drawn = [statistic(sample) for sample in _resampled(values)]
    return float(statistic(values)), float(np.std(drawn))


def centile_errors(values: np.ndarray, centiles: Sequence[float]) -> np.ndarray:
    """Bootstrap standard errors (n_centile,) of centiles of values (n,); errors as for `bootstrap`."""
    return np.percentile(_resampled(_some(values)), centiles, axis=1).std(axis=1)


def _some(values: np.ndarray) -> np.ndarray:
    if len(values) == 0:
        raise InsufficientDataError("found no observation; at least one is expected")
    return np.asarray(values, dtype=float)


def _resampled(values: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(SEED)
    return values[rng.integers(len(values), size=(RESAMPLES, len(values)))]


def binned(x: np.ndarray, y: np.ndarray) -> Binned:
    """Centiles of y (n,) in at most `MOST_BINS` bins of x (n,) with `FEWEST` observations or more where possible.

    Raises
    ------
    InsufficientDataError
        Without observations.
    """
    order = np.argsort(_some(x), kind="stable")
    groups = np.array_split(order, int(np.clip(len(x) // FEWEST, 1, MOST_BINS)))
    return Binned(
        x=np.array([np.median(x[group]) for group in groups]),
        count=np.array([len(group) for group in groups]),
        centile=np.array([np.percentile(y[group], CENTILES) for group in groups]).T,
        median_error=np.array([centile_errors(y[group], (50.0,))[0] for group in groups]),
    )


def quarters(values: np.ndarray) -> list[np.ndarray]:
    """Masks (n,) of the values in each quarter of the distribution, without NaN.

    Raises
    ------
    InsufficientDataError
        For fewer than four values.
    """
    known = np.isfinite(values)
    if known.sum() < 4:
        raise InsufficientDataError(f"found {known.sum()} observations with a fit; 4 or more make quarters")
    number = np.searchsorted(np.percentile(values[known], QUARTILES), values, side="right")
    return [known & (number == k) for k in range(4)]


def median_error(values: np.ndarray) -> tuple[float, float]:
    """Median of values (n,) without NaN, and its standard error; NaN without values."""
    known = values[np.isfinite(values)]
    return (float(np.median(known)), float(centile_errors(known, (50.0,))[0])) if len(known) else (np.nan, np.nan)


def cumulative(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sorted values (n,) and their cumulative distribution (n,), at half of each step.

    Raises
    ------
    InsufficientDataError
        Without values.
    """
    ordered = np.sort(_some(values))
    return ordered, (np.arange(len(ordered)) + 0.5) / len(ordered)


def scale_to(measured: np.ndarray, model: np.ndarray) -> float:
    """Factor of a model (n,) that fits positive values (n,) best, by least squares of logarithms; NaN without positive
    values."""
    used = measured > 0
    return float(np.exp(np.mean(np.log(measured[used] / model[used])))) if used.any() else float("nan")


def described(survey: MeasuredSurvey) -> str:
    """Words for captions: numbers of observations, band and scenes."""
    scenes = ", ".join(f"{count} of {name}" for name, count in Counter(survey.scene_of).items())
    return f"{len(survey.scene_of)} simulated observations at {survey.band_ghz} GHz ({scenes})"


def without_fit(survey: MeasuredSurvey) -> str:
    """Words for captions: number of observations without a fit."""
    missing = sum(fit is None for fit in survey.fits)
    return f"{missing} left out for want of a fit" if missing else "all fitted"
