"""The components of a time-stream, in the order in which they are added."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from surveysim.scene.scene import Scene
from surveysim.timestreams.atmosphere import add_atmosphere
from surveysim.timestreams.detector import add_detector_noise
from surveysim.timestreams.glitches import add_glitches, flag_glitches
from surveysim.timestreams.lines import add_lines
from surveysim.timestreams.lost_data import flag_dead_time, flag_dropped_samples
from surveysim.timestreams.low_frequency import add_low_frequency_noise
from surveysim.timestreams.observed_block import ObservedBlock
from surveysim.timestreams.photon import add_photon_noise
from surveysim.timestreams.readout_noise import add_readout_noise
from surveysim.timestreams.sky import add_scene_sky


@dataclass(frozen=True)
class StreamComponent:
    """A component of time-streams.

    Parameters
    ----------
    name
        Name of the component, and of the scene's section that turns it on.
    title
        Its name in reports.
    add
        Function that adds the component of a block to streams (n_det, n_samp) [mK], in place; None for lost samples
        alone.
    sentence
        One line for plans and reports.
    through_response
        Whether detectors see it and respond to it; else it is noise at their output.
    absence
        Consequence of its absence, for plans, after a colon; None for a component that most scenes do without.
    flag
        Function that flags the samples of a block that the component loses in flags (n_det, n_samp), in place; None for
        a component that loses none.
    switch
        Key of the section whose value "none" turns the component off, while all else that the section sets stays.
    """

    name: str
    title: str
    add: Callable[[np.ndarray, ObservedBlock], None] | None
    sentence: str
    through_response: bool
    absence: str | None = ""
    flag: Callable[[np.ndarray, ObservedBlock], None] | None = None
    switch: str = ""

    def is_present(self, scene: Scene) -> bool:
        """Tell whether the scene has the section, and its switch is on."""
        section = getattr(scene, self.name)
        return bool(section) and (not self.switch or getattr(section, self.switch) != "none")


# The order of additions is part of a scene's results, as its seed is: float32 sums depend on it. Components that pass
# through the response of the detectors come first.
COMPONENTS = (
    StreamComponent(
        "atmosphere",
        "Atmosphere",
        add_atmosphere,
        "turbulent layers that the wind moves through the beams",
        through_response=True,
        absence=": no layer, no weather",
        switch="turbulence",
    ),
    StreamComponent(
        "excess",
        "Excess noise",
        add_low_frequency_noise,
        "low-frequency noise with a power-law spectrum",
        through_response=True,
    ),
    StreamComponent(
        "sky",
        "Sky",
        add_scene_sky,
        "CMB, maps, clusters and sources",
        through_response=True,
        absence=": noise alone",
    ),
    StreamComponent(
        "photon",
        "Photon noise",
        add_photon_noise,
        "white noise, correlated between overlapping pixels",
        through_response=False,
    ),
    StreamComponent(
        "detector",
        "Detector noise",
        add_detector_noise,
        "white noise of each detector",
        through_response=False,
    ),
    StreamComponent(
        "readout_noise",
        "Readout noise",
        add_readout_noise,
        "1/f noise of detectors, readout groups or the whole array",
        through_response=False,
        absence=None,
    ),
    StreamComponent(
        "lines",
        "Lines",
        add_lines,
        "microphonic lines",
        through_response=False,
        absence=None,
    ),
    StreamComponent(
        "glitches",
        "Glitches",
        add_glitches,
        "hits that decay; those that are found are flagged",
        through_response=False,
        absence=None,
        flag=flag_glitches,
    ),
    StreamComponent(
        "dropped_samples",
        "Dropped samples",
        None,
        "gaps, which are flagged",
        through_response=False,
        absence=None,
        flag=flag_dropped_samples,
    ),
    StreamComponent(
        "dead_time",
        "Dead time",
        None,
        "detectors and scans that are lost in each observation",
        through_response=False,
        absence=None,
        flag=flag_dead_time,
    ),
)


def present_components(scene: Scene) -> tuple[StreamComponent, ...]:
    """Components that the scene has a section for, in the order of addition."""
    return tuple(item for item in COMPONENTS if item.is_present(scene))
