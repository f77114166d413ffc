"""Mode coupling of a taper on the flat sky."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.errors import OutOfRangeError
from mapmaker.mode_coupling import ModeCoupling, beam_power, coupling_flags, narrow_edges, unevenness, usable_bins
from mapmaker.spectrum import (
    Annuli,
    annuli,
    checked_taper,
    map_psd,
    mode_ell,
    mode_multiplicity,
    mode_psd,
    ring_mean,
    taper_autocorrelation,
)
from mapmaker.transfer_function import mode_pixel_window, pixel_window
from mapmaker.validation import pixel_side, reals, whole

MOST_DISTORTION = 0.005  # relative shift of multipoles from which a plane does not suffice
_LARGER = 4  # times the taper's grid: the default grid of the sky's modes


@dataclass(frozen=True)
class FlatField:
    """Field on the flat sky: taper (n_y, n_x), side of a pixel, bins of its modes."""

    taper: np.ndarray
    pixel_rad: float
    rings: Annuli

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns of a map."""
        return self.taper.shape

    def pseudo_power(self, maps_uk: np.ndarray) -> np.ndarray:
        """Binned PSD (..., n_bin) [uK^2 sr] of maps (..., n_y, n_x), as `map_psd`."""
        return map_psd(maps_uk, self.taper, self.pixel_rad, self.rings)

    def unevenness(self, map_uk: np.ndarray) -> np.ndarray:
        """Variance of the modes' power in each bin over that of modes of one variance, (n_bin,)."""
        is_complex = self.rings.multiplicity == 2
        power = mode_psd(map_uk, self.taper, self.pixel_rad).ravel()[is_complex]
        return unevenness(power, self.rings.bin_of_mode[is_complex], self.rings.ell.size)


@dataclass(frozen=True)
class _SkyGrid:
    """Modes of a periodic sky: its cells, and the cells along a pixel's side."""

    shape: tuple[int, int]
    cells_per_pixel: int
    pixel_rad: float

    @property
    def cell_rad(self) -> float:
        return self.pixel_rad / self.cells_per_pixel

    @property
    def ell(self) -> np.ndarray:
        return mode_ell(*self.shape, self.cell_rad)


def flat_coupling(
    taper: np.ndarray,
    pixel_rad: float,
    *,
    edges_ell: np.ndarray,
    beam: Callable[[np.ndarray], np.ndarray],
    transfer: np.ndarray | None = None,
    sky_shape: tuple[int, int] | None = None,
    cells_per_pixel: int = 1,
) -> ModeCoupling:
    """Mode coupling of a taper on the flat sky.

    The binned PSD of a tapered map is ``P_b = F_b sum_b' M_bb' D_b'`` for a sky whose ``l(l+1) C_l / 2 pi`` is D_b' in
    the bin b' (Hivon et al. 2002, ApJ 567, 2). M sums the power spectrum of the taper over the modes of both bins,
    evaluated exactly in real space, as in `coupled_psd`. The transfer function F is a ratio of tapered PSDs; it
    multiplies the PSD and not the sky.

    Parameters
    ----------
    taper : (n_y, n_x)
        Zero-padded to resolve narrow bins.
    pixel_rad
        Side of a pixel.
    edges_ell : (n_bin + 1,)
        Edges of the bins, from 0 to the Nyquist multipole at most.
    beam
        Power window B_l^2 of multipoles of any shape. The pixels' window is included already.
    transfer : (n_bin,), optional
        Power transfer function in these bins (`measure_transfer_function`); NaN or 0 where a bin is lost.
    sky_shape, cells_per_pixel
        Grid of the modes of the sky, as for `coupled_psd`; by default four times as large as the taper. With a
        transfer function: the grid of the skies that measured it.

    Raises
    ------
    ValueError
        For arguments as of `annuli` and `coupled_psd`, bins beyond the Nyquist multipole, and bins that are all lost.
    """
    pixel_side("pixel_rad", pixel_rad)
    taper = checked_taper(taper)
    n_y, n_x = taper.shape
    rings = annuli(n_y, n_x, pixel_rad, edges_ell=reals("edges_ell", edges_ell, ("n",), least=0), taper=taper)
    if rings.edges_ell[-1] > np.pi / pixel_rad * (1 + 1e-9):
        nyquist = f"{np.pi / pixel_rad:.6g}, the Nyquist multipole of the pixels,"
        raise OutOfRangeError(f"edges_ell: found {rings.edges_ell[-1]:.6g}; at most {nyquist} is expected")
    sky = _sky_grid(taper, pixel_rad, sky_shape, cells_per_pixel)
    transfer, usable = usable_bins(beam_power(beam, rings.ell) * pixel_window(rings.ell, pixel_rad), transfer)
    window_ell, response = _response(taper, rings, sky, beam)
    coupling = ModeCoupling(
        edges_ell=rings.edges_ell,
        ell=rings.ell,
        transfer=transfer,
        usable=usable,
        response=response,
        window_ell=window_ell,
        scatter=_scatter(taper, rings),
        resolution_ell=_resolution(taper, pixel_rad),
        field=FlatField(taper, pixel_rad, rings),
        flags=_plane_flags(taper, pixel_rad),
    )
    return replace(coupling, flags=coupling_flags(coupling) + coupling.flags)


def plane_distortion(taper: np.ndarray, pixel_rad: float) -> float:
    """Relative shift of the multipoles of a gnomonic map that is centred on its tangent point.

    At the distance r from the centre, lengths are stretched by 1 + r^2 along the radius and 1 + r^2 / 2 across it: by
    1 + 3/4 r^2 in the mean over directions. The result is the mean of 3/4 r^2 under the squared taper.

    Parameters
    ----------
    taper : (n_y, n_x)
        Its centre is the mean position under its square.
    pixel_rad
    """
    weight, variance = checked_taper(taper) ** 2, 0.0
    pixel_side("pixel_rad", pixel_rad)
    for axis, n in enumerate(weight.shape):
        along, at = weight.sum(axis=1 - axis), np.arange(n) * pixel_rad
        variance += np.average((at - np.average(at, weights=along)) ** 2, weights=along)
    return 0.75 * float(variance)


def _sky_grid(taper: np.ndarray, pixel_rad: float, sky_shape: tuple[int, int] | None, cells_per_pixel: int) -> _SkyGrid:
    cells = whole("cells_per_pixel", cells_per_pixel, least=1)
    n_y, n_x = (_LARGER * cells * n for n in taper.shape) if sky_shape is None else sky_shape
    return _SkyGrid((whole("sky_shape", n_y, least=1), whole("sky_shape", n_x, least=1)), cells, pixel_rad)


def _response(
    taper: np.ndarray, rings: Annuli, sky: _SkyGrid, beam: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean multipoles (n_ell,) of narrow bins, and the PSD (n_bin, n_ell) in the rings from unit band power in them.

    They are a quarter as wide as the modes of the sky are apart; bins without a mode are left out.
    """
    ell = sky.ell.ravel()
    signal = flat_spectrum_psd(ell) * beam_power(beam, ell)
    signal *= mode_pixel_window(*sky.shape, sky.cell_rad, sky.pixel_rad).ravel() * mode_multiplicity(*sky.shape)
    edges = narrow_edges(rings.edges_ell, np.pi / 2 / (min(sky.shape) * sky.cell_rad), ell.max())
    place, n_bin = np.searchsorted(edges, ell, side="right") - 1, edges.size - 1
    power = np.bincount(place, signal, n_bin)
    found = power > 0
    window_ell = np.bincount(place, ell * signal, n_bin)[found] / power[found]
    rows = (row.ravel() * signal for row in _mode_response(taper, rings, sky))
    return window_ell, np.array([np.bincount(place, row, n_bin)[found] for row in rows])


def _mode_response(taper: np.ndarray, rings: Annuli, sky: _SkyGrid) -> Iterator[np.ndarray]:
    """Response of the mean PSD of each ring to the modes of the sky's half plane: the adjoint of `coupled_psd`."""
    from scipy.fft import rfft2

    lags, tied = taper_autocorrelation(taper)
    on_map = np.ix_(*(lag % n for lag, n in zip(lags, taper.shape, strict=True)))
    on_sky = np.ix_(*(lag * sky.cells_per_pixel % n for lag, n in zip(lags, sky.shape, strict=True)))
    tied *= sky.cells_per_pixel**2 / (np.prod(sky.shape) * np.sum(taper**2))
    for own in _ring_correlations(taper.shape, rings):
        placed = np.zeros(sky.shape)
        np.add.at(placed, on_sky, tied * own[on_map])
        yield rfft2(placed, workers=1).real


def _ring_correlations(shape: tuple[int, int], rings: Annuli) -> Iterator[np.ndarray]:
    """Correlation function (n_y, n_x) of white modes in each ring, 1 at lag 0: the mean of their waves."""
    from scipy.fft import irfft2

    for place, count in enumerate(rings.modes_of_bin):
        inside = (rings.bin_of_mode == place).reshape(shape[0], -1)
        yield irfft2(inside * (shape[0] * shape[1] / count), shape, workers=1)


def _scatter(taper: np.ndarray, rings: Annuli) -> np.ndarray:
    """Mean over the modes of two rings of their squared correlation through the taper, (n_bin, n_bin).

    The formula is that of `neighbour_correlation`.
    """
    from scipy.fft import irfft2, rfft2

    squared = rfft2(taper**2, workers=1)
    tied = irfft2(squared.real**2 + squared.imag**2, taper.shape, workers=1) / np.sum(taper**2) ** 2
    correlations = _ring_correlations(taper.shape, rings)
    return np.array([ring_mean(rfft2(tied * own, workers=1).real, rings) for own in correlations])


def _resolution(taper: np.ndarray, pixel_rad: float) -> float:
    """Width in multipoles of a square as large as the power spectrum of the taper."""
    return 2 * np.pi / pixel_rad * float(np.sqrt(np.sum(taper**2)) / np.abs(np.sum(taper)))


def _plane_flags(taper: np.ndarray, pixel_rad: float) -> tuple[str, ...]:
    shift = plane_distortion(taper, pixel_rad)
    if shift <= MOST_DISTORTION:
        return ()
    return (f"the plane shifts multipoles by {100 * shift:.1f} %: such a field needs curved_coupling",)
