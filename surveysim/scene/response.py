"""Sections of the detectors' response and of pointing errors: how the output differs from an ideal look at the sky."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from surveysim.scene.fields import AngleExtent, Duration, Elevation, Frequency, Share, number, quantity
from surveysim.scene.readout import GroupSize
from surveysim.scene.section import Section


def _one_of(section: Section, **keys: str) -> None:
    """Raise ValueError for a section without any of some keys, by field; a key may be 0, as in a sweep."""
    if section.model_fields_set.isdisjoint(keys):
        first, *others = keys.values()
        alternatives = f"{'one of ' if len(others) > 1 else ''}{', '.join(map(repr, others))}"
        raise ValueError(f"{first}: missing; it or {alternatives} is expected")


class ResponsivityDrift(Section):
    """Changes of the detectors' responsivities within an observation: slow drifts, and losses by the load."""

    rms: Annotated[float, *number(0, 0.3)] = 0.0
    """Fractional rms of the drift of each detector, independent of other detectors and observations."""
    time_scale_s: Duration | None = Field(alias="time_scale", default=None)
    """Time T of the drift, a scan or longer: its correlation at a lag t is exp(-t^2 / 2 T^2). Required with `rms`."""
    load_coefficient_per_k: Annotated[float, *quantity("/ K", at_least="-0.2 / K", at_most="0.2 / K")] = Field(
        alias="load_coefficient", default=0.0
    )
    """Fractional loss of responsivity for each K (Rayleigh-Jeans) of additional load. Loads change with the airmass of
    a site and with the layer."""
    load_scatter: Annotated[float, *number(0, 1)] = 0.0
    """Scatter of `load_coefficient` between detectors: standard deviation of its logarithm."""
    calibration_elevation_rad: Elevation | None = Field(
        alias="calibration_elevation",
        default=None,
        json_schema_extra={"otherwise": "the mean elevation of each observation"},
    )
    """Elevation at which the loss by the load is 0, in the weather of the observation. For a site alone."""

    @model_validator(mode="after")
    def _changes(self) -> Self:
        if self.rms and self.time_scale_s is None:
            raise ValueError("time_scale: missing; 'rms' needs it")
        _one_of(self, rms="rms", load_coefficient_per_k="load_coefficient")
        for name in ("load_scatter", "calibration_elevation_rad"):
            if getattr(self, name) and "load_coefficient_per_k" not in self.model_fields_set:
                raise ValueError(f"{name.removesuffix('_rad')}: found without 'load_coefficient', which it belongs to")
        return self


class Crosstalk(Section):
    """Crosstalk: fractions of a detector's stream that appear in the streams of others of its readout group."""

    neighbour_fraction: Annotated[float, *number(-0.2, 0.2)] = 0.0
    """Fraction of each stream that its neighbours in readout get: the detectors before and after it in its group, by
    their rows in the table or their numbers."""
    group_fraction: Annotated[float, *number(-0.1, 0.1)] = 0.0
    """Fraction of each stream that all other detectors of its group get."""
    group_size: GroupSize | None = Field(
        default=None, json_schema_extra={"otherwise": "groups of the table's column `readout_group`, or one of all"}
    )
    """Detectors of a readout group, which have consecutive numbers."""

    @model_validator(mode="after")
    def _is_there(self) -> Self:
        _one_of(self, neighbour_fraction="neighbour_fraction", group_fraction="group_fraction")
        return self


class PointingErrors(Section):
    """Differences between true and assumed pointing. All are the rms along each of two axes on the sky."""

    jitter_rad: AngleExtent = Field(alias="jitter", default=0.0)
    """Fast motion of the boresight, independent in each sample without `jitter_bandwidth`."""
    jitter_bandwidth_hz: Frequency | None = Field(alias="jitter_bandwidth", default=None)
    """Bandwidth B of the jitter: its PSD is proportional to exp(-f^2 / 2 B^2). An eighth of the sample rate or less."""
    drift_rad: AngleExtent = Field(alias="drift", default=0.0)
    """Slow drift of the boresight, independent between observations."""
    drift_time_scale_s: Duration | None = Field(alias="drift_time_scale", default=None)
    """Time T of the drift, a scan or longer: its correlation at a lag t is exp(-t^2 / 2 T^2). Required with `drift`."""
    positions_rad: AngleExtent = Field(alias="positions", default=0.0)
    """Errors of the positions of the detectors in the array, the same in all observations."""

    @model_validator(mode="after")
    def _is_there(self) -> Self:
        if self.drift_rad and self.drift_time_scale_s is None:
            raise ValueError("drift_time_scale: missing; 'drift' needs it")
        if self.jitter_bandwidth_hz is not None and "jitter_rad" not in self.model_fields_set:
            raise ValueError("jitter_bandwidth: found without 'jitter', which it belongs to")
        _one_of(self, jitter_rad="jitter", drift_rad="drift", positions_rad="positions")
        return self


class TimeConstants(Section):
    """Time constants of the detectors: a low-pass filter with one pole, and its deconvolution."""

    value_s: Annotated[float, *quantity("s", at_least=0, at_most="10 day", zero_or="1 us")] | None = Field(
        alias="value", default=None
    )
    """Time constant of the detectors, up to a tenth of a scan. Alternative: the column `time_constant` of the table
    `instrument.positions`. 0 filters nothing, with the same random numbers as other values."""
    scatter: Share = 0.0
    """Scatter of `value` between detectors: standard deviation of its logarithm."""
    deconvolution_error: Annotated[float, *number(0, 0.5)] | None = None
    """Error of the time constants with which streams are deconvolved: standard deviation of their logarithm. Without it
    streams are not deconvolved."""

    @model_validator(mode="after")
    def _scatter_is_of_value(self) -> Self:
        if self.scatter and self.value_s is None:
            raise ValueError("scatter: found without 'value', which it belongs to")
        return self


class ResponseSections(Section):
    """Sections of the detectors' response; each can be left out."""

    responsivity_drift: ResponsivityDrift | None = None
    """Without it responsivities are constant within an observation."""
    time_constants: TimeConstants | None = None
    """Without it the table `instrument.positions` has the time constants, or they are 0."""
    crosstalk: Crosstalk | None = None
    pointing_errors: PointingErrors | None = None
    """Without it the assumed pointing is true."""
