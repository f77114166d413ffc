"""The schema of a scene file: what is checked, converted to internal units, and refused.

A scene is TOML; quantities are strings with units. A stage is a section, and an absent section
leaves its stage out. Every record here is frozen and holds floats in internal units.
"""

import hashlib
import json
import re
import tomllib
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from surveysim.units import to_float, to_floats, to_sky_angle


class SceneError(ValueError):
    """A scene that can't be run; the text has one line for each error: file, key, found, allowed."""


def _quantity(unit: str, above: float | None = None, at_least: float | None = None) -> BeforeValidator:
    def check(value: object) -> float | None:
        if value is None:
            return None
        number = to_float(value, unit)
        if above is not None and not number > above:
            raise ValueError(f"found {value!r}; a value above {above:g} is expected")
        if at_least is not None and not number >= at_least:
            raise ValueError(f"found {value!r}; a value of {at_least:g} or more is expected")
        return number

    return BeforeValidator(check)


def _fraction(value: object) -> object:
    return float(Fraction(value)) if isinstance(value, str) else value


def _pairs(value: object) -> object:
    return tuple(value.items()) if isinstance(value, dict) else value  # a scene is hashable, a dict is not


Angle = Annotated[float, _quantity("rad")]
PositiveAngle = Annotated[float, _quantity("rad", above=0)]
AngleExtent = Annotated[float, _quantity("rad", at_least=0)]
SkyAngle = Annotated[float, BeforeValidator(to_sky_angle)]
Speed = Annotated[float, _quantity("rad / s", above=0)]
SpeedExtent = Annotated[float, _quantity("rad / s", at_least=0)]
Duration = Annotated[float, _quantity("s", above=0)]
DurationExtent = Annotated[float, _quantity("s", at_least=0)]
Height = Annotated[float, _quantity("m")]
Length = Annotated[float, _quantity("m", above=0)]
Frequency = Annotated[float, _quantity("Hz", above=0)]
NoisePsd = Annotated[float, _quantity("mK2 / Hz", at_least=0)]
Temperature = Annotated[float, _quantity("mK")]
BandPowerExtent = Annotated[float, _quantity("uK2", at_least=0)]
PositiveBandPower = Annotated[float, _quantity("uK2", above=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Index = Annotated[float, BeforeValidator(_fraction), Field(gt=0, allow_inf_nan=False)]
Variances = Annotated[tuple[float, ...], BeforeValidator(lambda value: to_floats(value, "mK2"))]
Coherence = Literal["field", "intensity", "none"]


class Section(BaseModel):
    """A part of a scene: frozen, no unknown keys, keys named without units in the file."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=False, strict=False)


class FieldSection(Section):
    """The centre of the field (J2000)."""

    ra_rad: SkyAngle = Field(alias="ra")
    dec_rad: SkyAngle = Field(alias="dec")


class Schedule(Section):
    """Where and when the field is observed: elevation and parallactic angle come from real dates."""

    latitude_rad: SkyAngle = Field(alias="latitude")
    longitude_rad: SkyAngle = Field(alias="longitude")
    height_m: Height = Field(alias="height")
    first_night: str
    nights: int = Field(ge=1)
    max_hour_angle_rad: PositiveAngle = Field(alias="max_hour_angle")
    min_elevation_rad: AngleExtent = Field(alias="min_elevation")


class FixedPointing(Section):
    """A telescope at one elevation and parallactic angle, for scenes that need no dates."""

    elevation_rad: PositiveAngle = Field(alias="elevation")
    parallactic_angle_rad: Angle = Field(alias="parallactic_angle")


class Layout(Section):
    """A hexagonal layout: rings around a central position, pitch in (f/#)lambda, dead positions."""

    rings: int = Field(ge=0, le=60)
    pitch_f_lambda: Positive
    dead: tuple[int, ...] = ()


class Instrument(Section):
    """Band, beam and focal plane; detectors from `layout` or from the table `positions`."""

    frequency_hz: Frequency = Field(alias="frequency")
    beam_fwhm_rad: PositiveAngle = Field(alias="beam_fwhm")
    f_lambda_rad: PositiveAngle = Field(alias="f_lambda")
    responsivity_scatter: NotNegative
    camera_rotation_rad: AngleExtent = Field(alias="camera_rotation")
    layout: Layout | None = None
    positions: Path | None = None

    @model_validator(mode="after")
    def _one_focal_plane(self) -> Self:
        if (self.layout is None) == (self.positions is None):
            raise ValueError("exactly one of 'layout' (a section) and 'positions' (an ECSV file) is expected")
        return self


class Scan(Section):
    """The raster of one observation."""

    speed_rad_s: Speed = Field(alias="speed")
    scans: int = Field(ge=1)
    duration_s: Duration = Field(alias="duration")
    turnaround_s: DurationExtent = Field(alias="turnaround")
    step_rad: AngleExtent = Field(alias="step")
    dither_rad: AngleExtent = Field(alias="dither")
    sample_rate_hz: Frequency = Field(alias="sample_rate")


class Atmosphere(Section):
    """The Kolmogorov-Taylor thin screen and the distributions that each observation draws from."""

    index: Index
    layer_height_m: Length = Field(alias="layer_height")
    illuminated_aperture_m: Length = Field(alias="illuminated_aperture")
    outer_scale_m: Length | None = Field(alias="outer_scale", default=None)
    b2_probabilities: tuple[float, ...]
    b2: tuple[float, ...]
    wind_median_rad_s: SpeedExtent = Field(alias="wind_median")
    wind_log_scatter: NotNegative

    @model_validator(mode="before")
    @classmethod
    def _b2_in_units_of_the_index(cls, data: Any) -> Any:
        if not isinstance(data, dict) or "b2" not in data or "index" not in data:
            return data
        try:
            unit = f"mK2 rad({2 - Fraction(str(data['index'])).limit_denominator(1000)})"
        except (ValueError, ZeroDivisionError):
            return data
        try:
            return data | {"b2": to_floats(data["b2"], unit)}
        except ValueError as error:
            raise ValueError(f"b2: {error}") from None

    @model_validator(mode="after")
    def _distribution_is_one(self) -> Self:
        check_knots("b2_probabilities", self.b2_probabilities, "b2", self.b2)
        if not all(0 < p < 1 for p in self.b2_probabilities):
            raise ValueError(f"b2_probabilities: found {self.b2_probabilities}; values between 0 and 1 are expected")
        if self.index >= 4 and self.outer_scale_m is None:
            raise ValueError(f"outer_scale: missing; an index of {self.index:g} (4 or more) needs an outer scale")
        return self


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

    spectral_index: NotNegative
    band_limit_hz: Frequency = Field(alias="band_limit")
    b2: tuple[float, ...]
    variance_mk2: Variances = Field(alias="variance")
    coherence: Coherence

    @model_validator(mode="after")
    def _knots_fit(self) -> Self:
        check_knots("b2", self.b2, "variance", self.variance_mk2)
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

    ra_rad: SkyAngle = Field(alias="ra")
    dec_rad: SkyAngle = Field(alias="dec")
    peak_mk: Temperature = Field(alias="peak")


class Sky(Section):
    """Astronomical signal in the streams: a flat CMB band power and point sources."""

    cmb_band_power_ukcmb2: BandPowerExtent = Field(alias="cmb_band_power")
    point_sources: tuple[PointSource, ...] = ()
    curved_nside: int | None = None


class Cleaning(Section):
    """The subtraction algorithm and its convergence."""

    algorithm: Literal["none", "average", "planar", "quadratic"]
    tolerance: float = Field(gt=0, lt=1)
    max_iterations: int = Field(ge=1)


class MapSection(Section):
    """Pixels of the map."""

    pixel_rad: PositiveAngle = Field(alias="pixel")
    healpix_nside: int | None = None


class Window(Section):
    """Flat-CMB skies that measure what cleaning takes from the signal."""

    skies: int = Field(ge=2)
    observations: int = Field(ge=1)
    band_power_ukcmb2: PositiveBandPower = Field(alias="band_power")


class Reference(Section):
    """Published uncertainties to print beside the run's, by data set."""

    source: str
    values_ukcmb2: Annotated[tuple[tuple[str, PositiveBandPower], ...], BeforeValidator(_pairs)] = Field(
        alias="values"
    )
    gains: Annotated[tuple[tuple[str, Positive], ...], BeforeValidator(_pairs)] = ()


class Score(Section):
    """The flat band-power uncertainty: which sky area, which multipoles, which data sets."""

    size_rad: PositiveAngle = Field(alias="size")
    taper_fraction: float = Field(ge=0, le=1)
    ell_bin: int = Field(ge=1)
    ell_min: int = Field(ge=1)
    ell_max: int = Field(ge=2)
    jackknives: int = Field(ge=2)
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


class Scene(Section):
    """A whole scene; an absent section leaves its stage out.

    `assumed` is not a key of the file: it lists the file's own values whose comment says that they are
    assumed or calibrated.
    """

    name: str = Field(pattern=r"^[A-Za-z0-9_.-]+$")
    title: str
    seed: int = Field(ge=0)
    observations: int = Field(ge=1)
    field: FieldSection
    schedule: Schedule | None = None
    fixed_pointing: FixedPointing | None = None
    instrument: Instrument
    scan: Scan
    atmosphere: Atmosphere | None = None
    excess: Excess | None = None
    photon: Photon | None = None
    detector: Detector | None = None
    sky: Sky | None = None
    cleaning: Cleaning
    map: MapSection
    score: Score | None = None
    assumed: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _sections_fit(self) -> Self:
        if (self.schedule is None) == (self.fixed_pointing is None):
            raise ValueError("exactly one of the sections 'schedule' and 'fixed_pointing' is expected")
        if self.excess and len(self.excess.b2) > 1 and self.atmosphere is None:
            raise ValueError("excess.b2: found several values; without [atmosphere] one value is expected")
        if not any((self.atmosphere, self.excess, self.photon, self.detector, self.sky)):
            raise ValueError("at least one of atmosphere, excess, photon, detector and sky is expected")
        if self.scan.duration_s * self.scan.sample_rate_hz < 8:
            found = self.scan.duration_s * self.scan.sample_rate_hz
            raise ValueError(f"scan.duration: found {found:.3g} samples a scan; 8 or more are expected")
        return self


def load_scene(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Read and check a scene file; `overrides` maps dotted keys to values.

    Raises SceneError with one line for each error: file, key, what was found, what is allowed.
    """
    path = Path(path)
    text, data = _read(path)
    if "assumed" in data:
        raise SceneError(f"{path}: assumed: unknown key; allowed are {', '.join(_allowed(()))}")
    data["assumed"] = assumed_values(text)
    for key, value in (overrides or {}).items():
        _override(path, data, key, value)
    data.setdefault("name", path.stem)
    positions = data.get("instrument", {}).get("positions") if isinstance(data.get("instrument"), dict) else None
    if isinstance(positions, str):
        data["instrument"]["positions"] = str((path.parent / positions).resolve())
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        raise SceneError("\n".join(_error_line(path, item) for item in error.errors())) from None


def scene_hash(scene: Scene) -> str:
    """SHA-256 of all that a run's results depend on: equal for equal runs, whatever the comments say."""
    content = json.dumps(scene.model_dump(mode="json", exclude={"title", "assumed"}), sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def resolved(scene: Scene) -> str:
    """The scene in internal units as JSON, with units in the names."""
    return json.dumps(scene.model_dump(mode="json"), indent=1, sort_keys=True)


def assumed_values(text: str) -> list[str]:
    """Lines ``section.key = value: comment`` of a scene's text whose comment begins with assumed or calibrated."""
    section, found = "", []
    for line in text.splitlines():
        if match := re.match(r"\s*\[\[?([\w.]+)\]", line):
            section = match[1] + "."
        elif match := re.match(r"\s*(\w+)\s*=\s*(.*?)\s*#\s*((?:assumed|calibrated).*)$", line):
            found.append(f"{section}{match[1]} = {match[2]}: {match[3]}")
    return found


def _read(path: Path) -> tuple[str, dict]:
    try:
        text = path.read_text(encoding="utf-8")
        return text, tomllib.loads(text)
    except OSError as error:
        raise SceneError(f"{path}: can't be read ({error.strerror}); a scene file (TOML) is expected") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: not a whole TOML file ({error})") from None


def _override(path: Path, data: dict, key: str, value: Any) -> None:
    *sections, last = key.split(".")
    for name in sections:
        data = data.setdefault(name, {})
        if not isinstance(data, dict):
            raise SceneError(f"{path}: {key}: {name!r} is not a section")
    data[last] = value


def _error_line(path: Path, item: Any) -> str:
    key = ".".join(str(part) for part in item["loc"])
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "extra_forbidden":
        message = f"unknown key; allowed are {', '.join(_allowed(item['loc'][:-1]))}"
    elif item["type"] == "missing":
        message = "missing; this key is expected"
    elif item["type"] != "value_error":
        message = f"found {item['input']!r}; {message[0].lower()}{message[1:]}"
    return f"{path}: {key}: {message}" if key else f"{path}: {message}"


def _allowed(location: tuple) -> list[str]:
    model: Any = Scene
    for name in location:
        if isinstance(name, int):
            continue
        annotation = next(f.annotation for k, f in model.model_fields.items() if (f.alias or k) == name)
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        model = next(c for c in candidates if isinstance(c, type) and issubclass(c, Section))
    return sorted(f.alias or k for k, f in model.model_fields.items() if k != "assumed")
