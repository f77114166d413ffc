"""Delays of the layer in the scans of an observation, for wind cleaning, from the wind in all its time-streams."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmaker.cleaning import slowness
from mapmaker.lost_samples import fill_flagged
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.wind import MIN_SCANS, WindTransforms, fit_wind, scan_velocities, wind_transforms
from surveysim.reduction.setup import Setup
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.observation import DrawnBlock, Stopwatch, draw_block
from surveysim.timestreams.scan_blocks import Block

LONGEST_DELAY = 0.2  # longest delay, as a fraction of a scan; the wind model allows a quarter


@dataclass(frozen=True)
class LayerMotion:
    """Measurement of the layer's motion in the scans of one block, before the fit to all blocks.

    Attributes
    ----------
    transforms
        None where all scans are lost.
    velocity_rad_s : (n_scan, 2)
        Velocity of the boresight in the array frame.
    used : (n_scan,)
        False for lost scans, which have no transforms.
    """

    transforms: WindTransforms | None
    velocity_rad_s: np.ndarray
    used: np.ndarray


def layer_motion(streams: Timestreams, sample_rate_hz: float) -> LayerMotion:
    """Measure the layer's motion in the streams of one block, without lost scans and detectors without a sample."""
    bounds, velocity, data = streams.scan_bounds, scan_velocities(streams), streams.data_mk
    used = np.ones(len(bounds), bool)
    if (flags := streams.flags) is not None:
        used = np.array([not flags[:, start:stop].all() for start, stop in bounds])
        data = fill_flagged(data, bounds, flags)
        data[flags.all(axis=1)] = 0  # the wind leaves constant detectors out
        for start, stop in bounds[~used]:
            data[:, start:stop] = 0  # not finite otherwise
    if not used.any():
        return LayerMotion(None, velocity, used)
    transforms = wind_transforms(data, bounds[used], streams.focal_plane, sample_rate_hz=sample_rate_hz)
    return LayerMotion(transforms, velocity, used)


def measured_delays(blocks: Sequence[LayerMotion], plane: FocalPlane) -> np.ndarray:
    """Fit the slowness (n_scan, 2) [s/rad] of the layer to the motion in all blocks of an observation.

    0 without a valid measurement, and for scans with too long delays.
    """
    velocity = np.concatenate([block.velocity_rad_s for block in blocks])
    none, used = np.zeros_like(velocity), np.concatenate([block.used for block in blocks])
    if used.sum() < MIN_SCANS:  # of a plan or a pilot
        return none
    transforms = [block.transforms for block in blocks if block.transforms is not None]
    wind = fit_wind(transforms, plane, scan_velocity_rad_s=velocity[used])
    if wind.flag:
        return none
    found = slowness(wind.velocity_rad_s, velocity)
    radius = np.hypot(plane.x_rad - plane.x_rad.mean(), plane.y_rad - plane.y_rad.mean()).max()
    seconds = transforms[0].n_samp / transforms[0].sample_rate_hz
    # A layer that hardly moves against the scan can't be followed within it.
    return np.where(np.hypot(*found.T)[:, None] * radius < LONGEST_DELAY * seconds, found, 0.0)


def block_delays(setup: Setup, drawn: DrawnBlock) -> np.ndarray:
    """Measure the slowness (n_scan, 2) [s/rad] in the streams of one block; 0 where no pipeline uses it."""
    if not setup.analysis.uses_wind:
        return np.zeros((len(drawn.scan_bounds), 2))
    motion = layer_motion(drawn.timestreams(), setup.observing.scans.sample_rate_hz)
    return measured_delays([motion], drawn.focal_plane)


def delays_of_all_blocks(setup: Setup, observation: int, whole: Pointing, watch: Stopwatch) -> np.ndarray | None:
    """Draw all blocks of an observation to measure the slowness (n_scan, 2) [s/rad] of the layer in them.

    None for a single block, whose streams are measured when they are cleaned, and where no pipeline uses it.
    """
    if len(setup.observing.blocks) == 1 or not setup.analysis.uses_wind:
        return None
    blocks = [_block_motion(setup, observation, whole, block, watch) for block in setup.observing.blocks]
    with watch("wind"):
        return measured_delays(blocks, setup.camera.focal_plane)


def _block_motion(setup: Setup, observation: int, whole: Pointing, block: Block, watch: Stopwatch) -> LayerMotion:
    drawn = draw_block(setup, observation, whole, block, watch)
    with watch("wind"):
        return layer_motion(drawn.timestreams(), setup.observing.scans.sample_rate_hz)
