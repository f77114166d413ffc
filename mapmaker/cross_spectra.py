"""Band powers from cross-spectra of splits, which have no noise bias, and their covariance."""

from dataclasses import dataclass

import numpy as np

from mapmaker.errors import InsufficientDataError
from mapmaker.mode_coupling import Field, ModeCoupling
from mapmaker.validation import reals

WORST_ERROR = 0.1  # relative error of error bars that few realizations measure, from which they are flagged
MOST_DISTANT = 0.05  # of a bin's power from multipoles that its modes do not resolve: analytic errors lack it


@dataclass(frozen=True)
class Covariance:
    """Covariance of band powers.

    Attributes
    ----------
    matrix_uk4 : (n_bin, n_bin)
        [uK^4]; NaN in bins that are not usable.
    n_realizations
        Realizations that measured it; 0 for an analytic covariance.
    flags
        Reasons to distrust it, a sentence each.
    """

    matrix_uk4: np.ndarray
    n_realizations: int
    flags: tuple[str, ...] = ()

    @property
    def error_uk2(self) -> np.ndarray:
        """Standard deviations of the band powers, (n_bin,) [uK^2]."""
        return np.sqrt(np.diag(self.matrix_uk4))


@dataclass(frozen=True)
class BandPowers:
    """Band powers l(l+1) C_l / 2 pi of the sky.

    Attributes
    ----------
    ell, ell_low, ell_high : (n_bin,)
    power_uk2 : (n_bin,)
        Mean cross-power of the pairs of maps; NaN in bins that are not usable.
    noise_uk2 : (n_map, n_bin)
        Noise of each map in the same unit: its own power less the cross-power.
    n_modes : (n_bin,)
        Independent real degrees of freedom.
    covariance
        Analytic covariance.
    window_ell : (n_ell,)
    windows : (n_bin, n_ell)
        Expected band powers of a spectrum are ``windows @ spectrum(window_ell)``.
    flags
        Reasons to distrust the band powers, a sentence each.
    """

    ell: np.ndarray
    ell_low: np.ndarray
    ell_high: np.ndarray
    power_uk2: np.ndarray
    noise_uk2: np.ndarray
    n_modes: np.ndarray
    covariance: Covariance
    window_ell: np.ndarray
    windows: np.ndarray
    flags: tuple[str, ...]


def cross_band_powers(
    maps_uk: np.ndarray, coupling: ModeCoupling, *, signal_uk2: np.ndarray | None = None
) -> BandPowers:
    """Band powers of the sky in several maps of independent noise.

    The mean over all pairs of maps has no noise bias. The analytic covariance is that of Gaussian signal and noise
    (Knox 1995, PRD 52, 4307, for cross-spectra): the pseudo-powers of the bins b and b' have the covariance ``2 K_bb'
    tr(X_b X_b')``, ``X_b = C_b^(1/2) Q C_b^(1/2)``, with the covariance C of a mode between maps, measured noise
    included, the weights Q of their products and the scatter K of the coupling. It holds where signal and noise change
    little over the taper's resolution, for noise that is uniform under the taper and in all directions of modes.

    Parameters
    ----------
    maps_uk : (n_map, *shape of the coupling's field)
        Maps of the same sky [uK_CMB], 0 where unobserved.
    coupling
    signal_uk2 : (n_bin,), optional
        Band powers of the sky for the covariance; by default the measured ones, where positive.

    Raises
    ------
    ValueError
        For fewer than 2 maps, maps of another shape, and values that are not finite.
    """
    maps_uk = reals("maps_uk", maps_uk, ("n_map", *coupling.field.shape))
    cross, own = _pseudo_powers(maps_uk, coupling.field)
    power = coupling.decouple(cross)
    signal = np.maximum(power if signal_uk2 is None else reals("signal_uk2", signal_uk2, power.shape, finite=False), 0)
    noise = np.maximum(own - cross, 0)
    return BandPowers(
        ell=coupling.ell,
        ell_low=coupling.edges_ell[:-1],
        ell_high=coupling.edges_ell[1:],
        power_uk2=power,
        noise_uk2=coupling.decouple(own - cross),
        n_modes=coupling.n_modes,
        covariance=_analytic_covariance(coupling, signal, noise, maps_uk[0] - maps_uk[1]),
        window_ell=coupling.window_ell,
        windows=coupling.windows,
        flags=coupling.flags,
    )


def realized_band_powers(maps_uk: np.ndarray, coupling: ModeCoupling) -> np.ndarray:
    """Band powers (..., n_bin) [uK^2] of realizations (..., n_map, *shape), as `cross_band_powers` measures them.

    Raises
    ------
    ValueError
        As `cross_band_powers`.
    """
    maps_uk = reals("maps_uk", maps_uk, (..., "n_map", *coupling.field.shape))
    return coupling.decouple(_pseudo_powers(maps_uk, coupling.field)[0])


def monte_carlo_covariance(realized_uk2: np.ndarray) -> Covariance:
    """Covariance of band powers from independent realizations of signal and noise.

    Parameters
    ----------
    realized_uk2 : (n_realization, n_bin)
        Band powers of each realization; NaN in bins that are not usable.

    Raises
    ------
    ValueError
        For fewer than 2 realizations.
    """
    realized = reals("realized_uk2", realized_uk2, ("n_realization", "n_bin"), finite=False)
    n_realization, n_bin = len(realized), np.isfinite(realized).all(axis=0).sum()
    if n_realization < 2:
        raise InsufficientDataError(f"a covariance needs at least 2 realizations, got {n_realization}")
    flags = []
    if n_realization <= n_bin + 2:
        flags.append(f"{n_realization} realizations of {n_bin} bins: too few for a chi-squared")
    error = 1 / np.sqrt(2 * (n_realization - 1))
    if error > WORST_ERROR:
        flags.append(f"{n_realization} realizations determine errors of band powers to {100 * error:.0f} %")
    return Covariance(np.atleast_2d(np.cov(realized.T)), n_realization, tuple(flags))


def _pseudo_powers(maps_uk: np.ndarray, field: Field) -> tuple[np.ndarray, np.ndarray]:
    """Mean cross-power (..., n_bin) of the pairs of maps (..., n_map, *shape), and the power (..., n_map, n_bin) of
    each.
    """
    axis = -1 - len(field.shape)
    n_map = maps_uk.shape[axis]
    if n_map < 2:
        raise InsufficientDataError(f"cross-spectra need at least 2 maps, got {n_map}")
    own = field.pseudo_power(maps_uk)
    together = field.pseudo_power(maps_uk.sum(axis=axis))
    return (together - own.sum(axis=-2)) / (n_map * (n_map - 1)), own


def _analytic_covariance(
    coupling: ModeCoupling, signal_uk2: np.ndarray, noise: np.ndarray, difference_uk: np.ndarray
) -> Covariance:
    """Covariance from the signal's band powers (n_bin,) and the pseudo-power of each map's noise (n_map, n_bin).

    The difference of two maps tells whether all modes of a bin have one noise.
    """
    signal = coupling.expected_pseudo_power(signal_uk2)
    covariance = 2 * coupling.scatter * _mode_covariance(signal, noise)
    both = coupling.usable & coupling.usable[:, None]
    distant = coupling.distant_pseudo_power(signal_uk2) > MOST_DISTANT * (signal + noise.mean(axis=0) / len(noise))
    flags = _distant_flags(distant) + _noise_flags(coupling, coupling.field.unevenness(difference_uk), signal, noise)
    return Covariance(np.where(both, coupling.inverse @ covariance @ coupling.inverse.T, np.nan), 0, flags)


def _mode_covariance(signal: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Half the covariance (n_bin, n_bin) of the mean cross-power of modes that are alike but for their power.

    With the covariance C_b of a mode between the maps, and the weights Q of their products, it is ``tr(X_b X_b')`` with
    ``X_b = C_b^(1/2) Q C_b^(1/2)``.
    """
    n_map = len(noise)
    pairs = (np.ones((n_map, n_map)) - np.eye(n_map)) / (n_map * (n_map - 1))
    values, vectors = np.linalg.eigh(signal[:, None, None] + noise.T[:, :, None] * np.eye(n_map))
    root = np.einsum("bij,bj,bkj->bik", vectors, np.sqrt(np.maximum(values, 0)), vectors)
    products = root @ pairs @ root
    return np.einsum("aij,bij->ab", products, products)


def _noise_flags(coupling: ModeCoupling, uneven: np.ndarray, signal: np.ndarray, noise: np.ndarray) -> tuple[str, ...]:
    """Flag noise that depends on the direction of modes, which has fewer degrees of freedom than the scatter counts.

    Parameters
    ----------
    coupling
    uneven : (n_bin,)
        Variance of the noise's power over that of even modes.
    signal, noise : (n_bin,), (n_map, n_bin)
        Pseudo-power of the sky and of the noise of each map.
    """
    modes = np.where(coupling.usable, coupling.n_modes, 0)
    excess = np.average(uneven, weights=modes) - 1
    # The squared power of a complex mode has a relative scatter of sqrt(5).
    if excess < 3 * np.sqrt(5 / (modes.sum() / 2)):
        return ()
    of_noise, whole = (np.diag(_mode_covariance(of_sky, noise)) for of_sky in (0 * signal, signal))
    share = np.divide(of_noise, whole, out=np.zeros(whole.size), where=whole > 0)
    error = np.sqrt(1 + excess * share[coupling.usable].max()) - 1
    if error < WORST_ERROR:
        return ()
    return (f"noise depends on the direction of modes: true errors are larger, by some {100 * error:.0f} %",)


def _distant_flags(distant: np.ndarray) -> tuple[str, ...]:
    if not distant.any():
        return ()
    return (
        f"{distant.sum()} of {distant.size} bins: more than {100 * MOST_DISTANT:.0f} % of the power comes from distant "
        "multipoles, and analytic errors are too small",
    )
