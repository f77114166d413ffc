"""Error of sigma(A) and its parts: noise realizations, weather of the observations, transfer function.

Symbols as in `mapmaker.bandpower`: per-bin arrays are (n_bin,); `weight` or g is the contribution of each bin to
sigma^-2.
"""

from dataclasses import dataclass

import numpy as np

from mapmaker.errors import InsufficientDataError
from mapmaker.validation import reals

FEWEST = 16  # least number of observations whose scatter measures their sampling of the weather
_MODE_COUNT_DOF = 16  # realizations with the same weight as the closed form of their scatter


@dataclass(frozen=True)
class ErrorBudget:
    """Relative standard errors of sigma; NaN for a part that the data do not determine.

    Attributes
    ----------
    noise
        From the finite number of noise realizations.
    weather
        From the sample of observations: their weather, and the scans they lost.
    transfer_function
        From the transfer function of the signal.
    population
        From an expectation over weather that sigma is scaled to.
    """

    noise: float
    weather: float
    transfer_function: float
    population: float = 0.0

    @property
    def total(self) -> float:
        """Sum of the independent parts in quadrature."""
        return float(np.linalg.norm([self.noise, self.weather, self.transfer_function, self.population]))


def noise_error(
    noise_psds_ukcmb2: np.ndarray,
    weight: np.ndarray,
    observation_weights: np.ndarray,
    *,
    n_modes: np.ndarray | None = None,
    correlation: np.ndarray | None = None,
) -> float:
    """Relative error of sigma from the finite numbers of noise realizations and of observations.

    It is the sum in quadrature of the two `noise_error_parts`, which documents parameters and errors.
    """
    return float(
        np.hypot(
            *noise_error_parts(noise_psds_ukcmb2, weight, observation_weights, n_modes=n_modes, correlation=correlation)
        )
    )


def noise_error_parts(
    noise_psds_ukcmb2: np.ndarray,
    weight: np.ndarray,
    observation_weights: np.ndarray,
    *,
    n_modes: np.ndarray | None = None,
    correlation: np.ndarray | None = None,
) -> tuple[float, float]:
    """Relative errors of sigma from its noise: the part that more realizations reduce, and the part common to all of
    them.

    From `sigma^-2 = sum n/2 (M/N)^2` follows `d ln sigma = sum_b g_b dN_b / N_b`. Each realization k has a response
    r_k, and the error of sigma is that of the mean of r_k.

    The realizations have the same observations. In a Fourier mode let observation i add the complex Gaussian a_i of
    variance v_i, and `z_k = sum_i s_ki a_i` with signs s_ki. Then `<|z_k|^2> = V = sum v_i`, and by Wick's theorem the
    powers have `cov(|z_k|^2, |z_l|^2) = |<z_k z_l*>|^2 = (sum_i s_ki s_li v_i)^2`: V^2 for k = l and, averaged over
    signs, `sum v_i^2` for k != l. With inverse-variance weights `v_i ~ w_i^2 / w_i = w_i`, two realizations correlate
    by `c = 1 / n_eff`, `n_eff = (sum w)^2 / sum w^2`, and `var(mean r) = var(r) (1 - c) / K + var(r) c`: more
    realizations cannot replace more observations.

    A few realizations determine var(r) only to `sqrt(2 / (K - 1))`. For isotropic noise `var(r) = sum_b g_b^2 2 / n_b`.
    With `n_modes`, this closed form is averaged with the scatter of the realizations, with the weight of 16 more. The
    `correlation` of neighbouring bins lowers the variance of a single bin to `2 / n_b` less its shared part, which a
    wide sum regains. The common part does not show within the K realizations: `<s^2> = var(r) (1 - c)`.

    Parameters
    ----------
    noise_psds_ukcmb2 : (K, n_bin)
    weight : (n_bin,)
        g, or the derivatives of ln of another quantity to ln N_b, of either sign.
    observation_weights : (n_obs,)
        Inverse variances w_i, up to a factor.
    n_modes : (n_bin,), optional
    correlation : (n_bin - 1,), optional
        Correlation of each bin with the next.

    Returns
    -------
    signs, common : float

    Raises
    ------
    ValueError
        For fewer than 2 observations, or a weight that is not positive.
    """
    _check_observations(observation_weights)
    used = weight != 0
    response = (noise_psds_ukcmb2[:, used] / noise_psds_ukcmb2[:, used].mean(axis=0)) @ weight[used]
    common = np.sum(observation_weights**2) / np.sum(observation_weights) ** 2
    variance, n_real = np.var(response, ddof=1) / (1 - common), len(response)
    if n_modes is not None:
        counted = _counted_variance(weight, n_modes, correlation)
        variance = (_MODE_COUNT_DOF * counted + (n_real - 1) * variance) / (_MODE_COUNT_DOF + n_real - 1)
    return float(np.sqrt(variance * (1 - common) / n_real)), float(np.sqrt(variance * common))


def _counted_variance(weight: np.ndarray, n_modes: np.ndarray, correlation: np.ndarray | None) -> float:
    """Variance of the weighted sum of the bins' relative errors, from their numbers of modes."""
    used = weight != 0
    single = np.zeros(weight.shape)
    single[used] = weight[used] * np.sqrt(2 / n_modes[used])
    if correlation is None:
        return float(single @ single)
    shared = np.append(correlation, 0.0) + np.append(0.0, correlation)
    return _variance_of_sum(single / np.sqrt(1 + shared), correlation)


def _variance_of_sum(deviations: np.ndarray, correlation: np.ndarray | None) -> float:
    """Variance of the sum of (n_bin,) terms with these standard deviations, each correlated with the next only."""
    alone = float(deviations @ deviations)
    if correlation is None:
        return alone
    return alone + 2 * float(np.sum(correlation * deviations[1:] * deviations[:-1]))


def information_shares(
    weights: np.ndarray,
    data: np.ndarray | float,
    noise: np.ndarray,
    bin_weight: np.ndarray,
    *,
    exponent: float = 1.0,
) -> np.ndarray:
    """Contribution of each observation to the information of a survey.

    An observation with the weight w_i a sample, the fraction d_i of all data and the noise variance v_ib a sample adds
    to the co-added `N_b = sum w^2 d v_b / (sum w d)^2`. For a small change of its data, -d ln sigma is ``2 w d / sum(w
    d) - sum_b g_b w^2 d v_b / sum(w^2 d v_b)``. For w = 1 / v in all bins this is ``w d``; observations with excess
    noise in bins where the weight is not measured contribute less, possibly less than nothing.

    Parameters
    ----------
    weights : (n_obs,)
        w.
    data : (n_obs,) or scalar
        d.
    noise : (n_obs, n_bin)
        v; used in bins and observations with a weight.
    bin_weight : (n_bin,)
        g, or the derivatives of ln of another quantity to ln N_b, of either sign.
    exponent
        Their sum: the power of all noise that the quantity goes with.

    Returns
    -------
    (n_obs,) array
        Contributions, which sum to the exponent.

    Raises
    ------
    ValueError
        For other shapes, fewer than 2 observations with data, and values that are negative or not finite.
    """
    weights, bin_weight = reals("weights", weights, ("n_obs",), least=0), reals("bin_weight", bin_weight, ("n_bin",))
    data = reals("data", np.broadcast_to(data, weights.shape), weights.shape, least=0)
    used, bins = weights > 0, bin_weight != 0
    noise = reals("noise", noise, (len(weights), len(bins)), finite=False)
    reals("noise", noise[np.ix_(used, bins)], ("n_obs", "n_bin"), least=0)
    of_all = weights * data
    power = np.where(used[:, None], noise[:, bins], 0.0) * (weights * of_all)[:, None]
    return 2 * exponent * of_all / of_all.sum() - (power / power.sum(axis=0)) @ bin_weight[bins]


def block_sums(terms: np.ndarray, block: np.ndarray | None) -> np.ndarray:
    """Sums (n_block,) over blocks of observations of the deviations of terms (n_obs,) from their mean.

    Parameters
    ----------
    terms : (n_obs,)
    block : (n_obs,), optional
        Block of each observation, numbered from 0. By default each is one of its own, and the terms are returned.
    """
    return terms if block is None else np.bincount(block, terms - terms.mean())


def draws(n_obs: int, block: np.ndarray | None) -> int:
    """Return the number of independent draws: the blocks, or without them the observations."""
    return n_obs if block is None else int(block[-1]) + 1


def ratio_error(information: np.ndarray, expected: np.ndarray, block: np.ndarray | None = None) -> float:
    """Relative error of `sum(information) / sum(expected)` over observations that are independent draws.

    To first order, each draw changes the ratio r by `(x_i - r y_i) / sum y`. The relative variance is
    `n / (n - 1) sum (x_i - r y_i)^2 / (sum x)^2`: zero where the two are proportional. Of observations whose blocks are
    independent the sums over blocks are the draws; the error is NaN for a single one.

    Parameters
    ----------
    information, expected : (n_obs,)
        x and y.
    block : (n_obs,), optional
        Block of each observation, numbered from 0; by default each is one of its own.

    Raises
    ------
    ValueError
        For fewer than 2 observations, or an expectation whose sum is not positive.
    """
    if expected.size < 2 or not expected.sum() > 0:
        raise InsufficientDataError(f"expected at least 2 observations of a positive sum, got {expected}")
    ratio = information.sum() / expected.sum()
    off = block_sums(information - ratio * expected, block)
    if off.size < 2:
        return float("nan")
    return float(np.std(off, ddof=1) * np.sqrt(off.size) / information.sum())


def weather_error(information: np.ndarray, common_noise: float = 0.0, *, block: np.ndarray | None = None) -> float:
    """Relative error of sigma from the weather of its observations, estimated from their scatter.

    A sum of n independent draws has the relative variance `CV^2 / n`. The variance of its measurement noise, which is
    part of the error of sigma already, is subtracted. The deviation of a mean over its estimated error follows
    Student's t, hence `student_factor`. Few observations rarely include the best nights: below `FEWEST` the error is
    NaN. A long tail of weights makes it too small above, too. Of observations in blocks, the blocks count.

    Parameters
    ----------
    information : (n_obs,)
        Contribution of each observation (`information_shares`).
    common_noise
        Common part of `noise_error_parts`.
    block : (n_obs,), optional
        Block of each observation, numbered from 0; by default each is one of its own.

    Raises
    ------
    ValueError
        For fewer than 2 observations.
    """
    scatter, n_draw = ratio_error(information, np.ones(information.size), block), draws(information.size, block)
    if n_draw < FEWEST:
        return float("nan")
    return subtract_in_quadrature(scatter, common_noise) * student_factor(n_draw)


def student_factor(n_draw: int) -> float:
    """Standard deviation of Student's t for a mean of `n_draw` draws; NaN for fewer than 4."""
    return float(np.sqrt((n_draw - 1) / (n_draw - 3))) if n_draw > 3 else float("nan")


def subtract_in_quadrature(scatter: float, noise: float) -> float:
    """Subtract the noise from a scatter in quadrature; 0 where the noise is larger."""
    return float(np.sqrt(max(scatter**2 - noise**2, 0.0)))


def transfer_function_error(
    signal_psd_relative_error: np.ndarray, weight: np.ndarray, correlation: np.ndarray | None = None
) -> float:
    """Relative error of sigma from errors of the signal PSD: `d ln sigma = -sum_b g_b dM_b / M_b`.

    Parameters
    ----------
    signal_psd_relative_error, weight : (n_bin,)
        Relative errors of M, and g, or the derivatives of ln of another quantity to ln M_b, of either sign.
    correlation : (n_bin - 1,), optional
        Correlation of the errors of neighbouring bins by the map's taper. Without it they are independent:
        `sqrt(sum (g e)^2)`.
    """
    errors = np.where(weight != 0, weight * signal_psd_relative_error, 0.0)
    return float(np.sqrt(_variance_of_sum(errors, correlation)))


def _check_observations(observation_weights: np.ndarray) -> None:
    if observation_weights.ndim != 1 or observation_weights.size < 2:
        raise InsufficientDataError(f"observations with data: found {observation_weights.size}; 2 or more are expected")
    if not ((observation_weights > 0).all() and np.isfinite(observation_weights).all()):
        raise InsufficientDataError("observation weights must be positive and finite")
