"""Metric `band_powers`: uncertainty of a fiducial spectrum's band powers in bins of multipole, and their covariance.

Symbols as in `mapmaker.bandpower`: a ring b of the score has n_b modes, noise N_b, and the fiducial spectrum adds M_b.
A bin of the user is a set of rings. Its amplitude ``A = sum_b w_b (P_b - N_b) / sum_b w_b M_b`` has the weights
``w_b = n_b M_b / V_b^2``, where V_b is the noise, or noise plus signal where the signal's own variance counts.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from mapmaker.bandpower import flat_band_power, flat_spectrum_psd
from surveysim.metrics.map_noise import MapNoise, Quantity, ScoredMap, Spectrum
from surveysim.runtime.table import Table, file_column
from surveysim.scene.metrics import PIVOT_ELL, BandPowers, spectrum_table
from surveysim.survey.scores import DataSetScore

_CLUSTERED = -1.25  # power of ell of C_ell: Addison et al. 2012 (ApJ 752, 120), abstract


def quantities(noise: MapNoise, options: BandPowers) -> tuple[Quantity, ...]:
    """Compute the uncertainty of each bin's band power, and of the amplitude of the spectrum in all bins.

    ``sigma_LOW_HIGH`` is of noise alone, ``total_LOW_HIGH`` adds the variance of the signal itself (Knox 1995, Phys.
    Rev. D 52, 4307). `amplitude` is the relative uncertainty of the spectrum's amplitude from all bins, with that
    variance.
    """
    power, found = fiducial_powers(noise.map, options), list[Quantity]()
    for name in ("sigma", "total"):
        deviation = np.sqrt(np.diag(covariance(noise, options, own_variance=name == "total"))) * power
        for (low, high), sigma in zip(options.bins, deviation.tolist(), strict=True):
            found.append(Quantity(f"{name}_{low}_{high}", sigma, "uK2"))
    return (*found, Quantity("amplitude", _amplitude(noise, options), ""))


def fiducial_powers(scored: ScoredMap, options: BandPowers) -> np.ndarray:
    """Compute the fiducial band power ``ell (ell + 1) C_ell / 2 pi`` of each bin [uK_CMB^2], its mean over modes."""
    ell = np.maximum(scored.ell, 1)  # the lowest ring of a small map may contain ell = 0 alone
    power = _spectrum(options)(ell) / flat_spectrum_psd(ell)
    member = bin_members(scored, options)
    return member @ (scored.n_modes * power) / (member @ scored.n_modes)


def covariance(noise: MapNoise, options: BandPowers, *, own_variance: bool) -> np.ndarray:
    """Compute the covariance (n, n) of the amplitudes of the bins, in units of the fiducial spectrum.

    Through the taper each ring's PSD correlates with the next, and scatters less than 2 / n by this share
    (`mapmaker.uncertainty.noise_error_parts`).
    """
    estimator, scatter = _estimator(noise, options, own_variance)
    shared = np.append(noise.map.correlation, 0.0) + np.append(0.0, noise.map.correlation)
    deviation = scatter * np.sqrt(2 / noise.map.n_modes / (1 + shared))
    correlation = np.eye(len(deviation)) + np.diag(noise.map.correlation, 1) + np.diag(noise.map.correlation, -1)
    return estimator @ (correlation * np.outer(deviation, deviation)) @ estimator.T


def measured_covariance(noise: MapNoise, options: BandPowers, noise_psds: np.ndarray, common: float) -> np.ndarray:
    """Measure the covariance (n, n) of the amplitudes from noise PSDs (K, n_bin) of sign-flipped co-adds.

    These share a part `common` of their variance, which does not show in their scatter. An element has the relative
    error ``sqrt(2 / (K - 1))`` on the diagonal.
    """
    estimator, _ = _estimator(noise, options, own_variance=False)
    return np.atleast_2d(np.cov(estimator @ noise_psds.T, ddof=1)) / (1 - common)


def bin_members(scored: ScoredMap, options: BandPowers) -> np.ndarray:
    """Rings of each bin, (n, n_bin): 1 or 0."""
    low, high = scored.edges_ell[:-1], scored.edges_ell[1:]
    return np.array([(low >= first) & (high <= last) for first, last in options.bins], float)


def _estimator(noise: MapNoise, options: BandPowers, own_variance: bool) -> tuple[np.ndarray, np.ndarray]:
    """Weights (n, n_bin) of the rings' PSDs in the amplitude of each bin, and the PSD (n_bin,) that scatters."""
    signal = _fiducial_psd(noise.map, options) * noise.transmission
    scatter = noise.noise_psd + signal * own_variance
    with np.errstate(divide="ignore", invalid="ignore"):  # rings without noise or signal weigh nothing
        weight = np.nan_to_num(bin_members(noise.map, options) * noise.map.n_modes * signal / scatter**2, posinf=0.0)
        return weight / (weight @ signal)[:, None], scatter


def _amplitude(noise: MapNoise, options: BandPowers) -> float:
    signal = _fiducial_psd(noise.map, options) * noise.transmission
    used = np.asarray(bin_members(noise.map, options).any(axis=0))
    return flat_band_power(noise.noise_psd + signal, signal, noise.map.n_modes, used)


@lru_cache(maxsize=8)
def _fiducial_psd(scored: ScoredMap, options: BandPowers) -> np.ndarray:
    """PSD (n_bin,) [uK_CMB^2 sr] of the fiducial spectrum in the tapered map, before scans and cleaning."""
    return scored.psd_of(_spectrum(options))


def _spectrum(options: BandPowers) -> Spectrum:
    """C_ell [uK_CMB^2 sr] of the fiducial spectrum as a function of ell; 0 at ell = 0."""
    if isinstance(options.spectrum, Path):
        ell, power = spectrum_table(options.spectrum)
        return lambda at: flat_spectrum_psd(at) * np.interp(at, ell, power)
    index = {"flat": None, "poisson": 0.0, "clustered": _CLUSTERED}[options.spectrum]
    pivot = options.band_power_ukcmb2 * flat_spectrum_psd(np.array(PIVOT_ELL))
    if index is None:
        return lambda at: options.band_power_ukcmb2 * flat_spectrum_psd(at)
    return lambda at: np.where(at > 0, pivot * (np.maximum(at, 1e-9) / PIVOT_ELL) ** index, 0.0)


def table(options: BandPowers, items: Mapping[str, tuple[MapNoise, DataSetScore]]) -> Table:
    """Return a row for each bin with the uncertainties of all data sets, and the covariance of the bins.

    Parameters
    ----------
    options
        Options of the metric.
    items
        By data set the noise as quoted and the score with its noise realizations.
    """
    scored = next(iter(items.values()))[0].map
    power = fiducial_powers(scored, options)
    columns = [
        file_column("ell_low", np.array([low for low, _ in options.bins])),
        file_column("ell_high", np.array([high for _, high in options.bins])),
        file_column("n_modes", bin_members(scored, options) @ scored.n_modes),
        file_column("band_power", power, "uK2"),
    ]
    for name, (noise, item) in items.items():
        for kind, matrix in covariances(noise, options, item).items():
            scaled = matrix * np.outer(power, power)
            columns.append(file_column(f"{kind}_{name}", np.sqrt(np.diag(scaled)), "uK2"))
            for (low, high), row in zip(options.bins, scaled, strict=True):
                columns.append(file_column(f"{kind}_covariance_{name}_{low}_{high}", row, "uK4"))
    return Table(options.kind, "Band powers and their covariance", tuple(columns), meta={"temperature": "CMB"})


def covariances(noise: MapNoise, options: BandPowers, item: DataSetScore) -> dict[str, np.ndarray]:
    """Compute the covariances (n, n) of the bins' amplitudes: of noise alone, with the signal's own, and as measured.

    The measured one is scaled from the simulated noise to the quoted one, in each bin.
    """
    used = item.weights[item.weights > 0]
    common = float(np.sum(used**2) / np.sum(used) ** 2)
    analytic = covariance(noise, options, own_variance=False)
    simulated = replace(noise, noise_psd=item.noise_psd)
    measured = measured_covariance(simulated, options, item.noise_psds, common)
    scale = np.sqrt(np.diag(analytic) / np.diag(covariance(simulated, options, own_variance=False)))
    return {
        "sigma": analytic,
        "total": covariance(noise, options, own_variance=True),
        "measured": measured * np.outer(scale, scale),
    }
