"""Sums over a survey for the forecast of destriped maps: white weights with baselines projected out.

The baselines are a filter in time of the cleaned streams, and of the normal matrix. An observation has the weight that
a run measures on its right-hand side.
"""

from dataclasses import dataclass, replace

import numpy as np

from surveysim.forecasting.closed_forms import Noise, layers
from surveysim.forecasting.fitted_modes import NO_FITTED_MODES
from surveysim.forecasting.mode_response import Modes
from surveysim.forecasting.noise_bins import MapBins, scan_frequencies
from surveysim.forecasting.noise_model import map_bins, present_terms
from surveysim.forecasting.observing_conditions import ObservingConditions, white_shapes
from surveysim.forecasting.solved_maps import ObservationNoise, SolvedSums
from surveysim.forecasting.time_filters import ScanFilters, baseline_filter, no_filter, pipeline_filters
from surveysim.forecasting.track_motions import track_motions
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.setup import Setup
from surveysim.telescope.scans import samples_per_scan

_DRAWS = 32  # observations at a time: their noise in all motions and modes is in memory


@dataclass(frozen=True, eq=False)
class DestripedNoise:
    """Noise of the right-hand sides of a survey's observations, at each speed of the track.

    Attributes
    ----------
    modes
        Modes of the map.
    noise : (n_obs, n_speed, n_bin n_angle)
        Noise variance a sample [mK^2].
    normal, signal : (n_speed, n_bin n_angle)
        Normal matrix and amplitude of the signal, for a weight of 1.
    each
        Noise of the right-hand side of each observation.
    """

    modes: Modes
    noise: np.ndarray
    normal: np.ndarray
    signal: np.ndarray
    each: ObservationNoise

    def sums(self, weight: np.ndarray, share: np.ndarray) -> SolvedSums:
        """Add up observations with weights and fractions of kept samples (n_obs,)."""
        shape = (-1, *self.modes.wave.shape)
        noise = np.tensordot(weight**2 * share, self.noise, 1) / len(weight)
        seen = float(weight @ share) / len(weight)
        return SolvedSums(*(item.reshape(shape) for item in (seen * self.normal, noise, seen * self.signal)))


def destriped_noise(
    setup: Setup, pipeline: CleaningPipeline, conditions: ObservingConditions, length: int
) -> DestripedNoise:
    """Noise of the right-hand sides of destriped maps, with baselines of a number of samples."""
    n_samp, rate = samples_per_scan(setup.observing.scans), setup.observing.scans.sample_rate_hz
    pieces, nothing = baseline_filter(n_samp, length), no_filter(n_samp)
    cleaning = pipeline_filters(setup, pipeline) or ScanFilters(nothing, nothing, rate)
    after = cleaning.after.then(pieces.left, pieces.right, pieces.odd)
    bins = map_bins(setup, pipeline, conditions, white_shapes(setup), ScanFilters(cleaning.before, after, rate))
    modes, terms = bins[0].frequencies.modes, present_terms(setup.scene)
    parts = {term: _of_all_draws([term(_of_each_mode(item)) for item in bins], conditions) for term in terms}
    noise = np.sum(list(parts.values()), axis=0)
    normal = np.array([_normal(setup, item, ScanFilters(nothing, pieces, rate)) for item in bins])
    seen = ObservationNoise(
        _of_bins(modes, noise, conditions),
        _of_bins(modes, parts.get(layers, 0 * noise), conditions),
        1 - modes.mean(normal.mean(axis=0)),
    )
    return DestripedNoise(modes, noise, normal, np.array([item.signal_amplitude() for item in bins]), seen)


def _of_all_draws(noise: list[Noise], conditions: ObservingConditions) -> np.ndarray:
    """Noise (n_obs, n_speed, n_mode) of a term at each speed, some observations at a time."""
    found = []
    for first in range(0, len(conditions.sine), _DRAWS):
        some = conditions.some(slice(first, first + _DRAWS))
        found.append(np.stack([item(some) for item in noise], axis=1))
    return np.concatenate(found)


def _of_bins(modes: Modes, noise: np.ndarray, conditions: ObservingConditions) -> np.ndarray:
    """Mean (n_obs, n_bin) over azimuth and speeds."""
    mean = np.einsum("os,osk->ok", conditions.speed_share, noise)
    return mean.reshape(len(mean), *modes.wave.shape) @ modes.share


def _of_each_mode(of: MapBins) -> MapBins:
    """Make a bin of each mode."""
    n_angle = of.frequencies.modes.wave.shape[1]
    modes = Modes(of.frequencies.modes.wave.reshape(-1, 1), np.ones(1))
    return replace(of, frequencies=replace(of.frequencies, modes=modes), pixel=np.repeat(of.pixel, n_angle))


def _normal(setup: Setup, of: MapBins, filters: ScanFilters) -> np.ndarray:
    """Fraction (n_mode,) of the weight of each mode that the baselines leave."""
    spectrum, straight = of.frequencies, track_motions(setup).straight
    scan = setup.observing.scans, setup.scene.score, setup.analysis.region.rings.ell
    found = scan_frequencies(
        *scan,
        speed_rad_s=spectrum.speed_rad_s,
        straight=straight,
        fitted_modes=NO_FITTED_MODES,
        time_filters=filters,
    )
    return found.apodization.signal_amplitude(spectrum.at_hz)
