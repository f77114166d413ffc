"""Monte Carlo errors of quantities of co-added maps in ratios: what two data sets or surveys share cancels."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from mapmaker.uncertainty import ErrorBudget, block_sums
from surveysim.survey.scores import DataSetScore


@dataclass(frozen=True)
class Response:
    """Dependence of a quantity on noise and transfer function of a data set's map, and its relative errors.

    Attributes
    ----------
    noise, transmission : (n_bin,)
        Derivatives of the quantity's logarithm to ln noise PSD and ln transfer function.
    exponent
        Sum of `noise`: the power of all noise that it goes with.
    budget
        Relative errors by origin.
    """

    noise: np.ndarray
    transmission: np.ndarray
    exponent: float
    budget: ErrorBudget


@dataclass(frozen=True)
class Gain:
    """Ratio of the uncertainties of two data sets, with its error."""

    ratio: float
    error: float


def sigma_response(item: DataSetScore) -> Response:
    """Response of sigma(A) of a data set."""
    return Response(item.band.weight, -item.band.weight, 1.0, item.budget)


def gain(worse: DataSetScore, better: DataSetScore, factor: float = 1.0) -> Gain:
    """Compute ``factor * sigma(worse) / sigma(better)`` with its Monte Carlo error.

    The data sets share signs, weather and possibly signal skies, so the error is the norm of a difference
    (`error_modes`), not a sum in quadrature.
    """
    ratio = factor * worse.band.sigma_ukcmb2 / better.band.sigma_ukcmb2
    one, other = error_modes((worse, better), ("", ""))  # the skies of one survey
    return Gain(ratio, ratio * float(np.linalg.norm(one - other)))


def error_modes(
    items: Sequence[DataSetScore], skies: Sequence[Hashable], responses: Sequence[Response] | None = None
) -> np.ndarray:
    """Responses (n_item, n_mode) of ln of a quantity, by default sigma(A), to independent unit deviates.

    Products of rows are their covariance. The items are data sets of one survey or of surveys with one seed. A row's
    norm is the relative error of its item, and the norm of the difference of two rows that of their ratio; what both
    respond to alike cancels.
    Responses are those of `mapmaker.bandpower`: to the noise, one mode for each of the sign-flipped co-adds, whose
    signs are common; to the weather, one for each observation, or block of observations with independent weather,
    common too (of controlled scores how its information differs from the forecast's); to the transfer function, one for
    each sky and bin, common to items whose `skies` and bins are equal; to the sample of weather that expectations are
    taken from, common to all. An unknown error makes its row NaN. How far noise is common shows in the scatter of K
    co-adds: its correlation between two items is known to 1 / sqrt(K - 1). How far transfer functions are common shows
    in what each sky does to each bin.
    """
    groups = [(key, item.band.ell.tobytes()) for item, key in zip(items, skies, strict=True)]
    pairs = list(zip(items, responses or map(sigma_response, items), strict=True))
    block = _common_blocks(items)
    transfer = [_transfer_function_row(*pair) for pair in pairs]
    rows_of = (_noise_row, partial(_weather_row, block), lambda _, response: np.array([response.budget.population]))
    columns = [_stacked([row(*pair) for pair in pairs]) for row in rows_of]
    for group in dict.fromkeys(groups):
        rows = [row if own == group else row[:0] for row, own in zip(transfer, groups, strict=True)]
        if groups.count(group) == 1:  # shared with nobody: one mode has it all
            rows = [np.atleast_1d(np.linalg.norm(row)) if len(row) else row for row in rows]
        columns.append(_stacked(rows))
    return np.hstack(columns)


def _noise_row(item: DataSetScore, response: Response) -> np.ndarray:
    used = response.noise != 0
    row = (item.noise_psds[:, used] / item.noise_psd[used]) @ response.noise[used]
    return _of_norm(response.budget.noise, row - row.mean())


def _common_blocks(items: Sequence[DataSetScore]) -> np.ndarray | None:
    """Blocks (n_obs,) of observations whose weather is independent in all items; None where all observations are."""
    if all(item.block is None for item in items):
        return None
    begins = np.ones(max(len(item.weights) for item in items), bool)
    for item in items:
        if item.block is not None:
            begins[1 : len(item.block)] &= np.diff(item.block) > 0
    return np.cumsum(begins) - 1


def _weather_row(block: np.ndarray | None, item: DataSetScore, response: Response) -> np.ndarray:
    if not np.isfinite(response.noise).all():
        return np.full(len(item.weights), np.nan)
    if not response.noise.any():  # a quantity of the transfer function alone
        return np.zeros(len(item.weights))
    how = response.noise, response.exponent
    off = item.shares(*how) - item.expected_shares(*how)
    return _of_norm(response.budget.weather, block_sums(off, None if block is None else block[: len(off)]))


def _transfer_function_row(item: DataSetScore, response: Response) -> np.ndarray:
    used, transfer_function = response.transmission != 0, item.transfer_function
    row = np.zeros(transfer_function.deviations.shape)
    row[:, used] = (
        response.transmission[used] * transfer_function.deviations[:, used] / transfer_function.transmission[used]
    )
    return _of_norm(response.budget.transfer_function, row.ravel())


def _of_norm(norm: float, row: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(row)
    return row * (norm / length) if length > 0 else row


def _stacked(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Stack rows of any lengths, padded with zeros."""
    stacked = np.zeros((len(rows), max(len(row) for row in rows)))
    for row, values in zip(stacked, rows, strict=True):
        row[: len(values)] = values
    return stacked
