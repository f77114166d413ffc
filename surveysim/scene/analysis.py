"""Sections [cleaning] and [score]: from time-streams to uncertainties."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from surveysim.scene.fields import (
    AboveOne,
    BandPowers,
    Frequencies,
    Frequency,
    Line,
    Positive,
    PositiveAngle,
    PositiveBandPower,
    Ratios,
    Share,
    Steps,
    number,
    whole,
)
from surveysim.scene.metrics import AnyMetric, check_metrics
from surveysim.scene.section import Section

LONGEST_NAME = 100  # letters of a cleaning that is compared
# Keys without a default that an algorithm needs.
NEEDED_KEYS = {
    "local": ("neighbour_radius",),
    "polynomial": ("order", "regions"),
    "highpass": ("highpass_frequency",),
    "notch": ("notch_frequencies", "notch_widths"),
    "time_polynomial": ("time_order",),
}
PCA_KEYS = {"sigma_cut": "sigma_cut", "modes": "pca_modes", "variance": "pca_variance"}  # by criterion


class Cleaning(Section):
    """Cleaning algorithms of the time-streams and their parameters."""

    algorithm: Steps
    """Cleaning algorithm, or a list of algorithms applied in this order."""
    compare: tuple[Steps, ...] = ()
    """Alternative cleaning pipelines of the same time-streams, each scored as a data set of its own, and together as
    "optimal", the best of each observation. The joined names of a pipeline have 100 letters at most."""
    tolerance: Annotated[float, *number(1e-12, below=1)]
    """Mean fractional change of the responsivities at which the template fit has converged."""
    max_iterations: Annotated[int, *whole(1, 100_000)]
    """Largest number of iterations of the template fit; scans whose fit does not converge are discarded."""
    sigma_cut: Positive | None = None
    """Required by "pca": modes whose log eigenvalue exceeds the mean by this many standard deviations are removed."""
    pca_criterion: Literal["sigma_cut", "modes", "variance", "marchenko_pastur"] = "sigma_cut"
    """Modes that "pca" removes: by `sigma_cut`, a number `pca_modes`, the fewest that hold a share `pca_variance` of
    the variance, or those above the largest eigenvalue of white noise (Marchenko and Pastur)."""
    pca_modes: Annotated[int, *whole(1, 10_000)] | None = None
    """Required by the criterion "modes" of "pca", in place of `sigma_cut`: number of modes."""
    pca_variance: Annotated[float, *number(1e-6, below=1)] | None = None
    """Required by the criterion "variance" of "pca", in place of `sigma_cut`: share of the variance."""
    responsivities: Literal["scan", "observation", "survey", "known"] = "scan"
    """Responsivities used by template subtraction: "scan" and "observation" fit them to each scan or observation,
    "survey" uses the true values with a constant calibration error, "known" the true values."""
    calibration_error: Annotated[float, *number(1e-9, 1)] | None = None
    """Required by responsivities "survey": their relative rms error (log-normal)."""
    neighbour_radius: AboveOne | None = None
    """Required by "local": radius of the neighbourhood of a detector, in units of the closest separation."""
    order: Annotated[int, *whole(0, 20)] | None = None
    """Required by "polynomial": order of the polynomial over the focal plane."""
    regions: Annotated[int, *whole(1, 1000)] | None = None
    """Required by "polynomial": number of regions of the focal plane with separate polynomials."""
    highpass_frequency_hz: Frequency | None = Field(None, alias="highpass_frequency")
    """Required by "highpass": corner frequency."""
    highpass_order: Annotated[int, *whole(1, 20)] | None = None
    """Order of the Butterworth response of "highpass"; without it the cut is sharp."""
    notch_frequencies_hz: Frequencies | None = Field(None, alias="notch_frequencies")
    """Required by "notch": centres of the bands that are removed."""
    notch_widths_hz: Frequencies | None = Field(None, alias="notch_widths")
    """Required by "notch": full width of each band; 0 removes a single frequency."""
    time_order: Annotated[int, *whole(1, 20)] | None = None
    """Required by "time_polynomial": order of the polynomial in time that is removed from each detector and scan."""

    @property
    def named(self) -> frozenset[str]:
        """Names of all algorithms, of `compare` too."""
        return frozenset(name for steps in (self.algorithm, *self.compare) for name in steps)

    @model_validator(mode="after")
    def _each_algorithm_has_its_keys(self) -> Self:
        named = self.named
        for algorithm, keys in NEEDED_KEYS.items():
            for key in keys if algorithm in named else ():
                if self._value(key) is None:
                    raise ValueError(f"{key}: missing; {algorithm!r} needs it")
        self._check_pca(named)
        self._check_responsivities(named)
        n_notch = len(self.notch_frequencies_hz or ())
        if "notch" in named and len(self.notch_widths_hz or ()) != n_notch:
            raise ValueError(
                f"notch_widths: found {len(self.notch_widths_hz or ())} values; {n_notch}, one for each of"
                " notch_frequencies, are expected"
            )
        sets = ["+".join(steps) for steps in (self.algorithm, *self.compare)]
        alike = [name.lower() for name in sets]  # some file systems do not tell cases apart
        if repeated := [name for name in sets if alike.count(name.lower()) > 1]:
            raise ValueError(f"compare: found {repeated[0]!r} more than once; different algorithms are expected")
        for name, steps in zip(sets[1:], self.compare, strict=True):
            if len(name) > LONGEST_NAME:  # the name of a data set is part of file and column names
                raise ValueError(
                    f"compare: found {len(steps)} algorithms in order, whose names make {len(name)} letters; "
                    f"{LONGEST_NAME} or fewer are expected"
                )
        return self

    def _value(self, key: str) -> object:
        """Return the value of a key of the file, whose name here may have a unit."""
        return getattr(self, key, None) if key in type(self).model_fields else getattr(self, f"{key}_hz")

    def _check_pca(self, named: frozenset[str]) -> None:
        """Raise ValueError where the number of the criterion is missing, or the criterion would do nothing."""
        if "pca" not in named:
            if self.pca_criterion != "sigma_cut":
                raise ValueError(
                    f"pca_criterion: found {self.pca_criterion!r} without 'pca'; that algorithm is expected"
                )
            return
        key = PCA_KEYS.get(self.pca_criterion)
        if key is not None and getattr(self, key) is None:
            needs = "'pca'" if key == "sigma_cut" else f"pca_criterion {self.pca_criterion!r}"
            raise ValueError(f"{key}: missing; {needs} needs it")

    def _check_responsivities(self, named: frozenset[str]) -> None:
        """Raise ValueError where a key about responsivities is missing, or would do nothing."""
        from mapmaker.cleaning import TEMPLATE_CLEANINGS

        if self.responsivities == "survey" and self.calibration_error is None:
            raise ValueError("calibration_error: missing; responsivities 'survey' needs it")
        if self.responsivities != "scan" and named.isdisjoint(TEMPLATE_CLEANINGS):
            raise ValueError(
                f"responsivities: found {self.responsivities!r} with {', '.join(map(repr, sorted(named)))} alone, which"
                f" needs none; 'scan' is expected, or an algorithm of {', '.join(map(repr, TEMPLATE_CLEANINGS))}"
            )


class SignalSims(Section):
    """Signal simulations: random skies that measure the transfer function of cleaning."""

    skies: Annotated[int, *whole(2, 1000)]
    """Number of skies."""
    observations: Annotated[int, *whole(1, 1_000_000)]
    """Largest number of observations with simulated signal: the first 8 of the survey, then pairs that are 10 apart."""
    band_power_ukcmb2: PositiveBandPower = Field(alias="band_power")
    """Band power of flat skies; the transfer function does not depend on it."""
    spectrum: Literal["flat", "sky"] = "flat"
    """Spectrum of the skies: "flat", or "sky", that of the random sky of [sky]. The transfer function of a bin that
    scans and cleaning filter unevenly depends on it."""


class Reference(Section):
    """Published uncertainties, printed next to the results."""

    source: Line
    """Source of the published values."""
    values_ukcmb2: BandPowers = Field(alias="values")
    """Published sigma(A) of each data set."""
    gains: Ratios = ()
    """Published ratios of sigma(A), such as "actual / uncorrelated"."""


class Score(Section):
    """Uncertainty sigma(A) of a flat band power: map region, multipoles, data sets."""

    size_rad: PositiveAngle = Field(alias="size")
    """Side of the square region of the map that is scored."""
    taper_fraction: Share
    """Fraction of the side that is taken by the two cosine edges of the taper."""
    ell_bin: Annotated[int, *whole(1, 1_000_000)]
    """Width of the multipole bins."""
    ell_min: Annotated[int, *whole(1, 10_000_000)]
    """Lowest multipole that is scored."""
    ell_max: Annotated[int, *whole(2, 10_000_000)]
    """Highest multipole that is scored, at least `ell_min` plus `ell_bin`."""
    jackknives: Annotated[int, *whole(2, 1000)]
    """Number of jackknife realizations: co-adds of the observations with random signs, which measure the noise."""
    white_noise_above_hz: Frequency = Field(alias="white_noise_above")
    """Lowest frequency of the range in which the white-noise level is measured."""
    mask_separation_f_lambda: Positive | None = None
    """Smallest separation of detectors, in (f/#)lambda, of an additional masked array that is scored too."""
    noise_only_sets: tuple[Literal["uncorrelated", "white"], ...]
    """Additional noise-only data sets: "uncorrelated" has the measured spectrum of each detector without correlations,
    "white" its white-noise level."""
    signal_sims: SignalSims
    reference: Reference | None = None
    metrics: tuple[AnyMetric, ...] = ()
    """Further scores of the same maps; each is a list entry with its `kind`."""

    @model_validator(mode="after")
    def _range_and_sets(self) -> Self:
        if self.ell_max < self.ell_min + self.ell_bin:
            raise ValueError(
                f"ell_max: found {self.ell_max}; {self.ell_min + self.ell_bin} or more, ell_min + ell_bin, is expected"
            )
        if repeated := [name for name in self.noise_only_sets if self.noise_only_sets.count(name) > 1]:
            raise ValueError(f"noise_only_sets: found {repeated[0]!r} more than once; different data sets are expected")
        check_metrics(self.metrics, self.ell_bin, self.ell_max)
        return self
