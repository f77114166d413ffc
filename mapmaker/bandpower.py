"""Uncertainty of a flat CMB band power from the noise of a map: the score of a survey.

Symbols: a bin b of multipole has `n_b` real degrees of freedom; the noise map has the PSD `N_b`, and a sky of flat band
power `ell (ell + 1) C_ell / 2 pi = A` adds `A M_b`. `A` is in uK_CMB^2, PSDs in uK_CMB^2 sr, `M` in sr. All per-bin
arrays are (n_bin,); `mask` is a boolean (n_bin,) array that selects bins.
"""

from dataclasses import dataclass

import numpy as np

from mapmaker.errors import InsufficientDataError
from mapmaker.uncertainty import ErrorBudget, noise_error_parts, transfer_function_error, weather_error
from mapmaker.validation import reals


@dataclass(frozen=True)
class BandPower:
    """Uncertainty of a flat band power from noise alone, and the multipoles that it comes from.

    Attributes
    ----------
    sigma_ukcmb2
        Uncertainty of the band power.
    error_ukcmb2
        Standard error of `sigma_ukcmb2`; NaN where unknown.
    ell_eff, fwhm_ell
        Mean multipole and full width at half maximum of the weight `n/2 (M/N)^2`.
    weight : (n_bin,)
        Contribution of each bin to sigma^-2; sums to 1.
    ell : (n_bin,)
    cumulative : (n_bin,)
        Uncertainty from the selected bins at this multipole and above; infinite where there are none.
    """

    sigma_ukcmb2: float
    error_ukcmb2: float
    ell_eff: float
    fwhm_ell: float
    weight: np.ndarray
    ell: np.ndarray
    cumulative: np.ndarray


def flat_spectrum_psd(ell: np.ndarray) -> np.ndarray:
    """PSD on the sky of a flat spectrum of unit band power, `2 pi / (ell (ell + 1))`.

    Parameters
    ----------
    ell : any shape

    Returns
    -------
    array
        In uK^2 sr per uK^2; 0 at ell = 0, because the sky has no mean.

    Raises
    ------
    ValueError
        For multipoles that are negative or not finite.
    """
    ell = reals("ell", ell, (...,), least=0, empty=True).astype(np.float64, copy=False)
    return 2 * np.pi / np.where(ell > 0, ell * (ell + 1), np.inf)


def flat_band_power(
    noise_psd_ukcmb2: np.ndarray, signal_psd: np.ndarray, n_modes: np.ndarray, mask: np.ndarray
) -> float:
    """Uncertainty of A with optimally weighted bins: `sigma^-2 = sum n/2 (M/N)^2`.

    While noise dominates, the PSD of a bin has the variance `2/n N^2`; `P_b - N_b = A M_b` measures A in each bin, and
    inverse-variance weights combine the bins.

    Parameters
    ----------
    noise_psd_ukcmb2, signal_psd, n_modes : (n_bin,)
        `N` [uK_CMB^2 sr], `M` [sr] and `n`.
    mask : (n_bin,)
        Selected bins.

    Returns
    -------
    float
        [uK_CMB^2].

    Raises
    ------
    ValueError
        For shapes that differ, no selected bin, or selected noise or mode counts that are not positive.
    """
    return float(_information(noise_psd_ukcmb2, signal_psd, n_modes, mask).sum() ** -0.5)


def bin_weights(
    noise_psd_ukcmb2: np.ndarray, signal_psd: np.ndarray, n_modes: np.ndarray, mask: np.ndarray
) -> np.ndarray:
    """Contribution (n_bin,) of each bin to sigma^-2: 0 for bins that are not selected; sums to 1.

    Parameters and errors are those of `flat_band_power`.
    """
    information = _information(noise_psd_ukcmb2, signal_psd, n_modes, mask)
    return information / information.sum()


def flat_band_power_fixed_weights(
    noise_psd_ukcmb2: np.ndarray,
    signal_psd: np.ndarray,
    n_modes: np.ndarray,
    mask: np.ndarray,
    *,
    weighting_noise_psd_ukcmb2: np.ndarray,
) -> float:
    """Uncertainty of A when the bins are weighted for the noise `R` of another data set.

    `A = sum w (P - N) / sum w M` with `w = n M / R^2` has `sigma^2 = sum w^2 N^2 2/n / (sum w M)^2`. It equals
    `flat_band_power` for R = N, and is never smaller.

    Parameters
    ----------
    noise_psd_ukcmb2, signal_psd, n_modes, mask : (n_bin,)
        As for `flat_band_power`.
    weighting_noise_psd_ukcmb2 : (n_bin,)
        `R`.

    Returns
    -------
    float
        [uK_CMB^2].

    Raises
    ------
    ValueError
        As `flat_band_power`, for both noise PSDs.
    """
    noise, signal, modes = _selected(noise_psd_ukcmb2, signal_psd, n_modes, mask)
    weighting = _selected(weighting_noise_psd_ukcmb2, signal_psd, n_modes, mask)[0]
    weight = modes * signal / weighting**2
    return float(np.sqrt(np.sum((weight * noise) ** 2 * 2 / modes)) / np.sum(weight * signal))


def estimate_amplitude(
    psd_ukcmb2: np.ndarray,
    *,
    noise_psd_ukcmb2: np.ndarray,
    signal_psd: np.ndarray,
    n_modes: np.ndarray,
    mask: np.ndarray,
) -> np.ndarray:
    """Estimate the band power of maps: `A = sum w (P - N) / sum w M` with `w = n M / N^2`.

    While noise dominates, its standard deviation is `flat_band_power`.

    Parameters
    ----------
    psd_ukcmb2 : (..., n_bin)
        PSDs `P` of the maps.
    noise_psd_ukcmb2, signal_psd, n_modes, mask : (n_bin,)
        As for `flat_band_power`.

    Returns
    -------
    (...) array
        [uK_CMB^2].

    Raises
    ------
    ValueError
        As `flat_band_power`.
    """
    noise, signal, modes = _selected(noise_psd_ukcmb2, signal_psd, n_modes, mask)
    psd_ukcmb2, mask = reals("psd_ukcmb2", psd_ukcmb2, (..., "n_bin"), finite=False), np.asarray(mask)
    if psd_ukcmb2.shape[-1:] != mask.shape:
        raise ValueError(f"expected psd_ukcmb2 (..., {mask.size}), got {psd_ukcmb2.shape}")
    psd = reals("psd_ukcmb2[mask]", psd_ukcmb2[..., mask], (..., len(noise)))
    weight = modes * signal / noise**2
    return (psd - noise) @ weight / (signal @ weight)


def band_power(
    noise_psd_ukcmb2: np.ndarray,
    signal_psd: np.ndarray,
    n_modes: np.ndarray,
    mask: np.ndarray,
    *,
    ell: np.ndarray,
    edges_ell: np.ndarray,
    relative_error: float,
) -> BandPower:
    """Uncertainty of A, its own error, and the multipoles that it comes from.

    `cumulative` is the paper's cumulative sensitivity to a flat band power from all data above ell (figure
    `map_psd_ave_plane`, bottom).

    Parameters
    ----------
    noise_psd_ukcmb2, signal_psd, n_modes, mask : (n_bin,)
        As for `flat_band_power`.
    ell : (n_bin,)
    edges_ell : (n_bin + 1,)
    relative_error
        Relative error of sigma; 0 for a closed form.

    Raises
    ------
    ValueError
        As `flat_band_power`.
    """
    information = _information(noise_psd_ukcmb2, signal_psd, n_modes, mask)
    if ell.shape != mask.shape or edges_ell.shape != (mask.size + 1,):
        raise ValueError(f"expected {mask.size} ell and one edge more, got {ell.shape} and {edges_ell.shape}")
    above = np.cumsum(information[::-1])[::-1]
    cumulative = np.full(mask.size, np.inf)
    np.power(above, -0.5, out=cumulative, where=above > 0)
    sigma = float(above[0] ** -0.5)
    weight = information / above[0]
    return BandPower(
        sigma_ukcmb2=sigma,
        error_ukcmb2=sigma * relative_error,
        ell_eff=float(weight @ ell),
        fwhm_ell=weight_fwhm(weight, edges_ell, mask),
        weight=weight,
        ell=ell,
        cumulative=cumulative,
    )


def weight_fwhm(weight: np.ndarray, edges_ell: np.ndarray, mask: np.ndarray) -> float:
    """Full width at half maximum, in ell, of a weight known in bins.

    The weight per unit ell is interpolated linearly between bin centres, and is constant from the outermost centres to
    the edges of the selected range. The width extends from the first to the last multipole above half of the maximum;
    an edge of the range counts as a crossing.

    Parameters
    ----------
    weight : (n_bin,)
    edges_ell : (n_bin + 1,)
    mask : (n_bin,)
    """
    selected = np.flatnonzero(mask)
    bins = slice(selected[0], selected[-1] + 1)
    low, high = edges_ell[:-1][bins], edges_ell[1:][bins]
    density = weight[bins] / (high - low)
    ell = np.concatenate((low[:1], (low + high) / 2, high[-1:]))
    above = np.concatenate((density[:1], density, density[-1:])) - density.max() / 2
    over = np.flatnonzero(above >= 0)
    return float(_crossing(ell, above, over[-1], 1) - _crossing(ell, above, over[0], -1))


def _crossing(ell: np.ndarray, above: np.ndarray, inside: int, step: int) -> float:
    """Multipole at which `above` crosses zero between point `inside` and its neighbour, or the end of the range."""
    outside = inside + step
    if not 0 <= outside < ell.size:
        return ell[inside]
    return ell[inside] + (ell[outside] - ell[inside]) * above[inside] / (above[inside] - above[outside])


def score(
    noise_psds_ukcmb2: np.ndarray,
    signal_psd: np.ndarray,
    *,
    signal_psd_relative_error: np.ndarray,
    n_modes: np.ndarray,
    mask: np.ndarray,
    observation_weights: np.ndarray,
    ell: np.ndarray,
    edges_ell: np.ndarray,
    information: np.ndarray | None = None,
    correlation: np.ndarray | None = None,
    block: np.ndarray | None = None,
) -> tuple[BandPower, ErrorBudget]:
    """Band power of a survey and its error from sign-flip realizations of the noise.

    sigma follows from the mean PSD of the realizations. The division by a noisy N biases sigma low by a relative `sum_b
    (3/2 g_b - g_b^2) e_b^2`, where e_b is the relative error of N_b and g the normalised weight; this is less than the
    error of sigma.

    Parameters
    ----------
    noise_psds_ukcmb2 : (K, n_bin)
        PSDs of `sum_i s_ki w_i m_i / sum_i w_i`: the same observations m_i with random signs s_ki.
    signal_psd, signal_psd_relative_error : (n_bin,)
    n_modes, mask : (n_bin,)
    observation_weights : (n_obs,)
        Weights w_i: inverse variances up to a factor.
    ell : (n_bin,)
    edges_ell : (n_bin + 1,)
    information : optional
        `information_shares` of all observations made, 0 for those rejected; by default the weights, for equal data.
    correlation : (n_bin - 1,), optional
        Correlation between the noise of neighbouring bins (`mapmaker.spectrum.neighbour_correlation`).
    block : optional
        Block of each value of `information`, numbered from 0, where only blocks of observations have independent
        weather.

    Returns
    -------
    BandPower
    ErrorBudget
        Parts of the error: `noise_error_parts`, `weather_error` and `transfer_function_error`.

    Raises
    ------
    ValueError
        As `flat_band_power`, for fewer than 2 realizations or observations, and for weights that are not positive.
    """
    if noise_psds_ukcmb2.ndim != 2 or len(noise_psds_ukcmb2) < 2:
        raise InsufficientDataError(f"expected at least 2 noise realizations (K, n_bin), got {noise_psds_ukcmb2.shape}")
    if signal_psd_relative_error.shape != mask.shape:
        raise ValueError(f"expected {mask.size} signal PSD errors, got {signal_psd_relative_error.shape}")
    noise_psd = noise_psds_ukcmb2.mean(axis=0)
    weight = bin_weights(noise_psd, signal_psd, n_modes, mask)
    signs, common = noise_error_parts(
        noise_psds_ukcmb2, weight, observation_weights, n_modes=n_modes, correlation=correlation
    )
    budget = ErrorBudget(
        noise=float(np.hypot(signs, common)),
        weather=weather_error(observation_weights if information is None else information, common, block=block),
        transfer_function=transfer_function_error(signal_psd_relative_error, weight, correlation),
    )
    return band_power(
        noise_psd, signal_psd, n_modes, mask, ell=ell, edges_ell=edges_ell, relative_error=budget.total
    ), budget


def _information(noise_psd: np.ndarray, signal_psd: np.ndarray, n_modes: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Contribution `n/2 (M/N)^2` of the selected bins, zero in the others, (n_bin,)."""
    noise, signal, modes = _selected(noise_psd, signal_psd, n_modes, mask)
    information = np.zeros(np.shape(mask))
    information[np.asarray(mask)] = modes / 2 * (signal / noise) ** 2
    return information


def _selected(
    noise_psd: np.ndarray, signal_psd: np.ndarray, n_modes: np.ndarray, mask: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Noise, signal and modes of the selected bins; raises as `flat_band_power`."""
    noise_psd = reals("noise_psd_ukcmb2", noise_psd, (...,), finite=False)
    signal_psd = reals("signal_psd", signal_psd, (...,), finite=False)
    n_modes = reals("n_modes", n_modes, (...,), finite=False)
    mask = np.asarray(mask)
    shapes = [array.shape for array in (noise_psd, signal_psd, n_modes, mask)]
    if mask.ndim != 1 or len(set(shapes)) != 1:
        raise ValueError(f"noise PSD, signal PSD, n_modes and mask must all be (n_bin,), got {shapes}")
    if mask.dtype != np.bool_ or not mask.any():
        raise ValueError("mask must be boolean and select at least one bin")
    if not (noise_psd[mask] > 0).all():
        raise InsufficientDataError("the noise PSD must be positive in all selected bins")
    if not ((n_modes[mask] > 0).all() and np.isfinite(n_modes[mask]).all()):
        raise ValueError("the number of modes must be positive and finite in all selected bins")
    if not (np.isfinite(signal_psd[mask]).all() and signal_psd[mask].any()):
        raise InsufficientDataError("the signal PSD must be finite and not zero in all selected bins")
    return noise_psd[mask], signal_psd[mask], n_modes[mask]
