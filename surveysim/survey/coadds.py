"""Running sums over observations: co-added maps, sign-flipped co-adds, signal simulations.

`CoAdds` is the one mutable record of a run: observations are added to it in index order, and a checkpoint holds it.
Apart from a row and a few PSDs per observation (some kB), its size does not depend on the number of observations.
"""

from dataclasses import dataclass, field

import numpy as np

from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.cleaning_pipelines import ACTUAL, OPTIMAL
from surveysim.reduction.figure_of_merit import TARGETS, best_places
from surveysim.reduction.observation import ObservationResult
from surveysim.reduction.setup import Setup
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.scene import Scene
from surveysim.survey.kernels import add_signed

ROW_FIELDS = (
    "observation",
    "b2_mk2",
    "wind_speed_rad_s",
    "wind_angle_rad",
    "pwv_mm",
    "elevation_rad",
    "white_mk2_hz",
)


@dataclass
class CoAdds:
    """Sums over the first `done` observations, with weights w, sums S and hits H of each.

    Attributes
    ----------
    sums, weight, hits : (n_set, n_y, n_x)
        Sums of w S, w H and H.
    flipped : (K, n_set, n, n)
        Sums with random signs on the scored patch.
    signal_maps : (n_sky, n_transfer, 2, n, n)
        Signal simulations on the patch.
    signal_weight : (n_transfer, n, n)
    rows
        One tuple per observation (`row_names`).
    bin_noise : (n_obs, n_set, n_bin)
        Noise variances per sample [mK^2].
    raw_psd, clean_psd : (n_obs, n_freq)
    compared_psd : (n_obs, n_compare, n_freq)
    """

    sums: np.ndarray
    weight: np.ndarray
    hits: np.ndarray
    flipped: np.ndarray
    signal_maps: np.ndarray
    signal_weight: np.ndarray
    rows: list[tuple[float, ...]] = field(default_factory=list)
    bin_noise: list[np.ndarray] = field(default_factory=list)
    raw_psd: list[np.ndarray] = field(default_factory=list)
    clean_psd: list[np.ndarray] = field(default_factory=list)
    compared_psd: list[np.ndarray] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def done(self) -> int:
        """Number of observations."""
        return len(self.rows)

    @property
    def each_s(self) -> float:
        """Mean time [s] of an observation on one worker, without compilation."""
        return sum(self.seconds.values()) / max(1, self.done)

    @property
    def n_set(self) -> int:
        """Number of data sets."""
        return len(self.sums)

    def column(self, name: str) -> np.ndarray:
        """Select one of `ROW_FIELDS` of all observations, (n_obs,)."""
        place = ROW_FIELDS.index(name)
        return np.array([row[place] for row in self.rows])

    def noise_mk2(self) -> np.ndarray:
        """Select the noise variances per sample, (n_obs, n_set)."""
        return np.array([row[-self.n_set :] for row in self.rows])


def empty_coadds(analysis: AnalysisSetup) -> CoAdds:
    """Make sums over zero observations."""
    n_set, n_transfer = len(analysis.data_set_names), len(analysis.transfer_function_names)
    shape = (analysis.geometry.n_y, analysis.geometry.n_x)
    n_flip = n_sky = n = 0
    if analysis.scene.score:
        n_flip, n_sky = analysis.scene.score.jackknives, analysis.n_signal_skies
        n = len(analysis.region.taper)
    return CoAdds(
        sums=np.zeros((n_set, *shape)),
        weight=np.zeros((n_set, *shape)),
        hits=np.zeros((n_set, *shape), np.int64),
        flipped=np.zeros((n_flip, n_set, n, n)),
        signal_maps=np.zeros((n_sky, n_transfer, 2, n, n)),
        signal_weight=np.zeros((n_transfer, n, n)),
    )


def jackknife_signs(scene: Scene, observation: int) -> np.ndarray:
    """Draw the signs (K,) of one observation in the sign-flipped co-adds, in which the sky cancels."""
    score = scene.score
    if score is None:
        return np.zeros(0)
    rng = generator(scene.seed, RandomPurpose.JACKKNIFE, observation)
    return 2.0 * rng.integers(0, 2, score.jackknives) - 1.0


def add_observation(analysis: AnalysisSetup, coadds: CoAdds, result: ObservationResult) -> None:
    """Add one observation, weighted by its own noise, in place.

    Raises
    ------
    ValueError
        For an observation that is not the next, and for other shapes than those of the setup.
    """
    if result.observation != coadds.done:
        raise ValueError(f"found observation {result.observation}; {coadds.done} is the next in order")
    _check_shapes(analysis, coadds, result)
    weights = noise_weights(result.noise_mk2)
    sign = jackknife_signs(analysis.scene, result.observation)
    patch = analysis.region.patch if analysis.region else slice(0, 0)
    # Everything that could fail for lack of memory comes before the first sum: an observation is added whole.
    sums = weights[:, None, None] * result.sums.astype(float)
    hits = weights[:, None, None] * result.hits
    for s, weighted in enumerate(sums):
        coadds.sums[s] += weighted
        coadds.weight[s] += hits[s]
        if len(sign):
            add_signed(coadds.flipped[:, s], np.ascontiguousarray(weighted[patch, patch]), sign)
    coadds.hits += result.hits
    if result.signal_maps is not None:
        _add_signal_maps(analysis, coadds, result, weights)
    coadds.rows.append(_row(result))
    coadds.bin_noise.append(result.bin_noise_mk2)
    coadds.raw_psd.append(result.raw_psd)
    coadds.clean_psd.append(result.clean_psd)
    coadds.compared_psd.append(result.compared_psd)
    for stage, seconds in result.seconds.items():
        coadds.seconds[stage] = coadds.seconds.get(stage, 0.0) + seconds


def _check_shapes(analysis: AnalysisSetup, coadds: CoAdds, result: ObservationResult) -> None:
    """Raise ValueError for wrong shapes: results come from other processes, sums from files."""
    planes = (len(analysis.data_set_names), analysis.geometry.n_y, analysis.geometry.n_x)
    n_flip, n = (analysis.scene.score.jackknives, len(analysis.region.taper)) if analysis.scene.score else (0, 0)
    found = {
        "sums": (result.sums.shape, planes),
        "hits": (result.hits.shape, planes),
        "noise_mk2": (result.noise_mk2.shape, planes[:1]),
        "co-added sums": (coadds.sums.shape, planes),
        "flipped": (coadds.flipped.shape, (n_flip, planes[0], n, n)),
    }
    for name, (shape, expected) in found.items():
        if shape != expected:
            raise ValueError(f"{name}: found the shape {shape}; {expected} is expected")


def noise_weights(noise_mk2: np.ndarray) -> np.ndarray:
    """Convert noise variances per sample to weights [1/mK^2]; 0 without data."""
    known = np.isfinite(noise_mk2) & (noise_mk2 > 0)
    return np.divide(1.0, noise_mk2, out=np.zeros_like(noise_mk2), where=known)


def lost_scans(analysis: AnalysisSetup, coadds: CoAdds) -> np.ndarray:
    """Count the discarded scans (n_obs, n_set) of each observation so far, by data set.

    Noise-only sets lose the scans of the actual data, the optimal set those of the best pipeline.
    """
    columns = dict(zip(row_names(analysis), np.array(coadds.rows).T, strict=True))
    counts = {pipeline.data_set: columns[f"discarded_{pipeline.data_set}"] for pipeline in analysis.pipelines}
    if analysis.chooses:
        whole = [pipeline.data_set for pipeline in analysis.whole_pipelines]
        best = best_places(np.array([columns[f"merit_{TARGETS[0]}_{name}"] for name in whole]))
        # Without a figure of merit, take the first pipeline.
        counts[OPTIMAL] = np.array([counts[name] for name in whole])[np.maximum(best, 0), np.arange(len(best))]
    return np.stack([counts.get(name, counts[ACTUAL]) for name in analysis.data_set_names], axis=1)


def kept_shares(setup: Setup, coadds: CoAdds) -> dict[str, np.ndarray]:
    """Compute the fraction (n_obs,) of kept scans of each observation so far, by data set."""
    kept = 1 - lost_scans(setup.analysis, coadds) / setup.observing.scans.n_scans
    return dict(zip(setup.analysis.data_set_names, kept.T, strict=True))


def _add_signal_maps(analysis: AnalysisSetup, coadds: CoAdds, result: ObservationResult, weights: np.ndarray) -> None:
    patch = analysis.region.patch
    for place, name in enumerate(analysis.transfer_function_names):
        data_set = analysis.data_set_names.index(name)
        coadds.signal_maps[:, place] += weights[data_set] * result.signal_maps[:, place]
        coadds.signal_weight[place] += weights[data_set] * result.hits[data_set][patch, patch]


def _row(result: ObservationResult) -> tuple[float, ...]:
    weather = result.weather
    drawn = (np.nan,) * 4
    if weather is not None:
        drawn = (weather.b2, weather.wind_speed_rad_s, weather.wind_angle_rad, weather.pwv_mm)
    conditions = (result.observation, *drawn, result.elevation_rad, result.white_mk2_hz)
    cleaning = (*result.discarded, *result.iterations, *result.removed)
    figures_of_merit = () if result.figures_of_merit is None else result.figures_of_merit.T.ravel()
    return (*conditions, *cleaning, *figures_of_merit, *result.noise_mk2)


def row_names(analysis: AnalysisSetup) -> list[str]:
    """List the names of the values in a row of `CoAdds.rows`."""
    of_pipelines = [
        f"{what}_{pipeline.data_set}"
        for what in ("discarded", "iterations", "removed")
        for pipeline in analysis.pipelines
    ]
    whole = analysis.whole_pipelines if analysis.chooses else ()
    figures_of_merit = [f"merit_{target}_{pipeline.data_set}" for target in TARGETS for pipeline in whole]
    return [
        *ROW_FIELDS,
        *of_pipelines,
        *figures_of_merit,
        *(f"noise_mk2_{name}" for name in analysis.data_set_names),
    ]
