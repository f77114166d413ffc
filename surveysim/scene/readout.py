"""Sections of readout noise and lost data: 1/f noise, lines, glitches, dropped samples, dead detectors and scans."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic.config import JsonDict

from surveysim.scene.fields import (
    Duration,
    DurationExtent,
    Frequency,
    NoisePsd,
    Share,
    number,
    quantity,
    whole,
)
from surveysim.scene.section import Section

MOST_LOST = 0.9  # largest fraction of detectors, or scans, that [dead_time] takes

Rate = Annotated[float, *quantity("Hz", "1 / h", at_least=0, at_most="1 Hz")]
Amplitude = Annotated[float, *quantity("mK", at_least="1e-9 mK", at_most="1e6 K")]
GroupSize = Annotated[int, *whole(2, 1_000_000)]
_GROUPS: JsonDict = {"otherwise": "groups of the table's column `readout_group`"}


class RedNoise(Section):
    """1/f noise: a power law of frequency, which equals the white noise at the knee."""

    knee_hz: Annotated[float, *quantity("Hz", at_least="1e-6 Hz", at_most="1000 Hz")] = Field(alias="knee")
    """Frequency at which the PSD is `psd`."""
    slope: Annotated[float, *number(0.1, 2.5)]
    """The PSD is proportional to f to minus this power."""
    psd_mk2_hz: NoisePsd | None = Field(
        alias="psd", default=None, json_schema_extra={"otherwise": "the white noise of a detector in each observation"}
    )
    """One-sided PSD at the knee, in Rayleigh-Jeans temperature. White noise is that of photons and detectors, in the
    mean over the detectors."""


class GroupRedNoise(RedNoise):
    """1/f noise that the detectors of a readout group have in common, each group its own."""

    group_size: GroupSize | None = Field(default=None, json_schema_extra=_GROUPS)
    """Detectors of a readout group, which have consecutive numbers."""


class ReadoutNoise(Section):
    """1/f noise at the output of the detectors, independent of their responsivities."""

    detector: RedNoise | None = None
    """1/f noise of each detector, independent of others."""
    group: GroupRedNoise | None = None
    array: RedNoise | None = None
    """1/f noise that all detectors have in common."""

    @model_validator(mode="after")
    def _is_there(self) -> Self:
        if self.detector is None and self.group is None and self.array is None:
            raise ValueError("at least one of 'detector', 'group' and 'array' (sections) is expected")
        return self

    @property
    def parts(self) -> dict[str, RedNoise]:
        """Noise by the detectors that have it in common: "detector", "group", "array"."""
        of = {"detector": self.detector, "group": self.group, "array": self.array}
        return {name: part for name, part in of.items() if part is not None}


class Shared(Section):
    """Base of sections of what a detector, a readout group or the whole array has in common."""

    shared: Literal["detector", "group", "array"]
    """Detectors that have it in common: "detector" for each its own, "group" for those of a readout group, "array" for
    all."""
    group_size: GroupSize | None = Field(default=None, json_schema_extra=_GROUPS)
    """Detectors of a readout group, which have consecutive numbers. For `shared` "group"."""

    @model_validator(mode="after")
    def _size_is_of_groups(self) -> Self:
        if self.group_size is not None and self.shared != "group":
            raise ValueError(f"group_size: found with shared {self.shared!r}; it belongs to shared 'group'")
        return self


class MicrophonicLine(Shared):
    """Line in the noise at the output of the detectors, such as pick-up of a vibration."""

    frequency_hz: Frequency = Field(alias="frequency")
    """Frequency of the line, up to half of the sample rate."""
    width_hz: Frequency = Field(alias="width")
    """Full width at half maximum of its Gaussian PSD. Within a scan the line drifts by about so much, with a random
    phase in each scan."""
    rms_mk: Annotated[float, *quantity("mK", at_least=0, at_most="1e6 K")] = Field(alias="rms")
    """Standard deviation of the line in each detector, Rayleigh-Jeans."""


class Glitches(Section):
    """Glitches, such as hits by cosmic rays: steps that decay, in one detector each."""

    rate_hz: Rate = Field(alias="rate")
    """Glitches of a detector in a time."""
    amplitude_mk: Amplitude = Field(alias="amplitude")
    """Amplitude, Rayleigh-Jeans; the least with `largest_amplitude`."""
    largest_amplitude_mk: Amplitude | None = Field(
        alias="largest_amplitude", default=None, json_schema_extra={"otherwise": "`amplitude`"}
    )
    """Largest amplitude of a power law."""
    slope: Annotated[float, *number(0, 10)] | None = None
    """Glitches of the amplitude A are A to minus this power in number, for equal steps of A. Required with
    `largest_amplitude`."""
    decay_time_s: DurationExtent = Field(alias="decay_time")
    """Time in which a glitch decays by a factor e, a scan or shorter; 0 for single samples."""
    found: Share | None = None
    """Fraction of the glitches that is found and flagged, whatever their size. Alternative: `threshold`."""
    threshold: Annotated[float, *number(0.1, 1e6)] | None = None
    """Least amplitude that is found and flagged, in standard deviations of the white noise of a sample. Alternative:
    `found`."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        largest = self.largest_amplitude_mk
        if largest is not None and largest <= self.amplitude_mk:
            raise ValueError(
                f"largest_amplitude: found {largest:g} mK; more than 'amplitude', {self.amplitude_mk:g} mK, is expected"
            )
        if (largest is None) != (self.slope is None):
            needs = (
                "missing; 'largest_amplitude' needs it" if self.slope is None else "found without 'largest_amplitude'"
            )
            raise ValueError(f"slope: {needs}")
        if (self.found is None) == (self.threshold is None):
            raise ValueError("exactly one of 'found' and 'threshold' is expected")
        return self

    @property
    def extremes_mk(self) -> tuple[float, float]:
        """Least and largest amplitude."""
        return self.amplitude_mk, self.largest_amplitude_mk or self.amplitude_mk


class DroppedSamples(Shared):
    """Gaps in the data: samples that the readout drops, which are flagged."""

    rate_hz: Rate = Field(alias="rate")
    """Gaps in a time, of each detector, group or array."""
    length_s: Duration = Field(alias="length")
    """Length of a gap; a sample or more is lost."""


class DeadTime(Section):
    """Detectors and scans that are lost in an observation, drawn for each observation."""

    detectors: Annotated[float, *number(0, MOST_LOST)] = 0.0
    """Fraction of the detectors without data in an observation, beside those that are dead in all."""
    scans: Annotated[float, *number(0, MOST_LOST)] = 0.0
    """Fraction of the scans of an observation without data."""


class ReadoutSections(Section):
    """Sections of readout noise and lost data; each can be left out."""

    readout_noise: ReadoutNoise | None = None
    lines: tuple[MicrophonicLine, ...] = ()
    """Any number of lines."""
    glitches: Glitches | None = None
    dropped_samples: DroppedSamples | None = None
    dead_time: DeadTime | None = None

    @property
    def losses(self) -> tuple[str, ...]:
        """Names of the sections that flag samples as lost."""
        return tuple(name for name in ("glitches", "dropped_samples", "dead_time") if getattr(self, name))
