"""Response of scans and cleaning to one Fourier mode of the map, in closed form.

A scan at velocity v turns the map mode k into the frequency f = k.v / 2 pi of the streams; a detector at r sees it
with the phase k.r. Cleaning that projects templates out of the detectors with a projector P has the array response

    a = (1 - P)^H exp(i k.r),

so streams with the cross-spectral matrix C(f) add the power a^H C(f) a to the mode. P contains the responsivities that
cleaning assumes; where these differ from the true ones, part of the common signal remains. A scan is short and its
mean is removed: with w the transform of the map's taper along the scan, power at f' leaks into the mode at f by

    H(f, f') = (w(f - f') - sinc(f' T) w(f))^2,

normalised so that H integrates to 1 over f' where no mean is removed (`surveysim.forecasting.scan_apodization`). A
curved chunk crosses the taper of a length L, shorter than T, at any time: the product of the two terms then has the
mean sinc(f' (T - L)). Fits of responsivities remove modes in time as well (`surveysim.forecasting.fitted_modes`), which
enter H in the same way as the mean. All quantities are in the frame of the scan, whose x axis is the scan direction;
positions in it are complex numbers x + i y [rad].
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmaker.cleaning.templates import AVERAGE, PLANAR, QUADRATIC, template_basis
from mapmaker.timestreams import FocalPlane
from surveysim.atmosphere.thin_screen import Screen, at_elevation, beam_transfer, power
from surveysim.forecasting.mode_kernels import unit_phases
from surveysim.telescope.lattice_noise import NoiseCorrelation

# Templates of the cleaning algorithms that are a fixed projection once the responsivities are known. Two are so nearly:
# the shifts of "wind" move templates by about a sample, and PCA removes about one mode, which is nearly the average.
PROJECTIONS = {
    "none": (),
    "average": AVERAGE,
    "planar": PLANAR,
    "quadratic": QUADRATIC,
    "wind": AVERAGE,
    "pca": AVERAGE,
}

_NODES = 10  # quadrature nodes in each eighth of a turn
_RADII, _AZIMUTHS = 32, 16  # of the layer's wavevectors
_SHIFT_EDGES = np.array([0, 0.35, 0.75, 16.25])  # between parts of the spectrum of an evolving layer [cycles]


@dataclass(frozen=True)
class Modes:
    """Map modes at some multipoles, over half a turn in azimuth.

    Attributes
    ----------
    wave : (n_bin, n_angle)
        Complex wavevectors k [rad^-1].
    share : (n_angle,)
        Quadrature weights of the azimuths; they sum to 1.
    """

    wave: np.ndarray
    share: np.ndarray

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Average values (n_bin n_angle,) over azimuth, (n_bin,)."""
        return values.reshape(self.wave.shape) @ self.share


def ring_modes(ell: np.ndarray) -> Modes:
    """Choose map modes at multipoles (n_bin,), densest along and across the scan, where the frequency is near 0."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    root = (node + 1) / 2
    angle, share = np.pi / 4 * root**2, np.pi / 4 * root * weight
    eighths = [(0, 1), (np.pi / 2, -1), (np.pi / 2, 1), (np.pi, -1)]
    angles = np.concatenate([(start + sign * angle)[::sign] for start, sign in eighths])
    shares = np.concatenate([share[::sign] for _, sign in eighths])
    return Modes(np.outer(ell, np.exp(1j * angles)), shares / np.pi)


@dataclass(frozen=True)
class ProjectedArray:
    """Detectors in the frame of a scan, cleaned by one projection.

    Attributes
    ----------
    place : (n_det,)
        Complex positions [rad].
    responsivity : (n_det,)
        True responsivities.
    assumed : (n_det,)
        Responsivities that cleaning assumes.
    basis : (n_par, n_det)
        Orthonormal templates.
    weight : (n_det,)
        Weights of the detectors in the map.
    """

    place: np.ndarray
    responsivity: np.ndarray
    assumed: np.ndarray
    basis: np.ndarray
    weight: np.ndarray

    @property
    def projection(self) -> tuple[np.ndarray, np.ndarray]:
        """Factors (n_det, n_par) and (n_par, n_det) of P."""
        return self.assumed[:, None] * self.basis.T, self.basis / self.assumed

    def cleaned(self, streams: np.ndarray) -> np.ndarray:
        """Apply 1 - P to values (n_det, ...)."""
        left, right = self.projection
        return streams - left @ (right @ streams)

    def response(self, wave: np.ndarray) -> np.ndarray:
        """Array response a (n_det, n_mode) to modes (n_mode,)."""
        return self.respond(self.phases(wave))

    def respond(self, phases: np.ndarray) -> np.ndarray:
        """Array response a (n_det, n_mode) to modes with some phase factors."""
        phase, (left, right) = phases * self.weight[:, None], self.projection
        return phase - right.T @ (left.T @ phase)

    def phases(self, wave: np.ndarray) -> np.ndarray:
        """Phase factors exp(i k.r), (n_det, n_mode)."""
        found = np.empty((len(self.place), len(wave)), complex)
        unit_phases(*_components(self.place), *_components(wave), found)
        return found

    def seen(self, wave: np.ndarray) -> np.ndarray:
        """Amplitudes (n_det, n_mode) of waves in the streams, in single precision."""
        return self.phases(wave).astype(np.complex64) * self.responsivity[:, None].astype(np.float32)


def _components(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Components along x and y of complex vectors (n,)."""
    return np.ascontiguousarray(vector.real), np.ascontiguousarray(vector.imag)


def projected_array(
    plane: FocalPlane,
    angle_rad: float,
    *,
    responsivity: np.ndarray,
    algorithm: str,
    assumed: np.ndarray | None = None,
    weight: np.ndarray | None = None,
) -> ProjectedArray:
    """Set up the detectors of a scan, cleaned by one algorithm.

    Parameters
    ----------
    plane
        Detector positions.
    angle_rad
        Position angle of the array's y axis from the scan direction.
    responsivity : (n_det,)
        True responsivities.
    algorithm
        A key of `PROJECTIONS`.
    assumed : (n_det,), optional
        Responsivities that cleaning assumes; the true ones by default.
    weight : (n_det,), optional
        Weights of the detectors in the map; 1 by default.

    Raises
    ------
    ValueError
        For arrays whose positions do not support the templates, as `mapmaker.clean`.
    """
    # As sky_vector of surveysim.telescope.pointing, in complex numbers.
    place = np.exp(-1j * angle_rad) * (-plane.x_rad + 1j * plane.y_rad)
    exponents = PROJECTIONS[algorithm]
    basis = template_basis(plane, exponents) if exponents else np.zeros((0, len(place)))
    weight = np.ones(len(place)) if weight is None else weight
    return ProjectedArray(place, responsivity, responsivity if assumed is None else assumed, basis, weight)


def matrix_power(response: np.ndarray, correlation: np.ndarray | NoiseCorrelation | None) -> np.ndarray:
    """Power a^H K a / n_det of streams with unit PSD.

    Parameters
    ----------
    response : (n_det, n_mode)
        Array response a, whose precision is that of the product with K.
    correlation
        Correlation K between the detectors; None for independent ones.

    Returns
    -------
    (n_mode,) array
    """
    parts = _parts(response)  # a real product takes half the time of a complex one
    if isinstance(correlation, np.ndarray):
        spread = correlation.astype(parts.dtype, copy=False) @ parts
    else:
        spread = parts if correlation is None else _parts(correlation @ response)
    squares = np.sum(parts * spread, axis=0, dtype=float)
    return squares.reshape(-1, 2).sum(axis=1) / len(response)


def _parts(values: np.ndarray) -> np.ndarray:
    """Real and imaginary parts (n, 2 m), side by side, of complex values (n, m)."""
    return np.ascontiguousarray(values).view(values.real.dtype)


def stream_power(array: ProjectedArray, correlation: np.ndarray | NoiseCorrelation | None) -> float:
    """Mean PSD of the cleaned and weighted streams of detectors with unit PSD and a correlation (None: independent)."""
    n_det = len(array.place)
    if correlation is None:
        correlation = NoiseCorrelation(None, np.ones(n_det))
    own = np.diag(correlation) if isinstance(correlation, np.ndarray) else correlation.gain**2
    return float(array.weight**2 @ own - _projected_power(array, correlation)) / n_det


def _projected_power(array: ProjectedArray, correlation: np.ndarray | NoiseCorrelation) -> float:
    """Trace that cleaning removes from W K W, W the weights: with ``P = U V``, the trace of ``W (P K + K P^T - P K P^T)
    W``.
    """
    u, v = array.projection
    u = array.weight[:, None] * u
    kv = correlation @ v.T
    return float(2 * np.sum(array.weight[:, None] * u * kv) - np.sum((v @ kv) * (u.T @ u)))


@dataclass(frozen=True)
class LayerWaves:
    """Wavevectors that represent the layer.

    Attributes
    ----------
    alpha : (n_a,)
        Complex wavevectors [cycles/rad]; those of the second half are opposite to those of the first.
    power : (n_sine, n_a)
        Variance of each at some elevations.
    shift_hz, shift_share : (n_shift,)
        Frequencies by which the evolution of the layer shifts parts of each wave in the streams.
    """

    alpha: np.ndarray
    power: np.ndarray
    shift_hz: np.ndarray
    shift_share: np.ndarray

    @property
    def half(self) -> np.ndarray:
        """The first half of `alpha`: opposite waves have conjugate phases."""
        return self.alpha[: len(self.alpha) // 2]


def layer_waves(
    screen: Screen, longest_rad: float, sines: Sequence[float] = (1.0,), decorrelation_time_s: float | None = None
) -> LayerWaves:
    """Represent the layer by wavevectors, per unit amplitude.

    They range from well below one over the longest track to the cut-off by the beam. Still longer waves are slopes
    along any track; their variance is added to the longest waves. For a steep spectrum without an outer scale they make
    a third of the structure function.

    Parameters
    ----------
    screen
        The layer at the zenith.
    longest_rad
        Longest track.
    sines
        Sines of the elevations (n_sine,).
    decorrelation_time_s
        Time of the layer's evolution; None for a frozen layer.
    """
    edge = np.geomspace(0.02 / longest_rad, 12 / (screen.beam_rad * min(sines)), _RADII)
    # Every other radius starts between the azimuths of its neighbours.
    angle = 2 * np.pi / _AZIMUTHS * (np.arange(_AZIMUTHS // 2) + 0.5 * (np.arange(_RADII) % 2)[:, None])
    power = np.array([_ring_power(at_elevation(screen, sine), edge) for sine in sines])
    half, of_half = (edge[:, None] * np.exp(1j * angle)).ravel(), np.repeat(power, _AZIMUTHS // 2, axis=1)
    return LayerWaves(np.append(half, -half), np.tile(of_half, 2), *evolution_shifts(decorrelation_time_s))


def evolution_shifts(time_s: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Represent the spectrum of a wave in a layer with a decorrelation time T by shifts [Hz] and their shares.

    A realization counts by cos(pi t / 2 T) for |t| < T. The square of its transform is the spectrum,

        S(f) = (16 T / pi^2) (cos(2 pi f T) / (1 - 16 f^2 T^2))^2,

    which is integrated between `_SHIFT_EDGES` / T on both sides.
    """
    if time_s is None:
        return np.zeros(1), np.ones(1)
    cycles = np.linspace(0, _SHIFT_EDGES[-1], 8001)[1:] - _SHIFT_EDGES[-1] / 16_000
    density = (np.cos(2 * np.pi * cycles) / (1 - 16 * cycles**2)) ** 2
    part = np.digitize(cycles, _SHIFT_EDGES) - 1
    share, moment = (np.bincount(part, weight) for weight in (density, density * cycles**2))
    shift = np.sqrt(moment / share) / time_s
    return np.concatenate([-shift, shift]), np.tile(share / share.sum() / 2, 2)


def _ring_power(screen: Screen, edge: np.ndarray) -> np.ndarray:
    """Variance (n,) of one of the `_AZIMUTHS` wavevectors at each length (n,)."""
    step, turn = np.log(edge[1] / edge[0]), 2 * np.pi / _AZIMUTHS
    strength = power(screen, edge) * beam_transfer(edge * screen.beam_rad) ** 2 * edge**2 * step * turn
    strength[0] += _slope(screen, edge[0] * np.exp(-step / 2)) / edge[0] ** 2 * turn
    return strength


def _slope(screen: Screen, alpha: float) -> float:
    """Integrate alpha^3 P from 0 to `alpha`: the squared slope of the longest waves."""
    if np.isinf(screen.outer_scale_rad):
        return alpha ** (4 - screen.index) / (4 - screen.index)
    below = np.geomspace(1e-3 * min(alpha, 1 / screen.outer_scale_rad), alpha, 200)
    return float(np.trapezoid(power(screen, below) * below**4, np.log(below)))


def layer_gain(
    array: ProjectedArray, response: np.ndarray, layer: LayerWaves, gain_variance: float = 0.0
) -> np.ndarray:
    """Fraction of each wavevector's power that enters each mode, before the apodization: (n_mode, n_a).

    Gains of the detectors with independent errors of some variance add independent noise with the layer's spectrum.
    """
    of_mode, of_wave = _parts(response), _parts(array.seen(2 * np.pi * layer.half))
    product = (of_mode.T @ of_wave).reshape(response.shape[1], 2, -1, 2)
    (real, crossed), (other, imaginary) = product.transpose(1, 3, 0, 2).astype(float)
    gain = np.hstack([(real + sign * imaginary) ** 2 + (crossed - sign * other) ** 2 for sign in (1, -1)])
    gain /= len(array.place)
    if gain_variance:
        gain += gain_variance * matrix_power(response * array.responsivity[:, None], None)[:, None]
    return gain


def layer_stream_gain(array: ProjectedArray, layer: LayerWaves, gain_variance: float = 0.0) -> np.ndarray:
    """Fraction of each wavevector's power in the mean PSD of the cleaned and weighted streams, (n_a,).

    Errors of the gains enter as in `layer_gain`.
    """
    seen = array.phases(2 * np.pi * layer.half) * array.responsivity[:, None]
    left = array.cleaned(seen) * array.weight[:, None]
    gain = np.tile(np.mean(left.real**2 + left.imag**2, axis=0), 2)
    if gain_variance:
        gain += gain_variance * stream_power(array, NoiseCorrelation(None, array.responsivity))
    return gain
