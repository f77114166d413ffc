"""The sections of a scene file: their keys, units and bounds, as frozen records in internal units."""

import math
from fractions import Fraction
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from surveysim.quantities import (
    Angle,
    AngleExtent,
    BandPowerExtent,
    BeamWidth,
    Coherence,
    Duration,
    DurationExtent,
    Elevation,
    ElevationLimit,
    Frequency,
    Height,
    HourAngle,
    Index,
    IsoDate,
    Latitude,
    Length,
    Longitude,
    NoisePsd,
    Nside,
    Positive,
    PositiveAngle,
    PositiveBandPower,
    SiteName,
    Speed,
    SpeedExtent,
    Steps,
    TableFile,
    Temperature,
    Variances,
    Waters,
    pairs,
)
from surveysim.sites import with_site
from surveysim.units import to_floats


class Section(BaseModel):
    """A part of a scene: frozen, no unknown keys, keys named without units in the file."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=False, strict=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_key_is_true_or_false(cls, value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError(f"found {str(value).lower()}; no key of a scene is true or false")
        return value


class FieldSection(Section):
    """The centre of the field (J2000)."""

    ra_rad: Longitude = Field(alias="ra")
    dec_rad: Latitude = Field(alias="dec")


class Schedule(Section):
    """Where and when the field is observed: elevation and parallactic angle come from real dates."""

    latitude_rad: Latitude = Field(alias="latitude")
    longitude_rad: Longitude = Field(alias="longitude")
    height_m: Height = Field(alias="height")
    first_night: IsoDate
    nights: int = Field(ge=1, le=10_000)
    max_hour_angle_rad: HourAngle = Field(alias="max_hour_angle")
    min_elevation_rad: ElevationLimit = Field(alias="min_elevation")


class FixedPointing(Section):
    """A telescope at one elevation and parallactic angle, for scenes that need no dates."""

    elevation_rad: Elevation = Field(alias="elevation")
    parallactic_angle_rad: Angle = Field(alias="parallactic_angle")


class Layout(Section):
    """A hexagonal layout: rings around a central position, pitch in (f/#)lambda, dead positions."""

    rings: int = Field(ge=0, le=60)
    pitch_f_lambda: Positive
    dead: tuple[int, ...] = ()


class Colour(Section):
    """Another band of every pixel: its place in the spectrum and its noise, all of it white."""

    frequency_hz: Frequency = Field(alias="frequency", le=1e13)
    bandwidth: float = Field(gt=0, lt=1)
    psd_mk2_hz: NoisePsd = Field(alias="psd")


class Instrument(Section):
    """Band, beam and focal plane; detectors from `layout` or from the table `positions`.

    `colours` are further bands of the same pixels, which "spectral" cleaning subtracts from the one that is mapped.
    """

    frequency_hz: Frequency = Field(alias="frequency", le=1e13)
    bandwidth: float | None = Field(gt=0, lt=1, default=None)
    beam_fwhm_rad: BeamWidth = Field(alias="beam_fwhm")
    f_lambda_rad: PositiveAngle = Field(alias="f_lambda")
    responsivity_scatter: float = Field(ge=0, le=1)
    camera_rotation_rad: AngleExtent = Field(alias="camera_rotation")
    layout: Layout | None = None
    positions: TableFile = None
    colours: tuple[Colour, ...] = ()

    @model_validator(mode="after")
    def _one_focal_plane(self) -> Self:
        if (self.layout is None) == (self.positions is None):
            raise ValueError("exactly one of 'layout' (a section) and 'positions' (an ECSV file) is expected")
        return self


class Scan(Section):
    """The raster of one observation."""

    speed_rad_s: Speed = Field(alias="speed")
    scans: int = Field(ge=1, le=100_000)
    duration_s: Duration = Field(alias="duration")
    turnaround_s: DurationExtent = Field(alias="turnaround")
    step_rad: AngleExtent = Field(alias="step")
    dither_rad: AngleExtent = Field(alias="dither")
    sample_rate_hz: Frequency = Field(alias="sample_rate")


class Atmosphere(Section):
    """The Kolmogorov-Taylor thin screen and the distributions that each observation draws from.

    A `site` gives the keys that the scene leaves out: layer height, wind, the precipitable water (`pwv`) and its
    fractional fluctuations (`fluctuation`, (delta C / C)^2 as an amplitude like B2), from which B2 follows. With
    `b2` beside a site the B2 that follows keeps its rank and takes these quantiles; without a site there is no water.
    """

    index: Index
    illuminated_aperture_m: Length = Field(alias="illuminated_aperture")
    outer_scale_m: Length | None = Field(alias="outer_scale", default=None)
    site: SiteName = None
    layer_height_m: Length = Field(alias="layer_height")
    b2_probabilities: tuple[float, ...] = ()
    b2: tuple[float, ...] = ()
    pwv_probabilities: tuple[float, ...] = ()
    pwv_mm: Waters = Field(alias="pwv", default=())
    fluctuation_probabilities: tuple[float, ...] = ()
    fluctuation: tuple[float, ...] = ()
    wind_median_rad_s: SpeedExtent = Field(alias="wind_median")
    wind_log_scatter: float = Field(ge=0, le=2)
    wind_b2_exponent: float = Field(ge=-2, le=2, default=0.0)

    @model_validator(mode="before")
    @classmethod
    def _site_and_units_of_the_index(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        data = with_site(data)
        if "index" not in data:
            return data
        try:
            power = f"rad({2 - Fraction(str(data['index'])).limit_denominator(1000)})"
        except (ValueError, ZeroDivisionError):
            power = None  # one error is enough: the index is refused by its own check
        found = {}
        for name, unit in (("b2", f"mK2 {power}"), ("fluctuation", power)):
            try:
                found |= {name: to_floats(data[name], unit) if power else ()} if name in data else {}
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        return data | found

    @model_validator(mode="after")
    def _distributions_are_whole(self) -> Self:
        if self.site is None and self.pwv_mm:
            raise ValueError("site: missing; 'pwv' needs the opacity of a site")
        if self.b2 or self.b2_probabilities:
            check_quantiles("b2", self.b2_probabilities, self.b2)
        elif self.site is None:
            raise ValueError("b2: missing; a distribution of B2, or a site that it follows from, is expected")
        if self.site is not None:
            check_quantiles("fluctuation", self.fluctuation_probabilities, self.fluctuation)
            check_knots("pwv_probabilities", self.pwv_probabilities, "pwv", self.pwv_mm)
            if min(self.pwv_probabilities) < 0 or max(self.pwv_probabilities) > 1:
                raise ValueError(f"pwv_probabilities: found {self.pwv_probabilities}; values from 0 to 1 are expected")
            if not min(self.pwv_mm + self.fluctuation) > 0:
                raise ValueError(f"pwv: found {self.pwv_mm} and {self.fluctuation}; values above 0 are expected")
        if self.index >= 4 and self.outer_scale_m is None:
            raise ValueError(f"outer_scale: missing; an index of {self.index:g} (4 or more) needs an outer scale")
        return self


def check_quantiles(name: str, probabilities: tuple[float, ...], values: tuple[float, ...]) -> None:
    """Raise ValueError unless these are quantiles, with probabilities between 0 and 1."""
    check_knots(f"{name}_probabilities", probabilities, name, values)
    if not all(0 < p < 1 for p in probabilities):
        raise ValueError(f"{name}_probabilities: found {probabilities}; values between 0 and 1 are expected")


def check_knots(x_name: str, x: tuple[float, ...], y_name: str, y: tuple[float, ...]) -> None:
    """Raise ValueError unless x increases, y does not decrease or turn negative, and the lengths agree."""
    if len(x) != len(y) or not x:
        raise ValueError(f"{y_name}: found {len(y)} values for {len(x)} {x_name}; as many as these are expected")
    if any(b <= a for a, b in zip(x, x[1:], strict=False)):
        raise ValueError(f"{x_name}: found {x}; increasing values are expected")
    if min(y) < 0 or any(b < a for a, b in zip(y, y[1:], strict=False)):
        raise ValueError(f"{y_name}: found {y}; values of 0 or more that do not decrease are expected")


class Excess(Section):
    """Excess low-frequency noise: variance below a band limit against B2, spectrum f^-index."""

    spectral_index: float = Field(ge=0, le=10)
    band_limit_hz: Frequency = Field(alias="band_limit")
    b2: tuple[float, ...]
    variance_mk2: Variances = Field(alias="variance")
    coherence: Coherence

    @model_validator(mode="after")
    def _knots_fit(self) -> Self:
        check_knots("b2", self.b2, "variance", self.variance_mk2)
        # Excess is interpolated in the logarithms of both.
        for name, values in (("b2", self.b2), ("variance", self.variance_mk2)):
            if len(self.b2) > 1 and not all(0 < value < math.inf for value in values):
                raise ValueError(f"{name}: found {values}; finite values above 0 are expected")
        return self


class Photon(Section):
    """Photon noise, of which a coherent part is shared by overlapping pixels."""

    psd_mk2_hz: NoisePsd = Field(alias="psd")
    coherent_fraction: float = Field(ge=0, le=1)
    coherence: Coherence


class Detector(Section):
    """White noise of detectors and electronics, uncorrelated."""

    psd_mk2_hz: NoisePsd = Field(alias="psd")


class PointSource(Section):
    """A point source: peak Rayleigh-Jeans temperature in the beam."""

    ra_rad: Longitude = Field(alias="ra")
    dec_rad: Latitude = Field(alias="dec")
    peak_mk: Temperature = Field(alias="peak")


class Sky(Section):
    """Astronomical signal in the streams: a flat CMB band power and point sources."""

    cmb_band_power_ukcmb2: BandPowerExtent = Field(alias="cmb_band_power")
    point_sources: tuple[PointSource, ...] = ()
    curved_nside: Nside = None


class Cleaning(Section):
    """The subtraction algorithm, or several in order, others to compare it with, and what they need to know.

    `tolerance` and `max_iterations` are of all templates, `sigma_cut` of "pca", `reach` (in closest separations)
    of "local", `order` and `regions` of "polynomial".
    """

    algorithm: Steps
    compare: tuple[Steps, ...] = ()
    tolerance: float = Field(gt=0, lt=1)
    max_iterations: int = Field(ge=1, le=1_000_000)
    sigma_cut: Positive | None = None
    reach: Positive | None = None
    order: Annotated[int | None, Field(ge=0, le=20)] = None
    regions: Annotated[int | None, Field(ge=1, le=1000)] = None

    @model_validator(mode="after")
    def _each_algorithm_has_its_keys(self) -> Self:
        named = {name for steps in (self.algorithm, *self.compare) for name in steps}
        for key, algorithm in (
            ("sigma_cut", "pca"),
            ("reach", "local"),
            ("order", "polynomial"),
            ("regions", "polynomial"),
        ):
            if algorithm in named and getattr(self, key) is None:
                raise ValueError(f"{key}: missing; {algorithm!r} needs it")
        sets = ["+".join(steps) for steps in (self.algorithm, *self.compare)]
        if repeated := [name for name in sets if sets.count(name) > 1]:
            raise ValueError(f"compare: found {repeated[0]!r} more than once; different algorithms are expected")
        return self


class MapSection(Section):
    """Pixels of the map."""

    pixel_rad: PositiveAngle = Field(alias="pixel")
    healpix_nside: Nside = None


class Window(Section):
    """Flat-CMB skies that measure what cleaning takes from the signal."""

    skies: int = Field(ge=2, le=1000)
    observations: int = Field(ge=1)
    band_power_ukcmb2: PositiveBandPower = Field(alias="band_power")


class Reference(Section):
    """Published uncertainties to print beside the run's, by data set."""

    source: str
    values_ukcmb2: Annotated[tuple[tuple[str, PositiveBandPower], ...], BeforeValidator(pairs)] = Field(alias="values")
    gains: Annotated[tuple[tuple[str, Positive], ...], BeforeValidator(pairs)] = ()


class Score(Section):
    """The flat band-power uncertainty: which sky area, which multipoles, which data sets."""

    size_rad: PositiveAngle = Field(alias="size")
    taper_fraction: float = Field(ge=0, le=1)
    ell_bin: int = Field(ge=1)
    ell_min: int = Field(ge=1)
    ell_max: int = Field(ge=2)
    jackknives: int = Field(ge=2, le=1000)
    white_above_hz: Frequency = Field(alias="white_above")
    mask_separation_f_lambda: Positive | None = None
    simulated: tuple[Literal["uncorrelated", "white"], ...]
    window: Window
    reference: Reference | None = None

    @model_validator(mode="after")
    def _range_has_bins(self) -> Self:
        if self.ell_max < self.ell_min + self.ell_bin:
            raise ValueError(f"ell_max: found {self.ell_max}; at least ell_min + ell_bin is expected")
        return self
