"""HEALPix maps binned from time-streams, in the pixels within reach of the map."""

from collections.abc import Iterator

import numpy as np

from mapmaker.detector_places import array_homography
from mapmaker.errors import OutOfRangeError
from mapmaker.geometry import MapGeometry, north_angle, plane_directions, plane_offsets
from mapmaker.pipeline.one_file import CleanedFile

MOST_PIXELS = 5 * 10**7  # 1.6 GB


class HealpixSums:
    """Sums in the HEALPix pixels within the circle about the map, nested; mutable, as `MapSums`.

    Attributes
    ----------
    nside
    pixels : (n_pixel,)
        Numbers, increasing.
    weighted_sum, weight, hits : (n_pixel,)
    """

    def __init__(self, geometry: MapGeometry, nside: int) -> None:
        import healpy

        corner = geometry.pixel_rad * np.hypot(geometry.n_x, geometry.n_y) / 2
        radius = np.arctan(corner)
        expected = healpy.nside2npix(nside) * (1 - np.cos(radius)) / 2
        if expected > MOST_PIXELS:
            raise OutOfRangeError(
                f"map.healpix_nside: found {nside}; at most {MOST_PIXELS} pixels within the map are expected"
            )
        centre = healpy.ang2vec(np.pi / 2 - geometry.dec0_rad, geometry.ra0_rad)
        self.geometry, self.nside = geometry, nside
        self.pixels = np.sort(healpy.query_disc(nside, centre, radius, inclusive=True, nest=True))
        self.weighted_sum, self.weight = np.zeros((2, len(self.pixels)))
        self.hits = np.zeros(len(self.pixels), np.int64)

    def add(self, item: CleanedFile, index: np.ndarray, weight: np.ndarray) -> None:
        """Add the samples of a cleaned file that are on the map.

        Parameters
        ----------
        item
        index : (n_det, n_samp)
            Pixels of the map, negative off it.
        weight : (n_det, n_scan)
        """
        from mapmaker.kernels.weighted_sums import add_weighted

        for d, slots in enumerate(self._slots(item, index)):
            row = slice(d, d + 1)
            sums = self.weighted_sum, self.weight, self.hits
            add_weighted(item.cleaned_mk[row], slots[None], item.bounds, weight[row], *sums)

    def _slots(self, item: CleanedFile, index: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the places in `pixels` (n_samp,) of the samples of each detector, -1 off the map."""
        import healpy

        streams = item.streams
        xi, eta = plane_offsets(self.geometry, streams.ra_rad, streams.dec_rad)
        angle = streams.array_angle_rad + north_angle(self.geometry, xi, eta)
        places = array_homography(self.geometry.dec0_rad, xi, eta, angle)
        for d, (x, y) in enumerate(zip(streams.focal_plane.x_rad, streams.focal_plane.y_rad, strict=True)):
            seen = index[d] >= 0
            h = places[:, seen]
            depth = 1 + h[6] * x + h[7] * y
            ra, dec = plane_directions(
                self.geometry, (h[0] + h[1] * x + h[2] * y) / depth, (h[3] + h[4] * x + h[5] * y) / depth
            )
            slots = np.full(len(seen), -1)
            slots[seen] = np.searchsorted(self.pixels, healpy.ang2pix(self.nside, np.pi / 2 - dec, ra, nest=True))
            yield slots
