"""Iterative map-making: what cleaning takes from bright sources is put back.

A template fitted to the detectors holds a little of every bright source, and cleaning takes it out of the map.
The map's own bright part is therefore subtracted from the streams, the rest is cleaned, and the bright part is
added back, until it stands still: Enoch et al. (2006), section on iterative mapping; Sayers et al. (2010) point
to it. Only significant pixels are subtracted: a map of noise that goes round the loop brings back
the noise that cleaning took out.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from mapmaker.binning import BinnedMap, bin_map, checked_map, coadd
from mapmaker.cleaning import Cleaned
from mapmaker.errors import InsufficientDataError
from mapmaker.geometry import MapGeometry
from mapmaker.timestreams import FocalPlane
from mapmaker.validation import MAX_PIXELS, bounds_of_scans, number, pixel_numbers, reals, whole

# A normal deviate's standard deviation over its median absolute value.
_SIGMA_OF_MEDIAN = 1.482602218505602


@dataclass(frozen=True)
class StreamBlock:
    """One observation for a map-maker.

    `data_mk` (n_det, n_samp) float32 or float64 [mK]; `index` (n_det, n_samp) flat pixel, -1 off the map;
    `scan_bounds` (n_scan, 2) [start, stop); `weight` inverse noise variance a sample [1/mK^2].
    Data of other real types become float64. Raises ValueError for arrays that do not fit each other or the focal plane,
    and for weights that are not finite and 0 or more.
    """

    data_mk: np.ndarray
    index: np.ndarray
    scan_bounds: np.ndarray
    focal_plane: FocalPlane
    weight: float = 1.0

    def __post_init__(self):
        data = reals("data_mk", self.data_mk, (len(self.focal_plane.x_rad), "n_samp"), finite=False)
        index = pixel_numbers(self.index, data.shape, MAX_PIXELS)
        bounds = bounds_of_scans(self.scan_bounds, data.shape[1])
        values = {
            "data_mk": data,
            "index": index,
            "scan_bounds": bounds,
            "weight": number("weight", self.weight, least=0),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)


def check_pixels(geometry: MapGeometry, block: StreamBlock) -> None:
    """Raise ValueError for a block with pixels that the map does not have."""
    pixel_numbers(block.index, block.data_mk.shape, geometry.n_y * geometry.n_x)


@dataclass(frozen=True)
class IterationOptions:
    """What counts as signal and when the iteration ends.

    `threshold`: signal-to-noise ratio, either sign, of the beam-smoothed map above which pixels are subtracted
    from the streams. `loss`: after pass k, pixels below ``loss^k`` of the brightest are not, whatever their noise:
    what cleaning takes from a bright source it leaves as a negative ring, less by that share with every pass.
    `tolerance`: change of the signal over the signal, root of the weighted squares.
    """

    threshold: float = 5.0
    loss: float = 0.2
    tolerance: float = 1e-3
    max_iterations: int = 20

    def __post_init__(self):
        """Raise ValueError for values out of range."""
        number("threshold", self.threshold, above=0)
        number("loss", self.loss, least=0, below=1)
        number("tolerance", self.tolerance, above=0)
        whole("max_iterations", self.max_iterations, least=1, most=2**31 - 1)


@dataclass(frozen=True)
class IteratedMap:
    """The map and how it was reached; `estimate_mk` (n_y, n_x) is the signal that the last cleaning was spared."""

    map: BinnedMap
    estimate_mk: np.ndarray
    iterations: int  # passes over the observations
    change: tuple[float, ...]  # of the signal, after each pass; the first is 1, or 0 where no pixel is significant
    converged: bool


def iterate_map(
    geometry: MapGeometry,
    observations: Callable[[], Iterable[StreamBlock]],
    clean_block: Callable[[StreamBlock], Cleaned],
    options: IterationOptions,
) -> IteratedMap:
    """Clean and bin the observations until the map's significant part stands still.

    `observations()` gives all blocks anew at each pass, one at a time, so that they need not be held together.
    `clean_block` cleans one block. The signal is subtracted with unit responsivity: what a detector's own
    departs from 1 is cleaned as before, and averages out over detectors. A map that has no significant pixel is
    converged after one pass. Raises ValueError without an observation or for an index that does not fit the data.
    """
    estimate = np.zeros((geometry.n_y, geometry.n_x))
    signal = np.zeros(estimate.shape, bool)
    change: list[float] = []
    converged = False
    for k in range(1, options.max_iterations + 1):
        item, fwhm_rad = _one_pass(geometry, observations(), clean_block, estimate)
        spared = estimate
        # Once signal, always signal: a pixel on the threshold would go in and out for ever.
        signal |= significant(item, fwhm_rad, options.threshold, options.loss**k)
        estimate = np.where(signal, item.signal_mk, 0.0)
        change.append(_relative_change(estimate, spared, item.weight))
        converged = change[-1] < options.tolerance
        if converged:
            break
    return IteratedMap(item, spared, len(change), tuple(change), converged)


def significant(item: BinnedMap, fwhm_rad: float, threshold: float, floor: float) -> np.ndarray:
    """Pixels (n_y, n_x) bool where the beam-smoothed map departs from 0 by `threshold` sigma or more.

    Of these, only those where its ratio to the noise is at least `floor` times the largest.

    The matched filter of a point source in white noise, ``G * S / sqrt(G^2 * W)`` for sums S, weights W and a
    Gaussian G; sigma is its own scatter over observed pixels, 1.4826 times the median of its size, so that
    correlated noise is counted and sources on less than half of the map are not.
    """
    from scipy.ndimage import gaussian_filter

    item, fwhm_rad = checked_map(item), number("fwhm_rad", fwhm_rad, above=0)
    number("threshold", threshold, above=0)
    number("floor", floor, least=0, most=1)
    sigma_pixels = fwhm_rad / np.sqrt(8 * np.log(2)) / item.geometry.pixel_rad
    total = gaussian_filter(item.weighted_sum.astype(float), sigma_pixels, mode="constant")
    # The square of a Gaussian is one of 1 / sqrt(2) the width; its constant drops out with the scatter.
    weight = gaussian_filter(item.weight.astype(float), sigma_pixels / np.sqrt(2), mode="constant")
    seen = item.weight > 0
    ratio = np.zeros(total.shape)
    ratio[seen] = np.abs(total[seen]) / np.sqrt(weight[seen])
    scatter = _SIGMA_OF_MEDIAN * np.median(ratio[seen]) if seen.any() else 0.0
    return seen & (ratio > 0) & (ratio >= max(threshold * scatter, floor * ratio.max()))


def subtract_sky(block: StreamBlock, sky_mk: np.ndarray) -> StreamBlock:
    """The block less a map (n_y, n_x) [mK] as its pixels see it; samples off the map are left as they are.

    Raises ValueError for a map that is not finite or has not all pixels of the block.
    """
    sky_mk = reals("sky_mk", sky_mk, ("n_y", "n_x"))
    pixel_numbers(block.index, block.data_mk.shape, sky_mk.size)
    padded = np.append(sky_mk.ravel(), 0.0).astype(block.data_mk.dtype)
    # Index -1, off the map, is the last element: 0.
    return replace(block, data_mk=block.data_mk - padded[block.index])


def _one_pass(geometry, blocks, clean_block, estimate) -> tuple[BinnedMap, float]:
    """The co-added map with the estimate added back, and the narrowest beam."""
    total, fwhm_rad = None, np.inf
    for block in blocks:
        check_pixels(geometry, block)
        cleaned = clean_block(subtract_sky(block, estimate) if estimate.any() else block)
        one = bin_map(geometry, cleaned.data_mk, block.index, block.scan_bounds, kept=cleaned.kept)
        total = coadd([one], [block.weight]) if total is None else coadd([total, one], [1.0, block.weight])
        fwhm_rad = min(fwhm_rad, block.focal_plane.fwhm_rad)
    if total is None:
        raise InsufficientDataError("found no observation; one or more are expected")
    # Binning what the pixels put into the streams gives the pixels again.
    return replace(total, weighted_sum=total.weighted_sum + estimate * total.weight), fwhm_rad


def _relative_change(new: np.ndarray, old: np.ndarray, weight: np.ndarray) -> float:
    size = np.sqrt(np.sum(weight * new**2))
    step = np.sqrt(np.sum(weight * (new - old) ** 2))
    if step == 0:
        return 0.0
    return float(step / size) if size > 0 else np.inf
