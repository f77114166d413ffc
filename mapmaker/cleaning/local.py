"""Cleaning with localized templates: each detector's mean with its neighbours.

Sayers et al. (2010), "Adjacent Bolometer Correlations": noise that only near detectors have in common is taken for
"the data from a bolometer and the <= 6 bolometers that are adjacent to it". To be used before or after an algorithm
that removes what the whole array has in common. Since a detector is part of its own template, a good part of its own
signal goes too: of white noise a share of 1 / (1 + number of neighbours). Before, the templates take the common signal
with them, and an algorithm that fits responsivities to it finds none: it discards such scans.
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
    """Which detectors are neighbours."""

    neighbour_radius: float = 1.2  # in units of the closest separation of two detectors

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        number("neighbour_radius", self.neighbour_radius, above=1)


def neighbourhoods(focal_plane: FocalPlane, neighbour_radius: float) -> np.ndarray:
    """Each detector and its 6 or fewer nearest neighbours, (n_det, <= 7) by index; n_det stands for none.

    neighbour_radius: in units of the closest separation, detectors at one place apart. Raises ValueError for fewer than
    two places.
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

    Each detector's template is the mean of its own and its neighbours' streams, as they are before any is cleaned,
    and goes with the coefficient that fits it best. A detector without neighbours loses its mean alone.
    Responsivities are 1 and no iterations are made. Raises ValueError for fewer than two places in the array.
    Sayers et al. (2010), "Adjacent Bolometer Correlations".
    """
    index = neighbourhoods(focal_plane, options.neighbour_radius)
    return clean_scans(data_mk, scan_bounds, lambda block, scan: _subtract(block, index))


def _subtract(block: np.ndarray, index: np.ndarray) -> Fit:
    """Subtract the templates from one mean-removed scan, in place."""
    if has_dead(block):
        return Fit(None)
    n_det = len(block)
    padded = np.vstack([block, np.zeros(block.shape[1])])
    # Summed, not averaged: the coefficient takes the factor up.
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
