"""Winds and realizations of a layer in the scans of an observation."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mapmaker.timestreams import scan_bounds
from surveysim.atmosphere.evolution import Evolution
from surveysim.atmosphere.layers import Layer
from surveysim.atmosphere.weather import Weather
from surveysim.runtime.rng import NormalDeviates, RandomPurpose, generator, normal_deviates
from surveysim.telescope.pointing import Pointing
from surveysim.telescope.smooth_process import smooth_process
from surveysim.timestreams.scan_blocks import Block

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

    def share(self, purpose: RandomPurpose) -> float:
        """Draw a number from 0 to 1."""
        return float(
            generator(self.seed, purpose, self.observation, realization=self.realization, part=self.part).random()
        )


@dataclass(frozen=True)
class LayerView:
    """Scans of an observation that see one realization of a layer.

    Attributes
    ----------
    pointing
        Pointing of the scans, which share the trends of the layer.
    block
        Those of them that are drawn.
    wind_rad_s
        Angular velocity of the layer.
    wind_azimuth_rad
        Azimuth of the frame of the velocity, for scans over a wide range of azimuths.
    start
        First sample of the scans that are drawn, in the streams of the block of the observation.
    weight : (n_scan, n)
        Weights of the realization in the samples of the scans that are drawn; None for a frozen layer.
    """

    pointing: Pointing
    block: Block
    wind_rad_s: AzElVector
    wind_azimuth_rad: float
    start: int = 0
    weight: np.ndarray | None = None


def layer_wind(layer: Layer, weather: Weather, pointing: Pointing, numbers: LayerNumbers) -> AzElVector:
    """Angular velocity of a layer in the scans of an observation."""
    speed, angle = layer.wind(weather)
    drift = layer.section.wind_drift
    if drift is None:
        return speed * math.cos(angle), speed * math.sin(angle)
    bounds = scan_bounds(pointing.scan)
    middle = (pointing.time_s[bounds[:, 0]] + pointing.time_s[bounds[:, 1] - 1]) / 2
    process = smooth_process(2, middle[-1], drift.time_scale_s, numbers.deviates(RandomPurpose.WIND_DRIFT))
    faster, turned = process.at(middle)
    speeds, angles = speed * np.exp(drift.speed_rms * faster), angle + drift.direction_rms_rad * turned
    return speeds * np.cos(angles), speeds * np.sin(angles)


def evolving_views(layer: Layer, of: LayerView, numbers: LayerNumbers) -> Iterator[tuple[int, LayerView]]:
    """Yield number and view of each realization of a layer that evolves; none of a frozen one.

    The scans of a realization follow from the observation, whatever its blocks.
    """
    seconds = layer.section.decorrelation_time_s
    if seconds is None:
        return
    bounds, time_s = scan_bounds(of.pointing.scan), of.pointing.time_s
    evolution = Evolution(seconds, numbers.share(RandomPurpose.EVOLUTION))
    for number, first, end in evolution.realizations(time_s[bounds[:, 0]], time_s[bounds[:, 1] - 1]):
        begin, stop = max(first, of.block.first), min(end, of.block.end)
        if begin < stop:
            samples = slice(bounds[begin, 0], bounds[stop - 1, 1])
            weight = evolution.weight(number, time_s[samples]).reshape(stop - begin, -1)
            block = Block(of.block.number, begin - first, stop - first)
            wind = _of_scans(of.wind_rad_s, first, end)
            start = int(samples.start - bounds[of.block.first, 0])
            yield number, LayerView(of.pointing.scans(first, end), block, wind, of.wind_azimuth_rad, start, weight)


def _of_scans(wind_rad_s: AzElVector, first: int, end: int) -> AzElVector:
    azimuth, elevation = wind_rad_s
    if isinstance(azimuth, np.ndarray) and isinstance(elevation, np.ndarray):
        return azimuth[first:end], elevation[first:end]
    return wind_rad_s


def mean_azimuth(pointing: Pointing) -> float:
    """Mean azimuth of the samples of an observation."""
    return math.atan2(np.sin(pointing.azimuth_rad).mean(), np.cos(pointing.azimuth_rad).mean())


def moved(velocity_rad_s: np.ndarray, middle_s: np.ndarray, begin_s: np.ndarray) -> np.ndarray:
    """Integrate the velocity (n_scan, 2) of the layer at mid-scan to its displacement at the start of each scan."""
    between = (velocity_rad_s[1:] + velocity_rad_s[:-1]) / 2 * np.diff(middle_s)[:, None]
    until_middle = np.concatenate([np.zeros((1, 2)), np.cumsum(between, axis=0)])
    return until_middle - velocity_rad_s * (middle_s - begin_s)[:, None]
