"""Cleaning with localized templates: the mean of each detector and its neighbours.

Sayers et al. (2010), "Adjacent Bolometer Correlations": the templates of noise that only near detectors have in common
are "the data from a bolometer and the <= 6 bolometers that are adjacent to it". The algorithm is meant to run before or
after one that removes the common signal of the array. A detector is part of its own template, so part of its own signal
is removed: of white noise a fraction 1 / (1 + number of neighbours). If it runs first, the templates include the common
signal, and an algorithm that fits responsivities to that finds none: it discards the scans.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.cleaning.scans import Cleaned, Fit, checks_streams, clean_scans, has_dead
from mapmaker.errors import InsufficientDataError
from mapmaker.validation import number

if TYPE_CHECKING:
    from mapmaker.timestreams import FocalPlane

MOST_NEIGHBOURS = 6


@dataclass(frozen=True)
class LocalOptions:
    """Options of localized cleaning.

    Attributes
    ----------
    neighbour_radius
        Largest distance of neighbours, in units of the closest separation of two detectors.
    """

    neighbour_radius: float = 1.2

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        number("neighbour_radius", self.neighbour_radius, above=1)


def neighbourhoods(focal_plane: FocalPlane, neighbour_radius: float) -> np.ndarray:
    """Each detector and its nearest neighbours, at most 6.

    Parameters
    ----------
    focal_plane
    neighbour_radius
        In units of the closest separation of two detectors at different positions.

    Returns
    -------
    (n_det, <= 7) array
        Detectors by index; n_det stands for none.

    Raises
    ------
    ValueError
        For fewer than two positions.
    """
    from scipy.spatial import KDTree

    places = np.column_stack([focal_plane.x_rad, focal_plane.y_rad])
    apart = np.unique(places, axis=0)
    if len(apart) < 2:
        raise InsufficientDataError(
            f"{len(places)} detectors at {len(apart)} place have no neighbours, at least 2 are needed"
        )
    closest = KDTree(apart).query(apart, k=2)[0][:, 1].min()
    most = min(MOST_NEIGHBOURS + 1, len(places))
    return KDTree(places).query(places, k=most, distance_upper_bound=neighbour_radius * closest)[1]


@checks_streams
def subtract_local(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: LocalOptions
) -> Cleaned:
    """Remove the mean and the localized templates; arguments, result and errors as for `clean`.

    Each detector's template is the mean of its own and its neighbours' streams before cleaning, with the best-fitting
    coefficient. A detector without neighbours loses its mean alone. Responsivities are 1, without iterations. Source:
    Sayers et al. (2010), "Adjacent Bolometer Correlations".

    Raises
    ------
    ValueError
        For fewer than two positions in the array.
    """
    index = neighbourhoods(focal_plane, options.neighbour_radius)
    return clean_scans(data_mk, scan_bounds, lambda block, scan: _subtract(block, index))


def _subtract(block: np.ndarray, index: np.ndarray) -> Fit:
    """Subtract the templates from one mean-removed scan, in place."""
    if has_dead(block):
        return Fit(None)
    n_det = len(block)
    padded = np.vstack([block, np.zeros(block.shape[1])])
    # A sum in place of the mean: the coefficient includes the factor.
    template = padded[index[:, 0]]
    for column in index.T[1:]:
        template += padded[column]
    square = np.einsum("in,in->i", template, template)
    alone = np.sum(index < n_det, axis=1) == 1
    usable = ~alone & (square > 0)
    cross = np.einsum("in,in->i", template, block)
    coefficient = np.divide(cross, square, out=np.zeros(n_det), where=usable)
    template *= coefficient[:, None]
    block -= template
    return Fit(np.ones(n_det), 0, 1)
