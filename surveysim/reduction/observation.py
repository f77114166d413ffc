"""Reduction of one observation: cleaning by every pipeline, maps of every data set, noise levels, the best pipeline.

The blocks of the observation are drawn and added up one by one. The noise-only sets need the PSDs of all blocks, so
they are drawn in a second pass. Wind cleaning needs the wind of all blocks, so several blocks are drawn for it first.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mapmaker.cleaning import Cleaned
from mapmaker.formats.hdf5 import timestream_file
from mapmaker.geometry import MapGeometry
from mapmaker.kernels.pixels import bin_samples
from mapmaker.normal_equations import NormalBlock, add_diagonal, add_normal, add_right_side
from mapmaker.stream_psd import hann_power, white_level
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.cleaned_block import CleanedBlock, reduce_block
from surveysim.reduction.cleaning_pipelines import ACTUAL, OPTIMAL, CleaningPipeline
from surveysim.reduction.detector_weights import weighted
from surveysim.reduction.figure_of_merit import TARGETS, best_places, figures_of_merit
from surveysim.reduction.layer_delays import delays_of_all_blocks
from surveysim.reduction.map_noise import map_noise, probe_map, weighed_noise, weighs_itself
from surveysim.reduction.noise_only_sets import add_simulated
from surveysim.reduction.noise_weights import BlockWeights, block_weights, save_weights
from surveysim.reduction.observation_result import ObservationResult
from surveysim.reduction.setup import Setup
from surveysim.reduction.signal_maps import add_signal_maps, empty_signal_maps, scored_signal_maps
from surveysim.reduction.split_maps import add_split_maps, empty_split_maps, scored_split_maps
from surveysim.reduction.stream_psds import cleaned_power, cleaned_psd, mean_psd, psd_scale, sampled_scans
from surveysim.runtime.once import keep_last
from surveysim.telescope.pointing import Pointing
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.observation import Stopwatch
from surveysim.timestreams.observed_block import observation_weather
from surveysim.timestreams.simulation import observation_path

REFERENCE = (0, 1)  # observations that tell what pipelines leave of a signal: one along each direction


Map = tuple[np.ndarray, np.ndarray]  # sums and hits, or exposures, (n_y, n_x) each


@dataclass
class _Sums:
    """Running sums over the blocks of one observation.

    `maps` by data set: float64 sums [mK] and int64 hits (n_y n_x,); `exposure` by data set: sums of weights
    (n_y n_x,), if detectors differ in weight; `signal_maps` (n_sky, n_transfer, 2, n_y n_x)
    float64 or None; `split_maps` (n_part, 2, n_y n_x) float64, sums and exposures, or None; `power` (n_det, n_freq) of
    the kept scans of the actual data (`hann_power`), and their number less the part of lost samples, `sampled`
    (n_det,); number `flagged` of lost samples. Of each block: `kept`, `iterations` and `removed` (n_pipeline, n_scan),
    `lost` (n_scan,) scans, and the number of kept scans with their mean PSD (n_freq,) [mK^2/Hz], before cleaning
    (`raw`) and after the other pipelines (`compared`). `noise_weights` of blocks with a kept scan, of maps that are
    solved for; `probe` by data set (n_pixel,) is P^T N^-1 P of `probe_map`, of maximum-likelihood maps. `pixels`
    (n_det, n_samp) of the samples of an observation of one block, None of several.
    """

    maps: dict[str, Map]
    exposure: dict[str, np.ndarray]
    signal_maps: np.ndarray | None
    split_maps: np.ndarray | None
    power: np.ndarray
    sampled: np.ndarray
    flagged: int = 0
    kept: list[np.ndarray] = field(default_factory=list)
    lost: list[np.ndarray] = field(default_factory=list)
    iterations: list[np.ndarray] = field(default_factory=list)
    removed: list[np.ndarray] = field(default_factory=list)
    raw: list[tuple[int, np.ndarray]] = field(default_factory=list)
    compared: list[list[tuple[int, np.ndarray]]] = field(default_factory=list)
    noise_weights: list[BlockWeights] = field(default_factory=list)
    probe: dict[str, np.ndarray] = field(default_factory=dict)
    pixels: np.ndarray | None = None


def observe(
    setup: Setup,
    observation: int,
    with_signal_sims: bool,
    path: Path | None = None,
    *,
    weights_path: Path | None = None,
) -> ObservationResult:
    """Simulate, clean and bin one observation.

    Parameters
    ----------
    with_signal_sims
        Whether to simulate signals too.
    path
        File for the time-streams before cleaning; None for none.
    weights_path
        File for the noise weights of a map that is solved for; None for none.
    """
    watch, (_, pointing) = Stopwatch(), observation_path(setup.observing, observation)
    sums, delays = _empty_sums(setup, with_signal_sims), delays_of_all_blocks(setup, observation, pointing, watch)
    with _saved(path, len(pointing.time_s)) as save:
        for block in setup.observing.blocks:
            _add_part(
                sums, reduce_block(setup, observation, pointing, block, delays_s_rad=delays, watch=watch), save, watch
            )
    kept, lost, measured = np.concatenate(sums.kept, axis=1), np.concatenate(sums.lost), _some(sums.sampled > 0)
    scale = psd_scale(setup.observing.scans, setup.stream_type)
    psd = sums.power / np.where(sums.sampled > 0, sums.sampled, 1)[:, None] * scale
    white = np.full(len(psd), np.nan)
    if setup.scene.score:
        white = _add_noise_only(sums, setup, observation, pointing, psd, watch)
    if weights_path is not None:
        save_weights(weights_path, setup, observation, sums.noise_weights)
    analysis = setup.analysis
    maps = {name: _plane(analysis.geometry, setup.stream_type, *item) for name, item in sums.maps.items()}
    exposure = {name: sums.exposure.get(name, item[1]).reshape(item[1].shape) for name, item in maps.items()}
    worth, best = _choose(setup, maps, exposure, watch)
    ordered = [maps[name] for name in analysis.data_set_names]
    total, hits = (np.stack(planes) for planes in zip(*ordered, strict=True))
    weights = np.stack([exposure[name] for name in analysis.data_set_names]) if sums.exposure else hits
    with watch("weights"):
        alike = zip(analysis.data_set_names, total, weights, hits, strict=True)
        of_sets = [_map_noise(sums, analysis, *item) for item in alike]
        noise, of_bins = (np.array(part) for part in zip(*of_sets, strict=True))
    removed = np.concatenate(sums.removed, axis=1)
    compared = [mean_psd(list(of_pipeline)) for of_pipeline in zip(*sums.compared, strict=True)]
    return ObservationResult(
        observation=observation,
        sums=total,
        hits=hits,
        exposure=weights,
        noise_mk2=noise,
        bin_noise_mk2=of_bins,
        signal_maps=scored_signal_maps(analysis, setup.stream_type, sums.signal_maps, best),
        discarded=tuple((~kept & ~lost).sum(axis=1).tolist()),
        iterations=tuple(np.concatenate(sums.iterations, axis=1)[:, _some(~lost)].mean(axis=1).tolist()),
        removed=tuple(float(row[_some(of)].mean()) for row, of in zip(removed, kept, strict=True)),
        figures_of_merit=worth,
        weather=observation_weather(setup, observation),
        elevation_rad=float(pointing.scan_elevation_rad.mean()),
        raw_psd=mean_psd(sums.raw),
        clean_psd=psd[measured].mean(axis=0),
        compared_psd=np.array(compared).reshape(-1, psd.shape[1]),
        white_mk2_hz=float(white[measured].mean()),
        flagged=sums.flagged / (len(psd) * len(pointing.time_s)),
        seconds=watch.seconds,
        **scored_split_maps(analysis, setup.stream_type, sums.split_maps),
    )


@contextmanager
def _saved(path: Path | None, n_samp: int) -> Iterator[Callable[[CleanedBlock], None]]:
    """Write the streams of each block to a file of an observation of `n_samp` samples; to none without a path."""
    if path is None:
        yield lambda part: None
        return
    with timestream_file(path, n_samp) as save:
        yield lambda part: save(part.streams.timestreams())


def kept_scans(setup: Setup, observation: int) -> np.ndarray:
    """Find the scans of an observation that each pipeline does not discard, (n_pipeline, n_scan) bool."""
    (_, pointing), watch = observation_path(setup.observing, observation), Stopwatch()
    delays = delays_of_all_blocks(setup, observation, pointing, watch)
    parts = (
        reduce_block(setup, observation, pointing, block, delays_s_rad=delays, watch=watch)
        for block in setup.observing.blocks
    )
    return np.concatenate([[item.kept | part.streams.lost_scans for item in part.cleaned] for part in parts], axis=1)


def _empty_sums(setup: Setup, with_signal_sims: bool) -> _Sums:
    n_pixel = setup.analysis.geometry.n_y * setup.analysis.geometry.n_x
    hits = {pipeline.data_set: np.zeros(n_pixel, np.int64) for pipeline in setup.analysis.pipelines}
    names = [name for name in setup.analysis.data_set_names if name != OPTIMAL]
    # Noise-only sets have the hits of the actual data.
    maps = {name: (np.zeros(n_pixel), hits.get(name, hits[ACTUAL])) for name in names}
    power = np.zeros((setup.camera.n_det, samples_per_scan(setup.observing.scans) // 2 + 1))
    signals = empty_signal_maps(setup.analysis, setup.analysis.n_signal_skies) if with_signal_sims else None
    exposure = {}
    if setup.analysis.weight is not None or setup.scene.map.solved:
        exposure = {name: np.zeros(n_pixel) for name in hits}
        exposure |= {name: exposure[ACTUAL] for name in names if name not in hits}
    found = _Sums(maps, exposure, signals, empty_split_maps(setup.analysis), power, np.zeros(len(power)))
    if weighs_itself(setup.scene.map):
        found.probe = {name: np.zeros(n_pixel) for name in hits}
        found.probe |= {name: found.probe[ACTUAL] for name in names if name not in hits}
    return found


def _add_noise_only(
    sums: _Sums, setup: Setup, observation: int, pointing: Pointing, psd: np.ndarray, watch: Stopwatch
) -> np.ndarray:
    """Add the noise-only sets, from PSDs (n_det, n_freq) [mK^2/Hz] of the data; returns white levels (n_det,)."""
    scans = setup.observing.scans
    white = white_level(psd, samples_per_scan(scans), scans.sample_rate_hz, setup.scene.score.white_noise_above_hz)
    add_simulated(
        sums.maps,
        sums.kept,
        setup,
        observation,
        pointing,
        psd=psd,
        white=white,
        noise_weights=sums.noise_weights,
        pixels=sums.pixels,
        watch=watch,
    )
    return white


def _add_part(sums: _Sums, part: CleanedBlock, save: Callable[[CleanedBlock], None], watch: Stopwatch) -> None:
    """Add a reduced block to the sums; its streams are freed on return unless the caller keeps them."""
    setup = part.setup
    save(part)
    with watch("spectra"):
        _add_spectra(sums, part)
    with watch("pixels"):
        index_of_each = part.index
    sums.pixels = part.pixels if len(setup.observing.blocks) == 1 else None
    if setup.scene.map.solved:
        with watch("noise_weights"):
            normals = part.normal
        for pipeline, normal, item in zip(part.pipelines, normals, part.cleaned, strict=True):
            if normal is not None:
                _add_right_side(sums, part, pipeline, normal, item, watch)
    for pipeline, index, item in zip(part.pipelines, index_of_each, part.cleaned, strict=True):
        if setup.scene.map.solved:
            continue
        with watch("binning"):
            weight, bounds = setup.analysis.weight_of(pipeline.rows), part.streams.scan_bounds
            bin_samples(weighted(item.data_mk, weight), index, bounds, item.kept, *sums.maps[pipeline.data_set])
            if weight is not None:
                alike = np.empty_like(item.data_mk)
                alike[:] = weight[:, None]
                bin_samples(alike, index, bounds, item.kept, sums.exposure[pipeline.data_set], None)
    if sums.split_maps is not None:
        with watch("splits"):
            add_split_maps(sums.split_maps, part)
    for name in ("kept", "iterations", "removed"):
        getattr(sums, name).append(np.array([getattr(item, name) for item in part.cleaned]))
    sums.lost.append(part.streams.lost_scans)
    sums.flagged += 0 if part.streams.flags is None else int(np.count_nonzero(part.streams.flags))
    if sums.signal_maps is not None:
        with watch("transfer_function"):
            add_signal_maps(sums.signal_maps, part, setup.analysis.signal_skies_mk)


def _add_right_side(
    sums: _Sums, part: CleanedBlock, pipeline: CleaningPipeline, normal: NormalBlock, item: Cleaned, watch: Stopwatch
) -> None:
    """Add the cleaned streams of a map that is solved for to its right-hand side, and keep their noise weights."""
    setup = part.setup
    with watch("binning"):
        total, hits = sums.maps[pipeline.data_set]
        add_right_side(normal, item.data_mk, total)
        add_diagonal(normal, sums.exposure[pipeline.data_set], hits)
        if weighs_itself(setup.scene.map):
            probe = probe_map(setup.analysis.geometry).reshape(1, -1).astype(setup.stream_type)
            add_normal(normal, probe, sums.probe[pipeline.data_set][None])
    sums.noise_weights.append(block_weights(part.block, pipeline, normal, part.streams.flags))


def _choose(
    setup: Setup, maps: dict[str, Map], exposure: dict[str, np.ndarray], watch: Stopwatch
) -> tuple[np.ndarray | None, int]:
    """Add the optimal set, the maps of the best pipeline; returns the figures of merit and the place of the best.

    None and 0 where pipelines are not compared.
    """
    analysis = setup.analysis
    if not analysis.chooses:
        return None, 0
    with watch("figure_of_merit"):
        names = [pipeline.data_set for pipeline in analysis.whole_pipelines]
        of_pipelines = [(maps[name][0], exposure[name]) for name in names]
        worth = figures_of_merit(analysis, transfer_functions(setup), of_pipelines)
    best = max(0, int(best_places(worth[:, 0])))
    maps[OPTIMAL], exposure[OPTIMAL] = maps[names[best]], exposure[names[best]]
    return worth, best


def _map_noise(
    sums: _Sums, analysis: AnalysisSetup, name: str, total: np.ndarray, weight: np.ndarray, hits: np.ndarray
) -> tuple[float, np.ndarray]:
    """Noise of the map of one data set, and in each multipole bin."""
    if not weighs_itself(analysis.scene.map):
        return map_noise(analysis.region, total, weight)
    probe, observed = probe_map(analysis.geometry), sums.probe[name].reshape(total.shape)
    return weighed_noise(analysis.region, total, hits, probe=probe, observed=observed)


def _add_spectra(sums: _Sums, part: CleanedBlock) -> None:
    streams, seen = part.streams, ~part.streams.lost_scans
    scale, rows = psd_scale(part.setup.observing.scans, part.setup.stream_type), part.pipelines[0].rows
    actual, *others = part.cleaned[: len(part.setup.analysis.whole_pipelines)]
    sums.power[rows] += cleaned_power(streams, rows, actual)
    sums.sampled[rows] += sampled_scans(streams, rows, actual.kept)
    raw = hann_power(part.data_mk[rows], part.block.n_scans, seen)
    sums.raw.append((int(seen.sum()), (raw / max(1, seen.sum()) * scale).mean(axis=0)))
    sums.compared.append([cleaned_psd(streams, rows, item, scale) for item in others])


def _some(kept: np.ndarray) -> np.ndarray:
    """Select the kept scans, or all (of zeros) if none is kept, so that a mean is defined."""
    return kept if kept.any() else np.ones_like(kept)


def _plane(geometry: MapGeometry, dtype: np.dtype, total: np.ndarray, hits: np.ndarray) -> Map:
    shape = (geometry.n_y, geometry.n_x)
    kind = np.int32 if hits.max() < 2**31 else np.int64
    return total.reshape(shape).astype(dtype), hits.reshape(shape).astype(kind)


@keep_last(2)
def transfer_functions(setup: Setup) -> np.ndarray:
    """Measure the power transfer function of each pipeline for a flat CMB sky and for a point source.

    From the observations of `REFERENCE`. With several blocks, from those that reach the centre of the map: one, or two
    if their number is even.

    Returns
    -------
    (n_pipeline, 2, n_bin) array
        0 for a pipeline that discards all their scans.
    """
    skies = setup.analysis.signal_skies_mk[[0, -1]]
    everywhere = np.ones_like(setup.analysis.region.taper)
    powers = np.zeros((len(setup.analysis.whole_pipelines), len(TARGETS), 2, len(setup.analysis.region.rings.ell)))
    for observation in REFERENCE:
        signals = _signals_in_central_blocks(setup, observation % setup.scene.observations, skies)
        maps = scored_signal_maps(setup.analysis, setup.stream_type, signals, 0)
        for r, pipeline in enumerate(setup.analysis.whole_pipelines):
            place = setup.analysis.transfer_function_names.index(pipeline.data_set)
            for s, state in np.ndindex(powers.shape[1:3]):
                powers[r, s, state] += setup.analysis.region.ring_noise(maps[s, place, state], everywhere)
    return np.divide(powers[:, :, 1], powers[:, :, 0], out=np.zeros_like(powers[:, :, 0]), where=powers[:, :, 0] > 0)


def _signals_in_central_blocks(setup: Setup, observation: int, skies_mk: np.ndarray) -> np.ndarray:
    """Simulate signals in the blocks of an observation that reach the centre of the map, and nothing else."""
    signal_maps, watch = empty_signal_maps(setup.analysis, len(skies_mk)), Stopwatch()
    _, pointing = observation_path(setup.observing, observation)
    delays = delays_of_all_blocks(setup, observation, pointing, watch)
    blocks = setup.observing.blocks
    for block in blocks[(len(blocks) - 1) // 2 : len(blocks) // 2 + 1]:
        part = reduce_block(setup, observation, pointing, block, delays_s_rad=delays, watch=watch)
        add_signal_maps(signal_maps, part, skies_mk)
    return signal_maps
