"""Running sums of the maps: of all data, and of the first half of each division."""

from collections.abc import Sequence

import numpy as np

from mapmaker.binning import HITS_UNIT, INVERSE_VARIANCE_UNIT, BinnedMap, half_difference, map_shape
from mapmaker.geometry import MapGeometry
from mapmaker.pipeline.healpix_sums import HealpixSums
from mapmaker.pipeline.mapped_file import MappedFile
from mapmaker.pipeline.maps import Maps
from mapmaker.pipeline.splits import Split


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

    def add(self, file: MappedFile) -> None:
        """Add a file with its cleaned streams."""
        from mapmaker.kernels.weighted_sums import add_weighted

        item = file.item
        for s, half in enumerate([np.ones_like(item.used), *file.halves]):
            sums = self.weighted_sum[s], self.weight[s], self.hits[s]
            add_weighted(item.cleaned_mk, file.index, item.bounds, np.where(half, file.weight, 0.0), *sums)
        if self.healpix is not None:
            self.healpix.add(item, file.index, file.weight)

    def maps(self, solution: str = "", converged: bool = True) -> Maps:
        """Maps of the files added so far; the last two are those of `Maps`."""
        noise = tuple(self.noise_map(k) for k in range(len(self.splits)))
        return Maps(self.map(), self.splits, noise, self.healpix, solution, converged)

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
