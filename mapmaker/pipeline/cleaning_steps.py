"""Cleaning steps of a configuration: the options of each algorithm, with their defaults."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from mapmaker.pipeline.config_types import Frequency, Section, number, whole


class _TemplateStep(Section):
    tolerance: number(above=0, most=1) = 1e-8  # type: ignore[valid-type]
    """Mean fractional change of the responsivities at convergence."""
    max_iterations: whole(1, 10**6) = 100  # type: ignore[valid-type]
    """Most iterations; a scan that needs more is discarded."""
    responsivities: Literal["scan", "observation"] = "observation"
    """One fit of the responsivities to each scan, or one to each file."""

    def options(self, sample_rate_hz: float) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import TemplateOptions

        return TemplateOptions(self.tolerance, self.max_iterations, self.responsivities)


class MeanStep(Section):
    """Subtract the mean of each scan."""

    algorithm: Literal["none"] = "none"

    def options(self, sample_rate_hz: float) -> None:
        """Return the options of the algorithm: it has none."""


class AverageStep(_TemplateStep):
    """Subtract the mean over detectors."""

    algorithm: Literal["average"] = "average"


class PlanarStep(_TemplateStep):
    """Subtract a plane over the array."""

    algorithm: Literal["planar"]


class QuadraticStep(_TemplateStep):
    """Subtract a polynomial of order 2 over the array."""

    algorithm: Literal["quadratic"]


class PolynomialStep(_TemplateStep):
    """Subtract a polynomial of any order over the array, or over regions of it."""

    algorithm: Literal["polynomial"]
    order: whole(0, 20)  # type: ignore[valid-type]
    """Order of the polynomial."""
    regions: whole(1, 1000) = 1  # type: ignore[valid-type]
    """Number of regions of the array with polynomials of their own."""

    def options(self, sample_rate_hz: float) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import PolynomialOptions

        return PolynomialOptions(self.order, self.regions, self.tolerance, self.max_iterations, self.responsivities)


class PcaStep(Section):
    """Subtract modes with outlying eigenvalues."""

    algorithm: Literal["pca"]
    criterion: Literal["sigma_cut", "modes", "variance", "marchenko_pastur"] = "sigma_cut"
    """Choice of the modes: outliers by `sigma_cut`, a number of `modes`, those that hold a share of the `variance`, or
    those above the noise of random matrices."""
    sigma_cut: number(above=0, most=1000) | None = None  # type: ignore[valid-type]
    """Standard deviations of the logarithm of the eigenvalues above their mean; 3 by default."""
    modes: whole(1, 10**6) | None = None  # type: ignore[valid-type]
    """Number of modes."""
    variance: number(above=0, most=0.999999) | None = None  # type: ignore[valid-type]
    """Least share of the variance that the removed modes hold."""

    @model_validator(mode="after")
    def _number_of_criterion(self) -> "PcaStep":
        for name in ("sigma_cut", "modes", "variance"):
            value = getattr(self, name)
            if value is not None and name != self.criterion:
                raise ValueError(f'{name}: found {value} with criterion = "{self.criterion}"; no such key is expected')
            if value is None and name == self.criterion != "sigma_cut":
                raise ValueError(f'{name}: missing; criterion = "{self.criterion}" needs it')
        return self

    def options(self, sample_rate_hz: float) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import PcaOptions

        cut = (self.sigma_cut or 3.0) if self.criterion == "sigma_cut" else None
        return PcaOptions(cut, self.criterion, self.modes, self.variance)


class LocalStep(Section):
    """Subtract the mean over a detector and its neighbours."""

    algorithm: Literal["local"]
    neighbour_radius: number(above=1, most=1000) = 1.2  # type: ignore[valid-type]
    """Largest distance of a neighbour, in units of the closest separation of two detectors."""

    def options(self, sample_rate_hz: float) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import LocalOptions

        return LocalOptions(self.neighbour_radius)


class HighpassStep(Section):
    """Remove low frequencies of each scan."""

    algorithm: Literal["highpass"]
    corner: Frequency
    """Corner frequency."""
    order: whole(1, 20) | None = None  # type: ignore[valid-type]
    """Order of a Butterworth filter; without it, a step at the corner."""

    def options(self, sample_rate_hz: float) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import HighpassOptions

        return HighpassOptions(self.corner, sample_rate_hz, self.order)


class NotchStep(Section):
    """Remove bands of frequency of each scan."""

    algorithm: Literal["notch"]
    frequencies: Annotated[tuple[Frequency, ...], Field(strict=False, min_length=1)]
    """Centres of the bands."""
    widths: Annotated[tuple[Frequency, ...], Field(strict=False, min_length=1)]
    """Full widths of the bands."""

    @model_validator(mode="after")
    def _as_many(self) -> "NotchStep":
        if len(self.widths) != len(self.frequencies):
            raise ValueError(f"widths: found {len(self.widths)}; {len(self.frequencies)}, one each, are expected")
        return self

    def options(self, sample_rate_hz: float) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import NotchOptions

        return NotchOptions(self.frequencies, self.widths, sample_rate_hz)


class TimePolynomialStep(Section):
    """Subtract a polynomial in time from each scan."""

    algorithm: Literal["time_polynomial"]
    order: whole(1, 20)  # type: ignore[valid-type]
    """Order of the polynomial."""

    def options(self, sample_rate_hz: float) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import TimePolynomialOptions

        return TimePolynomialOptions(self.order)


CleaningStep = Annotated[
    MeanStep
    | AverageStep
    | PlanarStep
    | QuadraticStep
    | PolynomialStep
    | PcaStep
    | LocalStep
    | HighpassStep
    | NotchStep
    | TimePolynomialStep,
    Field(discriminator="algorithm"),
]
