"""Destriped maps: white noise, and a baseline for each piece of a scan that is fitted together with the map.

The baselines have no prior: N^-1 is the weight of the white noise with the baselines projected out. Lost samples, and
samples off the map, have no weight. A baseline does not cross from one scan to the next.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from mapmaker.geometry import MapGeometry
from mapmaker.iterative import StreamBlock
from mapmaker.linear_maps import SolvedMap, solved_map
from mapmaker.normal_equations import SolveOptions
from mapmaker.validation import reals, whole


@dataclass(frozen=True)
class DestripeOptions:
    """Options of a destriped map.

    Attributes
    ----------
    baseline
        Samples of a baseline. A scan is divided into pieces of nearly equal length, as near to this as possible.
    solve
        Convergence of the solution.
    """

    baseline: int
    solve: SolveOptions = field(default_factory=SolveOptions)

    def __post_init__(self) -> None:
        """Raise ValueError for values out of range."""
        whole("baseline", self.baseline, least=2, most=2**31 - 1)


@dataclass(frozen=True)
class BaselineWeight:
    """White noise of each detector, with baselines projected out.

    Attributes
    ----------
    weight : (n_det,)
        Inverse variance of a sample [1/mK^2].
    length
        Samples of a baseline (`DestripeOptions`).
    """

    weight: np.ndarray
    length: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "weight", reals("weight", self.weight, ("n_det",), least=0).astype(float))
        whole("length", self.length, least=2)

    def apply(self, data_mk: np.ndarray, index: np.ndarray, scan_bounds: np.ndarray) -> np.ndarray:
        """Compute ``N^-1 d``; see `NoiseWeight`."""
        from mapmaker.kernels.baselines import project_baselines

        out = np.empty_like(data_mk)
        weight = self.weight.astype(data_mk.dtype)
        project_baselines(data_mk, index, baselines(scan_bounds, self.length), weight, out)
        return out

    def white(self, scan_bounds: np.ndarray) -> np.ndarray:
        """Weights (n_det, n_scan) of the white noise alone, less the part of the baselines; see `NoiseWeight`."""
        n_samp = np.diff(scan_bounds, axis=1)[:, 0]
        share = 1 - np.array([len(baselines(b[None], self.length)) for b in scan_bounds]) / n_samp
        return np.outer(self.weight, share)


def baselines(scan_bounds: np.ndarray, length: int) -> np.ndarray:
    """First and one-past-last samples (n_baseline, 2) of the baselines of scans."""
    pieces = []
    for start, stop in scan_bounds:
        edges = np.linspace(start, stop, max(1, round((stop - start) / length)) + 1).round().astype(np.int64)
        pieces.append(np.column_stack([edges[:-1], edges[1:]]))
    return np.concatenate(pieces)


def measure_baseline_weight(
    data_mk: np.ndarray, index: np.ndarray, scan_bounds: np.ndarray, length: int
) -> BaselineWeight:
    """Measure the white noise of each detector as the variance about its baselines; sky signal counts as noise.

    Parameters
    ----------
    data_mk, index : (n_det, n_samp)
    scan_bounds : (n_scan, 2)
    length

    Returns
    -------
    BaselineWeight
        A detector without samples on the map, or of no variance, has no weight.
    """
    square, degrees = np.zeros(len(data_mk)), np.zeros(len(data_mk))
    for first, end in baselines(scan_bounds, length):
        seen = index[:, first:end] >= 0
        count = np.maximum(1, seen.sum(axis=1))
        piece = np.where(seen, data_mk[:, first:end], 0).astype(float)
        rest = np.where(seen, piece - (piece.sum(axis=1) / count)[:, None], 0)
        square += np.sum(rest**2, axis=1)
        degrees += count - 1
    return BaselineWeight(np.divide(degrees, square, out=np.zeros(len(square)), where=square > 0), length)


def destriped_map(
    geometry: MapGeometry, observations: Callable[[], Iterable[StreamBlock]], options: DestripeOptions
) -> SolvedMap:
    """Destriped map of observations, each with the white noise measured from its own streams.

    Scans with values that are not finite are discarded.

    Parameters
    ----------
    geometry
    observations
        Function that returns all blocks for one pass, one at a time. Their weights are not used.
    options

    Raises
    ------
    ValueError
        For no observation, and pixels of another map.
    """
    return solved_map(geometry, observations, partial(_weigh, length=options.baseline), options=options.solve)


def _weigh(block: StreamBlock, length: int) -> BaselineWeight:
    return measure_baseline_weight(block.data_mk, block.index, block.scan_bounds, length)
