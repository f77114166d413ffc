"""Pixels of the samples of one detector at a time: for all detectors they would be as large as the streams."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmaker.geometry import (
    MapGeometry,
    mean_direction,
    north_angle,
    pixel_centres,
    pixel_homography,
    plane_offsets,
)
from mapmaker.pipeline.config import Circle
from mapmaker.pipeline.usable import in_scans
from mapmaker.timestreams import FocalPlane, Timestreams

_MOST_PLACES = 10_000  # along a side of the map of places
_CIRCLE = 101  # pixels across a spared circle


@dataclass(frozen=True, eq=False)
class Places:
    """Lines of sight on a map.

    Attributes
    ----------
    geometry
    homography : (8, n_samp)
        From offsets in the array to pixels.
    plane
        Detectors.
    """

    geometry: MapGeometry
    homography: np.ndarray
    plane: FocalPlane

    def of(self, d: int) -> np.ndarray:
        """Pixels (n_samp,) of a detector; -1 off the map."""
        from mapmaker.kernels.pixels import plane_pixels

        row, size = slice(d, d + 1), (self.geometry.n_x, self.geometry.n_y)
        return plane_pixels(self.homography, self.plane.x_rad[row], self.plane.y_rad[row], *size)[0]


def places_on(geometry: MapGeometry, streams: Timestreams) -> Places:
    """Places of all samples on a map, lost ones too."""
    xi, eta = plane_offsets(geometry, streams.ra_rad, streams.dec_rad)
    angle = streams.array_angle_rad + north_angle(geometry, xi, eta)
    return Places(geometry, pixel_homography(geometry, xi, eta, angle, first=0.0), streams.focal_plane)


def half_beams(streams: Timestreams) -> Places:
    """Places on a map of half beams that covers all scans."""
    inside = in_scans(streams.scan_bounds, len(streams.time_s))
    ra, dec = streams.ra_rad[inside], streams.dec_rad[inside]
    centre, plane = mean_direction(ra, dec), streams.focal_plane
    offsets = plane_offsets(MapGeometry(*centre, 1e-6, 1, 1), ra, dec)
    reach = np.nanmax(np.abs(offsets)) + np.hypot(plane.x_rad, plane.y_rad).max()
    side = max(plane.fwhm_rad / 2, 2 * reach / _MOST_PLACES)
    n = int(np.ceil(2 * reach / side)) + 1
    return places_on(MapGeometry(*centre, side, n, n), streams)


@dataclass(frozen=True, eq=False)
class Circles:
    """Circles on the sky: the places of samples on a map of each, and its pixels (n_pixel + 1,) inside."""

    maps: tuple[tuple[Places, np.ndarray], ...]

    def hold(self, d: int, n_samp: int) -> np.ndarray:
        """Flags (n_samp,) of the samples of a detector within a circle."""
        found = np.zeros(n_samp, bool)
        for places, inside in self.maps:
            found |= inside[places.of(d)]
        return found


def circles(sections: Sequence[Circle], streams: Timestreams) -> Circles:
    """Put samples on maps of some circles."""
    maps = []
    for circle in sections:
        geometry = MapGeometry(*circle.centre, 2 * circle.radius / _CIRCLE, _CIRCLE, _CIRCLE)
        inside = np.hypot(*pixel_centres(geometry)) <= circle.radius
        maps.append((places_on(geometry, streams), np.append(inside.ravel(), False)))
    return Circles(tuple(maps))
