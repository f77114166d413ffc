"""Scores: from co-added maps to the uncertainty of a flat CMB band power, for every data set."""

from dataclasses import dataclass, replace

import numpy as np

from mapmaker.bandpower import BandPower, band_power, bin_weights, flat_band_power, score
from mapmaker.binning import weighted_mean
from mapmaker.spectrum import Annuli, map_psd
from mapmaker.transfer_function import TransferFunction, measure_transfer_function
from mapmaker.uncertainty import (
    ErrorBudget,
    draws,
    information_shares,
    noise_error,
    noise_error_parts,
    ratio_error,
    student_factor,
    subtract_in_quadrature,
)
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.data_set import DataSet, DataSetKind
from surveysim.reduction.map_noise import keeps_large_scales, weighs_itself
from surveysim.reduction.scored_region import N_SECTORS
from surveysim.reduction.setup import Setup
from surveysim.runtime.errors import InsufficientDataError
from surveysim.survey.coadds import CoAdds, kept_shares, noise_weights

PEAK = 0.8  # of the brightest pixel: what counts as a point source's peak
FEWEST_CONTROLLED = 4  # observations whose scatter about the forecast tells anything of it


@dataclass(frozen=True)
class Control:
    """Forecast of a data set, as the control variate of its score (`surveysim.results.control_variate`).

    Attributes
    ----------
    factor : (n_bin,)
        Expected noise PSD over all weather, divided by the one expected for the simulated observations.
    weights : (n_obs,)
        Expected weights of the observations.
    noise : (n_obs, n_bin)
        Expected noise variance per sample [mK^2].
    sampling
        Relative error of sigma from as many observations in random weather.
    population
        Relative error of the expectation over all weather.
    """

    factor: np.ndarray
    weights: np.ndarray
    noise: np.ndarray
    sampling: float
    population: float


@dataclass(frozen=True)
class DataSetScore:
    """Score of one data set.

    Attributes
    ----------
    band
        The quoted result, with the forecast as control variate if there is one.
    noise_psds : (K, n_bin)
        Noise PSDs of the sign-flipped co-adds [uK_CMB^2 sr].
    signal_psd : (n_bin,)
        PSD of a flat spectrum of unit band power in the map [sr].
    transfer_function
        Transfer function of its pipeline and detectors.
    weights : (n_obs,)
        Weights of the observations [1/mK^2 per sample]; 0 without data.
    bin_noise : (n_obs, n_bin)
        Noise variance per sample of their maps [mK^2].
    kept : (n_obs,)
        Fraction of their scans that is kept.
    control
        Control variate, or None.
    block : (n_obs,)
        Block of each observation, numbered from 0, where only blocks have independent weather; else None.
    plain
        Result without control variate, if there is one.
    """

    name: str
    kind: DataSetKind
    n_det: int
    band: BandPower
    budget: ErrorBudget
    noise_psds: np.ndarray
    signal_psd: np.ndarray
    transfer_function: TransferFunction
    weights: np.ndarray
    bin_noise: np.ndarray
    kept: np.ndarray | float = 1.0
    control: Control | None = None
    plain: BandPower | None = None
    block: np.ndarray | None = None

    @property
    def noise_psd(self) -> np.ndarray:
        """Mean over the sign-flipped co-adds."""
        return self.noise_psds.mean(axis=0)

    @property
    def quoted_psd(self) -> np.ndarray:
        """Noise PSD of `band`: expected over all weather with a control variate."""
        return self.noise_psd if self.control is None else self.noise_psd * self.control.factor

    @property
    def information(self) -> np.ndarray:
        """Share of each observation in the survey's, (n_obs,)."""
        return self.shares(self.band.weight)

    @property
    def expected(self) -> np.ndarray:
        """The same as the control variate expects it, or equal shares without one, (n_obs,)."""
        return self.expected_shares(self.band.weight)

    def shares(self, response: np.ndarray, exponent: float = 1.0) -> np.ndarray:
        """Share (n_obs,) of each observation in a quantity, `mapmaker.uncertainty.information_shares`.

        `response` (n_bin,) is the derivative of its logarithm to ln noise PSD, and `exponent` the sum.
        """
        return information_shares(self.weights, self.kept, self.bin_noise, response, exponent=exponent)

    def expected_shares(self, response: np.ndarray, exponent: float = 1.0) -> np.ndarray:
        """The same as the control variate expects it, or equal shares without one, (n_obs,)."""
        if self.control is None:
            return np.full(len(self.weights), exponent / len(self.weights))
        return information_shares(self.control.weights, 1.0, self.control.noise, response, exponent=exponent)

    @property
    def plain_band(self) -> BandPower:
        """The result of the very observations that were simulated, without a control variate."""
        return self.band if self.plain is None else self.plain


def score_survey(setup: Setup, coadds: CoAdds, names: tuple[str, ...] | None = None) -> dict[str, DataSetScore]:
    """Score data sets by name (all by default), from the observations so far, without control variates.

    Raises
    ------
    InsufficientDataError
        With fewer than 2 observations with data, before the first signal simulation, or without a kept scan.
    """
    analysis, kept = setup.analysis, kept_shares(setup, coadds)
    if not kept[ACTUAL].any():
        raise InsufficientDataError("cleaning discarded all scans; some scans of 2 or more observations are expected")
    scored = [item for item in analysis.data_sets if names is None or item.name in names]
    transfer_functions = {
        place: _transfer_function(analysis, coadds, place, analysis.region.rings)
        for place in {analysis.transfer_function_index(item.name) for item in scored}
    }
    weights = noise_weights(coadds.noise_mk2())
    scores = {}
    for item in scored:
        name, s = item.name, analysis.data_set_names.index(item.name)
        psds = _noise_psds(analysis, coadds, s, analysis.region.rings)
        scores[name] = _score(
            analysis,
            item,
            psds,
            transfer_functions[analysis.transfer_function_index(name)],
            weights=weights[:, s],
            bin_noise=np.array(coadds.bin_noise)[:, s],
            kept=kept[name],
            block=setup.air.block(coadds.done),
        )
    return scores


def controlled_score(analysis: AnalysisSetup, item: DataSetScore, control: Control) -> DataSetScore:
    """Apply the forecast as control variate to a plain score; `plain` keeps that score with the error by the forecast.

    The error of both is the scatter of the information of observations about the forecast's, without the scatter of
    noise; for fewer than 4 observations it is unknown. The plain score has the error of the drawn weather too.
    """
    rings, selected = analysis.region.rings, item.band.weight > 0
    _, common = noise_parts(analysis, item)
    off = ratio_error(item.information, replace(item, control=control).expected, item.block)
    off = subtract_in_quadrature(off, common) * student_factor(draws(len(item.weights), item.block))
    budget = replace(item.budget, weather=off, population=control.population)
    plain = replace(item.budget, weather=float(np.hypot(off, control.sampling))).total
    quoted = replace(item, budget=budget, control=control)
    band = band_power(
        quoted.quoted_psd,
        item.signal_psd,
        rings.n_modes,
        selected,
        ell=rings.ell,
        edges_ell=rings.edges_ell,
        relative_error=budget.total,
    )
    return replace(quoted, band=band, plain=replace(item.band, error_ukcmb2=item.band.sigma_ukcmb2 * plain))


def noise_parts(analysis: AnalysisSetup, item: DataSetScore) -> tuple[float, float]:
    """Compute relative errors of the plain sigma from noise: the part that more sign flips reduce, and the rest."""
    used = item.weights[item.weights > 0]
    of_bins = {"n_modes": analysis.region.rings.n_modes, "correlation": analysis.region.correlation}
    return noise_error_parts(item.noise_psds, item.plain_band.weight, used, **of_bins)


def bin_errors(analysis: AnalysisSetup, item: DataSetScore) -> np.ndarray:
    """Compute relative standard errors (n_bin,) of the plain noise PSD in each bin."""
    used = item.weights[item.weights > 0]
    of_bins = {"n_modes": analysis.region.rings.n_modes, "correlation": analysis.region.correlation}
    alone = np.eye(len(analysis.region.rings.ell))
    return np.array([noise_error(item.noise_psds, weight, used, **of_bins) for weight in alone])


def rescore(analysis: AnalysisSetup, item: DataSetScore, ell_min: float) -> DataSetScore:
    """Score the same data set from another lowest multipole."""
    low, high = analysis.region.rings.edges_ell[:-1], analysis.region.rings.edges_ell[1:]
    selected = (low >= ell_min) & (high <= analysis.scene.score.ell_max)
    plain = _score(
        analysis,
        item,
        item.noise_psds,
        item.transfer_function,
        weights=item.weights,
        bin_noise=item.bin_noise,
        kept=item.kept,
        block=item.block,
        selected=selected,
    )
    return plain if item.control is None else controlled_score(analysis, plain, item.control)


def sector_sigma(analysis: AnalysisSetup, coadds: CoAdds, item: DataSetScore) -> float:
    """Compute sigma(A) [uK_CMB^2] with modes also weighted by direction (`split_azimuth`)."""
    sectors = analysis.region.sectors
    noise = _noise_psds(analysis, coadds, analysis.data_set_names.index(item.name), sectors).mean(axis=0)
    if item.control is not None:
        noise = noise * np.repeat(item.control.factor[analysis.region.selected], N_SECTORS)
    transfer_function = _transfer_function(analysis, coadds, analysis.transfer_function_index(item.name), sectors)
    signal = analysis.region.sector_psd * transfer_function.transmission
    return flat_band_power(noise, signal, sectors.n_modes, np.ones(len(noise), bool))


def _score(
    analysis: AnalysisSetup,
    item: DataSet | DataSetScore,
    psds: np.ndarray,
    transfer_function: TransferFunction,
    *,
    weights: np.ndarray,
    bin_noise: np.ndarray,
    kept: np.ndarray | float,
    block: np.ndarray | None,
    selected: np.ndarray | None = None,
) -> DataSetScore:
    rings, signal = analysis.region.rings, analysis.region.signal_psd * transfer_function.transmission
    selected = analysis.region.selected if selected is None else selected
    shares = information_shares(
        weights, kept, bin_noise, bin_weights(psds.mean(axis=0), signal, rings.n_modes, selected)
    )
    band, budget = score(
        psds,
        signal,
        signal_psd_relative_error=transfer_function_errors(transfer_function),
        n_modes=rings.n_modes,
        mask=selected,
        observation_weights=weights[weights > 0],
        ell=rings.ell,
        edges_ell=rings.edges_ell,
        information=shares,
        correlation=analysis.region.correlation,
        block=block,
    )
    of_maps = psds, signal, transfer_function, weights, bin_noise, kept
    return DataSetScore(item.name, item.kind, item.n_det, band, budget, *of_maps, block=block)


def transfer_function_errors(transfer_function: TransferFunction) -> np.ndarray:
    """Compute relative errors (n_bin,) of the transfer function."""
    none = np.zeros_like(transfer_function.transmission)
    return np.divide(
        transfer_function.error, transfer_function.transmission, out=none, where=transfer_function.transmission > 0
    )


def _noise_psds(analysis: AnalysisSetup, coadds: CoAdds, data_set: int, rings: Annuli) -> np.ndarray:
    """PSDs (K, n_bin) [uK_CMB^2 sr] of the sign-flipped co-adds.

    Weights measured on the very maps that they weigh favour an observation whose noise fluctuates low, which lowers
    the co-added PSD where they are measured and raises it elsewhere (`Band.mode_chance`); this bias is corrected.
    The PSD of a survey goes as one over its observations: of a part it is scaled to the whole.
    """
    patch = analysis.region.patch
    maps = _scored(analysis, weighted_mean(coadds.flipped[:, data_set], coadds.weight[data_set][patch, patch]))
    to_ukcmb = 1e3 * analysis.scene.instrument.cmb_per_rj
    whole = coadds.done / analysis.scene.observations
    weights = noise_weights(coadds.noise_mk2()[:, data_set])
    independent = 1 - np.sum(weights**2) / np.sum(weights) ** 2  # a single observation can't be favoured
    if weighs_itself(analysis.scene.map):  # weights are those of time-streams, which few numbers describe
        independent = 0.0
    return _psd(analysis, maps, rings) * (to_ukcmb**2 * (1 + independent * analysis.region.chance(rings)) * whole)


def flux_removed(analysis: AnalysisSetup, coadds: CoAdds) -> dict[str, float]:
    """Share of a faint point source's flux that cleaning takes, by data set; empty where pipelines are not compared.

    At the sources' peaks, against the map binned without cleaning; the mean of the scans goes with it.
    """
    if not analysis.chooses:
        return {}
    removed = {}
    for place, name in enumerate(analysis.transfer_function_names):
        without, cleaned = weighted_mean(coadds.signal_maps[-1, place], coadds.signal_weight[place])
        peak = without > PEAK * without.max()
        removed[name] = 1 - float(cleaned[peak].sum() / without[peak].sum())
    return removed


def _transfer_function(analysis: AnalysisSetup, coadds: CoAdds, place: int, rings: Annuli) -> TransferFunction:
    skies = analysis.scene.score.signal_sims.skies
    maps = weighted_mean(coadds.signal_maps[:skies, place], coadds.signal_weight[place])
    maps[:, 1] = _scored(analysis, maps[:, 1])
    psd = _psd(analysis, maps, rings)
    return measure_transfer_function(psd[:, 1], psd[:, 0], rings.ell)


def _scored(analysis: AnalysisSetup, maps: np.ndarray) -> np.ndarray:
    """Maps (..., n, n) of the patch as they are scored: of maximum likelihood less a plane."""
    return analysis.region.less_plane(maps) if keeps_large_scales(analysis.scene.map) else maps


def _psd(analysis: AnalysisSetup, patches: np.ndarray, rings: Annuli) -> np.ndarray:
    band = analysis.region
    return map_psd(band.pad(patches), band.padded_taper, analysis.geometry.pixel_rad, rings)
