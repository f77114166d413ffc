"""Winds, tracks and realizations of a layer in the scans of an observation."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from surveysim.atmosphere.evolution import draw_evolution
from surveysim.atmosphere.layers import Layer
from surveysim.atmosphere.weather import Weather
from surveysim.runtime.rng import NormalDeviates, RandomPurpose, generator, normal_deviates
from surveysim.telescope.pointing import Pointing
from surveysim.telescope.smooth_process import smooth_process
from surveysim.timestreams.scan_blocks import Block

if TYPE_CHECKING:
    from surveysim.atmosphere.curved_tracks import CurvedTracks
    from surveysim.atmosphere.scan_trends import StripPoints
    from surveysim.atmosphere.screen_simulation import Tracks

# Components along azimuth (on the sky) and elevation, of all scans or (n_scan,) of each.
AzElVector = tuple[float, float] | tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class LayerNumbers:
    """Random numbers of one layer, or of one of its realizations in time, in one observation."""

    seed: int
    observation: int
    realization: int
    part: str

    def deviates(self, purpose: RandomPurpose, block: int = 0) -> NormalDeviates:
        """Make the normal deviates of one purpose."""
        return normal_deviates(
            self.seed, purpose, self.observation, realization=self.realization, block=block, part=self.part
        )

    def generator(self, purpose: RandomPurpose) -> np.random.Generator:
        """Make the generator of one purpose."""
        return generator(self.seed, purpose, self.observation, realization=self.realization, part=self.part)


@dataclass(frozen=True)
class LayerScans:
    """All scans of an observation over a layer.

    Attributes
    ----------
    bounds : (n_scan, 2)
        First sample and end of each scan.
    tracks
        Tracks of the scans over the layer.
    points
        Points that define the trends of the scans.
    amplitude_mk : (n_scan,) or (n_scan, n)
        Amplitude of each scan or sample.
    add
        Function that adds a realization to streams along some tracks.
    """

    bounds: np.ndarray
    tracks: "Tracks | CurvedTracks"
    points: "StripPoints"
    amplitude_mk: np.ndarray
    add: Callable[..., None]


@dataclass(frozen=True)
class LayerRealization:
    """One realization of a layer in time.

    Attributes
    ----------
    numbers
        Its random numbers.
    weight : (n_scan, n)
        Weights in the samples of a block; None for a frozen layer.
    """

    numbers: LayerNumbers
    weight: np.ndarray | None = None


def layer_wind(layer: Layer, weather: Weather, pointing: Pointing, numbers: LayerNumbers) -> AzElVector:
    """Angular velocity of a layer in the scans of an observation."""
    speed, angle = layer.wind(weather)
    drift = layer.section.wind_drift
    if drift is None:
        return speed * math.cos(angle), speed * math.sin(angle)
    bounds = pointing.scan_bounds
    middle = (pointing.time_s[bounds[:, 0]] + pointing.time_s[bounds[:, 1] - 1]) / 2
    process = smooth_process(2, middle[-1], drift.time_scale_s, numbers.deviates(RandomPurpose.WIND_DRIFT))
    faster, turned = process.at(middle)
    speeds, angles = speed * np.exp(drift.speed_rms * faster), angle + drift.direction_rms_rad * turned
    return speeds * np.cos(angles), speeds * np.sin(angles)


def layer_realizations(
    layer: Layer, pointing: Pointing, block: Block, numbers: LayerNumbers
) -> Iterator[LayerRealization]:
    """Yield the realizations of a layer in a block: one of a frozen layer."""
    seconds = layer.section.decorrelation_time_s
    if seconds is None:
        yield LayerRealization(numbers)
        return
    bounds, time_s = pointing.scan_bounds, pointing.time_s
    evolution = draw_evolution(
        seconds,
        scan_s=float(time_s[bounds[0, 1] - 1] - time_s[0]),
        end_s=float(time_s[-1]),
        rng=numbers.generator(RandomPurpose.EVOLUTION),
    )
    times = time_s[bounds[block.first, 0] : bounds[block.end - 1, 1]].reshape(block.end - block.first, -1)
    for number in range(evolution.count):
        own = replace(numbers, part=f"{layer.part} realization {number}")
        yield LayerRealization(own, evolution.weight(number, times))


def mean_azimuth(pointing: Pointing) -> float:
    """Mean azimuth of the samples of an observation."""
    return math.atan2(np.sin(pointing.azimuth_rad).mean(), np.cos(pointing.azimuth_rad).mean())


def moved(velocity_rad_s: np.ndarray, middle_s: np.ndarray, begin_s: np.ndarray) -> np.ndarray:
    """Integrate the velocity (n_scan, 2) of the layer at mid-scan to its displacement at the start of each scan."""
    between = (velocity_rad_s[1:] + velocity_rad_s[:-1]) / 2 * np.diff(middle_s)[:, None]
    until_middle = np.concatenate([np.zeros((1, 2)), np.cumsum(between, axis=0)])
    return until_middle - velocity_rad_s * (middle_s - begin_s)[:, None]
