"""A block of an observation: its pointing, weather, noise levels and random numbers."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from surveysim.atmosphere.weather import Weather, survey_weather
from surveysim.runtime.rng import NormalDeviates, RandomPurpose, generator, normal_deviates
from surveysim.telescope.noise_levels import WhiteByDetector, WhiteLevels, white_levels
from surveysim.telescope.pointing import Pointing
from surveysim.telescope.pointing_errors import true_pointing
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.simulation import Simulation, camera_white


@dataclass(frozen=True)
class ObservedBlock:
    """A block of an observation.

    Parameters
    ----------
    whole
        Pointing of the whole observation.
    weather
        Weather of the observation; None without an atmosphere.
    """

    setup: Simulation
    observation: int
    block: Block
    whole: Pointing
    weather: Weather | None

    @cached_property
    def pointing(self) -> Pointing:
        """Pointing of the block."""
        return self.whole.scans(self.block.first, self.block.end)

    @cached_property
    def true_pointing(self) -> Pointing:
        """Pointing of the block with its errors: `pointing` itself without errors."""
        true = true_pointing(self.setup.scene, self.observation, self.whole)
        return self.pointing if true is self.whole else true.scans(self.block.first, self.block.end)

    @cached_property
    def levels(self) -> WhiteLevels:
        """Photon and detector noise of the observation."""
        return _levels(self.setup, self.observation, self.weather)

    def generator(self, purpose: RandomPurpose | str, realization: int = 0) -> np.random.Generator:
        """Create the random generator of one purpose in this block, and in this band of the camera."""
        return generator(self.setup.scene.seed, purpose, self.observation, realization=realization, **self._place)

    def deviates(self, purpose: RandomPurpose | str, realization: int = 0) -> NormalDeviates:
        """Create the normal deviates of one purpose in this block, and in this band of the camera."""
        return normal_deviates(self.setup.scene.seed, purpose, self.observation, realization=realization, **self._place)

    @property
    def _place(self) -> dict[str, Any]:
        return {"block": self.block.number, "band": self.setup.scene.band_name}


def observed_block(setup: Simulation, observation: int, block: Block, whole: Pointing) -> ObservedBlock:
    """Draw the weather of an observation that is pointed as `whole`, for one of its blocks."""
    return ObservedBlock(setup, observation, block, whole, observation_weather(setup, observation))


def observation_weather(setup: Simulation, observation: int) -> Weather | None:
    """The weather drawn for one observation; None without an atmosphere."""
    if setup.scene.atmosphere is None:
        return None
    air = setup.air
    return survey_weather(setup.scene.atmosphere, air.water, setup.scene.seed, observation, dated=air.dated)


def observation_levels(setup: Simulation, observation: int) -> WhiteLevels:
    """Photon and detector noise of one observation, in its weather and at its elevation."""
    return _levels(setup, observation, observation_weather(setup, observation))


def white_of_block(of: ObservedBlock) -> WhiteByDetector:
    """Photon and detector noise of each detector in the observation of a block."""
    return camera_white(of.setup.camera, of.levels)


def mean_white(of: ObservedBlock) -> float:
    """White noise of photons and detectors in the observation of a block, mean over the detectors [mK^2/Hz]."""
    return white_of_block(of).mean


def _levels(setup: Simulation, observation: int, weather: Weather | None) -> WhiteLevels:
    opacity = setup.air.water.opacity if setup.air.water else None
    elevation = float(setup.observing.angles.elevation_rad[observation].mean())
    return white_levels(setup.scene, opacity, weather.pwv_mm if weather else np.nan, elevation)
