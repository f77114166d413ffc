"""Linear maps of several observations: right-hand side, weights and solution, with streams read anew for each pass."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from mapmaker.binning import BinnedMap, map_shape
from mapmaker.errors import InsufficientDataError
from mapmaker.geometry import MapGeometry
from mapmaker.iterative import StreamBlock, check_pixels
from mapmaker.normal_equations import (
    NoiseWeight,
    NormalBlock,
    SolveOptions,
    add_diagonal,
    add_right_side,
    normal_matrix,
    solve_normal,
)


@dataclass(frozen=True)
class SolvedMap:
    """Solution of the normal equations of one map, and its convergence.

    Attributes
    ----------
    map
        Its weights are those of the white noise alone [1/mK^2]. If a constant over all pixels is undetermined, the
        weighted mean is 0.
    iterations
    residual
        Residual of the normal equations over their right-hand side.
    converged
    discarded
        Scans with values that are not finite.
    """

    map: BinnedMap
    iterations: int
    residual: float
    converged: bool
    discarded: int


def solved_map(
    geometry: MapGeometry,
    observations: Callable[[], Iterable[StreamBlock]],
    weigh: Callable[[StreamBlock], NoiseWeight],
    *,
    options: SolveOptions,
) -> SolvedMap:
    """Solve the normal equations of observations.

    The observations are read once for the right-hand side, and once for each iteration. Only their noise weights are
    kept. Scans with values that are not finite are discarded.

    Parameters
    ----------
    geometry
    observations
        Function that returns all blocks for one pass, one at a time.
    weigh
        Function that returns the noise weight of a block, whose scans are finite.
    options

    Raises
    ------
    ValueError
        For no observation, and for pixels of another map.
    """
    n_pixel = geometry.n_y * geometry.n_x
    right, weight, hits = np.zeros(n_pixel), np.zeros(n_pixel), np.zeros(n_pixel, np.int64)
    noises: list[tuple[NoiseWeight | None, np.ndarray]] = []
    discarded, stream_type = 0, np.dtype(np.float32)
    for block in observations():
        check_pixels(geometry, block)
        stream_type = np.result_type(stream_type, block.data_mk)
        bounds = np.array([b for b in block.scan_bounds if np.isfinite(block.data_mk[:, b[0] : b[1]]).all()], np.int64)
        discarded += len(block.scan_bounds) - len(bounds)
        if not len(bounds):
            noises.append((None, bounds))
            continue
        item = NormalBlock(block.index, bounds, weigh(_of_scans(block, bounds)))
        add_right_side(item, block.data_mk, right)
        add_diagonal(item, weight, hits)
        noises.append((item.noise, bounds))
    if not any(len(bounds) for _, bounds in noises):
        raise InsufficientDataError("found no observation with finite values; one or more are expected")

    def blocks() -> Iterator[NormalBlock]:
        for block, (noise, bounds) in zip(observations(), noises, strict=True):
            if noise is not None:
                yield NormalBlock(block.index, bounds, noise)

    plane, shape = weight.reshape(geometry.n_y, geometry.n_x), map_shape(geometry)
    solution = solve_normal(normal_matrix(blocks, stream_type), right[None], plane, options=options)
    total = solution.sky_mk[0] * weight
    result = BinnedMap(geometry, total.reshape(shape), weight.reshape(shape), hits.reshape(shape))
    return SolvedMap(result, solution.iterations, float(solution.residual[0]), bool(solution.converged[0]), discarded)


def _of_scans(block: StreamBlock, bounds: np.ndarray) -> StreamBlock:
    return StreamBlock(block.data_mk, block.index, bounds, block.focal_plane, block.weight)
