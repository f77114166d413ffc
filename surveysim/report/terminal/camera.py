"""The detectors of a camera, and the steps of their response, in a few lines."""

from collections.abc import Iterator, Sequence

from surveysim.reduction.setup import Setup
from surveysim.runtime.numbers import plural
from surveysim.timestreams.component import present_components
from surveysim.timestreams.response import present_steps
from surveysim.timestreams.sharing import uses_table_groups


def camera_lines(setup: Setup) -> Iterator[str]:
    """Return the numbers of detectors, of dead ones, and of those in each wafer, band and readout group.

    A line tells each step of the response that a section turns on.
    """
    counts = setup.camera.counts
    dead = f"; {plural(counts.dead, 'dead position')} of {counts.positions}" if counts.dead else ""
    yield f"{plural(setup.camera.n_det, 'detector')}{dead}"
    if counts.wafers:
        yield "detectors of wafers: " + ", ".join(f"{live} of {positions}" for live, positions in counts.wafers)
    if counts.bands and not setup.scene.band_name:  # a camera of several bands has a line for each
        chosen = setup.scene.instrument.table_band
        yield f"detectors of bands: {_named(counts.bands)}" + (f"; {chosen} is simulated" if chosen else "")
    if counts.readout_groups:
        used = "" if uses_table_groups(setup.scene) else ", which change no result"
        yield f"detectors of readout groups{used}: {_named(counts.readout_groups)}"
    for item in present_components(setup.scene):
        if item.absence is None:
            yield f"{item.title.lower()}: {item.sentence}"
    for step in present_steps(setup):
        if step.section != "instrument":
            yield f"{step.title.lower()}: {step.sentence}"


def _named(counts: Sequence[tuple[str, int]]) -> str:
    return ", ".join(f"{number} of {name}" for name, number in counts)
