"""Noise of a data set's co-added map, as metrics take it: the same record for simulations and forecasts."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from mapmaker.matched_filter import profile_power
from mapmaker.spectrum import ring_mean
from mapmaker.transfer_function import pixel_window
from surveysim.forecasting.coverage import mean_hits
from surveysim.forecasting.forecast import DataSetForecast
from surveysim.reduction.scored_region import mapped_signal
from surveysim.reduction.setup import Setup
from surveysim.runtime.once import keep_last
from surveysim.scene.units import BOLTZMANN_J_K
from surveysim.survey.scores import DataSetScore
from surveysim.telescope.beams import Beams
from surveysim.telescope.diffraction import effective_area_m2
from surveysim.telescope.scans import duration_s
from surveysim.telescope.sensitivity import MJY

Spectrum = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class ScoredMap:
    """Properties of the scored map that all data sets of a scene share.

    Attributes
    ----------
    ell : (n_bin,)
        Mean multipole of the modes of each bin.
    edges_ell : (n_bin + 1,)
    n_modes : (n_bin,)
        Real degrees of freedom under the taper, about ``(2 ell + 1) d_ell f_sky``.
    selected : (n_bin,) bool
        Bins of the scored range.
    correlation : (n_bin - 1,)
        Correlation of the noise PSDs of each bin and the next, through the taper.
    flat_psd : (n_bin,)
        Expected PSD [sr] of a flat spectrum of unit band power in the tapered map, before scans and cleaning.
    hours, scan_hours
        Observing time of the survey: scans and turnarounds, and scans alone.
    ukcmb_per_mk
        CMB temperature [uK] per Rayleigh-Jeans temperature [mK].
    psd_of
        Function that maps a spectrum, C_ell as a function of multipoles, to its expected PSD (n_bin,) in the tapered
        map before scans and cleaning, in the unit of C_ell.
    power_of
        Function that maps the transform of a source, [sr] as a function of multipoles, to its power (n_bin,) [sr] in
        beam and pixels (`mapmaker.matched_filter.profile_power`).
    beam_sr
        Solid angle of the instrument's beam.
    mjy_per_mk
        Flux density [mJy] of a point source per peak Rayleigh-Jeans temperature [mK] in the instrument's beam.
    sz_ukcmb
        CMB temperature [uK] per Compton parameter y.
    """

    ell: np.ndarray
    edges_ell: np.ndarray
    n_modes: np.ndarray
    selected: np.ndarray
    correlation: np.ndarray
    flat_psd: np.ndarray
    hours: float
    scan_hours: float
    ukcmb_per_mk: float
    psd_of: Callable[[Spectrum], np.ndarray]
    power_of: Callable[[Spectrum], np.ndarray]
    beam_sr: float
    mjy_per_mk: float
    sz_ukcmb: float


@dataclass(frozen=True, eq=False)
class MapNoise:
    """Noise and transfer function of one data set's co-added map.

    Attributes
    ----------
    map
        Properties of the map.
    data_set, n_det
        Name of the data set and its number of detectors.
    noise_psd : (n_bin,)
        Noise PSD [uK_CMB^2 sr].
    transmission : (n_bin,)
        Transfer function (power) of scans and cleaning.
    exposure
        Function that computes the exposure of the map [detector-seconds per sr]: its harmonic mean under the squared
        taper, so that white noise of NET n per detector has the PSD ``n^2 / exposure``. All scans count, discarded
        ones too.
    """

    map: ScoredMap
    data_set: str
    n_det: int
    noise_psd: np.ndarray
    transmission: np.ndarray
    exposure: Callable[[], float]

    @property
    def signal_psd(self) -> np.ndarray:
        """PSD [sr] of a flat spectrum of unit band power in the map, after scans and cleaning (n_bin,)."""
        return self.map.flat_psd * self.transmission

    def scaled(self, noise: np.ndarray | float = 1.0, transmission: np.ndarray | float = 1.0) -> "MapNoise":
        """Return the same map with noise PSD and transfer function times these factors, (n_bin,) or scalar."""
        return replace(self, noise_psd=self.noise_psd * noise, transmission=self.transmission * transmission)


@dataclass(frozen=True)
class Quantity:
    """A value of a metric.

    Attributes
    ----------
    name
        Name within the metric: small letters, digits and `_`.
    value
        Positive; NaN without a value, infinite for one that is out of reach.
    unit
        Unit as astropy writes it: uK is of CMB temperature, mK of Rayleigh-Jeans temperature unless the name says CMB.
    lower_is_better
    note
        Remark for readers: the reason for a missing value, or a limit of the metric.
    response : (n_bin,), optional
        Derivative of ln value to ln noise PSD where there is a closed form and the value depends on the ratio of noise
        PSD and transfer function alone. Without it derivatives are finite differences.
    """

    name: str
    value: float
    unit: str
    lower_is_better: bool = True
    note: str = ""
    response: np.ndarray | None = None


@keep_last(1)
def scored_map(setup: Setup) -> ScoredMap:
    """Collect the properties of the scored map of a scene with a score."""
    analysis, scans, scene = setup.analysis, setup.observing.scans, setup.scene
    region, rings = analysis.region, analysis.region.rings
    return ScoredMap(
        ell=rings.ell,
        edges_ell=rings.edges_ell,
        n_modes=rings.n_modes,
        selected=region.selected,
        correlation=region.correlation,
        flat_psd=region.signal_psd,
        hours=scene.observations * duration_s(scans) / 3600,
        scan_hours=scene.observations * scans.n_scans * scans.scan_s / 3600,
        ukcmb_per_mk=1e3 * scene.instrument.cmb_per_rj,
        psd_of=partial(_spectrum_psd, setup),
        power_of=partial(_source_power, analysis.beams, analysis.geometry.pixel_rad, rings.edges_ell),
        beam_sr=2 * np.pi * scene.instrument.beam_fwhm_rad**2 / (8 * np.log(2)),
        mjy_per_mk=2 * BOLTZMANN_J_K * 1e-3 / (effective_area_m2(scene) * MJY),
        sz_ukcmb=1e6 * scene.instrument.band.sz_k_cmb,
    )


def _source_power(beams: Beams, pixel_rad: float, edges_ell: np.ndarray, profile: Spectrum) -> np.ndarray:
    def seen(ell: np.ndarray) -> np.ndarray:
        return profile(ell) * np.sqrt(beams.window(ell) * pixel_window(ell, pixel_rad))

    return profile_power(seen, edges_ell)


def _spectrum_psd(setup: Setup, spectrum: Spectrum) -> np.ndarray:
    analysis = setup.analysis
    padded = analysis.region.padded_taper
    psd = mapped_signal(analysis.beams, analysis.geometry, setup.sky.geometry, padded, spectrum=spectrum)
    return ring_mean(psd, analysis.region.rings)


def noise_of_score(setup: Setup, item: DataSetScore) -> tuple[MapNoise, MapNoise]:
    """Return the noise of a scored data set as quoted, over all weather with a control variate, and as simulated."""
    exposure = cache(partial(_exposure, setup, item.name))
    passed = item.transfer_function.transmission
    plain = MapNoise(scored_map(setup), item.name, item.n_det, item.noise_psd, passed, exposure)
    return replace(plain, noise_psd=item.quoted_psd), plain


def noise_of_forecast(setup: Setup, item: DataSetForecast, factor: np.ndarray | float = 1.0) -> MapNoise:
    """Return the forecast noise of a data set, times a factor (n_bin,)."""
    exposure = cache(partial(_exposure, setup, item.name))
    return MapNoise(scored_map(setup), item.name, item.n_det, item.noise_psd * factor, item.transmission, exposure)


def _exposure(setup: Setup, data_set: str) -> float:
    masked = [item for item in setup.analysis.pipelines if item.data_set == data_set]
    pipeline = masked[0] if masked else setup.analysis.pipelines[0]
    hits, squares = mean_hits(setup, pipeline), setup.analysis.region.taper**2
    covered = hits > 0
    inverse = np.sum(squares[covered] / hits[covered]) / squares.sum()
    seconds = setup.scene.observations / setup.observing.scans.sample_rate_hz
    return float(seconds / (inverse * setup.analysis.geometry.pixel_rad**2))
