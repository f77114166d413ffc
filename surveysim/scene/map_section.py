"""Section [map]: pixels, map-maker and its options."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from surveysim.scene.fields import Duration, FrequencyEdges, Nside, Positive, PositiveAngle, number, whole
from surveysim.scene.section import Section
from surveysim.scene.units import shown

Makers = Literal["binned", "destriped", "maximum_likelihood", "iterative"]
SOLVED = ("destriped", "maximum_likelihood")  # makers whose maps are solved for once all observations are there


class Solver(Section):
    """Conjugate gradients for the map."""

    tolerance: Annotated[float, *number(1e-12, below=1)] = 1e-4
    """Residual of the normal equations, over their right-hand side, at which the map has converged."""
    max_iterations: Annotated[int, *whole(1, 100_000)] = 200
    """Largest number of iterations; a map that has not converged by then is flagged."""


class Destriped(Solver):
    """Destriped maps: cleaned streams less an offset for each baseline, which the crossings of scans determine."""

    baseline_s: Duration = Field(alias="baseline")
    """Length of a baseline; a scan is cut into baselines of this length or a little less."""


class MaximumLikelihood(Solver):
    """Maximum-likelihood maps, with the spectra and cross-spectra of each observation's cleaned streams."""

    band_edges_hz: FrequencyEdges = Field(alias="band_edges", default=(0.1, 0.2, 0.4, 0.8, 1.6))
    """Frequencies between bands of constant noise covariance; the first band begins at 0, the last has no end."""
    max_modes: Annotated[int, *whole(0, 10_000)] = 20
    """Largest number of correlated modes in a band, those that are smooth over the array among them."""
    eigenvalue_cut: Annotated[float, *number(1, 1e6)] = 2.0
    """A mode that is not smooth is kept if its eigenvalue exceeds this times the largest one of uncorrelated noise."""

    @model_validator(mode="after")
    def _edges_increase(self) -> Self:
        edges = (0.0, *self.band_edges_hz)
        if any(b <= a for a, b in zip(edges, edges[1:], strict=False)):
            raise ValueError(f"band_edges: found {shown(self.band_edges_hz)}; increasing values above 0 are expected")
        return self


class Iterative(Section):
    """Binned maps of several passes over the survey; each pass cleans the streams less the bright part of the map."""

    threshold: Positive = 5.0
    """Signal-to-noise ratio of the beam-smoothed map above which pixels are bright."""
    loss: Annotated[float, *number(0, below=1)] = 0.2
    """Pixels below this power of the brightest, to the number of passes, are not bright."""
    tolerance: Annotated[float, *number(1e-12, below=1)] = 1e-3
    """Relative change of the bright part at which it has converged."""
    max_passes: Annotated[int, *whole(1, 100)] = 5
    """Largest number of passes; a map that has not converged by then is flagged."""


class MapSection(Section):
    """Pixels of the maps, and the map-maker."""

    pixel_rad: PositiveAngle = Field(alias="pixel")
    """Side of a square pixel in the tangent plane; a third of the beam FWHM is small enough."""
    healpix_nside: Nside = None
    """Nside of additional HEALPix maps."""
    maker: Makers = "binned"
    """Map-maker of the cleaned streams: "binned" averages them, "destriped" and "maximum_likelihood" solve for the map
    with offsets or measured noise spectra, "iterative" restores the bright sources that cleaning removes."""
    destriped: Destriped | None = None
    """Required by the maker "destriped"; other makers ignore it, so that a sweep over makers can have it."""
    maximum_likelihood: MaximumLikelihood | None = None
    """Options of the maker "maximum_likelihood"."""
    iterative: Iterative | None = None
    """Options of the maker "iterative"."""

    @property
    def solved(self) -> bool:
        """Return whether maps are solved for once all observations are there."""
        return self.maker in SOLVED

    @property
    def solver(self) -> Destriped | MaximumLikelihood:
        """Options of the solved maker; the defaults where the scene has none."""
        if self.maker == "destriped":
            return self.destriped
        return self.likelihood

    @property
    def likelihood(self) -> MaximumLikelihood:
        """Options of the maker "maximum_likelihood"; the defaults where the scene has none."""
        return self.maximum_likelihood or MaximumLikelihood()

    @property
    def iteration(self) -> Iterative:
        """Options of the iterative maker; the defaults where the scene has none."""
        return self.iterative or Iterative()

    @model_validator(mode="after")
    def _baseline_is_given(self) -> Self:
        if self.maker == "destriped" and self.destriped is None:
            raise ValueError("destriped: missing; the maker 'destriped' needs it, with its key 'baseline'")
        return self
