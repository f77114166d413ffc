"""Scored region: patch of the map, multipoles, and their modes."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.geometry import MapGeometry, fast_length
from mapmaker.spectrum import (
    Annuli,
    annuli,
    coupled_psd,
    mode_ell,
    neighbour_correlation,
    ring_mean,
    split_azimuth,
    tukey_taper,
)
from mapmaker.transfer_function import mode_pixel_window
from surveysim.atmosphere.cubic_spline import MonotoneCubic
from surveysim.runtime.errors import InsufficientDataError, SceneError
from surveysim.scene.scene import Scene
from surveysim.telescope.beams import Beams

N_SECTORS = 3
FAINTEST = 1e-100  # signal behind the beam whose square is still a number
_NOTHING, _BELOW = 1e-100, 3.0  # least transmission, and e-folds of ell that it is continued below the bins


@dataclass(frozen=True)
class ScoredRegion:
    """The scored sky area and multipoles.

    `patch`: rows (and columns) of the map under the taper; `taper` (n, n) on the patch; `rings` the bins
    of multipole of the patch padded to (n_pad, n_pad); `selected` (n_bin,) bins that count; `mode_weight`
    (n_pad, n_column): squared signal PSD times multiplicity, up to the last column of the half plane in
    the scored range; `sectors` the scored bins cut by direction, None where a sector would be empty; `mode_chance`
    (n_mode,), for the modes of `rings`, the share of its noise that each loses by chance where `noise` weighs maps.
    `signal_psd` (n_bin,) [sr]: PSD of a flat spectrum of unit band power in the map before scans and cleaning, of the
    rings, and `sector_psd` that of the sectors.
    """

    patch: slice
    taper: np.ndarray
    rings: Annuli
    selected: np.ndarray
    mode_weight: np.ndarray
    sectors: Annuli | None
    mode_chance: np.ndarray
    signal_psd: np.ndarray
    sector_psd: np.ndarray | None

    @property
    def padded_taper(self) -> np.ndarray:
        """The taper on the grid of the rings."""
        return self.pad(self.taper)

    def pad(self, patch: np.ndarray) -> np.ndarray:
        """A patch (..., n, n) with zeros up to the grid of the rings."""
        n_y, n_x = patch.shape[-2:]
        extra = len(self.mode_weight) - self.taper.shape[0]
        padded = np.zeros((*patch.shape[:-2], n_y + extra, n_x + extra), patch.dtype)
        padded[..., :n_y, :n_x] = patch
        return padded

    def less_plane(self, patches: np.ndarray) -> np.ndarray:
        """Patches (..., n, n) less the planes that fit them best under the taper, in the least squares of T m.

        A tapered gradient has power at all multipoles: it would hide the fainter noise of small scales.
        """
        shapes = self._planes
        return patches - np.tensordot(np.tensordot(patches, shapes * self.taper**2, ((-2, -1), (1, 2))), shapes, 1)

    @cached_property
    def _planes(self) -> np.ndarray:
        """Constant and two gradients (3, n, n), orthonormal under the square of the taper."""
        along = np.linspace(-1, 1, len(self.taper))
        shapes = np.stack(np.broadcast_arrays(1.0, along, along[:, None]))
        flat = (shapes * self.taper).reshape(3, -1)
        return np.tensordot(np.linalg.inv(np.linalg.cholesky(flat @ flat.T)), shapes, 1)

    @cached_property
    def correlation(self) -> np.ndarray:
        """Correlation (n_bin - 1,) of the measured noise PSDs of neighbouring bins, through the taper."""
        return neighbour_correlation(self.padded_taper, self.rings)

    @property
    def scored_correlation(self) -> float:
        """Its mean over neighbours that are both scored; NaN where a single bin is."""
        both = self.selected[:-1] & self.selected[1:]
        return float(self.correlation[both].mean()) if both.any() else math.nan

    @property
    def noise_scatter(self) -> float:
        """Relative variance of `noise` over white maps."""
        n_pad, n_column = self.mode_weight.shape
        chance = self.mode_chance.reshape(n_pad, -1)[:, :n_column]
        return float(np.sum(self.mode_weight * chance) / self.mode_weight.sum())

    def chance(self, rings: Annuli) -> np.ndarray:
        """Mean of `mode_chance` over the modes of each of some bins, (n_bin,)."""
        return ring_mean(self.mode_chance, rings)

    def ring_noise(self, total: np.ndarray, hits: np.ndarray) -> np.ndarray:
        """Noise variance a sample in each bin of multipole (n_bin,) of a patch of sums and hits; inf without a hit."""
        from scipy.fft import rfft2

        norm = float(np.sum(self.taper**2 * hits))
        if norm == 0:
            return np.full(len(self.rings.ell), np.inf)
        modes = rfft2(self.pad(self.taper * total))
        return ring_mean(modes.real**2 + modes.imag**2, self.rings) / norm

    @cached_property
    def _mode_bins(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bin and multiplicity of the modes up to the last scored column, and how many modes bins have there."""
        n_pad, n_column = self.mode_weight.shape
        of_modes = self.rings.bin_of_mode, self.rings.multiplicity
        bins, multiplicity = (values.reshape(n_pad, -1)[:, :n_column].ravel() for values in of_modes)
        return bins, multiplicity, np.bincount(bins, multiplicity, len(self.rings.ell) + 1)

    def noise(self, total: np.ndarray, hits: np.ndarray) -> tuple[float, np.ndarray]:
        """Noise variance a sample of a patch of sums and hits, both (n, n), and that in each bin (n_bin,).

        Both are inf without a hit.
        """
        from scipy.fft import fft, rfft

        n_bin, norm = len(self.rings.ell), float(np.sum(self.taper**2 * hits))
        if norm == 0:
            return np.inf, np.full(n_bin, np.inf)
        n_pad, n_column = self.mode_weight.shape
        tapered = self.taper.astype(total.dtype) * total
        modes = fft(rfft(tapered, n_pad)[:, :n_column], n_pad, axis=0)
        power = modes.real**2 + modes.imag**2
        bins, multiplicity, count = self._mode_bins
        of_bins = np.bincount(bins, power.ravel() * multiplicity, n_bin + 1) / count
        return float(np.sum(self.mode_weight * power) / (self.mode_weight.sum() * norm)), of_bins[:n_bin] / norm


def patch_side(size_rad: float, geometry: MapGeometry) -> int:
    """Count the pixels along a side of the scored patch."""
    return min(geometry.n_x, 2 * math.ceil(size_rad / geometry.pixel_rad / 2))


def padded_side(size_rad: float, geometry: MapGeometry) -> int:
    """Count the pixels along a side of the padded patch, whose modes resolve bins narrower than the patch's own."""
    return fast_length(2 * patch_side(size_rad, geometry))


def scored_region(scene: Scene, geometry: MapGeometry, sky_geometry: MapGeometry, beams: Beams) -> ScoredRegion | None:
    """Make the scored region of a scene; None without a score.

    Parameters
    ----------
    sky_geometry
        Grid of the signal simulations.
    beams
        Beams of the detectors.

    Raises
    ------
    SceneError
        If no bin or no mode is left.
    """
    score = scene.score
    if score is None:
        return None
    n = patch_side(score.size_rad, geometry)
    first = (geometry.n_x - n) // 2
    taper = tukey_taper(n, n, geometry.pixel_rad, size_rad=score.size_rad, edge_fraction=score.taper_fraction)
    n_pad = padded_side(score.size_rad, geometry)
    edges = np.arange(0, score.ell_max + score.ell_bin, score.ell_bin)
    edges = edges[edges <= max(score.ell_max, score.ell_min + score.ell_bin)].astype(float)
    padded = np.pad(taper, (0, n_pad - n))
    try:
        rings = annuli(n_pad, n_pad, geometry.pixel_rad, edges_ell=edges, taper=padded)
    except InsufficientDataError as error:
        raise SceneError(f"score.ell_bin: {error}; wider bins or a larger map are expected") from None
    selected = (edges[:-1] >= score.ell_min) & (edges[1:] <= score.ell_max)
    if not selected.any():
        raise SceneError(f"score.ell_bin: found {score.ell_bin}; a bin within ell_min to ell_max is expected")
    weight = _mode_weight(scene, beams, mode_ell(n_pad, n_pad, geometry.pixel_rad), rings)
    scored = annuli(
        n_pad,
        n_pad,
        geometry.pixel_rad,
        edges_ell=np.append(edges[:-1][selected], edges[1:][selected][-1]),
        taper=padded,
    )
    try:
        sectors = split_azimuth(scored, n_pad, n_pad, geometry.pixel_rad, n_sector=N_SECTORS)
    except InsufficientDataError:
        sectors = None
    signal = mapped_signal(beams, geometry, sky_geometry, padded)
    return ScoredRegion(
        patch=slice(first, first + n),
        taper=taper,
        rings=rings,
        selected=selected,
        mode_weight=weight,
        sectors=sectors,
        mode_chance=_mode_chance(scene, beams, padded, geometry.pixel_rad),
        signal_psd=ring_mean(signal, rings),
        sector_psd=None if sectors is None else ring_mean(signal, sectors),
    )


def mapped_signal(
    beams: Beams,
    geometry: MapGeometry,
    sky_geometry: MapGeometry,
    padded_taper: np.ndarray,
    transmission: Callable[[np.ndarray], np.ndarray] = np.ones_like,
    spectrum: Callable[[np.ndarray], np.ndarray] = flat_spectrum_psd,
) -> np.ndarray:
    """Expected PSD of a `spectrum` C_ell in the tapered map, on the half plane of `rfft2`: in its unit.

    By default the spectrum is flat and of unit band power [sr]. Behind beam and pixels, and the `transmission` of
    multipoles. The sky has the modes of the grid on which skies are
    drawn, and so no longer ones: with what these skies lose to scans and cleaning, measured as a ratio of tapered
    PSDs, the product is what they leave. Scans, which that grid just holds, lose longer modes anyway.
    """
    shape = sky_geometry.n_y, sky_geometry.n_x
    ell = mode_ell(*shape, sky_geometry.pixel_rad)
    sky = spectrum(ell) * beams.window(ell) * transmission(ell)
    sky *= mode_pixel_window(*shape, sky_geometry.pixel_rad, geometry.pixel_rad)
    return coupled_psd(
        sky, shape, padded_taper, geometry.pixel_rad, cells_per_pixel=round(geometry.pixel_rad / sky_geometry.pixel_rad)
    )


def left_signal(
    beams: Beams, geometry: MapGeometry, sky_geometry: MapGeometry, band: ScoredRegion, transmission: np.ndarray
) -> np.ndarray:
    """PSD (n_bin,) [sr] that a flat spectrum of unit band power leaves in the tapered map.

    `transmission` (n_bin,) is that of modes at the bins' mean multipoles; between bins, and below them, it goes as
    smooth powers of ell.
    """
    known = band.rings.ell > 0
    log_ell = np.log(band.rings.ell[known])
    log_share = np.log(np.maximum(transmission[known], _NOTHING))
    # Of the longest modes scans lose at least two powers of ell with their means.
    slope = max([2.0, *np.diff(log_share[:2]) / np.diff(log_ell[:2])])
    log_ell = np.append(log_ell[0] - _BELOW, log_ell)
    between = MonotoneCubic(log_ell, np.append(log_share[0] - _BELOW * slope, log_share))

    def share(ell: np.ndarray) -> np.ndarray:
        return np.exp(between(np.clip(np.log(np.maximum(ell, 1e-9)), log_ell[0], log_ell[-1])))

    return ring_mean(mapped_signal(beams, geometry, sky_geometry, band.padded_taper, share), band.rings)


def _mode_weight(scene: Scene, beams: Beams, ell: np.ndarray, rings: Annuli) -> np.ndarray:
    weight = _squared_signal(scene, beams, ell) * rings.multiplicity.reshape(ell.shape)
    # The scored range ends far below the Nyquist multipole: the columns beyond it weigh nothing.
    return np.ascontiguousarray(weight[:, : 1 + np.flatnonzero(weight.any(axis=0))[-1]])


def _squared_signal(scene: Scene, beams: Beams, ell: np.ndarray) -> np.ndarray:
    """Compute the squared PSD of a flat spectrum behind the beam, normalised to 1, 0 outside the scored range."""
    score = scene.score
    signal = np.zeros(ell.shape)
    inside = (ell >= score.ell_min) & (ell < score.ell_max)
    signal[inside] = flat_spectrum_psd(ell[inside]) * beams.window(ell[inside])
    if not signal.max() > FAINTEST:
        raise SceneError(f"score.ell_min: found {score.ell_min}; multipoles that the beam lets through are expected")
    return (signal / signal.max()) ** 2


def _mode_chance(scene: Scene, beams: Beams, taper: np.ndarray, pixel_rad: float) -> np.ndarray:
    """Compute the fractional noise bias (n_mode,) from estimating weights on the same maps.

    Weights are the inverse of the measured noise (`ScoredRegion.noise`) with relative errors e of variance d^2. A
    co-added mode of power P then has ``<w^2 P> / <w>^2 = N (1 + d^2 - 2 c)``, with c the covariance of e and the
    relative power of the mode; the bias is 2 c - d^2. Wick's theorem for modes correlated by the taper gives, with mode
    weights m, ``c_k = 2 sum_k' m_k' |r(k - k')|^2 / sum m``, where r is the transform of the squared, normalised taper;
    d^2 is the mean of c weighted by m. To first order, for white maps.
    """
    from scipy.fft import fft2, ifft2

    n = len(taper)
    frequency = 2 * np.pi * np.fft.fftfreq(n, pixel_rad)
    weight = _squared_signal(scene, beams, np.hypot(frequency[:, None], frequency))
    tied = np.abs(fft2(taper**2) / np.sum(taper**2)) ** 2
    covariance = 2 * fft2(ifft2(weight) * ifft2(tied)).real * weight.size / weight.sum()
    scatter = float(np.sum(weight * covariance) / weight.sum())
    return (2 * covariance - scatter)[:, : n // 2 + 1].ravel()
