"""One block of an observation, drawn and cleaned by every pipeline."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mapmaker.cleaning import Cleaned
from mapmaker.geometry import boresight_pixels
from mapmaker.normal_equations import NormalBlock
from surveysim.reduction.cleaning_pipelines import AuxiliaryData, CleaningPipeline, apply_pipeline
from surveysim.reduction.layer_delays import block_delays
from surveysim.reduction.live_detectors import live_pipelines
from surveysim.reduction.noise_weights import measured_weight
from surveysim.reduction.setup import Setup
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.observation import DrawnBlock, Stopwatch, draw_band, draw_block
from surveysim.timestreams.scan_blocks import Block


@dataclass(frozen=True)
class CleanedBlock:
    """A block with its streams, without gaps in `data_mk` (n_det, n_samp), and auxiliary data.

    For each pipeline, with the detectors that have samples in the block: cleaned streams.
    """

    setup: Setup
    observation: int
    block: Block
    pointing: Pointing
    streams: DrawnBlock
    data_mk: np.ndarray
    pipelines: tuple[CleaningPipeline, ...]
    auxiliary: AuxiliaryData
    cleaned: tuple[Cleaned, ...]

    @cached_property
    def pixels(self) -> np.ndarray:
        """Pixels (n_det, n_samp) of all samples: -1 for lost samples and off the map."""
        return block_pixels(self.setup, self.pointing, self.streams.flags, slice(None))

    @cached_property
    def index(self) -> tuple[np.ndarray, ...]:
        """Pixels (n_det, n_samp) of the samples of each pipeline."""
        return tuple(self.pixels[pipeline.rows] for pipeline in self.pipelines)

    @cached_property
    def normal(self) -> tuple[NormalBlock | None, ...]:
        """For each pipeline of maps that are solved for, pointing and noise weights of the kept scans; None without."""
        return tuple(map(self._normal, self.pipelines, self.index, self.cleaned))

    def _normal(self, pipeline: CleaningPipeline, index: np.ndarray, item: Cleaned) -> NormalBlock | None:
        bounds = self.streams.scan_bounds[item.kept]
        if not len(bounds):
            return None
        return NormalBlock(index, bounds, measured_weight(self.setup, pipeline.rows, item.data_mk, bounds))


def reduce_block(
    setup: Setup,
    observation: int,
    whole: Pointing,
    block: Block,
    *,
    delays_s_rad: np.ndarray | None,
    watch: Stopwatch,
) -> CleanedBlock:
    """Draw and clean one block of an observation with the pointing `whole`; without delays they are the block's own."""
    streams = draw_block(setup, observation, whole, block, watch)
    pointing, plane, pipelines = streams.of.pointing, streams.focal_plane, live_pipelines(setup, streams.live)
    data_mk = streams.filled(_less_bright_sky(setup, streams))
    with watch("wind"):
        bands = _other_bands(setup, observation, whole, block, streams.data_mk)
        delays = block_delays(setup, streams) if delays_s_rad is None else delays_s_rad[block.first : block.end]
        auxiliary = AuxiliaryData(delays, bands, setup.analysis.calibration)
    section, cleaned = setup.scene.cleaning, []
    for pipeline in pipelines:
        with watch("cleaning" if pipeline.steps == section.algorithm else f"cleaning {pipeline.label}"):
            item = apply_pipeline(
                section,
                pipeline,
                data_mk[pipeline.rows],
                scan_bounds=streams.scan_bounds,
                focal_plane=plane.subset(pipeline.rows),
                auxiliary=auxiliary,
                sample_rate_hz=setup.observing.scans.sample_rate_hz,
            )
        cleaned.append(item)
    return CleanedBlock(setup, observation, block, pointing, streams, data_mk, pipelines, auxiliary, tuple(cleaned))


def block_pixels(setup: Setup, pointing: Pointing, flags: np.ndarray | None, rows: slice) -> np.ndarray:
    """Pixels (n, n_samp) of the samples of some detectors: -1 for lost samples (n_det, n_samp) and off the map."""
    plane, angle = setup.camera.focal_plane.subset(rows), pointing.array_angle_rad
    pixels = boresight_pixels(setup.analysis.geometry, pointing.xi_rad, pointing.eta_rad, angle, plane=plane)
    if flags is not None:
        pixels[flags[rows]] = -1
    return pixels


def _less_bright_sky(setup: Setup, streams: DrawnBlock) -> np.ndarray:
    """Subtract the bright sky, as detectors of unit responsivity see it; the streams themselves without one."""
    if setup.bright_sky_mk is None:
        return streams.data_mk
    index = block_pixels(setup, streams.of.pointing, None, slice(None))
    padded = np.append(setup.bright_sky_mk, 0.0).astype(streams.data_mk.dtype)  # index -1, off the map, is the last
    return streams.data_mk - padded[index]


def _other_bands(setup: Setup, observation: int, whole: Pointing, block: Block, data_mk: np.ndarray) -> np.ndarray:
    """Draw the other bands (n_band, n_det, n_samp) that a pipeline subtracts, of the type of the streams `data_mk`."""
    streams = np.empty((len(setup.others), *data_mk.shape), data_mk.dtype)
    for band, out in zip(setup.others, streams, strict=True):
        out[:] = draw_band(band, observation, whole, block)
    return streams
