"""Sections that say how streams become maps and scores."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from surveysim.scene.fields import (
    BandPowers,
    Frequency,
    Line,
    Nside,
    Positive,
    PositiveAngle,
    PositiveBandPower,
    Ratios,
    Share,
    Steps,
    number,
    whole,
)
from surveysim.scene.section import Section

LONGEST_NAME = 100  # letters of a cleaning that is compared


class Cleaning(Section):
    """The subtraction algorithm, or several in order, others to compare it with, and what they need to know."""

    algorithm: Steps
    """What the scene cleans with: an algorithm, or several that are applied in order."""
    compare: tuple[Steps, ...] = ()
    """Other ways of cleaning the same streams, scored as data sets beside it and as "optimal", the best of each; the
    names of one that has several algorithms make 100 letters at most, as they name its files."""
    tolerance: Annotated[float, *number(1e-12, 0.999999)]
    """Mean fractional change of the responsivities at which the iteration of templates ends."""
    max_iterations: Annotated[int, *whole(1, 100_000)]
    """A scan, or an observation that is fitted as one, whose fit takes more is discarded."""
    sigma_cut: Positive | None = None
    """Needed by "pca": removes modes whose log eigenvalue is more than so many standard deviations above the mean."""
    responsivities: Literal["scan", "observation", "survey", "known"] = "scan"
    """Whose responsivities templates are subtracted with: fitted to each scan, as in the paper, or to all scans of an
    observation together; the true ones with an error that lasts the survey, or without."""
    calibration_error: Annotated[float, *number(1e-9, 1)] | None = None
    """Needed by responsivities "survey", which alone use it: rms error of these, relative and log-normal."""
    neighbour_radius: Positive | None = None
    """Needed by "local": detectors within so many closest separations are neighbours."""
    order: Annotated[int, *whole(0, 20)] | None = None
    """Needed by "polynomial": order of the templates over the focal plane."""
    regions: Annotated[int, *whole(1, 1000)] | None = None
    """Needed by "polynomial": regions of the focal plane, each with templates of its own."""

    @model_validator(mode="after")
    def _each_algorithm_has_its_keys(self) -> Self:
        named = {name for steps in (self.algorithm, *self.compare) for name in steps}
        for key, algorithm in (
            ("sigma_cut", "pca"),
            ("neighbour_radius", "local"),
            ("order", "polynomial"),
            ("regions", "polynomial"),
        ):
            if algorithm in named and getattr(self, key) is None:
                raise ValueError(f"{key}: missing; {algorithm!r} needs it")
        self._check_responsivities(named)
        sets = ["+".join(steps) for steps in (self.algorithm, *self.compare)]
        alike = [name.lower() for name in sets]  # some file systems do not tell cases apart
        if repeated := [name for name in sets if alike.count(name.lower()) > 1]:
            raise ValueError(f"compare: found {repeated[0]!r} more than once; different algorithms are expected")
        for name, steps in zip(sets[1:], self.compare, strict=True):
            if len(name) > LONGEST_NAME:  # of a data set, which names files and columns
                raise ValueError(
                    f"compare: found {len(steps)} algorithms in order, whose names make {len(name)} letters; "
                    f"{LONGEST_NAME} or fewer are expected"
                )
        return self

    def _check_responsivities(self, named: set[str]) -> None:
        """Raise ValueError where a key about responsivities is missing, or would do nothing."""
        from mapmaker.cleaning import TEMPLATE_CLEANINGS

        if self.responsivities == "survey" and self.calibration_error is None:
            raise ValueError("calibration_error: missing; responsivities 'survey' needs it")
        if self.responsivities != "scan" and named.isdisjoint(TEMPLATE_CLEANINGS):
            raise ValueError(
                f"responsivities: found {self.responsivities!r} with {', '.join(map(repr, sorted(named)))} alone, which"
                f" needs none; 'scan' is expected, or an algorithm of {', '.join(map(repr, TEMPLATE_CLEANINGS))}"
            )


class MapSection(Section):
    """Pixels of the map."""

    pixel_rad: PositiveAngle = Field(alias="pixel")
    """Side of a pixel in the tangent plane; a third of the beam is fine."""
    healpix_nside: Nside = None
    """Write the maps in HEALPix of this nside too."""


class SignalSims(Section):
    """Signal simulations: flat-CMB skies that measure the transfer function of cleaning."""

    skies: Annotated[int, *whole(2, 1000)]
    """How many skies."""
    observations: Annotated[int, *whole(1, 1_000_000)]
    """How many observations carry them, spread over the survey."""
    band_power_ukcmb2: PositiveBandPower = Field(alias="band_power")
    """Their band power; the transfer function does not depend on it."""


class Reference(Section):
    """Published uncertainties to print beside the run's, by data set."""

    source: Line
    """Where they are from."""
    values_ukcmb2: BandPowers = Field(alias="values")
    """sigma(A) by name of the data set."""
    gains: Ratios = ()
    """Ratios by name, as "actual / uncorrelated"."""


class Score(Section):
    """The flat band-power uncertainty: which sky area, which multipoles, which data sets."""

    size_rad: PositiveAngle = Field(alias="size")
    """Side of the square of the map that is scored."""
    taper_fraction: Share
    """Share of that side that its two cosine edges take."""
    ell_bin: Annotated[int, *whole(1, 1_000_000)]
    """Width of the bins of multipole."""
    ell_min: Annotated[int, *whole(1, 10_000_000)]
    """Lowest multipole that is scored."""
    ell_max: Annotated[int, *whole(2, 10_000_000)]
    """Highest multipole that is scored, a bin above `ell_min` or more."""
    jackknives: Annotated[int, *whole(2, 1000)]
    """Co-adds with random signs that measure the noise."""
    white_noise_above_hz: Frequency = Field(alias="white_noise_above")
    """The streams' level above this frequency is their white level."""
    mask_separation_f_lambda: Positive | None = None
    """Score also the array masked to detectors at least so many (f/#)lambda apart."""
    noise_only_sets: tuple[Literal["uncorrelated", "white"], ...]
    """Data sets made of each detector's measured spectrum without correlations, and of its white level."""
    signal_sims: SignalSims
    reference: Reference | None = None

    @model_validator(mode="after")
    def _range_and_sets(self) -> Self:
        if self.ell_max < self.ell_min + self.ell_bin:
            raise ValueError(f"ell_max: found {self.ell_max}; at least ell_min + ell_bin is expected")
        if repeated := [name for name in self.noise_only_sets if self.noise_only_sets.count(name) > 1]:
            raise ValueError(f"noise_only_sets: found {repeated[0]!r} more than once; different data sets are expected")
        return self
