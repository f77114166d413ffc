"""Configuration of `mapmaker clean-and-map`: its sections, their defaults, and the reading of a TOML file."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, ValidationError, field_validator, model_validator

from mapmaker.errors import InputError
from mapmaker.files import one_line
from mapmaker.pipeline.cleaning_steps import AverageStep, CleaningStep
from mapmaker.pipeline.config_errors import error_lines
from mapmaker.pipeline.config_types import (
    Declination,
    Duration,
    Length,
    RightAscension,
    Section,
    number,
    shown,
    whole,
)

_MOST_BYTES = 10**6  # of a configuration
Kind = Literal["files", "time", "direction", "detectors"]
Test = Literal["jumps", "glitches", "noise"]


class MapSection(Section):
    """The map: pixels, place, weights."""

    pixel: Length | None = None
    """Side of a pixel. Without it, a third of the beam of the first file."""
    centre: Annotated[tuple[RightAscension, Declination], Field(strict=False)] | None = None
    """Right ascension and declination of the centre. Without it, the middle of all scans."""
    size: Annotated[tuple[Length, Length], Field(strict=False)] | None = None
    """Width and height. Without it, the map covers all scans."""
    weights: Literal["detector", "file", "uniform"] = "detector"
    """Weight of a sample: the inverse variance of the cleaned streams of its detector in its file, their mean in the
    file, or 1."""
    healpix_nside: whole(1, 2**20) | None = None  # type: ignore[valid-type]
    """With it, a HEALPix map is binned from the time-streams as well."""

    @field_validator("healpix_nside")
    @classmethod
    def _power_of_two(cls, value: int | None) -> int | None:
        if value is not None and value & (value - 1):
            raise ValueError(f"found {value}; a power of two is expected")
        return value


class Circle(Section):
    """A circle on the sky."""

    centre: Annotated[tuple[RightAscension, Declination], Field(strict=False)]
    """Right ascension and declination."""
    radius: Length
    """Radius."""


class FlagSection(Section):
    """Tests of the time-streams, and limits of usable data."""

    find: Annotated[tuple[Test, ...], Field(strict=False)] = get_args(Test)
    """Tests of the cleaned streams."""
    glitch_sigma: number(least=3, most=1e6) = 6.0  # type: ignore[valid-type]
    """A sample farther than this from 0, in robust standard deviations of its detector, is a glitch."""
    jump_sigma: number(least=3, most=1e6) = 8.0  # type: ignore[valid-type]
    """A step larger than this, in robust standard deviations of the differences before and after each sample, is a
    jump: its detector is left out of the scan."""
    jump_window: Duration = 1.0
    """Time before and after a sample whose mean values are compared."""
    noise_ratio: number(above=1, most=1e6) = 3.0  # type: ignore[valid-type]
    """A detector whose white noise differs from the median of the file by more than this factor is left out."""
    max_lost: number(least=0, most=1) = 0.3  # type: ignore[valid-type]
    """A detector that has lost more than this fraction of a scan is left out of the scan."""
    min_duration: Duration = 1.0
    """Shorter scans are left out."""
    min_motion: Length | None = None
    """Scans that move by less are left out. Without it, the beam."""
    passes: whole(1, 100) = 6  # type: ignore[valid-type]
    """Most repetitions of cleaning and tests; they end when nothing new is found."""
    spare: Annotated[tuple[Circle, ...], Field(strict=False)] = ()
    """Circles on the sky without tests for glitches and jumps, for bright sources."""


class JackknifeSection(Section):
    """Jackknife maps: differences of the maps of two halves of the data."""

    splits: Annotated[tuple[Kind, ...], Field(strict=False)] = get_args(Kind)
    """Halves by files at random, in time, by scan direction, or by detectors. The first is the noise map."""
    files: whole(1, 1000) = 4  # type: ignore[valid-type]
    """Number of random divisions of the files into halves."""
    seed: whole(0, 2**32 - 1) = 1  # type: ignore[valid-type]
    """Seed of the random divisions."""


class InputSection(Section):
    """The files."""

    fwhm: Length | None = None
    """Full width at half maximum of the beam, in place of that of the files. Some formats do not hold it."""


class Config(Section):
    """All sections; each can be left out."""

    input: InputSection = InputSection()
    map: MapSection = MapSection()
    cleaning: Annotated[tuple[CleaningStep, ...], Field(strict=False, min_length=1)] = (AverageStep(),)
    """Cleaning steps, in order."""
    flags: FlagSection = FlagSection()
    jackknives: JackknifeSection = JackknifeSection()

    @model_validator(mode="after")
    def _parts_differ(self) -> "Config":
        for key, values in (("flags.find", self.flags.find), ("jackknives.splits", self.jackknives.splits)):
            if len(set(values)) < len(values):
                raise ValueError(f"{key}: found {shown(list(values))}; different items are expected")
        return self


def load_config(path: str | Path) -> Config:
    """Read a configuration.

    Raises
    ------
    InputError
        With one line for each error: file, key, value found, values allowed.
    """
    path = Path(path)
    if not path.is_file():
        found = "no file" if path.exists() else "no such file"
        raise InputError(f"{path}: {found}; a configuration in TOML is expected")
    try:
        with open(path, "rb") as file:
            content = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    if len(content) > _MOST_BYTES:
        raise InputError(f"{path}: found more than {_MOST_BYTES} bytes; a configuration in TOML is expected")
    try:
        read: dict[str, Any] = tomllib.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not TOML ({one_line(error)})") from None
    try:
        return Config.model_validate(read)
    except ValidationError as error:
        raise InputError("\n".join(f"{path}: {line}" for line in error_lines(error, Config))) from None
