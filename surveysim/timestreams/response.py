"""Response of the detectors: the steps from the signal that they see to the streams at their output, in order.

Every signal passes through here: the components of the streams, and simulated signals.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.crosstalk import crosstalk
from surveysim.timestreams.observed_block import ObservedBlock
from surveysim.timestreams.responsivity import responsivities, responsivity_drift
from surveysim.timestreams.simulation import Simulation
from surveysim.timestreams.sky import add_seen_sky, add_true_sky
from surveysim.timestreams.time_constants import deconvolution, time_constants

_IN_LOOK_UP = "responsivity"  # the step that the look-up of a simulated signal makes
Operator = Callable[[np.ndarray], None]  # changes streams (n_det, n_samp) in place; linear in them


@dataclass(frozen=True)
class ResponseStep:
    """A step of the response.

    Parameters
    ----------
    name
        Name of the step.
    section
        Section of the scene that turns it on.
    title
        Its name in reports.
    operator
        Function that makes the step for one block of an observation. It gets the block and the streams (n_det, n_samp)
        that detectors see in it, before the first step. None for a step that look-ups of the sky make themselves.
    sentence
        One line for plans and reports.
    acts_on
        "sky": the sky alone. "signals": all that detectors see, but for photon noise. "light": photon noise too.
        "streams": all noise too.
    is_present
        Whether a simulation has the step.
    """

    name: str
    section: str
    title: str
    operator: Callable[[ObservedBlock, np.ndarray], Operator] | None
    sentence: str
    acts_on: Literal["sky", "signals", "light", "streams"]
    is_present: Callable[[Simulation], bool]


# Steps that act on fewer parts of the streams come first.
RESPONSE_STEPS = (
    ResponseStep(
        "pointing_errors",
        "pointing_errors",
        "Pointing errors",
        None,
        "detectors look at the sky beside the assumed positions",
        acts_on="sky",
        is_present=lambda setup: setup.scene.pointing_errors is not None,
    ),
    ResponseStep(
        "responsivity",
        "instrument",
        "Responsivities",
        responsivities,
        "detectors differ in responsivity",
        acts_on="signals",
        is_present=lambda setup: bool((setup.camera.responsivity != 1).any()),
    ),
    ResponseStep(
        "responsivity_drift",
        "responsivity_drift",
        "Responsivity drift",
        responsivity_drift,
        "responsivities change within an observation",
        acts_on="signals",
        is_present=lambda setup: setup.scene.responsivity_drift is not None,
    ),
    ResponseStep(
        "time_constants",
        "time_constants",
        "Time constants",
        time_constants,
        "a low-pass filter with one pole on all that a detector sees",
        acts_on="light",
        is_present=lambda setup: setup.camera.time_constant_s is not None,
    ),
    ResponseStep(
        "crosstalk",
        "crosstalk",
        "Crosstalk",
        crosstalk,
        "streams leak into the streams of other detectors of their readout group",
        acts_on="streams",
        is_present=lambda setup: setup.scene.crosstalk is not None,
    ),
    ResponseStep(
        "deconvolution",
        "time_constants",
        "Deconvolution",
        deconvolution,
        "time constants are deconvolved, with those that are assumed",
        acts_on="streams",
        is_present=lambda setup: setup.camera.deconvolved_s is not None,
    ),
)


def present_steps(setup: Simulation) -> tuple[ResponseStep, ...]:
    """Steps of the response that a simulation has, in their order."""
    return tuple(step for step in RESPONSE_STEPS if step.is_present(setup))


@dataclass(frozen=True)
class BlockResponse:
    """Response of the detectors in one block of an observation.

    Attributes
    ----------
    of
        The block.
    steps
        Steps with an operator, in their order.
    """

    of: ObservedBlock
    steps: tuple[tuple[ResponseStep, Operator], ...]

    def apply(self, data_mk: np.ndarray) -> None:
        """Apply all steps to streams (n_det, n_samp), in place."""
        for _, operator in self.steps:
            operator(data_mk)

    def acting_on(self, *kinds: str) -> "BlockResponse":
        """Select the steps that act on some kinds of signal and noise."""
        return BlockResponse(self.of, tuple(item for item in self.steps if item[0].acts_on in kinds))

    def output(self, sky_mk: np.ndarray, signal_mk: np.ndarray) -> np.ndarray:
        """Output (n_det, n_samp) of the detectors for a sky, whose `signal_mk` is that of `write_sky_signal`.

        It is `signal_mk` itself, not a copy, where no further step and no pointing error changes it.
        """
        later = [operator for step, operator in self.steps if step.name != _IN_LOOK_UP]
        found = signal_mk
        if self.of.setup.scene.pointing_errors is not None:
            found = np.zeros_like(signal_mk)
            add_true_sky(self.of, sky_mk, found, self.of.setup.camera.responsivity)
        elif later:
            found = signal_mk.copy()
        for operator in later:
            operator(found)
        return found


def block_response(of: ObservedBlock, seen_mk: np.ndarray) -> BlockResponse:
    """Make the response of one block, in which the detectors see some streams (n_det, n_samp)."""
    steps = (step for step in present_steps(of.setup) if step.operator is not None)
    return BlockResponse(of, tuple((step, step.operator(of, seen_mk)) for step in steps))


def pass_light(of: ObservedBlock, photons_mk: np.ndarray) -> None:
    """Apply the steps that act on photon noise (n_det, n_samp) in a block, in place."""
    block_response(of, photons_mk).acting_on("light").apply(photons_mk)


def draws_parts(of: ObservedBlock) -> bool:
    """Tell if photon and detector noise are drawn apart: they differ between detectors, or pass different steps."""
    steps = (step.acts_on == "light" for step in present_steps(of.setup))
    return of.setup.camera.properties.white_differs or any(steps)


def write_sky_signal(setup: Simulation, pointing: Pointing, sky_mk: np.ndarray, out_mk: np.ndarray) -> None:
    """Write the signal of a sky at the assumed pointing, times the responsivities, to streams (n_det, n_samp).

    Several skies (n_sky, ...) are written to as many streams (n_sky, n_det, n_samp). The look-up multiplies by the
    responsivity before it rounds to the type of the streams.
    """
    out_mk[:] = 0
    add_seen_sky(setup, pointing, sky_mk, out_mk, setup.camera.responsivity)
