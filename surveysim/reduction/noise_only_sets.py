"""The simulated data sets of section 5.2: streams of each detector's measured PSD, or of its white level alone."""

from collections.abc import Mapping, Sequence

import numpy as np

from mapmaker.chunks import row_chunks
from mapmaker.geometry import boresight_pixels
from mapmaker.kernels.pixels import bin_samples
from mapmaker.timestreams import scan_bounds
from surveysim.reduction.setup import Setup
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.telescope.pointing import Pointing
from surveysim.telescope.raster import samples_per_scan
from surveysim.timestreams.noise import draw_from_psd
from surveysim.timestreams.observation import Stopwatch

SIMULATED = {"uncorrelated": RandomPurpose.UNCORRELATED, "white": RandomPurpose.WHITE}


def mean_removed(data: np.ndarray, n_scans: int) -> np.ndarray:
    """Streams (n_det, n_samp) of equal scans side by side, less the mean of each scan."""
    scans = data.reshape(len(data), n_scans, -1)
    return (scans - scans.mean(axis=-1, keepdims=True)).reshape(data.shape)


def add_simulated(
    maps: Mapping[str, tuple[np.ndarray, np.ndarray]],
    kept_scans: Sequence[np.ndarray],
    setup: Setup,
    observation: int,
    whole: Pointing,
    *,
    psd: np.ndarray,
    white: np.ndarray,
    watch: Stopwatch,
) -> None:
    """Add the maps of section 5.2's simulated sets, in the scans that the actual data keep.

    `maps` holds sums and hits by data set, which grow in place; `kept_scans` of each block (n_pipeline, n_scan). `psd`
    (n_det, n_freq) and `white` (n_det,), measured on the cleaned streams [mK^2/Hz], are all that the sets need of them:
    detectors are taken some at a time.
    """
    plane = setup.camera.focal_plane
    for block, kept in zip(setup.observing.blocks, kept_scans, strict=True):
        pointing = whole.scans(block.first, block.end)
        angle, bounds = pointing.array_angle_rad[pointing.scan], scan_bounds(pointing.scan)
        names = setup.scene.score.noise_only_sets
        rngs = [generator(setup.scene.seed, SIMULATED[name], observation, block=block.number) for name in names]
        for rows in row_chunks(setup.camera.n_det, len(pointing.time_s)):
            with watch("pixels"):
                some = plane.subset(rows)
                index = boresight_pixels(setup.analysis.geometry, pointing.xi_rad, pointing.eta_rad, angle, plane=some)
            for name, rng in zip(names, rngs, strict=True):
                with watch("simulated sets"):
                    data = simulated_streams(setup, name, psd[rows], white[rows], block.n_scans, rng)
                with watch("binning"):
                    bin_samples(data, index, bounds, kept[0], *maps[name])


def simulated_streams(
    setup: Setup, name: str, psd: np.ndarray, white: np.ndarray, n_scans: int, rng: np.random.Generator
) -> np.ndarray:
    """Streams (n_det, n_samp) of section 5.2's simulated sets: each detector's measured PSD, or its white level.

    Uncorrelated between detectors; the mean of each scan is removed, as cleaning does.
    """
    rate, n = setup.observing.raster.sample_rate_hz, samples_per_scan(setup.observing.raster)
    if name == "uncorrelated":
        streams = draw_from_psd(psd[:, None, :], (len(psd), n_scans), n, rate, rng)
        return streams.reshape(len(psd), -1).astype(setup.stream_type, copy=False)
    data = rng.standard_normal((len(psd), n_scans * n), dtype=np.float32).astype(setup.stream_type, copy=False)
    data *= np.sqrt(white * rate / 2).astype(data.dtype)[:, None]
    return mean_removed(data, n_scans)
