"""The scored area of the map and its multipoles."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import fft, fft2, fftfreq, ifft2, next_fast_len, rfft, rfft2

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.geometry import MapGeometry
from mapmaker.spectrum import Annuli, annuli, mode_ell, split_azimuth, tukey_taper
from mapmaker.window import beam_window
from surveysim.scene import Scene, SceneError

N_SECTORS = 3


@dataclass(frozen=True)
class Band:
    """The scored sky area and multipoles.

    `patch`: rows (and columns) of the map under the taper; `taper` (n, n) on the patch; `rings` the bins
    of multipole of the patch padded to (n_pad, n_pad); `selected` (n_bin,) bins that count; `mode_weight`
    (n_pad, n_column): squared signal PSD times multiplicity, up to the last column of the half plane in
    the scored range; `sectors` the scored bins cut by direction, None where a sector would be empty;
    `noise_scatter` the relative variance of `noise` over white maps.
    """

    patch: slice
    taper: np.ndarray
    rings: Annuli
    selected: np.ndarray
    mode_weight: np.ndarray
    sectors: Annuli | None
    noise_scatter: float

    @property
    def padded_taper(self) -> np.ndarray:
        """The taper on the grid of the rings."""
        return self.pad(self.taper)

    def pad(self, patch: np.ndarray) -> np.ndarray:
        """A patch (..., n, n) with zeros up to the grid of the rings."""
        extra = len(self.mode_weight) - self.taper.shape[0]
        return np.pad(patch, [(0, 0)] * (patch.ndim - 2) + [(0, extra)] * 2)

    def ring_noise(self, total: np.ndarray, hits: np.ndarray) -> np.ndarray:
        """Noise variance a sample in each bin of multipole (n_bin,) of a patch of sums and hits; inf without a hit."""
        norm = float(np.sum(self.taper**2 * hits))
        if norm == 0:
            return np.full(len(self.rings.ell), np.inf)
        modes = rfft2(self.pad(self.taper * total)).ravel()
        power = (modes.real**2 + modes.imag**2) * self.rings.multiplicity
        n_bin = len(self.rings.ell)
        cells = np.bincount(self.rings.bin_of_mode, self.rings.multiplicity, n_bin + 1)[:n_bin]
        return np.bincount(self.rings.bin_of_mode, power, n_bin + 1)[:n_bin] / cells / norm

    def noise(self, total: np.ndarray, hits: np.ndarray) -> float:
        """Noise variance a sample of a patch of sums and hits, both (n, n); inf without a hit."""
        norm = float(np.sum(self.taper**2 * hits))
        if norm == 0:
            return np.inf
        n_pad, n_column = self.mode_weight.shape
        modes = fft(rfft(self.taper * total, n_pad)[:, :n_column], n_pad, axis=0)
        power = modes.real**2 + modes.imag**2
        return float(np.sum(self.mode_weight * power) / (self.mode_weight.sum() * norm))


def scored_band(scene: Scene, geometry: MapGeometry) -> Band | None:
    """The band of a scene, None without a score; raises SceneError when no bin or no mode is left."""
    score = scene.score
    if score is None:
        return None
    n = min(geometry.n_x, 2 * math.ceil(score.size_rad / geometry.pixel_rad / 2))
    first = (geometry.n_x - n) // 2
    taper = tukey_taper(n, n, geometry.pixel_rad, score.size_rad, score.taper_fraction)
    # The padding resolves bins of multipole that are narrower than the patch's own modes.
    n_pad = next_fast_len(2 * n, real=True)
    edges = np.arange(0, score.ell_max + score.ell_bin, score.ell_bin)
    edges = edges[edges <= max(score.ell_max, score.ell_min + score.ell_bin)].astype(float)
    padded = np.pad(taper, (0, n_pad - n))
    try:
        rings = annuli(n_pad, n_pad, geometry.pixel_rad, edges, padded)
    except ValueError as error:
        raise SceneError(f"score.ell_bin: {error}; wider bins or a larger map are expected") from None
    selected = (edges[:-1] >= score.ell_min) & (edges[1:] <= score.ell_max)
    if not selected.any():
        raise SceneError(f"score.ell_bin: found {score.ell_bin}; a bin within ell_min to ell_max is expected")
    weight = _mode_weight(scene, mode_ell(n_pad, n_pad, geometry.pixel_rad), rings)
    scored = annuli(n_pad, n_pad, geometry.pixel_rad, np.append(edges[:-1][selected], edges[1:][selected][-1]), padded)
    try:
        sectors = split_azimuth(scored, n_pad, n_pad, geometry.pixel_rad, N_SECTORS)
    except ValueError:
        sectors = None
    return Band(
        patch=slice(first, first + n),
        taper=taper,
        rings=rings,
        selected=selected,
        mode_weight=weight,
        sectors=sectors,
        noise_scatter=_noise_scatter(scene, padded, geometry.pixel_rad),
    )


def _mode_weight(scene: Scene, ell: np.ndarray, rings: Annuli) -> np.ndarray:
    weight = _squared_signal(scene, ell) * rings.multiplicity.reshape(ell.shape)
    # The scored range ends far below the Nyquist multipole: the columns beyond it weigh nothing.
    return np.ascontiguousarray(weight[:, : 1 + np.flatnonzero(weight.any(axis=0))[-1]])


def _squared_signal(scene: Scene, ell: np.ndarray) -> np.ndarray:
    """Squared PSD of a flat spectrum behind the beam, largest 1, 0 outside the scored range."""
    score = scene.score
    signal = np.zeros(ell.shape)
    inside = (ell >= score.ell_min) & (ell < score.ell_max)
    signal[inside] = flat_spectrum_psd(ell[inside]) * beam_window(ell[inside], scene.instrument.beam_fwhm_rad)
    if not signal.max() > 0:
        raise SceneError(f"score.ell_min: found {score.ell_min}; multipoles that the beam lets through are expected")
    return (signal / signal.max()) ** 2


def _noise_scatter(scene: Scene, taper: np.ndarray, pixel_rad: float) -> float:
    """Relative variance of `Band.noise` over white maps.

    With weights m of the modes, ``2 sum_kk' m_k m_k' |r(k - k')|^2 / (sum m)^2``, r the transform of the squared
    taper over its sum: Wick's theorem for the powers of modes that the taper ties together.
    """
    frequency = 2 * np.pi * fftfreq(len(taper), pixel_rad)
    weight = _squared_signal(scene, np.hypot(frequency[:, None], frequency))
    tied = np.abs(fft2(taper**2) / np.sum(taper**2)) ** 2
    spread = fft2(ifft2(weight) * ifft2(tied)).real * weight.size
    return float(2 * np.sum(weight * spread) / weight.sum() ** 2)
