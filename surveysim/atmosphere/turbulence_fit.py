"""Fit of amplitude, spectral index and height of the turbulent layer to detector correlations (paper, section 3.2)."""

from dataclasses import dataclass

import numpy as np

from mapmaker.correlations import PairBins, Profile
from surveysim.atmosphere.detector_correlation import CorrelationGrid

# The paper's grid.
INDEX_GRID = tuple(2 / 3 + 0.5 * k for k in range(13))
HEIGHT_GRID_M = (375.0, 500.0, 750.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0, 6000.0)
KOLMOGOROV = 6  # 11/3 in INDEX_GRID
# From layers that move by an arcminute to those that move by 1.5 rad during a scan.
TRACKS_RAD = np.geomspace(3e-4, 1.5, 24)


@dataclass(frozen=True)
class TurbulenceFit:
    """Fits of one observation at every grid point of spectral index and height.

    Attributes
    ----------
    b2 : (n_b, n_h)
        Amplitude at the zenith [mK^2 rad^(2-b)].
    chi2 : (n_b, n_h)
    best : (int, int)
        Grid point of the smallest chi^2.
    """

    b2: np.ndarray
    chi2: np.ndarray
    best: tuple[int, int]


def fit_turbulence(
    profile: Profile,
    bins: PairBins,
    grid: CorrelationGrid,
    *,
    track_rad: np.ndarray,
    elevation_rad: np.ndarray,
    overlap: np.ndarray | None,
) -> TurbulenceFit | None:
    """Fit every grid point to the correlation profile of one observation.

    Adjacent pairs are excluded. The level of C gives B2. Its shape, which does not depend on gains, gives chi^2, with
    jackknife errors over scans.

    Parameters
    ----------
    profile, bins
        Measured profile and its pair bins.
    grid
    track_rad, elevation_rad : (n_scan,)
        Track of the layer during each scan, and elevation.
    overlap : (n_bin,), optional
        Coherence of pixels at each separation. Low-frequency noise that pixels share through it has a free amplitude in
        the fit, because it extends beyond adjacent pairs.

    Returns
    -------
    TurbulenceFit or None
        None where the profile, or the track of a scan, can't be used.
    """
    theory = grid.correlation(track_rad, elevation_rad)
    if not (np.isfinite(profile.log_level) and (theory > 0.0).all()):
        return None
    shape = np.log(theory)
    level = shape @ (bins.count / bins.count.sum())
    fitted, error = fitted_profile(profile, shape, overlap)
    chi2 = (((profile.log_profile - fitted) / error) ** 2).sum(axis=-1)
    best = np.unravel_index(int(chi2.argmin()), chi2.shape)
    return TurbulenceFit(np.exp(profile.log_level - level), chi2, (int(best[0]), int(best[1])))


def fitted_profile(
    profile: Profile, log_theory: np.ndarray, overlap: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Fit predictions of ln C to a profile with a free offset and a free amplitude of `overlap`.

    Parameters
    ----------
    profile
    log_theory : (..., n_bin)
        Predicted ln C.
    overlap : (n_bin,), optional

    Returns
    -------
    fit : (..., n_bin)
    error : (n_bin,)
        Errors of the profile, from a jackknife over scans.
    """
    n_scan = len(profile.scan_profiles)
    weight = 1.0 / np.maximum((n_scan - 1) * profile.scan_profiles.var(axis=0), 1e-30)
    ignored = np.ones((1, len(weight))) if overlap is None else np.stack([np.ones(len(weight)), overlap])
    left = _fit_residuals(profile.log_profile - log_theory, ignored, weight)
    return profile.log_profile - left, weight**-0.5


def _fit_residuals(residual: np.ndarray, ignored: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Subtract the weighted fit of the shapes `ignored` (n_shape, n_bin) from residuals (..., n_bin)."""
    scaled = np.sqrt(weight)
    basis = np.linalg.qr((ignored * scaled).T)[0]
    whitened = residual * scaled
    return (whitened - (whitened @ basis) @ basis.T) / scaled
