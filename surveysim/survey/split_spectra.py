"""Band powers of the simulated sky from cross-spectra of split maps, and null tests of the splits."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.binning import weighted_mean
from mapmaker.cross_spectra import (
    BandPowers,
    Covariance,
    cross_band_powers,
    monte_carlo_covariance,
    realized_band_powers,
)
from mapmaker.flat_spectra import flat_coupling
from mapmaker.mode_coupling import ModeCoupling
from mapmaker.null_tests import ChiSquared, NullTest, chi_squared, null_power, null_test
from mapmaker.spectrum import annuli, map_psd, mode_ell
from mapmaker.transfer_function import TransferFunction, measure_transfer_function, mode_pixel_window
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.input_map import input_map
from surveysim.reduction.setup import Setup
from surveysim.reduction.splits import Split
from surveysim.runtime.errors import InsufficientDataError
from surveysim.runtime.rng import generator
from surveysim.scene.spectra import NIGHT
from surveysim.survey.coadds import CoAdds
from surveysim.survey.part_maps import PartMaps, part_maps

Spectrum = Callable[[np.ndarray], np.ndarray]  # l(l+1) C_l / 2 pi [uK_CMB^2] of multipoles


@dataclass(frozen=True)
class SplitSpectrum:
    """Band powers from the cross-spectra of the parts of a split, and its null test.

    Attributes
    ----------
    split
    powers
        Band powers, with their analytic covariance; without the noise bias for parts that share weather.
    monte_carlo
        Covariance over realizations of noise, with random signs, and Gaussian signal.
    bias_uk2, bias_error_uk2 : (n_bin,)
        Cross-power of the noise of the parts, as the realizations have it, and its error as an estimate of the mean of
        other surveys.
    fit
        Chi-squared of the band powers about those of the simulated sky; None where the sky is no spectrum.
    null
        Power of the difference of the parts with even and with odd numbers.
    independent
        Observations of equal weight that have as many independent signs as the noise of the difference.
    unseen
        Largest share of the tapered patch that a part does not see.
    """

    split: Split
    powers: BandPowers
    monte_carlo: Covariance
    bias_uk2: np.ndarray
    bias_error_uk2: np.ndarray
    fit: ChiSquared | None
    null: NullTest
    independent: float
    unseen: float

    @property
    def shares_weather(self) -> bool:
        """Return whether the parts have the weather of the same observations, so that their noise may correlate."""
        return self.split.name != NIGHT


@dataclass(frozen=True)
class SurveySpectra:
    """Spectra of all splits of a survey, the first of them reported.

    Attributes
    ----------
    splits
        By name, in the order of the scene.
    transfer : (n_bin,)
        Power transfer function of scans and cleaning.
    transfer_error : (n_bin,)
    input_uk2 : (n_bin,), optional
        Expected band powers of the simulated sky; None where it is no spectrum.
    sky_uk2 : (n_bin,), optional
        Band powers of the simulated sky itself, with its sample variance; None without a sky.
    own_transfer
        Whether the skies that measure the transfer function have the spectrum of the sky.
    """

    splits: dict[str, SplitSpectrum]
    transfer: np.ndarray
    transfer_error: np.ndarray
    input_uk2: np.ndarray | None
    sky_uk2: np.ndarray | None
    own_transfer: bool

    @property
    def reported(self) -> SplitSpectrum:
        """The first split."""
        return next(iter(self.splits.values()))


@dataclass(frozen=True)
class _Measure:
    """Scene, mode coupling, transfer function and spectrum that the measurements of all splits have in common."""

    setup: Setup
    coupling: ModeCoupling
    transfer: TransferFunction
    spectrum: Spectrum | None


def survey_spectra(setup: Setup, coadds: CoAdds) -> SurveySpectra:
    """Measure the spectra of all splits of a survey.

    Raises
    ------
    InsufficientDataError
        For too few observations or realizations.
    """
    measure = _measure(setup, coadds)
    splits = {split.name: _split_spectrum(measure, coadds, split) for split in setup.analysis.splits.splits}
    transfer = measure.transfer
    expected = _expected(measure)
    own = setup.scene.score.signal_sims.spectrum == "sky"
    return SurveySpectra(splits, transfer.transmission, transfer.error, expected, _sky(measure), own)


def bin_edges(setup: Setup) -> np.ndarray:
    """Edges (n_bin + 1,) of the multipole bins, all within the scored range."""
    score = setup.scene.score
    return np.arange(score.ell_min, score.ell_max + 1, setup.scene.spectra.ell_bin).astype(float)


def _measure(setup: Setup, coadds: CoAdds) -> _Measure:
    analysis, edges = setup.analysis, bin_edges(setup)
    taper, pixel = analysis.region.padded_taper, analysis.geometry.pixel_rad
    rings = annuli(len(taper), len(taper), pixel, edges_ell=edges, taper=taper)
    place = analysis.transfer_function_index(ACTUAL)
    skies = setup.scene.score.signal_sims.skies
    if not coadds.signal_weight[place].any():
        raise InsufficientDataError("no observation with signal simulations is done; one or more is expected")
    maps = analysis.region.pad(weighted_mean(coadds.signal_maps[:skies, place], coadds.signal_weight[place]))
    psd = map_psd(maps, taper, pixel, rings)
    transfer = measure_transfer_function(psd[:, 1], psd[:, 0], rings.ell)
    sky = setup.sky.geometry
    coupling = flat_coupling(
        taper,
        pixel,
        edges_ell=edges,
        beam=analysis.beams.window,
        transfer=transfer.transmission,
        sky_shape=(sky.n_y, sky.n_x),
        cells_per_pixel=round(pixel / sky.pixel_rad),
    )
    return _Measure(setup, coupling, transfer, _input_spectrum(setup))


def _input_spectrum(setup: Setup) -> Spectrum | None:
    """Spectrum of the simulated sky; None where it has more than a spectrum."""
    sky = setup.scene.sky
    if sky is None:
        return np.zeros_like
    return sky.band_power_ukcmb2 if sky.is_spectrum else None


def _expected(measure: _Measure) -> np.ndarray | None:
    if measure.spectrum is None:
        return None
    return measure.coupling.windows @ measure.spectrum(measure.coupling.window_ell)


def _sky(measure: _Measure) -> np.ndarray | None:
    """Band powers (n_bin,) of the simulated sky, from its map without noise, scans and cleaning."""
    analysis = measure.setup.analysis
    if analysis.own_sky is None:
        return None
    to_ukcmb = 1e3 * analysis.scene.instrument.cmb_per_rj
    sky = analysis.region.pad(input_map(analysis, analysis.signal_skies_mk[analysis.own_sky])) * to_ukcmb
    return measure.coupling.decouple(measure.coupling.field.pseudo_power(sky) * measure.transfer.transmission)


def _split_spectrum(measure: _Measure, coadds: CoAdds, split: Split) -> SplitSpectrum:
    analysis, coupling = measure.setup.analysis, measure.coupling
    expected = _expected(measure)
    each = part_maps(analysis, coadds, split, [slice(place, place + 1) for place in range(len(split.parts))])
    maps, noise = analysis.region.pad(each.maps_uk), analysis.region.pad(each.noise_uk)
    powers, of_noise = cross_band_powers(maps, coupling, signal_uk2=expected), realized_band_powers(noise, coupling)
    bias, bias_error = _mean(of_noise, each)
    if split.name != NIGHT:
        powers = replace(powers, power_uk2=powers.power_uk2 - bias, noise_uk2=powers.noise_uk2 + bias)
    spectrum = measure.spectrum or _measured_spectrum(powers)
    signal = analysis.region.pad(_signal_maps(measure, spectrum, len(noise)))
    monte_carlo = monte_carlo_covariance(realized_band_powers(noise + signal[:, None], coupling))
    if split.name != NIGHT:
        monte_carlo = _with_bias(monte_carlo, of_noise)
    fit = None
    if expected is not None:
        fit = chi_squared(powers.power_uk2 - expected, _with_transfer(measure, monte_carlo, expected))
    null, independent = _null(measure, coadds, split)
    return SplitSpectrum(split, powers, monte_carlo, bias, bias_error, fit, null, independent, float(each.unseen.max()))


def _with_bias(covariance: Covariance, of_noise: np.ndarray) -> Covariance:
    """Add the error of the mean of the noise powers of realizations (K, n_bin), which is subtracted from band powers.

    The products of each observation's noise with itself are the same in all realizations and in the band powers. The
    subtraction removes them, bias and scatter. Products of different observations are left, as the realizations have
    them.
    """
    own = monte_carlo_covariance(of_noise).matrix_uk4 / len(of_noise)
    return replace(covariance, matrix_uk4=covariance.matrix_uk4 + own)


def _mean(realized: np.ndarray, of: PartMaps) -> tuple[np.ndarray, np.ndarray]:
    """Mean of realizations (K, n_bin) and its standard error, with what all realizations have in common."""
    common = of.common
    variance = realized.var(axis=0, ddof=1) / (1 - common)
    return realized.mean(axis=0), np.sqrt(variance * (common + (1 - common) / len(realized)))


def _with_transfer(measure: _Measure, covariance: Covariance, power_uk2: np.ndarray) -> Covariance:
    """Add the error of the transfer function to a covariance of band powers."""
    transfer = measure.transfer
    relative = np.divide(
        transfer.deviations,
        transfer.transmission,
        out=np.zeros_like(transfer.deviations),
        where=measure.coupling.usable,
    )
    return replace(covariance, matrix_uk4=covariance.matrix_uk4 + (relative * power_uk2).T @ (relative * power_uk2))


def _null(measure: _Measure, coadds: CoAdds, split: Split) -> tuple[NullTest, float]:
    """Compare the power of the difference of parts with that of its noise.

    The sky is removed from the realizations, so they are not correlated with the difference itself.
    """
    both = part_maps(measure.setup.analysis, coadds, split, [slice(0, None, 2), slice(1, None, 2)])
    pad = measure.setup.analysis.region.pad
    power, realized = (null_power(pad(maps), measure.coupling) for maps in (both.maps_uk, both.noise_uk))
    return null_test(power, realized, measure.coupling, common=both.common), both.independent


def _measured_spectrum(powers: BandPowers) -> Spectrum:
    """Band powers, where positive, linear between bins."""
    known = np.isfinite(powers.power_uk2)
    ell, power = powers.ell[known], np.maximum(powers.power_uk2[known], 0)
    return lambda at: np.interp(at, ell, power)


def _signal_maps(measure: _Measure, spectrum: Spectrum, number: int) -> np.ndarray:
    """Draw Gaussian skies through beam, pixels, scans and cleaning, (K, n, n) [uK_CMB].

    The transfer function is linear in multipole between the bins.
    """
    from scipy.fft import irfft2, rfft2

    setup, coupling = measure.setup, measure.coupling
    sky, step = setup.sky.geometry, round(setup.analysis.geometry.pixel_rad / setup.sky.geometry.pixel_rad)
    shape, n = (sky.n_y, sky.n_x), len(setup.analysis.region.taper)
    ell = mode_ell(*shape, sky.pixel_rad)
    passed = np.interp(ell, coupling.ell[coupling.usable], measure.transfer.transmission[coupling.usable])
    psd = flat_spectrum_psd(ell) * spectrum(ell) * setup.analysis.beams.window(ell) * passed
    amplitude = np.sqrt(psd * mode_pixel_window(*shape, sky.pixel_rad, setup.analysis.geometry.pixel_rad))
    maps = np.empty((number, n, n))
    for place, drawn in enumerate(maps):
        white = generator(setup.scene.seed, "signal of split maps", realization=place).standard_normal(shape)
        whole = irfft2(rfft2(white) * (amplitude / sky.pixel_rad), shape)
        drawn[:] = whole[: n * step : step, : n * step : step]
    return maps
