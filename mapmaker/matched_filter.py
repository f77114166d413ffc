"""Matched filter: amplitudes of sources of a known profile in a map, and their scatter.

A source of amplitude A adds ``A s(k) a(k)`` to the map's transform, with its profile s in beam and pixels
(`mapmaker.profiles`) and the amplitude a that scans and cleaning leave. In noise of the PSD N, the kernel ``s a / N``
gives the amplitude with the least scatter, ``sigma^-2 = int |s a|^2 / N d^2k / (2 pi)^2``.

N and a are known in annuli. Cleaning that treats directions alike has a real a, whose square is the transfer function
of power. Else a is the real part of the mean over directions, ``Re <c r*> / <|r|^2>`` of the transforms of skies with
and without cleaning (`measure_amplitude_transfer`), and amplitudes remain unbiased. Their scatter is then above the
value for the transfer function of power T by ``sqrt(T) / a``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mapmaker.errors import InsufficientDataError
from mapmaker.spectrum import Annuli, mode_multiplicity
from mapmaker.validation import argument_error, flags, increasing, pixel_side, reals

_NODES = 16  # of a bin of multipole; exact to rounding for smooth profiles
_LEAST_RESPONSE = 1e-3  # of a source to which the map is blind


@dataclass(frozen=True)
class MatchedFilter:
    """Matched filter on a periodic grid (n_y, n_x).

    Attributes
    ----------
    kernel : (n_y, n_x // 2 + 1)
        Transform of the weights of a map about a source.
    profile : (n_y, n_x)
        Map of a source of amplitude 1 in pixel (0, 0), as cleaning leaves it.
    sigma
        Scatter of an amplitude at weight 1, in the unit of the map.
    """

    kernel: np.ndarray
    profile: np.ndarray
    sigma: float


def profile_power(profile: Callable[[np.ndarray], np.ndarray], edges_ell: np.ndarray) -> np.ndarray:
    """Power of a profile in bins of multipole, ``int |s|^2 ell dell / 2 pi``.

    Parameters
    ----------
    profile
        s [sr] of an array of multipoles above 0.
    edges_ell : (n_bin + 1,)
        Increasing edges of the bins.

    Returns
    -------
    (n_bin,) array
        [sr].

    Raises
    ------
    ValueError
        For edges that do not increase from 0 or more.
    """
    edges = increasing("edges_ell", edges_ell, fewest=2, least=0)
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    ell = edges[:-1, None] + np.diff(edges)[:, None] * (1 + node) / 2
    return (profile(ell) ** 2 * ell) @ weight * np.diff(edges) / (4 * np.pi)


def filter_depth(noise_psd: np.ndarray, power: np.ndarray, transmission: np.ndarray, mask: np.ndarray) -> float:
    """Scatter of the amplitude of a source that a matched filter measures, ``(sum power T / N)^(-1/2)``.

    Parameters
    ----------
    noise_psd : (n_bin,)
        N, the squared unit of the map times sr.
    power : (n_bin,)
        `profile_power` of the source in beam and pixels.
    transmission : (n_bin,)
        Transfer function T of power.
    mask : (n_bin,)
        Bins that are used.

    Returns
    -------
    float
        In the unit of the map.

    Raises
    ------
    ValueError
        For shapes that differ, noise that is not positive in a used bin, and bins without signal.
    """
    return float(filter_information(noise_psd, power, transmission, mask).sum() ** -0.5)


def filter_information(
    noise_psd: np.ndarray, power: np.ndarray, transmission: np.ndarray, mask: np.ndarray
) -> np.ndarray:
    """Contribution (n_bin,) of each bin to sigma^-2; parameters and errors are those of `filter_depth`."""
    inverse = _inverse(noise_psd, mask)
    transmission = reals("transmission", transmission, inverse.shape, least=0)
    information = reals("power", power, inverse.shape, least=0) * transmission * inverse
    if not information.any():
        raise InsufficientDataError("the used bins must have a signal")
    return information


def _inverse(noise_psd: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Inverse of the noise (n_bin,), 0 in bins that are not used; raises ValueError where it is not positive."""
    mask = flags("mask", mask, ("n_bin",))
    noise = reals("noise_psd", noise_psd, mask.shape, finite=False)
    if not (noise[mask] > 0).all():
        raise InsufficientDataError("the noise PSD must be positive in all used bins")
    return np.divide(1.0, noise, out=np.zeros(mask.shape), where=mask)


def source_filter(
    profile: np.ndarray,
    noise_psd: np.ndarray,
    *,
    transfer: np.ndarray,
    mask: np.ndarray,
    rings: Annuli,
    pixel_rad: float,
) -> MatchedFilter:
    """Make the matched filter of a profile in noise that is known in annuli.

    Parameters
    ----------
    profile : (n_y, n_x // 2 + 1)
        Transform of a source of amplitude 1 [sr], in beam and pixels, on the half plane of the rings' grid. The grid
        should be twice as large as maps, so that its period does not matter.
    noise_psd : (n_bin,)
        PSD of the noise times the root of the relative weight of each pixel.
    transfer : (n_bin,)
        Amplitude that scans and cleaning leave.
    mask : (n_bin,)
        Bins that are used.
    rings
        Annuli of the grid.
    pixel_rad

    Raises
    ------
    ValueError
        For shapes that do not fit, noise that is not positive in a used bin, and bins without signal.
    """
    from scipy.fft import irfft2

    profile = reals("profile", profile, ("n_y", "n_half"))
    n_y, n_half = profile.shape
    n_x, area = 2 * (n_half - 1), pixel_side("pixel_rad", pixel_rad) ** 2
    if rings.bin_of_mode.size != profile.size:
        raise argument_error("profile", f"{profile.size} modes", f"{rings.bin_of_mode.size}, those of the annuli, are")
    transfer = reals("transfer", transfer, rings.ell.shape)
    inverse = _inverse(noise_psd, mask)
    if inverse.shape != transfer.shape:
        raise argument_error("mask", f"{inverse.size} bins", f"{transfer.size}, those of the annuli, are")
    source = profile.ravel() * np.append(transfer, 1.0)[rings.bin_of_mode]
    kernel = source * np.append(inverse, 0.0)[rings.bin_of_mode]
    information = float(np.sum(kernel * source * rings.multiplicity)) / (n_y * n_x * area)
    if not information > 0:
        raise InsufficientDataError("the used bins must have a signal")
    seen = irfft2(source.reshape(profile.shape) / area, (n_y, n_x), workers=1)
    return MatchedFilter(kernel.reshape(profile.shape) / information, seen, information**-0.5)


@dataclass(frozen=True)
class Amplitudes:
    """Amplitudes of sources and their scatter, in the unit of the map; NaN and infinite where nothing was observed."""

    amplitude: np.ndarray
    scatter: np.ndarray


def filtered_map(item: MatchedFilter, map_mk: np.ndarray, weight: np.ndarray) -> Amplitudes:
    """Amplitude of a source in the centre of each pixel, and its scatter.

    The noise of a pixel is that of the stationary noise of the filter over the root of its weight. The map times that
    root is filtered, and divided by what a source of amplitude 1 leaves there, which also holds at edges and holes.

    Parameters
    ----------
    item
        Filter, on a grid as large as the map or larger.
    map_mk : (n_y, n_x)
    weight : (n_y, n_x)
        Relative exposure: 1 where the noise is the filter's, 0 in unobserved pixels.

    Returns
    -------
    Amplitudes
        Maps (n_y, n_x).

    Raises
    ------
    ValueError
        For maps larger than the grid, weights of another shape or below 0, and values that are not finite.
    """
    from scipy.fft import irfft2

    shape = item.profile.shape
    modes = [irfft2(part, shape, workers=1) for part in _transforms(item, map_mk, weight)]
    rows, columns = np.shape(map_mk)
    return _amplitudes(item, *(part[:rows, :columns] for part in modes))


def source_amplitudes(
    item: MatchedFilter, map_mk: np.ndarray, weight: np.ndarray, *, row: np.ndarray, column: np.ndarray
) -> Amplitudes:
    """Amplitudes of sources at known places between pixel centres, and their scatter.

    Parameters
    ----------
    item, map_mk, weight
        As for `filtered_map`.
    row, column : (n_source,)
        Places in pixels, 0 at the centre of the first.

    Returns
    -------
    Amplitudes
        Of shape (n_source,).

    Raises
    ------
    ValueError
        As `filtered_map`, and for places of different shapes.
    """
    row = reals("row", row, ("n_source",))
    column = reals("column", column, row.shape)
    n_y, n_x = item.profile.shape
    multiplicity = mode_multiplicity(n_y, n_x).reshape(n_y, -1) / (n_y * n_x)
    up = np.exp(2j * np.pi * np.outer(row, np.fft.fftfreq(n_y)))
    along = np.exp(2j * np.pi * np.outer(column, np.fft.rfftfreq(n_x)))
    parts = (np.sum((up @ (part * multiplicity)) * along, axis=1).real for part in _transforms(item, map_mk, weight))
    return _amplitudes(item, *parts)


def _transforms(item: MatchedFilter, map_mk: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Transforms of the filtered map and of the response to a source of amplitude 1."""
    from scipy.fft import irfft2, rfft2

    shape = item.profile.shape
    map_mk = reals("map_mk", map_mk, ("n_y", "n_x"))
    root = np.sqrt(reals("weight", weight, map_mk.shape, least=0))
    if any(n > grid for n, grid in zip(map_mk.shape, shape, strict=True)):
        raise argument_error("map_mk", f"the shape {map_mk.shape}", f"{shape} or less, the grid of the filter, is")
    seen = irfft2(item.kernel, shape, workers=1) * item.profile
    numerator = rfft2(map_mk * root, shape, workers=1) * item.kernel
    return numerator, rfft2(root, shape, workers=1) * rfft2(seen, workers=1).conj()


def _amplitudes(item: MatchedFilter, numerator: np.ndarray, response: np.ndarray) -> Amplitudes:
    seen = response > _LEAST_RESPONSE
    amplitude = np.divide(numerator, response, out=np.full(response.shape, np.nan), where=seen)
    scatter = np.divide(item.sigma, response, out=np.full(response.shape, np.inf), where=seen)
    return Amplitudes(amplitude, scatter)
