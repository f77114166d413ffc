"""PSDs of maps: tapers, 2-D and azimuthally averaged PSDs, their expectation and degrees of freedom."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mapmaker.errors import InsufficientDataError, OutOfRangeError
from mapmaker.validation import MAX_PIXELS, argument_error, increasing, number, pixel_side, plane_sides, reals, whole


@dataclass(frozen=True)
class Annuli:
    """Annuli of multipole on the half plane of `rfft2`; bin b holds `edges_ell[b] <= ell < edges_ell[b + 1]`.

    Attributes
    ----------
    edges_ell : (n_bin + 1,)
    ell : (n_bin,)
        Mean over the modes of the bin.
    n_modes : (n_bin,)
        Independent real degrees of freedom.
    bin_of_mode : (n_y * (n_x // 2 + 1),)
        Bin of each flattened half-plane mode, int64; `n_bin` for modes outside all bins.
    multiplicity : (n_y * (n_x // 2 + 1),)
        2 for a mode whose complex conjugate `rfft2` leaves out, else 1; float64.
    """

    edges_ell: np.ndarray
    ell: np.ndarray
    n_modes: np.ndarray
    bin_of_mode: np.ndarray
    multiplicity: np.ndarray

    @cached_property
    def modes_of_bin(self) -> np.ndarray:
        """Number of modes of the whole plane in each bin, (n_bin,)."""
        return np.bincount(self.bin_of_mode, self.multiplicity, self.ell.size + 1)[: self.ell.size]


def tukey_taper(n_y: int, n_x: int, pixel_rad: float, *, size_rad: float, edge_fraction: float) -> np.ndarray:
    """Separable cosine-edged taper on a centred square, zero outside.

    Parameters
    ----------
    n_y, n_x
        Pixels of the map.
    pixel_rad
    size_rad
        Side of the square.
    edge_fraction
        Fraction of the side in the two cosine edges: 0 is a box, 1 a Hann taper.

    Returns
    -------
    (n_y, n_x) array

    Raises
    ------
    ValueError
        For an edge fraction outside [0, 1], or a square larger than the map.
    """
    _check_plane(n_y, n_x, pixel_rad)
    if not 0 <= number("edge_fraction", edge_fraction) <= 1:
        raise OutOfRangeError(f"edge_fraction must be in [0, 1], got {edge_fraction}")
    extent_rad = min(n_y, n_x) * pixel_rad
    if not 0 < number("size_rad", size_rad) <= extent_rad * (1 + 1e-9):
        raise OutOfRangeError(f"size_rad must be in (0, {extent_rad}], the map's shorter side; got {size_rad}")
    return np.outer(tukey(n_y, pixel_rad, size_rad, edge_fraction), tukey(n_x, pixel_rad, size_rad, edge_fraction))


def tukey(n: int, pixel_rad: float, size_rad: float, edge_fraction: float) -> np.ndarray:
    """Cosine-edged taper (n,) in steps of `pixel_rad` with the full width `size_rad`; see `tukey_taper`."""
    from_centre = np.abs(np.arange(n) - (n - 1) / 2) * pixel_rad / (size_rad / 2)
    inside = from_centre <= 1
    if edge_fraction == 0:
        return inside.astype(np.float64)
    into_edge = np.clip((from_centre - (1 - edge_fraction)) / edge_fraction, 0, 1)
    return np.where(inside, 0.5 * (1 + np.cos(np.pi * into_edge)), 0.0)


def mode_ell(n_y: int, n_x: int, pixel_rad: float) -> np.ndarray:
    """Multipole `ell = |k|` of each mode of `rfft2`, (n_y, n_x // 2 + 1).

    Raises
    ------
    ValueError
        For sides that are not positive integers, and pixels that are not positive.
    """
    _check_plane(n_y, n_x, pixel_rad)
    k_y = 2 * np.pi * np.fft.fftfreq(n_y, pixel_rad)
    k_x = 2 * np.pi * np.fft.rfftfreq(n_x, pixel_rad)
    return np.hypot(k_y[:, None], k_x)


def annuli(n_y: int, n_x: int, pixel_rad: float, *, edges_ell: np.ndarray, taper: np.ndarray) -> Annuli:
    """Sort the Fourier modes of a map into bins of multipole and count their degrees of freedom.

    A full plane has as many real degrees of freedom as cells. The taper T correlates modes: the squared correlations of
    one mode with all modes add up to `N_pix sum T^4 / (sum T^2)^2`. A bin that is wide against the taper's resolution
    therefore has `n = cells (sum T^2)^2 / (N_pix sum T^4)`, and its PSD the relative variance 2 / n for stationary
    isotropic noise. A narrower bin scatters less than 2 / n, but its correlation with neighbours compensates for that
    in any smooth sum over bins, such as a band power.

    Parameters
    ----------
    n_y, n_x, pixel_rad
        Pixels of the map, and their side.
    edges_ell : (n_bin + 1,)
        Increasing edges of the bins.
    taper : (n_y, n_x)

    Raises
    ------
    ValueError
        For edges that do not increase, a bin without modes, or a taper of another shape.
    """
    edges_ell = increasing("edges_ell", edges_ell, fewest=2)
    _check_plane(n_y, n_x, pixel_rad)
    taper = checked_taper(taper, (n_y, n_x))
    n_bin = edges_ell.size - 1
    ell = mode_ell(n_y, n_x, pixel_rad).ravel()
    bin_of_mode = np.searchsorted(edges_ell, ell, side="right") - 1
    bin_of_mode[bin_of_mode < 0] = n_bin
    multiplicity = mode_multiplicity(n_y, n_x)
    cells = np.bincount(bin_of_mode, multiplicity, n_bin + 1)[:n_bin]
    if not cells.all():
        empty = int(np.argmin(cells))
        raise InsufficientDataError(
            f"no Fourier mode of the map has {edges_ell[empty]} <= ell < {edges_ell[empty + 1]}"
        )
    ell_mean = np.bincount(bin_of_mode, multiplicity * ell, n_bin + 1)[:n_bin] / cells
    kept = np.sum(taper**2) ** 2 / (taper.size * np.sum(taper**4))
    return Annuli(edges_ell, ell_mean, cells * kept, bin_of_mode, multiplicity)


def _check_plane(n_y: int, n_x: int, pixel_rad: float) -> None:
    plane_sides(n_y, n_x)
    pixel_side("pixel_rad", pixel_rad)


def checked_taper(taper: np.ndarray, shape: tuple = ("n_y", "n_x")) -> np.ndarray:
    """Check a taper that is not zero everywhere."""
    taper = reals("taper", taper, shape)
    if not taper.any():
        raise argument_error("taper", "zeros alone", "a taper that hides a part of the map is")
    return taper


def split_azimuth(rings: Annuli, n_y: int, n_x: int, pixel_rad: float, *, n_sector: int) -> Annuli:
    """Split annuli into sectors of the angle between a mode and the nearer map axis, 0 to 45 degrees.

    Scans along the axes make the noise anisotropic with this symmetry. Bin b becomes bins `b n_sector` to
    `b n_sector + n_sector - 1`; `edges_ell` are unchanged.

    Raises
    ------
    ValueError
        For a sector without modes.
    """
    n_bin = rings.ell.size
    k_y, k_x = np.fft.fftfreq(n_y, pixel_rad)[:, None], np.fft.rfftfreq(n_x, pixel_rad)[None, :]
    from_axis = np.abs((np.arctan2(k_y, k_x).ravel() + np.pi / 4) % (np.pi / 2) - np.pi / 4)
    sector = np.minimum((from_axis / (np.pi / 4) * n_sector).astype(np.int64), n_sector - 1)
    inside = rings.bin_of_mode < n_bin
    bin_of_mode = np.where(inside, rings.bin_of_mode * n_sector + sector, n_bin * n_sector)
    cells = np.bincount(bin_of_mode, rings.multiplicity, n_bin * n_sector + 1)[:-1]
    if not cells.all():
        raise InsufficientDataError(f"{n_sector} sectors leave one of the {n_bin} rings without modes in a sector")
    of_ring = cells.reshape(n_bin, n_sector)
    n_modes = rings.n_modes[:, None] * of_ring / of_ring.sum(axis=1, keepdims=True)
    ell = mode_ell(n_y, n_x, pixel_rad).ravel()
    ell_mean = np.bincount(bin_of_mode, rings.multiplicity * ell, n_bin * n_sector + 1)[:-1] / cells
    return Annuli(rings.edges_ell, ell_mean, n_modes.ravel(), bin_of_mode, rings.multiplicity)


def mode_multiplicity(n_y: int, n_x: int) -> np.ndarray:
    """Full-plane cells of each flattened half-plane mode of `rfft2`: columns 0 and Nyquist have both signs of k_y."""
    of_column = np.full(n_x // 2 + 1, 2.0)
    of_column[0] = 1
    if n_x % 2 == 0:
        of_column[-1] = 1
    return np.tile(of_column, n_y)


def mode_psd(map_mk: np.ndarray, taper: np.ndarray, pixel_rad: float) -> np.ndarray:
    """2-D PSD of tapered maps on the half plane of `rfft2`.

    It is normalised by `sum T^2`: white noise of variance s^2 a pixel has the PSD s^2 pixel_rad^2 for any taper.

    Parameters
    ----------
    map_mk : (..., n_y, n_x)
        Maps, zero in unobserved pixels.
    taper : (n_y, n_x)
    pixel_rad

    Returns
    -------
    (..., n_y, n_x // 2 + 1) array
        [mK^2 rad^2], or the squared unit of the map.

    Raises
    ------
    ValueError
        For a taper of another shape than the map, and values that are not finite.
    """
    return _psd(*_checked_map(map_mk, taper, pixel_rad), pixel_rad)


def _checked_map(map_mk: np.ndarray, taper: np.ndarray, pixel_rad: float) -> tuple[np.ndarray, np.ndarray]:
    taper = checked_taper(taper)
    pixel_side("pixel_rad", pixel_rad)
    return reals("map_mk", map_mk, (..., *taper.shape)), taper


def _psd(map_mk: np.ndarray, taper: np.ndarray, pixel_rad: float) -> np.ndarray:
    from scipy.fft import rfft2

    modes = rfft2(map_mk * taper, workers=1)
    return (modes.real**2 + modes.imag**2) * (pixel_rad**2 / np.sum(taper**2))


def map_psd(map_mk: np.ndarray, taper: np.ndarray, pixel_rad: float, rings: Annuli) -> np.ndarray:
    """Azimuthally averaged PSD of tapered maps, normalised as `mode_psd`.

    Parameters
    ----------
    map_mk : (..., n_y, n_x)
    taper : (n_y, n_x)
    pixel_rad
    rings
        Annuli of the map.

    Returns
    -------
    (..., n_bin) array
        [mK^2 rad^2].

    Raises
    ------
    ValueError
        For a taper or annuli of another map, and values that are not finite.
    """
    map_mk, taper = _checked_map(map_mk, taper, pixel_rad)
    n_bin = rings.ell.size
    n_half = map_mk.shape[-2] * (map_mk.shape[-1] // 2 + 1)
    if rings.bin_of_mode.size != n_half:
        raise ValueError(f"annuli are for {rings.bin_of_mode.size} half-plane modes, the map has {n_half}")
    psd = np.empty(map_mk.shape[:-2] + (n_bin,))
    for index in np.ndindex(map_mk.shape[:-2]):
        psd[index] = _ring_mean(_psd(map_mk[index], taper, pixel_rad), rings)
    return psd


def ring_mean(values: np.ndarray, rings: Annuli) -> np.ndarray:
    """Average values on the half plane of `rfft2`, flattened or not, over the modes of each bin: (n_bin,).

    Raises
    ------
    ValueError
        For another number of values than modes, and values that are not finite.
    """
    values = reals("values", values, (...,))
    if values.size != rings.bin_of_mode.size:
        raise argument_error(
            "values", f"{values.size} values", f"{rings.bin_of_mode.size}, one a mode of the annuli, are"
        )
    return _ring_mean(values, rings)


def _ring_mean(values: np.ndarray, rings: Annuli) -> np.ndarray:
    n_bin = rings.ell.size
    total = np.bincount(rings.bin_of_mode, values.ravel() * rings.multiplicity, n_bin + 1)[:n_bin]
    return total / rings.modes_of_bin


def coupled_psd(
    sky_psd: np.ndarray, sky_shape: tuple[int, int], taper: np.ndarray, pixel_rad: float, *, cells_per_pixel: int = 1
) -> np.ndarray:
    """Expectation of `mode_psd` over Gaussian skies: their PSD convolved with the power spectrum of the taper.

    A taper couples neighbouring modes, which raises a steep spectrum: ``<P(k)> = sum_k' S(k') |T(k - k')|^2 / (L^2 sum
    T^2)`` over the modes k' of a sky of area L^2. The sum is evaluated exactly in real space: the taper's
    autocorrelation times the correlation function of the sky.

    Parameters
    ----------
    sky_psd : (N_y, N_x // 2 + 1)
        PSD S of the sky in the map, on the half plane of `rfft2` of a periodic grid: beam and pixel window included, 0
        for the mean. The grid should be several times as large as the taper, as it lacks modes longer than its period.
    sky_shape : (N_y, N_x)
        Cells of that grid.
    taper : (n_y, n_x)
        Taper on the map's pixels.
    pixel_rad
        Side of a map pixel.
    cells_per_pixel
        Cells of the sky's grid along the side of a pixel.

    Returns
    -------
    (n_y, n_x // 2 + 1) array
        In the unit of `sky_psd`; `ring_mean` averages it in bins of multipole.

    Raises
    ------
    ValueError
        For a `sky_psd` that is not on the half plane of `sky_shape`, is negative or not finite; for a taper that is not
        finite; and for `cells_per_pixel` that is not a positive integer.
    """
    if len([whole("sky_shape", n, least=1) for n in sky_shape]) != 2:
        raise argument_error("sky_shape", f"{len(sky_shape)} numbers", "two are")
    sky_psd = reals("sky_psd", sky_psd, (sky_shape[0], sky_shape[1] // 2 + 1), least=0)
    taper = checked_taper(taper)
    pixel_side("pixel_rad", pixel_rad)
    whole("cells_per_pixel", cells_per_pixel, least=1, most=MAX_PIXELS)
    from scipy.fft import irfft2, rfft2

    correlation = irfft2(sky_psd, sky_shape, workers=1) * (cells_per_pixel / pixel_rad) ** 2
    lags, tied = taper_autocorrelation(taper)
    places = (lag * cells_per_pixel % n for lag, n in zip(lags, sky_shape, strict=True))
    at_lags = correlation[np.ix_(*places)]
    at_lags *= tied
    step_y, step_x = (padded // n for padded, n in zip(tied.shape, taper.shape, strict=True))
    power = rfft2(at_lags, workers=1).real[::step_y, ::step_x]
    return power * (pixel_rad**2 / np.sum(taper**2))


def taper_autocorrelation(taper: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Lags [pixels] along y and x, in the order of `fft2`, and the sum of a taper times itself at those lags.

    The grid of lags is once or twice as large as the taper (n_y, n_x), so that lags of both signs stay apart.
    """
    from scipy.fft import irfft2, rfft2

    shape = tuple(n * (1 + (2 * _extent(taper, axis) > n)) for axis, n in enumerate(taper.shape))
    spread = rfft2(taper, shape, workers=1)
    lags = [np.rint(np.fft.fftfreq(n, 1 / n)).astype(int) for n in shape]
    return lags, irfft2(spread.real**2 + spread.imag**2, shape, workers=1)


def _extent(taper: np.ndarray, axis: int) -> int:
    """Rows (or columns) from the first to the last with a non-zero taper."""
    seen = np.flatnonzero(taper.any(axis=1 - axis))
    return int(seen[-1] - seen[0] + 1)


def neighbour_correlation(taper: np.ndarray, rings: Annuli) -> np.ndarray:
    """Correlation of the PSD's noise between each bin and the next.

    The taper T correlates modes by r, the transform of T^2 over its sum. The PSDs of white noise in the bins a and b
    have the covariance ``2 sum_ka sum_kb |r(ka - kb)|^2`` over the product of their numbers of modes, evaluated in real
    space. It holds for any noise whose PSD changes little over the taper's resolution.

    Parameters
    ----------
    taper : (n_y, n_x)
    rings
        Annuli of the same map.

    Returns
    -------
    (n_bin - 1,) array

    Raises
    ------
    ValueError
        For annuli of another map.
    """
    taper = checked_taper(taper)
    n_y, n_x = taper.shape
    if rings.bin_of_mode.size != n_y * (n_x // 2 + 1):
        raise ValueError(f"annuli are for {rings.bin_of_mode.size} half-plane modes, the taper has {taper.shape}")
    from scipy.fft import fft2, ifft2, irfft2

    tied = np.abs(fft2(taper**2)) ** 2
    kernel = ifft2(tied).real
    n_bin = len(rings.ell)
    variance, covariance = np.empty(n_bin), np.empty(n_bin - 1)
    before = None
    for place in range(n_bin):
        own = irfft2((rings.bin_of_mode == place).reshape(n_y, -1).astype(float), (n_y, n_x))
        variance[place] = np.sum(kernel * own**2)
        if before is not None:
            covariance[place - 1] = np.sum(kernel * own * before)
        before = own
    return covariance / np.sqrt(variance[1:] * variance[:-1])
