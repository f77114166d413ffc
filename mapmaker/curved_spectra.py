"""Mode coupling on the sphere, for fields too large for a plane: maps and tapers in HEALPix pixels."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.errors import InsufficientDataError, OutOfRangeError
from mapmaker.mode_coupling import ModeCoupling, beam_power, coupling_flags, unevenness, usable_bins
from mapmaker.spectrum import checked_taper
from mapmaker.transfer_function import pixel_window
from mapmaker.validation import argument_error, increasing, reals

_FINER = 8  # points along the side of a HEALPix pixel, for its window
_SEPARATIONS = 400  # bins of the distances between them


@dataclass(frozen=True)
class CurvedField:
    """Field on the sphere: taper (n_pixel,) in HEALPix pixels in ring order, multipoles of the edges of the bins."""

    taper: np.ndarray
    first_ell: np.ndarray

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a map."""
        return self.taper.shape

    def pseudo_power(self, maps_uk: np.ndarray) -> np.ndarray:
        """Binned power (..., n_bin) [uK^2 sr] of maps (..., n_pixel); white noise keeps its power for any taper."""
        maps_uk = reals("maps_uk", maps_uk, (..., *self.shape))
        power = np.empty((*maps_uk.shape[:-1], self.first_ell.size - 1))
        for index in np.ndindex(maps_uk.shape[:-1]):
            power[index] = self.bin_mean(_power_spectrum(self.taper * maps_uk[index]))
        return power / np.mean(self.taper**2)

    def unevenness(self, map_uk: np.ndarray) -> np.ndarray:
        """Variance of the modes' power in each bin over that of modes of one variance, (n_bin,)."""
        from healpy import Alm, map2alm

        modes = map2alm(self.taper * map_uk)
        ell, m = Alm.getlm(Alm.getlmax(modes.size))
        n_bin = self.first_ell.size - 1
        place = np.searchsorted(self.first_ell, ell, side="right") - 1
        place[place < 0] = n_bin
        return unevenness(np.abs(modes[m > 0]) ** 2, place[m > 0], n_bin)

    def bin_mean(self, of_ell: np.ndarray) -> np.ndarray:
        """Mean over the modes of each bin, (n_bin,), of values (n_ell,) of multipoles from 0 to the last bin."""
        modes = 2 * np.arange(self.first_ell[-1]) + 1.0
        weighted = modes * of_ell[: modes.size]
        return np.add.reduceat(weighted, self.first_ell[:-1]) / np.add.reduceat(modes, self.first_ell[:-1])


def curved_coupling(
    taper: np.ndarray,
    *,
    edges_ell: np.ndarray,
    beam: Callable[[np.ndarray], np.ndarray],
    transfer: np.ndarray | None = None,
) -> ModeCoupling:
    """Mode coupling of a taper on the sphere (Hivon et al. 2002, ApJ 567, 2).

    The coupling matrix is ``M_ll' = (2 l' + 1) / 2 int xi(x) P_l(x) P_l'(x) dx`` with the correlation function xi of
    the taper, by Gauss-Legendre quadrature, which is exact. It equals the sum over squared 3-j symbols. The covariance
    of white noise is that matrix of the squared taper (Efstathiou 2004, MNRAS 349, 603).

    Parameters
    ----------
    taper : (n_pixel,)
        In HEALPix pixels, in ring order.
    edges_ell : (n_bin + 1,)
        Edges of the bins, from 0 to 2 nside at most.
    beam
        Power window B_l^2 of multipoles of any shape. The window of HEALPix pixels is included already; that of the
        pixels of a plane map, if one was binned again, is not.
    transfer : (n_bin,), optional
        Power transfer function in these bins; NaN or 0 where a bin is lost.

    Raises
    ------
    ValueError
        For another number of pixels than HEALPix has, bins beyond 2 nside or without a multipole, and bins that are all
        lost.
    """
    taper = checked_taper(taper, ("n_pixel",))
    nside = _nside(taper.size)
    edges_ell = increasing("edges_ell", edges_ell, fewest=2, least=0)
    if edges_ell[-1] > 2 * nside:
        raise OutOfRangeError(f"edges_ell: found {edges_ell[-1]:.6g}; at most {2 * nside}, twice nside, is expected")
    first_ell = np.ceil(edges_ell).astype(int)
    if (np.diff(first_ell) < 1).any():
        empty = int(np.argmin(np.diff(first_ell)))
        raise InsufficientDataError(f"no multipole has {edges_ell[empty]} <= ell < {edges_ell[empty + 1]}")
    field, ell = CurvedField(taper, first_ell), np.arange(3.0 * nside)
    window = beam_power(beam, ell) * healpix_window(ell, nside)
    transfer, usable = usable_bins(field.bin_mean(window), transfer)
    modes, scatter = _coupled_modes(field, nside)
    coupling = ModeCoupling(
        edges_ell=edges_ell,
        ell=field.bin_mean(ell),
        transfer=transfer,
        usable=usable,
        response=modes * (window * flat_spectrum_psd(ell)),
        window_ell=ell,
        scatter=scatter,
        resolution_ell=float(np.sqrt(np.pi * taper.size * np.sum(taper**2)) / np.abs(np.sum(taper))),
        field=field,
        flags=(),
    )
    return replace(coupling, flags=coupling_flags(coupling))


def _coupled_modes(field: CurvedField, nside: int) -> tuple[np.ndarray, np.ndarray]:
    """Response (n_bin, 3 nside) of binned pseudo-power to C_l, and the scatter (n_bin, n_bin) of white noise."""
    from ducc0.misc import GL_thetas, GL_weights

    top, modes = 3 * nside, 2 * np.arange(3 * nside) + 1.0
    n_node = 3 * top // 2 + 1  # exact for products of three polynomials below the order `top`
    cosine, weight = np.cos(GL_thetas(n_node)), GL_weights(n_node, 1) / (2 * np.pi)
    spectra = np.stack([_power_spectrum(field.taper**power) for power in (1, 2)])
    coefficients = np.concatenate((spectra / (4 * np.pi), _bin_shares(field.first_ell, top))) * modes
    at_nodes = np.zeros((len(coefficients), n_node))
    for l_, wave in enumerate(_legendre(cosine, top)):
        at_nodes += np.outer(coefficients[:, l_], wave)
    (own, squared), binned = at_nodes[:2], at_nodes[2:]
    norm = np.mean(field.taper**2)
    tapered = binned * (weight * own / (2 * norm))
    response = np.stack([tapered @ wave for wave in _legendre(cosine, top)], axis=1) * modes
    return response, (binned * (weight * squared / (2 * norm**2))) @ binned.T


def _bin_shares(first_ell: np.ndarray, top: int) -> np.ndarray:
    """Share (n_bin, top) of one mode of each multipole in the mean of each bin."""
    ell = np.arange(top)
    inside = (ell >= first_ell[:-1, None]) & (ell < first_ell[1:, None])
    return inside / np.sum(inside * (2 * ell + 1), axis=1, keepdims=True)


def _legendre(cosine: np.ndarray, top: int) -> Iterator[np.ndarray]:
    """Legendre polynomials P_0 to P_(top - 1)."""
    before, wave = np.zeros_like(cosine), np.ones_like(cosine)
    for l_ in range(top):
        yield wave
        before, wave = wave, ((2 * l_ + 1) * cosine * wave - l_ * before) / (l_ + 1)


def _power_spectrum(values: np.ndarray) -> np.ndarray:
    """C_l up to 3 nside - 1."""
    from healpy import anafast

    return anafast(values)


def healpix_window(ell: np.ndarray, nside: int) -> np.ndarray:
    """Power window of HEALPix pixels, mean over pixels, for multipoles of any shape up to 3 nside.

    It is the mean of P_l over pairs of points in a pixel. The points are the centres of smaller pixels in 128 pixels of
    a polar and of an equatorial face. The error is below 0.1 % up to 2 nside. (healpy's `pixwin` loads a file from the
    network.)
    """
    from healpy import nside2resol, pix2vec
    from scipy.special import j0

    stride = max(nside**2 // 64, 1)
    inside = np.arange(_FINER**2)
    window = np.zeros(ell.shape)
    for face, share in ((0, 2 / 3), (4, 1 / 3)):
        blocks = face * nside**2 + np.arange(0, nside**2, stride)
        pixels = np.concatenate((blocks + max(stride // 4 - 1, 0), blocks + stride * 3 // 4))  # about their centres
        points = np.stack(pix2vec(nside * _FINER, pixels[:, None] * _FINER**2 + inside, nest=True), axis=-1)
        chord = np.sqrt(np.sum((points[:, :, None] - points[:, None]) ** 2, axis=-1))
        count, edges = np.histogram(2 * np.arcsin(chord / 2), bins=_SEPARATIONS)
        middle = (edges[1:] + edges[:-1]) / 2
        window += share * (j0((ell[..., None] + 0.5) * middle) @ (count / count.sum()))
    return window * pixel_window(ell, nside2resol(nside) / _FINER)


def _nside(n_pixel: int) -> int:
    from healpy import isnpixok, npix2nside

    if not isnpixok(n_pixel):
        raise argument_error("taper", f"{n_pixel} values", "12 nside^2, a whole sky of HEALPix pixels, are")
    return int(npix2nside(n_pixel))
