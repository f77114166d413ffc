"""Iterative map-making, which restores the signal that cleaning removes from bright sources.

A template fitted to the detectors contains a little of every bright source, which cleaning removes from the map. The
bright part of the map is therefore subtracted from the streams, the rest is cleaned, and the bright part is added back,
until it converges: Enoch et al. (2006), section on iterative mapping, to which Sayers et al. (2010) refer. Only
significant pixels are subtracted: otherwise the iteration would restore the noise that cleaning removed.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mapmaker.binning import STOKES, BinnedMap, bin_map, checked_map, coadd, map_shape
from mapmaker.cleaning import Cleaned
from mapmaker.errors import InsufficientDataError
from mapmaker.geometry import MapGeometry
from mapmaker.timestreams import FocalPlane
from mapmaker.validation import MAX_PIXELS, bounds_of_scans, number, pixel_numbers, reals, whole

# Standard deviation of a normal deviate over its median absolute value.
_SIGMA_OF_MEDIAN = 1.482602218505602


@dataclass(frozen=True)
class StreamBlock:
    """Observation for a map-maker.

    Attributes
    ----------
    data_mk : (n_det, n_samp)
        float32 or float64; other real types become float64.
    index : (n_det, n_samp)
        Flat pixel of each sample, -1 off the map.
    scan_bounds : (n_scan, 2)
        Scans [start, stop).
    focal_plane
    weight
        Inverse noise variance a sample [1/mK^2].

    Raises
    ------
    ValueError
        For arrays that do not match each other or the focal plane, and weights that are not finite and at least 0.
    """

    data_mk: np.ndarray
    index: np.ndarray
    scan_bounds: np.ndarray
    focal_plane: FocalPlane
    weight: float = 1.0

    def __post_init__(self) -> None:
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
    """Raise ValueError for a block with pixels outside the map."""
    pixel_numbers(block.index, block.data_mk.shape, geometry.n_y * geometry.n_x)


@dataclass(frozen=True)
class IterationOptions:
    """Definition of signal, and convergence.

    Attributes
    ----------
    threshold
        Signal-to-noise ratio, of either sign, of the beam-smoothed map above which pixels are subtracted from the
        streams.
    loss
        After pass k, pixels below ``loss^k`` of the brightest are not subtracted, whatever their noise. Cleaning
        leaves a bright source a negative ring, which shrinks by this factor with every pass.
    tolerance
        Relative change of the signal, root of the weighted squares.
    max_iterations
    """

    threshold: float = 5.0
    loss: float = 0.2
    tolerance: float = 1e-3
    max_iterations: int = 20

    def __post_init__(self) -> None:
        """Raise ValueError for values out of range."""
        number("threshold", self.threshold, above=0)
        number("loss", self.loss, least=0, below=1)
        number("tolerance", self.tolerance, above=0)
        whole("max_iterations", self.max_iterations, least=1, most=2**31 - 1)


@dataclass(frozen=True)
class IteratedMap:
    """Result of iterative map-making.

    Attributes
    ----------
    map
    estimate_mk : (n_stokes, n_y, n_x)
        Signal that was subtracted before the last cleaning.
    iterations
        Passes over the observations.
    change
        Relative change of the signal after each pass; the first is 1, or 0 where no pixel is significant.
    converged
    """

    map: BinnedMap
    estimate_mk: np.ndarray
    iterations: int
    change: tuple[float, ...]
    converged: bool


def iterate_map(
    geometry: MapGeometry,
    observations: Callable[[], Iterable[StreamBlock]],
    clean_block: Callable[[StreamBlock], Cleaned],
    options: IterationOptions,
) -> IteratedMap:
    """Clean and bin the observations until the significant part of the map converges.

    The signal is subtracted with unit responsivity: the residual from a detector's own is cleaned as before, and
    averages out over detectors. A map without significant pixels converges after one pass.

    Parameters
    ----------
    geometry
    observations
        Function that returns all blocks for one pass, one at a time.
    clean_block
        Function that cleans one block.
    options

    Raises
    ------
    ValueError
        For no observation, and for an index that does not match the data.
    """
    estimate = np.zeros(map_shape(geometry))
    signal = np.zeros(estimate.shape, bool)
    change: list[float] = []
    converged = False
    for k in range(1, options.max_iterations + 1):
        item, fwhm_rad = _one_pass(geometry, observations(), clean_block, estimate)
        spared = estimate
        # A signal pixel stays one: at the threshold it would alternate for ever.
        signal |= significant(item, fwhm_rad, options.threshold, options.loss**k)
        estimate = np.where(signal, item.signal_mk, 0.0)
        change.append(relative_change(estimate, spared, item.weight))
        converged = change[-1] < options.tolerance
        if converged:
            break
    return IteratedMap(item, spared, len(change), tuple(change), converged)


def significant(item: BinnedMap, fwhm_rad: float, threshold: float, floor: float) -> np.ndarray:
    """Find the pixels where the beam-smoothed map differs significantly from 0.

    The statistic is the matched filter of a point source in white noise, ``G * S / sqrt(G^2 * W)``, for sums S, weights
    W and a Gaussian G. Its sigma is 1.4826 times the median of its absolute values over observed pixels, which includes
    correlated noise and is insensitive to sources on less than half of the map.

    Parameters
    ----------
    item
    fwhm_rad
    threshold
        Least significance in sigma.
    floor
        Least ratio to the largest statistic.

    Returns
    -------
    (n_stokes, n_y, n_x) bool array
    """
    from scipy.ndimage import gaussian_filter

    item, fwhm_rad = checked_map(item), number("fwhm_rad", fwhm_rad, above=0)
    number("threshold", threshold, above=0)
    number("floor", floor, least=0, most=1)
    sigma_pixels = fwhm_rad / np.sqrt(8 * np.log(2)) / item.geometry.pixel_rad
    smooth = partial(gaussian_filter, mode="constant", axes=(-2, -1))
    total = smooth(item.weighted_sum.astype(float), sigma_pixels)
    # The square of a Gaussian is a Gaussian of 1 / sqrt(2) the width; its constant cancels against the scatter.
    weight = smooth(item.weight.astype(float), sigma_pixels / np.sqrt(2))
    seen = item.weight > 0
    ratio = np.zeros(total.shape)
    ratio[seen] = np.abs(total[seen]) / np.sqrt(weight[seen])
    scatter = _SIGMA_OF_MEDIAN * np.median(ratio[seen]) if seen.any() else 0.0
    return seen & (ratio > 0) & (ratio >= max(threshold * scatter, floor * ratio.max()))


def subtract_sky(block: StreamBlock, sky_mk: np.ndarray) -> StreamBlock:
    """Subtract a map (n_stokes, n_y, n_x) [mK] from the streams; samples off the map are unchanged.

    Raises
    ------
    ValueError
        For a map that is not finite, or lacks pixels of the block.
    """
    sky_mk = reals("sky_mk", sky_mk, (len(STOKES), "n_y", "n_x"))
    pixel_numbers(block.index, block.data_mk.shape, sky_mk.size)
    padded = np.append(sky_mk.ravel(), 0.0).astype(block.data_mk.dtype)
    # Index -1, off the map, is the last element: 0.
    return replace(block, data_mk=block.data_mk - padded[block.index])


def _one_pass(
    geometry: MapGeometry,
    blocks: Iterable[StreamBlock],
    clean_block: Callable[[StreamBlock], Cleaned],
    estimate: np.ndarray,
) -> tuple[BinnedMap, float]:
    """Co-added map with the estimate added back, and the narrowest beam."""
    total, fwhm_rad = None, np.inf
    for block in blocks:
        check_pixels(geometry, block)
        cleaned = clean_block(subtract_sky(block, estimate) if estimate.any() else block)
        one = bin_map(geometry, cleaned.data_mk, block.index, block.scan_bounds, kept=cleaned.kept)
        total = coadd([one], [block.weight]) if total is None else coadd([total, one], [1.0, block.weight])
        fwhm_rad = min(fwhm_rad, block.focal_plane.fwhm_rad)
    if total is None:
        raise InsufficientDataError("found no observation; one or more are expected")
    # Binning streams of the estimate gives the estimate again.
    return replace(total, weighted_sum=total.weighted_sum + estimate * total.weight), fwhm_rad


def relative_change(new: np.ndarray, old: np.ndarray, weight: np.ndarray) -> float:
    """Root of the weighted squares of the change of a map, over that of the new map; infinite for a map of zeros."""
    size = np.sqrt(np.sum(weight * new**2))
    step = np.sqrt(np.sum(weight * (new - old) ** 2))
    if step == 0:
        return 0.0
    return float(step / size) if size > 0 else np.inf
