"""Maps of simulated signals: of each sky, and of the difference that it makes to cleaned streams.

The skies of a block are cleaned in one pass, as more scans of one observation: the same bits as one after the other.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mapmaker.cleaning import Cleaned
from mapmaker.cleaning.responsivity import OBSERVATION
from mapmaker.kernels.pixels import bin_samples
from mapmaker.normal_equations import NormalBlock, add_right_side
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.cleaned_block import CleanedBlock
from surveysim.reduction.cleaning_pipelines import OPTIMAL, AuxiliaryData, CleaningPipeline, apply_pipeline
from surveysim.reduction.detector_weights import weighted
from surveysim.timestreams.response import write_sky_signal

# Samples of all streams that are cleaned in one pass: few enough for the processor's cache and for memory.
_MOST_SAMPLES = 2**21


def empty_signal_maps(analysis: AnalysisSetup, n_sky: int) -> np.ndarray:
    """Make empty flat maps (n_sky, n_transfer, 2, n_pixel) of skies, before and after cleaning."""
    n_pixel = analysis.geometry.n_y * analysis.geometry.n_x
    return np.zeros((n_sky, len(analysis.transfer_function_names), 2, n_pixel))


def add_signal_maps(signal_maps: np.ndarray, part: CleanedBlock, skies_mk: np.ndarray) -> None:
    """Add each sky as a perfect pointing sees it, and the difference that it makes to the cleaned data, in place."""
    at_once = max(1, _MOST_SAMPLES // (part.data_mk.size * (1 + len(part.auxiliary.other_bands_mk))))
    if part.setup.scene.cleaning.responsivities == OBSERVATION:  # a fit to all scans is that of one sky
        at_once = 1
    for first in range(0, len(skies_mk), at_once):
        some = slice(first, first + at_once)
        _add_some(signal_maps[some], part, skies_mk[some])


def _add_some(signal_maps: np.ndarray, part: CleanedBlock, skies_mk: np.ndarray) -> None:
    setup, streams = part.setup, part.streams
    signals = np.empty((len(skies_mk), *part.data_mk.shape), part.data_mk.dtype)
    write_sky_signal(setup, part.pointing, skies_mk, signals)
    passed = [streams.filled(streams.response.output(*item)) for item in zip(skies_mk, signals, strict=True)]
    normals = part.normal if setup.scene.map.solved else (None,) * len(part.pipelines)
    for pipeline, index, base, normal in zip(part.pipelines, part.index, part.cleaned, normals, strict=True):
        kept, differences = _cleaned_signals(part, pipeline, base, passed)
        place = setup.analysis.transfer_function_names.index(pipeline.data_set)
        for maps, keep, *states in zip(signal_maps, kept, signals[:, pipeline.rows], differences, strict=True):
            if setup.scene.map.solved:
                if normal is not None:
                    _add_right_sides(maps[place], normal, states, streams.scan_bounds[~keep])
                continue
            weight = setup.analysis.weight_of(pipeline.rows)
            for flat_map, data in zip(maps[place], states, strict=True):
                bin_samples(weighted(data, weight), index, streams.scan_bounds, keep, flat_map, None)


def _add_right_sides(maps: np.ndarray, normal: NormalBlock, states: Sequence[np.ndarray], lost: np.ndarray) -> None:
    """Add a signal before cleaning to its map with the weights of the white noise, and after it to its right side.

    The noise weights are of the scans that are kept without the signal; scans [start, stop) that it loses, `lost`,
    add nothing.
    """
    before, after = (data.copy() for data in states)
    for start, stop in lost:
        before[:, start:stop] = after[:, start:stop] = 0
    bounds = normal.scan_bounds
    for (start, stop), white in zip(bounds, normal.noise.white(bounds).T, strict=True):
        before[:, start:stop] *= white[:, None].astype(before.dtype)
    bin_samples(before, normal.index, bounds, np.ones(len(bounds), bool), maps[0], None)
    add_right_side(normal, after, maps[1])


def _cleaned_signals(
    part: CleanedBlock, pipeline: CleaningPipeline, base: Cleaned, passed: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Clean the streams of a pipeline with each of some signals added.

    Returns
    -------
    kept : (n_sky, n_scan)
        Scans that are kept with and without the signal.
    differences : (n_sky, n_det, n_samp)
        Cleaned streams less those without the signal, `base`.
    """
    raw, n_sky = part.data_mk[pipeline.rows], len(passed)
    n_samp, scans = raw.shape[1], _cleaned_again(part, pipeline, base.kept)
    both = np.empty((len(raw), n_sky, n_samp), raw.dtype)
    for s, signal in enumerate(passed):
        np.add(raw, signal[pipeline.rows], out=both[:, s])
    bounds = part.streams.scan_bounds[scans]
    cleaned = apply_pipeline(
        part.setup.scene.cleaning,
        pipeline,
        both.reshape(len(raw), -1),
        scan_bounds=np.concatenate([bounds + s * n_samp for s in range(n_sky)]),
        focal_plane=part.streams.focal_plane.subset(pipeline.rows),
        # Fits to scans begin with the responsivities without the signal, which hardly changes them.
        auxiliary=_repeated(part.auxiliary, scans, n_sky, base.responsivity[scans] if scans is base.kept else None),
        sample_rate_hz=part.setup.observing.scans.sample_rate_hz,
    )
    kept = np.repeat(base.kept[None], n_sky, axis=0)
    kept[:, scans] &= cleaned.kept.reshape(n_sky, -1)
    if scans is not base.kept:  # another fit to all scans: the difference is not the signal's alone
        kept[(kept != base.kept).any(axis=1)] = False
    differences = cleaned.data_mk.reshape(both.shape)
    differences -= base.data_mk[:, None]
    return kept, differences.transpose(1, 0, 2)


def _repeated(auxiliary: AuxiliaryData, scans: np.ndarray, n_sky: int, first_guess: np.ndarray | None) -> AuxiliaryData:
    """Auxiliary data of some scans (n_scan,) bool of a block, for each of some skies side by side."""
    return replace(
        auxiliary,
        delays_s_rad=np.tile(auxiliary.delays_s_rad[scans], (n_sky, 1)),
        other_bands_mk=np.tile(auxiliary.other_bands_mk, (1, 1, n_sky)),
        first_guess=None if first_guess is None else np.tile(first_guess, (n_sky, 1)),
    )


def _cleaned_again(part: CleanedBlock, pipeline: CleaningPipeline, kept: np.ndarray) -> np.ndarray:
    """Select the scans (n_scan,) bool to clean once more with a signal: those kept without it.

    Discarded scans would take all iterations for nothing. If all scans share one fit, all take part again unless it
    failed.
    """
    together = part.setup.scene.cleaning.responsivities == OBSERVATION and pipeline.takes_responsivities
    return np.ones_like(kept) if together and kept.any() else kept


def scored_signal_maps(
    analysis: AnalysisSetup, dtype: np.dtype, signal_maps: np.ndarray | None, best: int
) -> np.ndarray | None:
    """Cut the signal maps to the summed patch; the optimal set takes those of the best pipeline, number `best`."""
    if signal_maps is None:
        return None
    patch, names = analysis.sums_patch, analysis.transfer_function_names
    maps = signal_maps.reshape(*signal_maps.shape[:3], analysis.geometry.n_y, analysis.geometry.n_x)
    maps = maps[..., patch, patch].astype(dtype)
    if analysis.chooses:
        maps[:, names.index(OPTIMAL)] = maps[:, names.index(analysis.whole_pipelines[best].data_set)]
    return maps
