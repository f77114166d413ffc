"""Sums over consecutive observations: co-added maps, sign-flipped co-adds, signal simulations.

`CoAdds` is the one mutable record of a run: observations, and sums over later ones, are added to it in order. Apart
from a row and a few PSDs per observation (some kB), its size does not depend on the number of observations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.cleaning_pipelines import ACTUAL, OPTIMAL
from surveysim.reduction.figure_of_merit import TARGETS, best_places
from surveysim.reduction.map_noise import weighs_itself
from surveysim.reduction.observation_result import ObservationResult
from surveysim.reduction.setup import Setup
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.scene import Scene
from surveysim.scene.spectra import NIGHT
from surveysim.survey.kernels import add_signed
from surveysim.survey.rows import ROW_FIELDS, row_names, row_of

_OF_SIGNALS = ("signal_maps", "signal_weight")
_OF_SPLITS = ("split_sums", "split_weight", "split_flipped")
_ARRAYS = ("sums", "weight", "hits", "flipped", *_OF_SIGNALS, *_OF_SPLITS)
LISTS = ("rows", "bin_noise", "raw_psd", "clean_psd", "compared_psd")  # with an entry for each observation


@dataclass(frozen=True)
class Convergence:
    """Convergence of maps that are solved for.

    Parameters
    ----------
    name : str
        Data set, or "signal simulations".
    iterations : int
        Iterations of the conjugate gradients.
    residual : float
        Largest residual of the normal equations over their right-hand side, of the map and its jackknives.
    converged : bool
        Whether all residuals are within the tolerance.
    """

    name: str
    iterations: int
    residual: float
    converged: bool


@dataclass
class CoAdds:
    """Sums over `done` observations from number `first` on, with weights w, sums S and exposures H of each.

    Attributes
    ----------
    sums, weight, hits : (n_set, n_y, n_x)
        Sums of w S, w H and H.
    flipped : (K, n_set, n, n)
        Sums with random signs on the scored patch, or the whole map before it is solved for, of the type of the
        streams: nearly all of the memory. (0, n_set, n, n) of one observation alone, where they follow from `sums`.
    signal_maps : (n_sky, n_transfer, 2, n, n)
        Signal simulations on the same pixels.
    signal_weight : (n_transfer, n, n)
    split_sums, split_weight : (n_map, n, n)
        Sums of w S and w H of the actual data in each part of the splits, on the patch; no maps without splits.
    split_flipped : (n_map, K, 2, n, n)
        Both with random signs of the observations (`split_signs`), of the same type; K is 0 for one observation alone.
    rows
        One tuple per observation (`row_names`).
    bin_noise : (n_obs, n_set, n_bin)
        Noise variances per sample [mK^2].
    raw_psd, clean_psd : (n_obs, n_freq)
    compared_psd : (n_obs, n_compare, n_freq)
    convergence
        Convergence of maps that have been solved for.
    """

    sums: np.ndarray
    weight: np.ndarray
    hits: np.ndarray
    flipped: np.ndarray
    signal_maps: np.ndarray
    signal_weight: np.ndarray
    split_sums: np.ndarray
    split_weight: np.ndarray
    split_flipped: np.ndarray
    rows: list[tuple[float, ...]] = field(default_factory=list)
    bin_noise: list[np.ndarray] = field(default_factory=list)
    raw_psd: list[np.ndarray] = field(default_factory=list)
    clean_psd: list[np.ndarray] = field(default_factory=list)
    compared_psd: list[np.ndarray] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    convergence: tuple[Convergence, ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """Leave out of a pickle the arrays that follow from others, in single observations two thirds of the bytes."""
        state = dict(vars(self))
        if not self.signal_weight.any():
            state |= dict.fromkeys(_OF_SIGNALS)
            state["signal_shapes"] = [getattr(self, name).shape for name in _OF_SIGNALS]
        if self.done == 1 and not len(self.flipped):
            follows = np.array_equal(self.weight, self._weight_of_hits())
            state |= {"hits": _in_few_bytes(self.hits)} | ({"weight": None} if follows else {})
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the arrays that a pickle leaves out."""
        for name, shape in zip(_OF_SIGNALS, state.pop("signal_shapes", ()), strict=False):
            state[name] = np.zeros(shape)
        vars(self).update(state)
        self.hits = self.hits.astype(np.int64, copy=False)
        if state["weight"] is None:
            self.weight = self._weight_of_hits()

    def _weight_of_hits(self) -> np.ndarray:
        """Weight of a single observation whose samples weigh alike."""
        return noise_weights(self.noise_mk2()[0])[:, None, None] * self.hits

    @property
    def done(self) -> int:
        """Number of observations."""
        return len(self.rows)

    @property
    def first(self) -> int:
        """Number of the first observation; 0 without one."""
        return int(self.rows[0][0]) if self.rows else 0

    @property
    def end(self) -> int:
        """Number of the observation that comes next."""
        return self.first + self.done

    @property
    def each_s(self) -> float:
        """Mean time [s] of an observation on one worker, without compilation."""
        return self.total_s / max(1, self.done)

    @property
    def total_s(self) -> float:
        """Time [s] of all observations on one worker, without compilation."""
        return sum(self.seconds.values())

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


def empty_coadds(analysis: AnalysisSetup, *, flips: bool = True) -> CoAdds:
    """Make sums over no observation, with or without sign-flipped co-adds."""
    shape = (len(analysis.data_set_names), analysis.geometry.n_y, analysis.geometry.n_x)
    return CoAdds(np.zeros(shape), np.zeros(shape), np.zeros(shape, np.int64), **_empty_patches(analysis, flips))


def array_names(analysis: AnalysisSetup) -> tuple[str, ...]:
    """List the names of the arrays of a survey's sums: those of splits only where there are splits."""
    return tuple(name for name in _ARRAYS if analysis.splits is not None or name not in _OF_SPLITS)


def sums_bytes(analysis: AnalysisSetup) -> float:
    """Size of the arrays of sums [bytes]."""
    empty = empty_coadds(analysis)
    return sum(getattr(empty, name).nbytes for name in _ARRAYS)


def _empty_patches(analysis: AnalysisSetup, flips: bool) -> dict[str, Any]:
    """Make the sums on the scored patch over no observation, by name."""
    n_set, n_transfer = len(analysis.data_set_names), len(analysis.transfer_function_names)
    n_flip = n_sky = n = n_split = n_split_flip = 0
    if analysis.scene.score:
        n_flip, n_sky = analysis.scene.score.jackknives * flips, analysis.n_signal_skies
        n = len(range(analysis.geometry.n_y)[analysis.sums_patch])
    if analysis.splits:
        n_split, n_split_flip = analysis.splits.n_map, analysis.scene.spectra.realizations * flips
    kind = analysis.scene.numerics.precision
    return {
        "flipped": np.zeros((n_flip, n_set, n, n), kind),
        "signal_maps": np.zeros((n_sky, n_transfer, 2, n, n)),
        "signal_weight": np.zeros((n_transfer, n, n)),
        "split_sums": np.zeros((n_split, n, n)),
        "split_weight": np.zeros((n_split, n, n)),
        "split_flipped": np.zeros((n_split, n_split_flip, 2, n, n), kind),
    }


def jackknife_signs(scene: Scene, observation: int) -> np.ndarray:
    """Draw the signs (K,) of one observation in the sign-flipped co-adds, in which the sky cancels."""
    score = scene.score
    if score is None:
        return np.zeros(0)
    rng = generator(scene.seed, RandomPurpose.JACKKNIFE, observation)
    return 2.0 * rng.integers(0, 2, score.jackknives) - 1.0


def split_signs(scene: Scene, observation: int) -> np.ndarray:
    """Draw the signs (K,) of one observation in the sign-flipped split maps, the same in all parts."""
    rng = generator(scene.seed, "signs of split maps", observation)
    return 2.0 * rng.integers(0, 2, scene.spectra.realizations) - 1.0


def observation_sums(analysis: AnalysisSetup, result: ObservationResult) -> CoAdds:
    """Weight one observation by its own noise: sums over it alone, without sign-flipped co-adds.

    Raises
    ------
    ValueError
        For other shapes than those of the setup.
    """
    _check_shapes(analysis, result)
    weights = coadd_weights(analysis, result.noise_mk2)
    found = CoAdds(
        np.multiply(weights[:, None, None], result.sums, dtype=float),
        np.multiply(weights[:, None, None], result.exposure, dtype=float),
        result.hits.astype(np.int64),
        **_empty_patches(analysis, flips=False),
        rows=[row_of(result)],
        bin_noise=[result.bin_noise_mk2],
        raw_psd=[result.raw_psd],
        clean_psd=[result.clean_psd],
        compared_psd=[result.compared_psd],
        seconds=dict(result.seconds),
    )
    if result.signal_maps is not None:
        _add_signal_maps(analysis, found, result, weights)
    if analysis.splits:
        _add_split_maps(analysis, found, result, weights[0])
    return found


def add_observations(analysis: AnalysisSetup, coadds: CoAdds, observations: Sequence[CoAdds]) -> None:
    """Add observations (`observation_sums`) one after the other, in place.

    The bits do not depend on how many are added at a time.

    Raises
    ------
    ValueError
        For observations that do not follow each other and the sums.
    """
    if not observations:
        return
    following = coadds.end if coadds.done else observations[0].first
    for number, item in enumerate(observations, following):
        if (item.first, item.done) != (number, 1):
            raise ValueError(f"found observation {item.first}; {number} is the next in order")
    patch = analysis.sums_patch
    signs = np.stack([jackknife_signs(analysis.scene, item.first) for item in observations], axis=1)
    # All that could fail for want of memory comes before the first sum: none is left half done.
    patches = np.stack([item.sums[:, patch, patch] for item in observations])
    _flip(coadds.flipped, patches, signs)
    for item in observations:
        _flip_splits(analysis.scene, coadds, item)
        _add_arrays(coadds, item)
        _add_lists(coadds, item)


def add_sums(coadds: CoAdds, later: CoAdds) -> None:
    """Add sums over the observations that follow, in place.

    Raises
    ------
    ValueError
        For sums over other observations than those that follow, or over one alone.
    """
    if later.first != coadds.end or later.flipped.shape != coadds.flipped.shape:
        raise ValueError(f"found sums from observation {later.first} on; {coadds.end} is the next in order")
    coadds.flipped += later.flipped
    coadds.split_flipped += later.split_flipped
    _add_arrays(coadds, later)
    _add_lists(coadds, later)


def _add_arrays(coadds: CoAdds, later: CoAdds) -> None:
    coadds.sums += later.sums
    coadds.weight += later.weight
    coadds.hits += later.hits
    if later.signal_weight.any():
        coadds.signal_maps += later.signal_maps
        coadds.signal_weight += later.signal_weight
    coadds.split_sums += later.split_sums
    coadds.split_weight += later.split_weight


def _flip(flipped: np.ndarray, values: np.ndarray, signs: np.ndarray) -> None:
    """Add `signs[k, b] * values[b]` to `flipped[k]` for each b in turn, in place, all of the type of `flipped`."""
    if flipped.size:
        kind, n_flip, n = flipped.dtype, len(flipped), len(values)
        add_signed(flipped.reshape(n_flip, -1), values.reshape(n, -1).astype(kind), signs.astype(kind))


def _flip_splits(scene: Scene, coadds: CoAdds, item: CoAdds) -> None:
    """Add the split maps of one observation with random signs, in place."""
    if not len(item.split_sums):
        return
    signs = split_signs(scene, item.first)[:, None]
    for number in np.flatnonzero(item.split_weight.any(axis=(1, 2))):  # one part of the split by night has it
        maps = np.stack([item.split_sums[number], item.split_weight[number]])[None]
        _flip(coadds.split_flipped[number], maps, signs)


def _add_lists(coadds: CoAdds, later: CoAdds) -> None:
    for name in LISTS:
        getattr(coadds, name).extend(getattr(later, name))
    for stage, seconds in later.seconds.items():
        coadds.seconds[stage] = coadds.seconds.get(stage, 0.0) + seconds


def copied(coadds: CoAdds) -> CoAdds:
    """Copy sums: what is added to the copy leaves them as they are."""
    found: dict[str, Any] = {name: getattr(coadds, name).copy() for name in (*_ARRAYS, *LISTS, "seconds")}
    return CoAdds(**found)


def _check_shapes(analysis: AnalysisSetup, result: ObservationResult) -> None:
    """Raise ValueError for wrong shapes."""
    planes = (len(analysis.data_set_names), analysis.geometry.n_y, analysis.geometry.n_x)
    found = {
        "sums": (result.sums.shape, planes),
        "hits": (result.hits.shape, planes),
        "exposure": (result.exposure.shape, planes),
        "noise_mk2": (result.noise_mk2.shape, planes[:1]),
    }
    for name, (shape, expected) in found.items():
        if shape != expected:
            raise ValueError(f"{name}: found the shape {shape}; {expected} is expected")


def _in_few_bytes(hits: np.ndarray) -> np.ndarray:
    return hits.astype(np.int32) if hits.max(initial=0) < 2**31 else hits


def noise_weights(noise_mk2: np.ndarray) -> np.ndarray:
    """Convert noise variances per sample to weights [1/mK^2]; 0 without data."""
    known = np.isfinite(noise_mk2) & (noise_mk2 > 0)
    return np.divide(1.0, noise_mk2, out=np.zeros_like(noise_mk2), where=known)


def coadd_weights(analysis: AnalysisSetup, noise_mk2: np.ndarray) -> np.ndarray:
    """Factors of the sums of observations in co-adds; 1 where N^-1 has the weight already, 0 without data."""
    weights = noise_weights(noise_mk2)
    return (weights > 0).astype(float) if weighs_itself(analysis.scene.map) else weights


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
    patch = analysis.sums_patch
    for place, name in enumerate(analysis.transfer_function_names):
        data_set = analysis.data_set_names.index(name)
        coadds.signal_maps[:, place] += weights[data_set] * result.signal_maps[:, place]
        coadds.signal_weight[place] += weights[data_set] * result.exposure[data_set][patch, patch]


def _add_split_maps(analysis: AnalysisSetup, coadds: CoAdds, result: ObservationResult, weight: float) -> None:
    patch, first = analysis.region.patch, 0
    for split in analysis.splits.splits:
        if split.name == NIGHT:
            number = split.first + int(analysis.splits.night_parts[result.observation])
            maps, found = slice(number, number + 1), (result.sums[:1, patch, patch], result.exposure[:1, patch, patch])
        else:
            maps, own = split.maps, slice(first, first + len(split.parts))
            found, first = (result.split_sums[own], result.split_exposure[own]), own.stop
        coadds.split_sums[maps] = np.multiply(weight, found[0], dtype=float)
        coadds.split_weight[maps] = np.multiply(weight, found[1], dtype=float)
