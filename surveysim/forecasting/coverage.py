"""Coverage of the scored patch by the detectors: hit counts, and the samples that make the map of each place."""

from dataclasses import dataclass

import numpy as np

from mapmaker.chunks import row_chunks
from mapmaker.geometry import MapGeometry, boresight_pixels, pixel_homography
from mapmaker.timestreams import FocalPlane
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.setup import Setup
from surveysim.telescope.pointing import Pointing
from surveysim.telescope.scans import ScanPath, samples_per_scan
from surveysim.timestreams.simulation import observation_path

_HIT_SAMPLES = 3e7  # of the observations that represent the coverage
_FEWEST_HITS, _MOST_HITS = 4, 48
_MOST_HIT_SAMPLES = 3e7  # of one of them; larger ones are thinned in time
_CELLS = 4  # along a side of the patch
PLACES = _CELLS**2
_DETECTORS = 64  # that represent all in the part of samples


def samples_in_maps(path: ScanPath, every: int) -> np.ndarray:
    """Numbers of one of `every` samples, without those of turnarounds."""
    used = np.arange(0, len(path.time_s), every)
    return used if path.flagged is None else used[~path.flagged[used]]


def pointed_samples(pointing: Pointing, used: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boresight and angle of the array of some samples, as `boresight_pixels` takes them."""
    return pointing.xi_rad[used], pointing.eta_rad[used], pointing.array_angle_rad[used]


def mean_hits(setup: Setup, pipeline: CleaningPipeline) -> np.ndarray:
    """Mean hits of one observation on the scored patch (n, n), from a sample of observations over the survey."""
    from mapmaker.kernels.pixels import count_samples, plane_pixels

    n_obs, geometry = setup.scene.observations, setup.analysis.geometry
    plane: FocalPlane = setup.camera.focal_plane.subset(pipeline.rows)
    samples = len(plane.x_rad) * setup.observing.scans.n_scans * samples_per_scan(setup.observing.scans)
    every = max(1, int(samples // _MOST_HIT_SAMPLES))
    wanted = min(n_obs, int(np.clip(_HIT_SAMPLES / samples, _FEWEST_HITS, _MOST_HITS)))
    # In pairs of both scan directions.
    numbers = np.unique(np.minimum(2 * (np.arange(wanted) * n_obs // wanted // 2) + np.arange(wanted) % 2, n_obs - 1))
    hits = np.zeros(geometry.n_x * geometry.n_y, np.int64)
    for number in numbers:
        path, pointing = observation_path(setup.observing, int(number))
        used = samples_in_maps(path, every)
        place = pixel_homography(geometry, *pointed_samples(pointing, used), first=0.0)
        for rows in row_chunks(len(plane.x_rad), len(used)):
            index = plane_pixels(place, plane.x_rad[rows], plane.y_rad[rows], geometry.n_x, geometry.n_y)
            count_samples(index, hits)
    patch = setup.analysis.region.patch
    return hits.reshape(geometry.n_y, geometry.n_x)[patch, patch] * every / len(numbers)


@dataclass(frozen=True)
class SampleCoverage:
    """Part of samples (n,) in the map, summed over detectors: in its noise, and in the signal of places (n, PLACES)."""

    noise: np.ndarray
    places: np.ndarray


class Coverage:
    """Coverage of the scored patch by one cleaning pipeline, from which the part of samples in the map follows.

    A sample counts by taper^2 / hits^2 of its pixel in the noise, and by taper^2 / hits in the signal.
    """

    def __init__(self, setup: Setup, pipeline: CleaningPipeline):
        region, geometry = setup.analysis.region, setup.analysis.geometry
        plane = setup.camera.focal_plane.subset(pipeline.rows)
        hits, square = mean_hits(setup, pipeline), region.taper**2
        signal = np.divide(square, hits, out=np.zeros_like(square), where=hits > 0)
        noise = np.divide(signal, hits, out=np.zeros_like(square), where=hits > 0)
        n = len(square)
        cell = np.arange(n) * _CELLS // n
        self.geometry = geometry
        self.plane = plane.subset(np.arange(0, len(plane.x_rad), -(-len(plane.x_rad) // _DETECTORS)))
        self._signal, self._noise, self._place = (
            _on_map(geometry, region.patch, item) for item in (signal, noise, cell[:, None] * _CELLS + cell)
        )

    def of_samples(self, pointing: Pointing, kept: np.ndarray) -> SampleCoverage:
        """Part of some samples, by their numbers (n,), in the map."""
        pixel = boresight_pixels(self.geometry, *pointed_samples(pointing, kept), plane=self.plane)
        place = np.arange(len(kept)) * PLACES + self._place[pixel]
        places = np.bincount(place.ravel(), self._signal[pixel].ravel(), len(kept) * PLACES)
        return SampleCoverage(self._noise[pixel].sum(axis=0), places.reshape(len(kept), PLACES))


def _on_map(geometry: MapGeometry, patch: slice, values: np.ndarray) -> np.ndarray:
    """Values of a patch on the flat map, with 0 around it and, last, for samples off the map."""
    whole = np.zeros((geometry.n_y, geometry.n_x), values.dtype)
    whole[patch, patch] = values
    return np.append(whole, values.dtype.type(0))
