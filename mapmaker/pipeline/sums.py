"""Running sums of the maps: of all data, and of the first half of each division."""

from collections.abc import Sequence

import numpy as np

from mapmaker.binning import HITS_UNIT, INVERSE_VARIANCE_UNIT, BinnedMap, half_difference, map_shape
from mapmaker.geometry import MapGeometry, pixel_indices
from mapmaker.pipeline.dropped import OFF_MAP, SAMPLES, Dropped
from mapmaker.pipeline.healpix_sums import HealpixSums
from mapmaker.pipeline.one_file import CleanedFile
from mapmaker.pipeline.splits import Split, first_half


class MapSums:
    """Sums over the files added so far.

    The one mutable record of the pipeline: maps are as large as all of the rest.

    Attributes
    ----------
    geometry, splits, unit
    weighted_sum, weight, hits : (1 + n_split, n_pixel)
        Of all data, then of the first half of each division.
    healpix
        Sums on HEALPix pixels; None without.
    """

    def __init__(self, geometry: MapGeometry, splits: Sequence[Split], uniform: bool, nside: int | None) -> None:
        n_pixel = geometry.n_x * geometry.n_y
        self.geometry, self.splits = geometry, tuple(splits)
        self.unit = HITS_UNIT if uniform else INVERSE_VARIANCE_UNIT
        self.weighted_sum, self.weight = np.zeros((2, 1 + len(splits), n_pixel))
        self.hits = np.zeros((1 + len(splits), n_pixel), np.int64)
        self.healpix = None if nside is None else HealpixSums(geometry, nside)
        self._order: dict[str, int] = {}  # of detectors, by name

    def add(self, item: CleanedFile, weight: np.ndarray, place: tuple[int, int]) -> tuple[Dropped, ...]:
        """Add a cleaned file; returns what is off the map.

        Parameters
        ----------
        item
        weight : (n_det,)
            Weight of a sample.
        place
            Number of the file, and number of files.
        """
        from mapmaker.kernels.weighted_sums import add_weighted

        for label in item.labels:
            self._order.setdefault(str(label), len(self._order))
        index = pixel_indices(self.geometry, item.streams)
        data, of_scans = item.streams.data_mk, np.where(item.used, weight[:, None], 0.0)
        halves = [first_half(split, item, place, self._order) for split in self.splits]
        for s, half in enumerate([np.ones_like(item.used), *halves]):
            sums = self.weighted_sum[s], self.weight[s], self.hits[s]
            add_weighted(data, index, item.bounds, np.where(half, of_scans, 0.0), *sums)
        if self.healpix is not None:
            self.healpix.add(item, index, of_scans)
        missed = sum(
            int(np.sum((index[:, a:b] < 0) & ~item.streams.flags[:, a:b] & used[:, None]))
            for (a, b), used in zip(item.bounds, item.used.T, strict=True)
        )
        return (Dropped(item.name, SAMPLES, OFF_MAP, samples=missed),) if missed else ()

    def map(self) -> BinnedMap:
        """Map of all data."""
        return self._binned(self.weighted_sum[0], self.weight[0], self.hits[0])

    def noise_map(self, number: int) -> BinnedMap:
        """Noise map of a division: the difference of its halves, scaled to the noise of all data."""
        first = [plane[1 + number] for plane in (self.weighted_sum, self.weight, self.hits)]
        second = [
            plane[0] - half for plane, half in zip((self.weighted_sum, self.weight, self.hits), first, strict=True)
        ]
        # A difference of equal sums has rounding.
        seen = second[2] > 0
        return half_difference(self._binned(*first), self._binned(second[0] * seen, second[1] * seen, second[2]))

    def _binned(self, *planes: np.ndarray) -> BinnedMap:
        shape = map_shape(self.geometry)
        total, weight, hits = (plane.reshape(shape) for plane in planes)
        return BinnedMap(self.geometry, total, weight, hits, self.unit)
