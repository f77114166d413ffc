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
    Frequency,
    Length,
    RightAscension,
    Section,
    number,
    shown,
    whole,
)

_MOST_BYTES = 10**6  # of a configuration
Kind = Literal["files", "time", "direction", "detectors"]
Test = Literal["jumps", "glitches", "noise", "common"]


class IterativeSection(Section):
    """Options of the maker "iterative"."""

    threshold: number(above=0, most=1e6) = 5.0  # type: ignore[valid-type]
    """Signal-to-noise ratio of the smoothed map above which a pixel is not cleaned."""
    loss: number(least=0, most=0.99) = 0.2  # type: ignore[valid-type]
    """After pass k, pixels below this to the power k of the brightest are cleaned, whatever their noise."""
    tolerance: number(above=0, most=1) = 1e-3  # type: ignore[valid-type]
    """Relative change of the signal at convergence."""
    max_iterations: whole(1, 1000) = 20  # type: ignore[valid-type]
    """Most passes over the files."""


class DestripedSection(Section):
    """Options of the maker "destriped"."""

    baseline: Duration = 2.0
    """Length of a baseline."""
    tolerance: number(above=0, most=0.1) = 1e-5  # type: ignore[valid-type]
    """Residual of the normal equations at convergence."""
    max_iterations: whole(1, 10**5) = 300  # type: ignore[valid-type]
    """Most iterations, each a pass over the files."""


class MaximumLikelihoodSection(Section):
    """Options of the maker "maximum_likelihood"."""

    bands: Annotated[tuple[Frequency, ...], Field(strict=False, min_length=1)] = (0.1, 0.2, 0.4, 0.8, 1.6)
    """Edges between the frequency bands in which the noise is measured."""
    max_modes: whole(0, 1000) = 20  # type: ignore[valid-type]
    """Most correlated modes in a band, those that are smooth over the array among them."""
    tolerance: number(above=0, most=0.1) = 1e-5  # type: ignore[valid-type]
    """Residual of the normal equations at convergence."""
    max_iterations: whole(1, 10**5) = 300  # type: ignore[valid-type]
    """Most iterations, each a pass over the files."""

    @model_validator(mode="after")
    def _increase(self) -> "MaximumLikelihoodSection":
        if any(b <= a for a, b in zip(self.bands, self.bands[1:], strict=False)):
            raise ValueError(f"bands: found {shown(list(self.bands))}; increasing frequencies are expected")
        return self


class MapSection(Section):
    """The map: pixels, place, map-maker, weights."""

    pixel: Length | None = None
    """Side of a pixel. Without it, a third of the beam of the first file."""
    centre: Annotated[tuple[RightAscension, Declination], Field(strict=False)] | None = None
    """Right ascension and declination of the centre. Without it, the middle of all scans."""
    size: Annotated[tuple[Length, Length], Field(strict=False)] | None = None
    """Width and height. Without it, the map covers all scans."""
    maker: Literal["binned", "iterative", "destriped", "maximum_likelihood"] = "binned"
    """Map-maker, applied to the cleaned streams. All but "binned" pass over the files several times."""
    weights: Literal["detector", "file", "uniform"] = "detector"
    """Weight of a sample in binned and iterative maps: the inverse variance of the cleaned streams of its detector in
    its file, the inverse of their mean variance in the file, or 1."""
    healpix_nside: whole(1, 2**20) | None = None  # type: ignore[valid-type]
    """With it, a HEALPix map is binned from the time-streams as well."""
    iterative: IterativeSection = IterativeSection()
    """Options of the maker."""
    destriped: DestripedSection = DestripedSection()
    """Options of the maker."""
    maximum_likelihood: MaximumLikelihoodSection = MaximumLikelihoodSection()
    """Options of the maker."""

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
    """Tests of the cleaned streams; "common" finds detectors that do not follow the signal of the others."""
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
