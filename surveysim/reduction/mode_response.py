"""What scans and cleaning make of one map mode: the closed forms that a forecast is built of.

A scan at velocity v turns the map mode k into the frequency f = k.v / 2 pi of the streams, and a detector at r sees it
with the phase k.r. Cleaning that projects templates out of the detectors, P, leaves of the mode the array response

    a = (1 - P)^H exp(i k.r),

so streams with the cross-spectral matrix C(f) put the power a^H C(f) a into it. P holds the responsivities that
cleaning assumes; where these are not the true ones, a part of what all detectors see stays. A scan is short and its
mean is removed: with w the transform of the map's taper along the scan, a stream's power at f' enters the mode at f by

    H(f, f') = (w(f - f') - sinc(f' T) w(f))^2,

normalised so that H adds up to 1 over f' if no mean is removed. Fitted responsivities take a course in time too
(`surveysim.reduction.fitted_modes`), which goes from H as the mean does. All is in the scan's frame, whose x axis is
the direction of the scan; places in it are complex numbers x + i y.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmaker.cleaning.templates import AVERAGE, PLANAR, QUADRATIC, template_basis
from mapmaker.spectrum import tukey
from mapmaker.timestreams import FocalPlane
from surveysim.atmosphere.thin_screen import Screen, at_elevation, beam_transfer, power
from surveysim.reduction.fitted_modes import NO_COURSES, Courses
from surveysim.reduction.mode_kernels import windowed_sums
from surveysim.telescope.lattice_noise import NoiseCorrelation
from surveysim.telescope.pixel_coherence import MOST_DENSE

# The templates of cleaning that is, once the responsivities are known, a fixed projection; and of cleaning that comes
# close to one: the wind's shifts move templates by a sample or so, and PCA takes about one mode, nearly the average's.
PROJECTIONS = {
    "none": (),
    "average": AVERAGE,
    "planar": PLANAR,
    "quadratic": QUADRATIC,
    "wind": AVERAGE,
    "pca": AVERAGE,
}

_TAPER_STEPS, _CYCLES, _STEPS_PER_CYCLE = 1024, 40, 16
_NODES = 10  # of each eighth of a turn
_RADII, _AZIMUTHS = 32, 16  # of the layer's wavevectors


@dataclass(frozen=True)
class ScanApodization:
    """A scan of `duration_s` seen through a taper: `transfer` is w at steps of 1 / `per_step` Hz from 0.

    `of_courses` (n, n_f) is the same of the taper times each of the `courses` that scans lose beside their mean.
    """

    duration_s: float
    transfer: np.ndarray
    per_step: float
    courses: Courses
    of_courses: np.ndarray

    def at(self, frequency_hz: np.ndarray) -> np.ndarray:
        """w at frequencies of any shape and sign, 0 beyond the table."""
        step = np.arange(len(self.transfer))
        return np.interp(np.abs(frequency_hz) * self.per_step, step, self.transfer, right=0.0)

    def sums(self, strength: np.ndarray, frequency_hz: np.ndarray, at_hz: np.ndarray) -> np.ndarray:
        """Sum of H(f_k, f_a) strength_ka over a, (n_k,); strength (n_k, n_a) or (1, n_a)."""
        return self.power_sums(strength, np.ones((1, len(frequency_hz))), frequency_hz, at_hz)[0]

    def power_sums(
        self, gain: np.ndarray, power: np.ndarray, frequency_hz: np.ndarray, at_hz: np.ndarray
    ) -> np.ndarray:
        """`sums` of gain_ka power_pa, (n_p, n_k); power (n_p, n_a). Raises ValueError for shapes that do not fit."""
        n_k, n_a = len(at_hz), len(frequency_hz)
        if gain.shape not in ((n_k, n_a), (1, n_a)) or power.shape[1:] != (n_a,):
            raise ValueError(
                f"found gain {gain.shape} and power {power.shape}; ({n_k}, {n_a}) and (n, {n_a}) are expected"
            )
        mean = np.sinc(frequency_hz * self.duration_s)
        lost = self.courses.of_waves(frequency_hz, self.duration_s)
        arrays = (np.ascontiguousarray(array, dtype=np.float64) for array in (gain, power, frequency_hz, at_hz))
        losses = self.courses.share, self.own(at_hz), lost
        return windowed_sums(*arrays, self.transfer, self.per_step, mean, *losses)

    def own(self, at_hz: np.ndarray) -> np.ndarray:
        """Components of modes at frequencies (n_f,) along each course, seen through the taper, (n_f, n)."""
        step, place = np.arange(len(self.transfer)), np.abs(at_hz) * self.per_step
        sign = np.where(self.courses.odd[:, None], np.sign(at_hz), 1.0)
        rows = [np.interp(place, step, row, right=0.0) for row in self.of_courses]
        return np.ascontiguousarray((sign * np.reshape(rows, sign.shape)).T)

    def passed(self, at_hz: np.ndarray) -> np.ndarray:
        """Mean share of a signal's amplitude that is left of its own mode without the scan's mean and courses."""
        at_hz = np.atleast_1d(at_hz)
        mean = np.sinc(at_hz * self.duration_s) * self.at(at_hz)
        fitted = (self.courses.of_waves(at_hz, self.duration_s) * self.own(at_hz)) @ self.courses.share
        return 1 - (mean + fitted) / self.transfer[0]


def time_window(duration_s: float, taper: np.ndarray, step_s: float, courses: Courses = NO_COURSES) -> ScanApodization:
    """The window of a taper (n,) at steps of `step_s` about the middle of a scan, which loses the courses too."""
    time = (np.arange(len(taper)) - (len(taper) - 1) / 2) * step_s
    length = len(taper) * step_s
    per_step = _STEPS_PER_CYCLE * length
    frequency = np.arange(_CYCLES * _STEPS_PER_CYCLE + 1) / per_step
    phase, scale = 2 * np.pi * np.outer(frequency, time), np.sqrt(step_s / np.sum(taper**2))
    tapered = taper * courses.at(time, duration_s)
    of_courses = [(np.sin if odd else np.cos)(phase) @ row for odd, row in zip(courses.odd, tapered, strict=True)]
    of_courses = scale * np.reshape(of_courses, (len(tapered), len(frequency)))
    return ScanApodization(duration_s, scale * (np.cos(phase) @ taper), per_step, courses, of_courses)


def scan_window(
    duration_s: float, speed_rad_s: float, size_rad: float, taper_fraction: float, courses: Courses = NO_COURSES
) -> ScanApodization:
    """The window of a map's taper, `size_rad` wide with cosine edges, along a scan through its middle."""
    length = min(duration_s, size_rad / speed_rad_s)
    step = length / _TAPER_STEPS
    return time_window(duration_s, tukey(_TAPER_STEPS, step * speed_rad_s, size_rad, taper_fraction), step, courses)


def hann_window(duration_s: float, courses: Courses = NO_COURSES) -> ScanApodization:
    """The window of the tapered periodograms that measure the PSD of streams."""
    return time_window(duration_s, np.hanning(_TAPER_STEPS + 1)[:-1], duration_s / _TAPER_STEPS, courses)


def frequency_nodes(window: ScanApodization, highest_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,) of both signs and their weights: fine where the scan's mean goes, else by its resolution."""
    cycle = min(_STEPS_PER_CYCLE / window.per_step, highest_hz / 8)
    near = np.geomspace(0.02 / window.duration_s, 0.5 * cycle, 24)
    far = np.linspace(0.5 * cycle, highest_hz, 1 + int(np.ceil(4 * (highest_hz / cycle - 0.5))))
    positive = np.concatenate([near[near < 0.5 * cycle], far])
    weight = np.gradient(positive)
    weight[0], weight[-1] = positive[0] + weight[0] / 2, weight[-1] / 2
    return np.concatenate([-positive[::-1], positive]), np.concatenate([weight[::-1], weight])


@dataclass(frozen=True)
class Modes:
    """Map modes of some multipoles over half a turn: `wave` (n_bin, n_angle) complex [rad^-1], `share` (n_angle,).

    A quarter of a turn takes the angles to themselves: column `turned[j]` lies a quarter before column j.
    """

    wave: np.ndarray
    share: np.ndarray

    @property
    def turned(self) -> np.ndarray:
        """Column (n_angle,) of the mode a quarter of a turn before, or of its conjugate."""
        return np.roll(np.arange(len(self.share)), len(self.share) // 2)

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Ring means (n_bin,) of values (n_bin n_angle,)."""
        return values.reshape(self.wave.shape) @ self.share


def ring_modes(ell: np.ndarray) -> Modes:
    """Modes of multipoles (n_bin,), densest along and across the scan, where little is left of the frequency."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    root = (node + 1) / 2
    angle, share = np.pi / 4 * root**2, np.pi / 4 * root * weight
    eighths = [(0, 1), (np.pi / 2, -1), (np.pi / 2, 1), (np.pi, -1)]
    angles = np.concatenate([(start + sign * angle)[::sign] for start, sign in eighths])
    shares = np.concatenate([share[::sign] for _, sign in eighths])
    return Modes(np.outer(ell, np.exp(1j * angles)), shares / np.pi)


@dataclass(frozen=True)
class Array:
    """Some detectors as a scan sees them, cleaned by one projection.

    `place` (n_det,) complex [rad]; `responsivity` (n_det,) by which they see, `assumed` (n_det,) those that cleaning
    takes for it; `basis` (n_par, n_det), orthonormal templates.
    """

    place: np.ndarray
    responsivity: np.ndarray
    assumed: np.ndarray
    basis: np.ndarray

    def cleaned(self, streams: np.ndarray) -> np.ndarray:
        """(1 - P) of values (n_det, ...), as cleaning with these responsivities leaves them."""
        gain = self.assumed[:, None]
        return streams - gain * (self.basis.T @ (self.basis @ (streams / gain)))

    def response(self, wave: np.ndarray) -> np.ndarray:
        """The array response a (n_det, n_mode) to modes (n_mode,)."""
        phase = self.seen(wave)
        gain = self.assumed[:, None]
        return phase - (self.basis.T @ (self.basis @ (phase * gain))) / gain

    def seen(self, wave: np.ndarray) -> np.ndarray:
        """exp(i k.r), (n_det, n_mode)."""
        return np.exp(1j * (np.outer(self.place.real, wave.real) + np.outer(self.place.imag, wave.imag)))


def projected_array(
    plane: FocalPlane,
    angle_rad: float,
    responsivity: np.ndarray,
    algorithm: str,
    assumed: np.ndarray | None = None,
) -> Array:
    """Detectors whose y axis has the position angle `angle_rad` from the scan's direction, cleaned by an algorithm.

    `assumed` are the responsivities that it takes, None for the true ones. `algorithm` is one of `PROJECTIONS`; raises
    ValueError as `mapmaker.clean` for arrays that do not support it.
    """
    # sky_vector of surveysim.telescope.pointing as complex numbers.
    place = np.exp(-1j * angle_rad) * (-plane.x_rad + 1j * plane.y_rad)
    exponents = PROJECTIONS[algorithm]
    basis = template_basis(plane, exponents) if exponents else np.zeros((0, len(place)))
    return Array(place, responsivity, responsivity if assumed is None else assumed, basis)


def matrix_power(response: np.ndarray, correlation: np.ndarray | NoiseCorrelation | None) -> np.ndarray:
    """Power a^H K a / n_det (n_mode,) of streams of unit PSD with the correlation K (None: none), a (n_det, n_mode)."""
    spread = response if correlation is None else correlation @ response
    return np.einsum("ij,ij->j", response.conj(), spread).real / len(response)


def stream_power(array: Array, correlation: np.ndarray | NoiseCorrelation | None) -> float:
    """Mean PSD of the cleaned streams of detectors that have unit PSD and a correlation (None: none)."""
    n_det = len(array.place)
    if correlation is None and n_det > MOST_DENSE:
        correlation = NoiseCorrelation(None, np.ones(n_det))
    if isinstance(correlation, NoiseCorrelation):
        return float(np.mean(correlation.gain**2)) - _projected_power(array, correlation) / n_det
    matrix = np.eye(n_det) if correlation is None else correlation
    once = array.cleaned(matrix)
    return float(np.trace(array.cleaned(once.T)) / n_det)


def _projected_power(array: Array, correlation: NoiseCorrelation) -> float:
    """What cleaning takes of the trace of K: with ``P = U V^T``, that of ``P K + K P^T - P K P^T``."""
    gain = array.assumed[:, None]
    u, v = gain * array.basis.T, array.basis.T / gain
    ku, kv = correlation @ u, correlation @ v
    return float(2 * np.sum(v * ku) - np.sum((v.T @ kv) * (u.T @ u)))


@dataclass(frozen=True)
class Layer:
    """Wavevectors of the layer: `alpha` (n_a,) complex [cycles/rad]; `power` (n_sine, n_a), the variance of each."""

    alpha: np.ndarray
    power: np.ndarray


def layer_waves(screen: Screen, longest_rad: float, sines: Sequence[float] = (1.0,)) -> Layer:
    """Wavevectors for unit amplitude, from well below one over the longest track to where the beam ends.

    `screen` is the layer at the zenith; it is seen at elevations with these sines. What is longer still is a slope
    along any track, and added to the longest waves as such: of a steep spectrum without an outer scale, a third of what
    sets points apart.
    """
    edge = np.geomspace(0.02 / longest_rad, 12 / (screen.beam_rad * min(sines)), _RADII)
    # Every other radius starts between the azimuths of its neighbours.
    angle = 2 * np.pi / _AZIMUTHS * (np.arange(_AZIMUTHS) + 0.5 * (np.arange(_RADII) % 2)[:, None])
    power = np.array([_ring_power(at_elevation(screen, sine), edge) for sine in sines])
    return Layer((edge[:, None] * np.exp(1j * angle)).ravel(), np.repeat(power, _AZIMUTHS, axis=1))


def _ring_power(screen: Screen, edge: np.ndarray) -> np.ndarray:
    """Variance (n,) of one of the `_AZIMUTHS` wavevectors with each length (n,)."""
    step, turn = np.log(edge[1] / edge[0]), 2 * np.pi / _AZIMUTHS
    strength = power(screen, edge) * beam_transfer(edge * screen.beam_rad) ** 2 * edge**2 * step * turn
    strength[0] += _slope(screen, edge[0] * np.exp(-step / 2)) / edge[0] ** 2 * turn
    return strength


def _slope(screen: Screen, alpha: float) -> float:
    """The integral of alpha^3 P from 0 to `alpha`: what the longest waves put into squared slopes."""
    if np.isinf(screen.outer_scale_rad):
        return alpha ** (4 - screen.index) / (4 - screen.index)
    below = np.geomspace(1e-3 * min(alpha, 1 / screen.outer_scale_rad), alpha, 200)
    return float(np.trapezoid(power(screen, below) * below**4, np.log(below)))


def layer_gain(array: Array, response: np.ndarray, layer: Layer) -> np.ndarray:
    """Share of each wavevector's power that goes into each mode before the time window, (n_mode, n_a)."""
    seen = array.seen(2 * np.pi * layer.alpha) * array.responsivity[:, None]
    amplitude = response.conj().T @ seen
    return (amplitude.real**2 + amplitude.imag**2) / len(array.place)


def layer_stream_gain(array: Array, layer: Layer) -> np.ndarray:
    """Share of each wavevector's power that is left in the mean PSD of the cleaned streams, (n_a,)."""
    left = array.cleaned(array.seen(2 * np.pi * layer.alpha) * array.responsivity[:, None])
    return np.mean(left.real**2 + left.imag**2, axis=0)
