"""Cleaning with polynomial templates of any order, on the whole focal plane or in regions of it.

Sayers et al. (2010) use orders 0, 1 and 2 over 8 arcmin ("Higher-Order Template Subtraction"); larger fields of view
need higher orders or regions. Each region has its own templates and responsivities.

Regions are cut as in a k-d tree: a set of detectors is split across the larger of its extents in x and y, until there
are enough sets; their sizes differ by one detector at most.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.cleaning.responsivity import SCAN, Region, Responsivities, TemplateModel, check_fit, clean_templates
from mapmaker.cleaning.scans import Cleaned, checks_streams
from mapmaker.cleaning.templates import template_basis
from mapmaker.errors import InsufficientDataError
from mapmaker.validation import whole

if TYPE_CHECKING:
    from mapmaker.timestreams import FocalPlane

# Extents and positions that differ by less than this fraction of the array's are equal: rows of a lattice differ by
# rounding.
_EQUAL = 1e-6
_MOST_ORDER = 200  # 20,000 terms, which need as many detectors


@dataclass(frozen=True)
class PolynomialOptions:
    """Options of polynomial cleaning.

    Attributes
    ----------
    order
        Highest degree of the terms.
    regions
        Number of regions.
    tolerance, max_iterations, responsivities, first_guess
        As in `TemplateOptions`; convergence is tested in each region.
    """

    order: int
    regions: int
    tolerance: float
    max_iterations: int
    responsivities: Responsivities = SCAN
    first_guess: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for values out of range."""
        whole("order", self.order, least=0, most=_MOST_ORDER)
        whole("regions", self.regions, least=1, most=2**31 - 1)
        check_fit(self.tolerance, self.max_iterations, self.responsivities, self.first_guess)


def exponents(order: int) -> tuple[tuple[int, int], ...]:
    """Exponents (of x, of y) of all terms up to the order, lowest first."""
    return tuple((total - b, b) for total in range(order + 1) for b in range(total + 1))


def focal_plane_regions(focal_plane: FocalPlane, regions: int) -> list[np.ndarray]:
    """Split the detectors into regions, by index; their sizes differ by one at most.

    Raises
    ------
    ValueError
        For fewer detectors than regions.
    """
    if len(focal_plane.x_rad) < regions:
        raise InsufficientDataError(f"{regions} regions need at least as many detectors, got {len(focal_plane.x_rad)}")
    places = np.stack([focal_plane.x_rad, focal_plane.y_rad], axis=1).astype(np.float64)
    places = np.rint((places - places.min(axis=0)) / (_EQUAL * (np.ptp(places, axis=0).max() or 1.0)))
    base, more = divmod(len(places), regions)
    sizes = [base + (k < more) for k in range(regions)]
    return [np.sort(region) for region in _split(places, np.arange(len(places)), sizes)]


def _split(places: np.ndarray, members: np.ndarray, sizes: list[int]) -> list[np.ndarray]:
    if len(sizes) == 1:
        return [members]
    x, y = places[members].T
    order = np.lexsort((y, x) if np.ptp(x) >= np.ptp(y) else (x, y))
    half = len(sizes) // 2
    first, second = np.split(members[order], [sum(sizes[:half])])
    return _split(places, first, sizes[:half]) + _split(places, second, sizes[half:])


@checks_streams
def subtract_polynomial(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: PolynomialOptions
) -> Cleaned:
    """Remove the mean and all templates x^a y^b, a + b <= order, in each region.

    Arguments, result and errors are those of `clean`. Above order 0, responsivities have the mean 1 in each region:
    they compare detectors of one region only. `iterations` is that of the slowest region, `removed` counts the
    templates of all regions; a fit fails if it fails in one region. With one region, orders 0, 1 and 2 are average,
    planar and quadratic subtraction.

    Raises
    ------
    ValueError
        If a region does not support the templates.
    """
    regions = tuple(
        Region(rows, template_basis(focal_plane.subset(rows), exponents(options.order)))
        for rows in focal_plane_regions(focal_plane, options.regions)
    )
    return clean_templates(data_mk, scan_bounds, TemplateModel(regions), options)
