"""Errors of sigma(A), parts and all: noise realizations, the observations' weather, the signal window.

Symbols as in `mapmaker.bandpower`: per-bin arrays are (n_bin,), `weight` or g is each bin's share in sigma^-2.
"""

from dataclasses import dataclass

import numpy as np

from mapmaker.errors import InsufficientDataError
from mapmaker.validation import reals

FEWEST = 16  # observations whose own scatter tells how well they sample the weather
_MODE_COUNT_DOF = 16  # realizations that a count of modes is worth as a measure of their scatter


@dataclass(frozen=True)
class ErrorBudget:
    """Relative standard errors of sigma; NaN for a part that the data do not tell.

    `noise` of the noise realizations, `weather` of the sample of observations (the weather that they had and the scans
    that they lost), `window` of the signal window, `population` of an expectation over weather that sigma is scaled to.
    """

    noise: float
    weather: float
    window: float
    population: float = 0.0

    @property
    def total(self) -> float:
        """The parts, being independent, in quadrature."""
        return float(np.linalg.norm([self.noise, self.weather, self.window, self.population]))


def noise_error(
    noise_psds_ukcmb2: np.ndarray,
    weight: np.ndarray,
    observation_weights: np.ndarray,
    *,
    n_modes: np.ndarray | None = None,
    correlation: np.ndarray | None = None,
) -> float:
    """Relative error of sigma from the finite number of noise realizations (K, n_bin) and of observations.

    The two `noise_error_parts` in quadrature; raises ValueError as they do.
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
    """Relative errors of sigma from its noise: the part that more realizations take away, and the part they share.

    Response of sigma: `sigma^-2 = sum n/2 (M/N)^2` gives `d ln sigma = sum_b g_b dN_b / N_b`, g the
    normalised `weight`. So each realization has a response `r_k`, and the error of sigma is that of the mean
    of r_k.

    The realizations share their observations. In a Fourier mode let observation i add the complex Gaussian
    a_i of variance v_i, and `z_k = sum_i s_ki a_i`. Then `<|z_k|^2> = V = sum v_i` and, by Wick's theorem,
    the powers have `cov(|z_k|^2, |z_l|^2) = |<z_k z_l*>|^2 = (sum_i s_ki s_li v_i)^2`: V^2 for k = l and on
    average over signs `sum v_i^2` for k != l. With inverse-variance weights `v_i ~ w_i^2 / w_i = w_i`, so two
    realizations correlate by `c = 1 / n_eff`, `n_eff = (sum w)^2 / sum w^2`, and
    `var(mean r) = var(r) (1 - c) / K + var(r) c`: more signs cannot replace more observations.

    A few realizations know var(r) badly, to `sqrt(2 / (K - 1))`. Modes of noise that is alike in all directions have
    `var(r) = sum_b g_b^2 2 / n_b`. With `n_modes` (n_bin,) this closed form and the scatter of the realizations are
    averaged, as if the closed form were the scatter of 16 more; without, the scatter is all there is. The `correlation`
    (n_bin - 1,) of bins with the next leaves each bin `2 / n_b` less what it shares with its neighbours, which a wide
    sum has again: a sum that one bin rules has less. Within the K the common part does not show: `<s^2> = var(r)
    (1 - c)`.
    Raises ValueError for fewer than 2 observations or a weight that is not positive.
    """
    _check_observations(observation_weights)
    used = weight > 0
    response = (noise_psds_ukcmb2[:, used] / noise_psds_ukcmb2[:, used].mean(axis=0)) @ weight[used]
    common = np.sum(observation_weights**2) / np.sum(observation_weights) ** 2
    variance, n_real = np.var(response, ddof=1) / (1 - common), len(response)
    if n_modes is not None:
        counted = _counted_variance(weight, n_modes, correlation)
        variance = (_MODE_COUNT_DOF * counted + (n_real - 1) * variance) / (_MODE_COUNT_DOF + n_real - 1)
    return float(np.sqrt(variance * (1 - common) / n_real)), float(np.sqrt(variance * common))


def _counted_variance(weight: np.ndarray, n_modes: np.ndarray, correlation: np.ndarray | None) -> float:
    """Variance of the weighted sum of relative errors of bins whose wide sums have 2 / n of each."""
    used = weight > 0
    single = np.zeros(weight.shape)
    single[used] = weight[used] * np.sqrt(2 / n_modes[used])
    if correlation is None:
        return float(single @ single)
    shared = np.append(correlation, 0.0) + np.append(0.0, correlation)
    return _variance_of_sum(single / np.sqrt(1 + shared), correlation)


def _variance_of_sum(deviations: np.ndarray, correlation: np.ndarray | None) -> float:
    """Of (n_bin,) terms with these standard deviations, each of which correlates with the next alone."""
    alone = float(deviations @ deviations)
    if correlation is None:
        return alone
    return alone + 2 * float(np.sum(correlation * deviations[1:] * deviations[:-1]))


def information_shares(
    weights: np.ndarray, data: np.ndarray | float, noise: np.ndarray, bin_weight: np.ndarray
) -> np.ndarray:
    """How much each of (n_obs,) observations has of a survey's information: sigma answers to it; they sum to 1.

    An observation of the weight w_i a sample, a share d_i of all `data` and the `noise` variance v_ib a sample
    (n_obs, n_bin) adds to the co-added `N_b = sum w^2 d v_b / (sum w d)^2`. Of more or less of it, d ln sigma is minus
    its ``2 w d / sum(w d) - sum_b g_b w^2 d v_b / sum(w^2 d v_b)``, g the `bin_weight` (n_bin,). With w = 1 / v in all
    bins that is ``w d``; one that is noisy where its weight is not measured has less, even less than none. Noise counts
    in bins and observations that have a weight. Raises ValueError for other shapes, for fewer than 2 observations with
    data, and for weights, data or noise that are negative or not finite.
    """
    weights, bin_weight = (
        reals("weights", weights, ("n_obs",), least=0),
        reals("bin_weight", bin_weight, ("n_bin",), least=0),
    )
    data = reals("data", np.broadcast_to(data, weights.shape), weights.shape, least=0)
    used, bins = weights > 0, bin_weight > 0
    noise = reals("noise", noise, (len(weights), len(bins)), finite=False)
    reals("noise", noise[np.ix_(used, bins)], ("n_obs", "n_bin"), least=0)
    of_all = weights * data
    power = np.where(used[:, None], noise[:, bins], 0.0) * (weights * of_all)[:, None]
    return 2 * of_all / of_all.sum() - (power / power.sum(axis=0)) @ bin_weight[bins]


def ratio_error(information: np.ndarray, expected: np.ndarray) -> float:
    """Relative error of `sum(information) / sum(expected)` over (n_obs,) observations that are independent draws.

    To first order the ratio r changes by `(x_i - r y_i) / sum y` for each draw, so its relative variance is
    `n / (n - 1) sum (x_i - r y_i)^2 / (sum x)^2`: none where the two are proportional.
    Raises ValueError for fewer than 2 observations or an expectation whose sum is not positive.
    """
    if expected.size < 2 or not expected.sum() > 0:
        raise InsufficientDataError(f"expected at least 2 observations of a positive sum, got {expected}")
    ratio = information.sum() / expected.sum()
    return float(np.std(information - ratio * expected, ddof=1) * np.sqrt(expected.size) / information.sum())


def weather_error(information: np.ndarray, common_noise: float = 0.0) -> float:
    """Relative error of sigma from the weather of (n_obs,) observations, judged by their own scatter; NaN below 16.

    `information` is what sigma has of each (`information_shares`): its weight, with equal data and noise that changes
    alike in all bins. A sum of n independent draws has the relative variance `CV^2 / n`. It is measured with noise,
    which is in the error of sigma already: its variance `common_noise` squared (`noise_error_parts`) is taken off. The
    deviation of a mean over its estimated error is Student's t, hence the `student_factor`. Few observations rarely
    hold the best nights, so below `FEWEST` the error is unknown; a long tail of weights makes it too small above, too.
    Raises ValueError for fewer than 2 observations.
    """
    n_obs = information.size
    scatter = ratio_error(information, np.ones(n_obs))
    if n_obs < FEWEST:
        return float("nan")
    return subtract_in_quadrature(scatter, common_noise) * student_factor(n_obs)


def student_factor(n_draw: int) -> float:
    """Standard deviation of Student's t of n_draw draws: of a mean's error over its estimate; NaN below 4 draws."""
    return float(np.sqrt((n_draw - 1) / (n_draw - 3))) if n_draw > 3 else float("nan")


def subtract_in_quadrature(scatter: float, noise: float) -> float:
    """A scatter less the part that noise has in it, in quadrature; 0 where noise alone is larger."""
    return float(np.sqrt(max(scatter**2 - noise**2, 0.0)))


def transfer_function_error(
    signal_psd_relative_error: np.ndarray, weight: np.ndarray, correlation: np.ndarray | None = None
) -> float:
    """Relative error of sigma from errors of the signal PSD, (n_bin,).

    `d ln sigma = -sum_b g_b dM_b / M_b`, g the normalised `weight`. Errors of neighbours have the `correlation`
    (n_bin - 1,) that the map's taper gives them, and are independent by default: `sqrt(sum (g e)^2)`.
    """
    errors = np.where(weight > 0, weight * signal_psd_relative_error, 0.0)
    return float(np.sqrt(_variance_of_sum(errors, correlation)))


def _check_observations(observation_weights: np.ndarray) -> None:
    if observation_weights.ndim != 1 or observation_weights.size < 2:
        raise InsufficientDataError(f"observations with data: found {observation_weights.size}; 2 or more are expected")
    if not ((observation_weights > 0).all() and np.isfinite(observation_weights).all()):
        raise InsufficientDataError("observation weights must be positive and finite")
