"""Band powers from cross-spectra of splits, which have no noise bias, and their analytic covariance."""

from dataclasses import dataclass

import numpy as np

from mapmaker.mode_coupling import ModeCoupling


@dataclass(frozen=True)
class Covariance:
    """Covariance of band powers, (n_bin, n_bin) [uK^4]; `n_realizations` is 0 for an analytic one."""

    matrix_uk4: np.ndarray
    n_realizations: int
    flags: tuple[str, ...]

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
        As of the coupling: the expected band powers are ``windows @ spectrum(window_ell)``.
    flags
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

    Parameters
    ----------
    maps_uk : (n_map, *shape of the coupling's taper)
        Maps of the same sky [uK_CMB], 0 where unobserved.
    coupling
    signal_uk2 : (n_bin,), optional
        Band powers of the sky for the covariance; by default the measured ones, where positive.
    """
    raise NotImplementedError


def realized_band_powers(maps_uk: np.ndarray, coupling: ModeCoupling) -> np.ndarray:
    """Band powers (..., n_bin) [uK^2] of realizations (..., n_map, *shape), as `cross_band_powers` measures them."""
    raise NotImplementedError


def monte_carlo_covariance(realized_uk2: np.ndarray) -> Covariance:
    """Covariance of band powers from realizations (n_realization, n_bin) of signal and noise."""
    raise NotImplementedError
