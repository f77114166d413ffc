"""Cleaning steps of a configuration: the options of each algorithm, with their defaults."""

from typing import Annotated, Any, Literal

from pydantic import Field

from mapmaker.pipeline.config_types import Section, number, whole


class _TemplateStep(Section):
    tolerance: number(above=0, most=1) = 1e-8  # type: ignore[valid-type]
    """Mean fractional change of the responsivities at convergence."""
    max_iterations: whole(1, 10**6) = 100  # type: ignore[valid-type]
    """Most iterations; a scan that needs more is discarded."""
    responsivities: Literal["scan", "observation"] = "observation"
    """One fit of the responsivities to each scan, or one to each file."""

    def options(self) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import TemplateOptions

        return TemplateOptions(self.tolerance, self.max_iterations, self.responsivities)


class MeanStep(Section):
    """Subtract the mean of each scan."""

    algorithm: Literal["none"] = "none"

    def options(self) -> None:
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

    def options(self) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import PolynomialOptions

        return PolynomialOptions(self.order, self.regions, self.tolerance, self.max_iterations, self.responsivities)


class PcaStep(Section):
    """Subtract modes with outlying eigenvalues."""

    algorithm: Literal["pca"]
    sigma_cut: number(above=0, most=1000) = 3.0  # type: ignore[valid-type]
    """Standard deviations of the logarithm of the eigenvalues above their mean."""

    def options(self) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import PcaOptions

        return PcaOptions(self.sigma_cut)


class LocalStep(Section):
    """Subtract the mean over a detector and its neighbours."""

    algorithm: Literal["local"]
    neighbour_radius: number(above=1, most=1000) = 1.2  # type: ignore[valid-type]
    """Largest distance of a neighbour, in units of the closest separation of two detectors."""

    def options(self) -> Any:
        """Return the options of the algorithm."""
        from mapmaker.cleaning import LocalOptions

        return LocalOptions(self.neighbour_radius)


CleaningStep = Annotated[
    MeanStep | AverageStep | PlanarStep | QuadraticStep | PolynomialStep | PcaStep | LocalStep,
    Field(discriminator="algorithm"),
]
