"""Noise-only data sets (section 5.2): streams of the measured PSD of each detector, or of its white level alone."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mapmaker.chunks import row_chunks
from mapmaker.kernels.pixels import bin_samples
from mapmaker.kernels.spectra import scale_mean_removed
from mapmaker.normal_equations import NormalBlock, add_right_side
from surveysim.reduction.cleaned_block import block_pixels
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.detector_weights import weighted
from surveysim.reduction.noise_weights import BlockWeights
from surveysim.reduction.setup import Setup
from surveysim.runtime.rng import NormalDeviates, RandomPurpose, normal_deviates
from surveysim.telescope.pointing import Pointing
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.noise import draw_from_psd
from surveysim.timestreams.observation import Stopwatch, sample_flags
from surveysim.timestreams.observed_block import observed_block


@dataclass(frozen=True)
class NoiseOnlySet:
    """A noise-only set, uncorrelated between detectors.

    Parameters
    ----------
    purpose
        Purpose of its random numbers.
    draw
        Function of the setup, the deviates and the detectors to draw, with the measured PSDs `psd` (n_det, n_freq) and
        white levels `white` (n_det,) [mK^2/Hz] of all detectors, and the number of scans `n_scans`. It returns the
        streams [mK], the mean of each scan removed as in cleaning.
    """

    purpose: RandomPurpose
    draw: Callable[..., np.ndarray]


def add_simulated(
    maps: Mapping[str, tuple[np.ndarray, np.ndarray]],
    kept_scans: Sequence[np.ndarray],
    setup: Setup,
    observation: int,
    whole: Pointing,
    *,
    psd: np.ndarray,
    white: np.ndarray,
    noise_weights: Sequence[BlockWeights],
    pixels: np.ndarray | None,
    watch: Stopwatch,
) -> None:
    """Add the maps of the noise-only sets (section 5.2), in the scans that the actual data keep.

    Detectors are drawn some at a time, or together for a map that is solved for, whose noise weights tie them.

    Parameters
    ----------
    maps
        Sums and hits by data set. Sums are changed in place; hits are those of the actual data.
    kept_scans
        Kept scans (n_pipeline, n_scan) of each block.
    psd : (n_det, n_freq)
        PSDs measured on the cleaned streams [mK^2/Hz].
    white : (n_det,)
        White levels measured on the cleaned streams [mK^2/Hz].
    noise_weights
        Weights of the blocks, in maps that are solved for.
    pixels : (n_det, n_samp)
        Pixels of the samples of an observation of one block; None where they are computed anew.
    """
    solved = setup.scene.map.solved
    of_blocks = {item.block: item for item in noise_weights if item.data_set == ACTUAL}
    for block, kept in zip(setup.observing.blocks, kept_scans, strict=True):
        pointing = whole.scans(block.first, block.end)
        lost = None if pixels is not None else sample_flags(observed_block(setup, observation, block, whole), watch)
        scene, names = setup.scene, setup.scene.score.noise_only_sets
        purposes = [NOISE_ONLY_SETS[name].purpose for name in names]
        deviates = [
            normal_deviates(scene.seed, purpose, observation, block=block.number, band=scene.band_name)
            for purpose in purposes
        ]
        together = [slice(0, setup.camera.n_det)] if solved else row_chunks(setup.camera.n_det, len(pointing.time_s))
        for rows in together:
            weight = None if setup.analysis.weight is None else setup.analysis.weight[rows]
            with watch("pixels"):
                index = block_pixels(setup, pointing, lost, rows) if pixels is None else pixels[rows]
            for name, own in zip(names, deviates, strict=True):
                with watch("simulated sets"):
                    data = NOISE_ONLY_SETS[name].draw(setup, own, rows, psd=psd, white=white, n_scans=block.n_scans)
                if solved:
                    with watch("binning"):
                        _add_right_side(of_blocks.get(block.number), index, data, maps[name][0])
                    continue
                with watch("binning"):
                    bin_samples(weighted(data, weight), index, pointing.scan_bounds, kept[0], maps[name][0], None)


def _add_right_side(weights: BlockWeights | None, index: np.ndarray, data: np.ndarray, total: np.ndarray) -> None:
    """Add streams of all detectors to a right-hand side with the weights of the actual data; nothing without any."""
    if weights is not None:
        rows = weights.rows
        add_right_side(NormalBlock(index[rows], weights.bounds, weights.noise), data[rows], total)


def _draw_uncorrelated(
    setup: Setup, deviates: NormalDeviates, rows: slice, *, psd: np.ndarray, white: np.ndarray, n_scans: int
) -> np.ndarray:
    rate, n = setup.observing.scans.sample_rate_hz, samples_per_scan(setup.observing.scans)
    some, first = psd[rows, None, :], rows.start * n_scans
    streams = draw_from_psd(some, (len(some), n_scans), n, rate, deviates, first_stream=first)
    return streams.reshape(len(some), -1).astype(setup.stream_type, copy=False)


def _draw_white(
    setup: Setup, deviates: NormalDeviates, rows: slice, *, psd: np.ndarray, white: np.ndarray, n_scans: int
) -> np.ndarray:
    rate, n_samp = setup.observing.scans.sample_rate_hz, n_scans * samples_per_scan(setup.observing.scans)
    level = np.sqrt(white[rows] * rate / 2).astype(setup.stream_type)
    data = deviates.draw((len(level), n_samp), first=rows.start * n_samp, dtype=setup.stream_type)
    scale_mean_removed(data, n_scans, level)
    return data


# By their names in `score.noise_only_sets`.
NOISE_ONLY_SETS = {
    "uncorrelated": NoiseOnlySet(RandomPurpose.UNCORRELATED, _draw_uncorrelated),
    "white": NoiseOnlySet(RandomPurpose.WHITE, _draw_white),
}
