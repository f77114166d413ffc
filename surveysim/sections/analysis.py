"""Sections that say how streams become maps and scores."""

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from surveysim.quantities import Frequency, Nside, Positive, PositiveAngle, PositiveBandPower, Steps, pairs
from surveysim.sections.base import Section


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
