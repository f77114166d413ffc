"""Maps by other map-makers than binning, from files in a folder: they need each file several times."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from mapmaker.binning import BinnedMap, map_shape
from mapmaker.cleaning import Cleaned, clean_in_order
from mapmaker.destriping import measure_baseline_weight
from mapmaker.errors import InsufficientDataError
from mapmaker.files import one_line
from mapmaker.geometry import MapGeometry
from mapmaker.gls import GlsOptions, measure_scan_noise
from mapmaker.iterative import IterationOptions, StreamBlock, iterate_map, subtract_sky
from mapmaker.normal_equations import (
    NormalBlock,
    SolveOptions,
    add_diagonal,
    add_right_side,
    normal_matrix,
    solve_normal,
)
from mapmaker.pipeline.config import Config
from mapmaker.pipeline.dropped import CLEANING, FILE, Dropped, UnusableFileError
from mapmaker.pipeline.healpix_sums import HealpixSums
from mapmaker.pipeline.mapped_file import FileStore, MappedFile
from mapmaker.pipeline.maps import Maps
from mapmaker.pipeline.one_file import cleaning_steps
from mapmaker.pipeline.sums import MapSums

Tell = Callable[[int], None]  # told the number of passes


@dataclass(frozen=True)
class _StepsBlock(StreamBlock):
    """A block with the cleaning steps of its file."""

    steps: tuple = ()


def iterated_maps(store: FileStore, sums: MapSums, config: Config, tell: Tell) -> Maps:
    """Iterate the map, and add the files of the last pass to `sums`, which are empty."""
    section, passes = config.map.iterative, 0

    def blocks() -> Iterator[StreamBlock]:
        nonlocal passes
        passes += 1
        tell(passes)
        yield from (_block(file, config) for file in store.files())

    options = IterationOptions(section.threshold, section.loss, section.tolerance, section.max_iterations)
    found = iterate_map(sums.geometry, blocks, _clean, options)
    for file in store.files():
        block = _block(file, config)
        rest = subtract_sky(block, found.estimate_mk)
        cleaned = _clean(rest)
        data, sky = cleaned.data_mk, rest.data_mk
        np.subtract(block.data_mk, rest.data_mk, out=sky)
        data += sky
        weight = np.where(cleaned.kept, file.weight, 0.0)
        sums.add(replace(file, item=replace(file.item, cleaned_mk=data), weight=weight))
    end = "converged" if found.converged else "did not converge"
    return sums.maps(f"The iteration {end} in {found.iterations} passes.", found.converged)


def _block(file: MappedFile, config: Config) -> _StepsBlock:
    item, used = file.item, file.weight > 0
    weight = float(file.weight[used].mean()) if used.any() else 0.0
    streams = item.streams
    steps = tuple(cleaning_steps(streams, config))
    return _StepsBlock(streams.data_mk, file.index, item.bounds, streams.focal_plane, weight, steps)


def _clean(block: StreamBlock) -> Cleaned:
    steps = cast(_StepsBlock, block).steps
    return clean_in_order(steps, block.data_mk, block.scan_bounds, block.focal_plane)


def solved_maps(store: FileStore, sums: MapSums, config: Config, tell: Tell) -> Maps:
    """Solve the normal equations for the map and for the noise maps.

    The noise maps are those of the streams without the map, with the sign of one half changed, by the same normal
    equations. Their scale in each pixel is that of the noise of the map for white noise, as in `half_difference`.
    """
    from mapmaker.kernels.weighted_sums import add_weighted

    geometry, splits = sums.geometry, sums.splits
    section = config.map.destriped if config.map.maker == "destriped" else config.map.maximum_likelihood
    options = SolveOptions(section.tolerance, section.max_iterations)
    n_pixel = geometry.n_x * geometry.n_y
    right, weight, hits = np.zeros((1, n_pixel)), np.zeros(n_pixel), np.zeros(n_pixel, np.int64)
    first = np.zeros((len(splits), n_pixel))
    for file in store.files():
        block = _normal_block(file)
        add_right_side(block, file.item.cleaned_mk, right[0])
        add_diagonal(block, weight, hits)
        white = file.noise.white(file.item.bounds)
        for half, out in zip(file.halves, first, strict=True):
            of_half = np.where(half & (file.weight > 0), white, 0.0)
            spare = np.zeros(n_pixel), np.zeros(n_pixel, np.int64)
            add_weighted(file.item.cleaned_mk, file.index, file.item.bounds, of_half, spare[0], out, spare[1])
    passes = 0

    def blocks() -> Iterator[NormalBlock]:
        nonlocal passes
        passes += 1
        tell(passes)
        yield from map(_normal_block, store.files())

    apply, plane = normal_matrix(blocks, np.dtype(np.float32)), weight.reshape(geometry.n_y, geometry.n_x)
    found = solve_normal(apply, right, plane, options=options)
    noise, converged = [], found.converged.all()
    if splits:
        flipped = solve_normal(apply, _flipped(store, found.sky_mk[0], len(splits)), plane, options=options)
        converged &= flipped.converged.all()
        noise = [_noise_map(geometry, sky, one, (weight, hits)) for sky, one in zip(flipped.sky_mk, first, strict=True)]
    end = "converged" if converged else "did not converge"
    solution = f"The solution {end} in {found.iterations} iterations, to a residual of {found.residual[0]:.1g}."
    made = _map(geometry, found.sky_mk[0], weight, hits)
    _add_healpix(store, sums.healpix, found.sky_mk[0])
    return Maps(made, splits, tuple(noise), sums.healpix, solution, bool(converged))


def _add_healpix(store: FileStore, sums: HealpixSums | None, sky_mk: np.ndarray) -> None:
    """Bin streams of the solution: the map, and the streams without the map less their correlated noise.

    On the pixels of the map itself the second part averages to 0. On others it has the signal within a pixel.
    """
    if sums is None:
        return
    for file in store.files():
        item, block = file.item, _normal_block(file)
        rest = _without_map(file, sky_mk)
        streams = item.cleaned_mk - rest
        left = block.noise.apply(rest[None], file.index, item.bounds)[0]
        weight = np.where(file.weight > 0, block.noise.white(item.bounds), 0.0)
        for (start, stop), white in zip(item.bounds, weight.T, strict=True):
            scale = np.divide(1.0, white, out=np.zeros(len(white)), where=white > 0)
            streams[:, start:stop] += left[:, start:stop] * scale[:, None].astype(left.dtype)
        sums.add(replace(item, cleaned_mk=streams), file.index, weight)


def _without_map(file: MappedFile, sky_mk: np.ndarray) -> np.ndarray:
    """Cleaned streams (n_det, n_samp) less the map."""
    from mapmaker.kernels.pixels import look_up

    rest = np.empty_like(file.item.cleaned_mk)
    look_up(sky_mk[None].astype(rest.dtype), file.index, rest[None])
    return np.subtract(file.item.cleaned_mk, rest, out=rest)


def _normal_block(file: MappedFile) -> NormalBlock:
    return NormalBlock(file.index, file.item.bounds, file.noise)


def with_noise(file: MappedFile, config: Config) -> MappedFile:
    """Measure the noise of a file for the maker, if that solves the normal equations.

    Raises
    ------
    UnusableFileError
        Where the streams do not suffice.
    """
    maker, item = config.map.maker, file.item
    try:
        if maker == "destriped":
            length = max(2, round(config.map.destriped.baseline / _step_s(file)))
            return replace(file, noise=measure_baseline_weight(item.cleaned_mk, file.index, item.bounds, length))
        if maker == "maximum_likelihood":
            section = config.map.maximum_likelihood
            options = GlsOptions((0.0, *section.bands, np.inf), section.max_modes)
            plane, rate_hz = item.streams.focal_plane, 1 / _step_s(file)
            return replace(file, noise=measure_scan_noise(item.cleaned_mk, item.bounds, plane, rate_hz, options))
    except InsufficientDataError as error:
        dropped = Dropped(item.name, FILE, CLEANING, detail=one_line(error))
        raise UnusableFileError((*item.dropped, dropped)) from None
    return file


def _step_s(file: MappedFile) -> float:
    return float(np.median(np.diff(file.item.streams.time_s)))


def _flipped(store: FileStore, sky_mk: np.ndarray, n_split: int) -> np.ndarray:
    """Right-hand sides (n_split, n_pixel) of the streams without the map, with second halves of the other sign."""
    right = np.zeros((n_split, len(sky_mk)))
    for file in store.files():
        block, bounds, rest = _normal_block(file), file.item.bounds, _without_map(file, sky_mk)
        for half, out in zip(file.halves, right, strict=True):
            _change_signs(rest, bounds, half)
            add_right_side(block, rest, out)
            _change_signs(rest, bounds, half)
    return right


def _change_signs(streams: np.ndarray, bounds: np.ndarray, half: np.ndarray) -> None:
    """Change the sign of the scans (n_det, n_scan) that are not in the first half, in place."""
    for (start, stop), first in zip(bounds, half.T, strict=True):
        streams[~first, start:stop] *= -1


def _map(geometry: MapGeometry, sky_mk: np.ndarray, weight: np.ndarray, hits: np.ndarray) -> BinnedMap:
    shape = map_shape(geometry)
    return BinnedMap(geometry, (sky_mk * weight).reshape(shape), weight.reshape(shape), hits.reshape(shape))


def _noise_map(
    geometry: MapGeometry, sky_mk: np.ndarray, first: np.ndarray, of_all: tuple[np.ndarray, np.ndarray]
) -> BinnedMap:
    """Noise map of a division from its solution and the white weights (n_pixel,) of its first half."""
    weight, hits = of_all
    second = weight - first
    seen = (first > 1e-9 * weight) & (second > 1e-9 * weight)
    scale = np.where(seen, weight / (2 * np.sqrt(np.where(seen, first * second, 1.0))), 0.0)
    return _map(geometry, sky_mk * scale, np.where(seen, weight, 0.0), np.where(seen, hits, 0))
