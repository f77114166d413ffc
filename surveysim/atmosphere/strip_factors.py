"""Factors of random strips of the layer, from which realizations are drawn.

In the frame of the moving layer, all detectors of a scan at constant velocity follow parallel straight lines. A scan
needs a strip that is long along the relative velocity (x) and as wide as the focal plane (y): `n_lane` lanes of `n_x`
lattice points. The field has stationary increments, but without an outer scale no finite variance. Intrinsic circulant
embedding along x (Stein 2002, J. Comput. Graph. Stat. 11, 587) handles both: with D the structure function, the
covariance

    C(x, dy) = -(D(r) - a x^2) / 2,   r^2 = x^2 + dy^2,   a = D'(L/2) / L,

continued with the period L = n_x step has zero slope at the seam x = L/2, and an independent linear ramp along x with
the slope variance a restores a x^2. Higher odd derivatives jump at the seam, which would give negative power at high
frequencies; C is therefore made smooth and even about the seam over its last quarter. The structure function on the
lattice is exact up to there, and longer tracks are refused.

A Fourier transform along x gives one small matrix per frequency, C(k) = V diag(lambda) V^T, and a strip is the inverse
transform of V sqrt(lambda) z with normal z, plus the ramp; `Strip` holds V sqrt(lambda). At k = 0, C is positive for
contrasts between lanes only, so the constant is projected out: it does not matter, as the mean of every scan is
removed.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import ceil, log2, pi

import numpy as np
from threadpoolctl import threadpool_limits

from surveysim.atmosphere.thin_screen import LAG_MAX, Screen, structure_function, structure_slope
from surveysim.runtime.errors import OutOfRangeError

# Fraction of half a period that is changed to make the seam smooth.
SEAM = 0.25
# Modes that contribute less than the first fraction to the differences between lattice neighbours are omitted; all
# omitted modes, of which long strips have many, contribute at most the second.
_NEGLIGIBLE, NEGLIGIBLE_SUM = 1e-9, 1e-3
# Negative power acts as roughness: it hardly changes the structure function, but a fraction of 2e-4 raises the residual
# of a quadratic in the field of view by 7 % at 1000 m, and 7e-4 by 40 % at 375 m. For the same reason the spline of the
# structure function must be as smooth.
CLIPPED_MAX = 1e-5
# Elements of a vector instruction in single precision.
_VECTOR = 8
_N_X_MIN, N_X_MAX = 32, 2**17
# Largest numbers of lattice points and of elements in all matrices: a few gigabytes.
MOST_POINTS, _MOST_ELEMENTS = 2**24, 10**8


def _smooth_step(place: np.ndarray) -> np.ndarray:
    step = np.clip(place / 0.8, 0.0, 1.0)
    return step**4 * (35.0 - 84.0 * step + 70.0 * step**2 - 20.0 * step**3)


@dataclass(frozen=True)
class Seam:
    """Change of a covariance at the seam.

    Attributes
    ----------
    terms
        Number of even powers in the polynomial that it changes into.
    step
        Share of the polynomial, as a function of the place from the beginning of the change, 0, to the seam, 1.
    """

    terms: int = 4
    step: Callable[[np.ndarray], np.ndarray] = _smooth_step


@dataclass(frozen=True)
class Strip:
    """Factors of strips of one size, per unit amplitude; built once and drawn from many times.

    The lowest frequencies along x have `columns`. In wide strips (`surveysim.atmosphere.wide_strips`) those above have
    a Fourier transform across, with an `amplitude`.

    Attributes
    ----------
    step_rad
        Lattice step.
    n_x, n_lane
        Points along and across the strip.
    ramp_std
        Standard deviation of the slope along x [1/rad].
    columns : (n_total, n_lane or more)
        Eigenvectors, scaled to the standard deviation of each part of a mode in an unnormalized DFT, and zeros up to a
        multiple of a vector instruction; float32 or float64.
    start : (n_freq + 1,)
        Rows start[k]:start[k + 1] of `columns` belong to frequency k; higher frequencies have none.
    clipped_fraction
        Fraction of the variance of neighbour differences in negative eigenvalues, which were set to zero.
    n_y
        Period across of the frequencies above; 0 for none.
    amplitude : (n_more, n_half)
        Standard deviation of each part of a mode in unnormalized DFTs, by frequencies along and (of both signs) across.
    """

    step_rad: float
    n_x: int
    n_lane: int
    ramp_std: float
    columns: np.ndarray
    start: np.ndarray
    clipped_fraction: float
    n_y: int = 0
    amplitude: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def length_rad(self) -> float:
        """Longest track for which the structure function is exact [rad]."""
        return 0.5 * (1.0 - SEAM) * self.n_x * self.step_rad

    @property
    def half_width_rad(self) -> float:
        """Largest distance of a track from the middle of the strip [rad]."""
        return 0.5 * (self.n_lane - 1) * self.step_rad

    @property
    def lane_columns(self) -> np.ndarray:
        """The columns without the zeros, (n_total, n_lane)."""
        return self.columns[:, : self.n_lane]

    @property
    def n_deviates(self) -> int:
        """Number of normal deviates in a realization: two for each row of `columns` and mode, one for the slope."""
        return 2 * len(self.columns) + self.n_across + 1

    @property
    def n_across(self) -> int:
        """Number of normal deviates of the frequencies with an `amplitude`."""
        n_more, n_half = self.amplitude.shape
        return 2 * n_more * max(2 * n_half - 1, 0)


@threadpool_limits.wrap(limits=1)  # the last bits of eigenvectors depend on the number of BLAS threads
def build_strip(
    screen: Screen,
    *,
    length_rad: float,
    half_width_rad: float,
    step_rad: float,
    precision: str = "float32",
    fewest_lanes: int = 2,
    factorize: "Callable[..., Strip] | None" = None,
) -> Strip:
    """Build the factors of a strip.

    The period is the smallest power of two of steps that contains the length. It is doubled while negative eigenvalues
    have more than 1e-5 of the variance of neighbour differences. This happens where the field is smooth over the
    period: on tracks of a few beams, or for b > 5.

    Parameters
    ----------
    screen
    length_rad
        Longest track.
    half_width_rad
        Largest distance of a track from the middle.
    step_rad
        Lattice step.
    precision
        "float32" or "float64".
    fewest_lanes
        Least number of lanes.
    factorize
        Function that builds a strip of a given size; `factorize_dense` by default.

    Raises
    ------
    ValueError
        Where no period is long enough, and for strips too large to hold.
    """
    n_lane = lanes(half_width_rad, step_rad, fewest_lanes)
    n_x = points_along(length_rad, step_rad)
    check_points(n_x, n_lane, step_rad, screen)
    factorize = factorize or factorize_dense
    strip = factorize(screen, n_x=n_x, n_lane=n_lane, step_rad=step_rad, precision=precision)
    while strip.clipped_fraction > CLIPPED_MAX:
        n_x *= 2
        if n_x > N_X_MAX:
            raise OutOfRangeError(
                f"no strip of {n_lane} lanes {step_rad:g} rad apart for {screen}: negative eigenvalues with"
                f" {strip.clipped_fraction:.2g} of the variance found; at most {CLIPPED_MAX:g} is allowed,"
                " use a smaller outer scale or shorter scans"
            )
        strip = factorize(screen, n_x=n_x, n_lane=n_lane, step_rad=step_rad, precision=precision)
    return strip


def lanes(half_width_rad: float, step_rad: float, fewest: int) -> int:
    """Number of lanes of a strip with a half width, at least `fewest`."""
    return max(fewest, ceil(2.0 * half_width_rad / step_rad) + 1)


def check_points(n_x: int, n_lane: int, step_rad: float, screen: Screen) -> None:
    """Raise ValueError for strips with too many points, or longer than the structure function's table."""
    if n_x * n_lane > MOST_POINTS or n_x * step_rad > 2.0 * LAG_MAX * screen.beam_rad:
        raise OutOfRangeError(_too_large(n_x, n_lane, step_rad))


def check_elements(used: int, n_x: int, n_lane: int, step_rad: float) -> None:
    """Raise ValueError for too many elements in the covariance matrices of `used` frequencies."""
    if used * n_lane**2 > _MOST_ELEMENTS:
        raise OutOfRangeError(_too_large(n_x, n_lane, step_rad))


def _too_large(n_x: int, n_lane: int, step_rad: float) -> str:
    return (
        f"found a strip of the layer with {n_x} by {n_lane} points {step_rad:.3g} rad apart; up to {MOST_POINTS:.3g}"
        f" points, {LAG_MAX:g} beams of length and {_MOST_ELEMENTS:.3g} elements of covariance are allowed, by shorter"
        " scans, a slower wind, a lower layer, a smaller camera or a larger numerics.screen_step"
    )


def points_along(length_rad: float, step_rad: float) -> int:
    """Smallest power of two of lattice points whose half, without the seam, exceeds the length."""
    return max(_N_X_MIN, 2 ** ceil(log2(2.0 / (1.0 - SEAM) * (length_rad / step_rad + 1.0))))


def longest_track(n_x: int, step_rad: float) -> float:
    """Longest track [rad] for which a strip gets exactly this power of two of points."""
    return (0.5 * (1.0 - SEAM) * n_x - 1.5) * step_rad


def factorize_dense(screen: Screen, *, n_x: int, n_lane: int, step_rad: float, precision: str) -> Strip:
    """Build a strip of a given size, whatever its clipped fraction."""
    _, density = lane_spectra(screen, n_x, n_lane, step_rad)
    used = used_modes(screen, density, n_x, step_rad)
    strip = dense_strip(screen, density, n_x=n_x, step_rad=step_rad, used=used, precision=precision)
    n_freq = int(np.searchsorted(strip.start, strip.start[-1]))
    return replace(strip, start=strip.start[: n_freq + 1])


def dense_strip(screen: Screen, density: np.ndarray, *, n_x: int, step_rad: float, used: int, precision: str) -> Strip:
    """Build a strip from the first `used` frequencies of spectra (n_x/2 + 1, n_lane); raises as `check_elements`."""
    n_lane = density.shape[1]
    total = 2.0 * float(structure_function(screen, step_rad))
    value, vector, share = _eigen_modes(density, n_x, step_rad, used)
    share /= total
    kept = share > min(_NEGLIGIBLE, 0.1 * NEGLIGIBLE_SUM / share.size)
    scale = np.sqrt(np.maximum(value, 0.0) * mode_parts(n_x)[: len(value), None])
    columns = np.zeros((int(kept.sum()), -(-n_lane // _VECTOR) * _VECTOR), precision)
    columns[:, :n_lane] = vector.swapaxes(1, 2)[kept] * scale[kept][:, None]
    start = np.concatenate([[0], np.cumsum(kept.sum(axis=1))]).astype(np.int64)
    clipped = max(0.0, -float(share[share < 0.0].sum()))
    return Strip(step_rad, n_x, n_lane, _ramp_variance(screen, n_x, step_rad) ** 0.5, columns, start, clipped)


def mode_parts(n_x: int) -> np.ndarray:
    """Variance (n_x/2 + 1,) of each part of a mode in an unnormalized DFT, per eigenvalue.

    A real mode (k = 0 or Nyquist) has all its variance in one part, the others half of it.
    """
    part = np.full(n_x // 2 + 1, 0.5 * n_x)
    part[[0, -1]] = n_x
    return part


def lane_spectra(
    screen: Screen, n_x: int, n_lane: int, step_rad: float, seam: Seam | None = None
) -> tuple[float, np.ndarray]:
    """Spectra of the covariance along x, with a `seam`.

    Returns
    -------
    ramp_variance
        [1/rad^2].
    density : (n_x // 2 + 1, n_lane)
        DFT along x of C for lanes 0, 1, ... apart.
    """
    from scipy.fft import dct

    ramp_variance = _ramp_variance(screen, n_x, step_rad)
    x = step_rad * np.arange(n_x // 2 + 1)
    distance = np.hypot(x[:, None], step_rad * np.arange(n_lane))
    covariance = -0.5 * (structure_function(screen, distance) - ramp_variance * x[:, None] ** 2)
    return ramp_variance, dct(smooth_seam(covariance, seam or Seam()), type=1, axis=0)


def _ramp_variance(screen: Screen, n_x: int, step_rad: float) -> float:
    half = 0.5 * n_x * step_rad
    return max(0.0, float(structure_slope(screen, half)) / (2.0 * half))


def smooth_seam(covariance: np.ndarray, seam: Seam) -> np.ndarray:
    """Make the covariance (n_x/2 + 1, n_lane) smooth and even about its last row, the seam.

    Over the last `SEAM` of its length it changes into the best-fitting polynomial that is even about the seam.
    """
    n = int(SEAM * (covariance.shape[0] - 1))
    s = np.arange(n, -1, -1.0) / n  # 1 where the change begins, 0 at the seam
    even = s[:, None] ** np.arange(0, 2 * seam.terms, 2)
    far = slice(0, max(seam.terms, n // 2))
    end = covariance[-n - 1 :]
    coefficients = np.linalg.lstsq(even[far], end[far], rcond=None)[0]
    return np.concatenate([covariance[: -n - 1], end + seam.step(1.0 - s)[:, None] * (even @ coefficients - end)])


def difference_weights(n_x: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (n_x/2 + 1,) of frequencies in the variance, and in the variance of neighbour differences along x."""
    weight = np.full(n_x // 2 + 1, 2.0 / n_x)
    weight[[0, -1]] = 1.0 / n_x
    return weight, weight * (2.0 * np.sin(pi * np.arange(n_x // 2 + 1) / n_x)) ** 2


def used_modes(screen: Screen, density: np.ndarray, n_x: int, step_rad: float, omitted: float = NEGLIGIBLE_SUM) -> int:
    """Count the frequencies, from 0 on, that are not negligible in spectra (n_x/2 + 1, n_lane).

    Those above contribute at most the fraction `omitted` to the differences between lattice neighbours.
    """
    weight, along = difference_weights(n_x)
    # No eigenvalue exceeds its matrix' largest absolute row sum.
    bound = np.abs(density).sum(axis=1) * (along + weight)
    used = 1 + int(np.flatnonzero(bound[1:] > 1e-2 * _NEGLIGIBLE * bound[1:].sum()).max()) + 1
    # For long strips and red spectra the sum of bounds is far above the total.
    share = along * density[:, 0] + 2.0 * weight * (density[:, 0] - density[:, 1])
    total = 2.0 * float(structure_function(screen, step_rad))
    above = np.flatnonzero(np.cumsum(share[::-1])[::-1] > omitted * total)
    return max(used, 1 + int(above.max(initial=0)))


def _eigen_modes(
    density: np.ndarray, n_x: int, step_rad: float, used: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues (used, n_lane), eigenvectors (used, n_lane, n_lane) and variance fractions (used, n_lane).

    The fraction of a mode is its contribution to the variance of neighbour differences along x plus across; without the
    ramp they add up to 2 D(step). Raises ValueError where the matrices would be too large.
    """
    n_lane = density.shape[1]
    check_elements(used, n_x, n_lane, step_rad)
    lane = np.arange(n_lane)
    weight, along = difference_weights(n_x)
    matrix = density[:used, np.abs(lane[:, None] - lane)]
    matrix[0] -= matrix[0].mean(axis=0)
    matrix[0] -= matrix[0].mean(axis=1)[:, None]
    value, vector = mirrored_eigh(matrix)
    change = np.diff(vector, axis=1)
    across = np.einsum("kij,kij->kj", change, change) / (n_lane - 1)
    return value, vector, value * (along[:used, None] / n_lane + weight[:used, None] * across)


def mirrored_eigh(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the eigenvectors of symmetric matrices that are their own mirror images, as of lanes at equal distances.

    The vectors are even or odd about the middle: two matrices of half the size take a quarter of the time.

    Parameters
    ----------
    matrix : (k, n, n)
        Equal to ``matrix[:, ::-1, ::-1]``.

    Returns
    -------
    value : (k, n)
        Eigenvalues of the even vectors, ascending, then of the odd ones.
    vector : (k, n, n)
        Orthonormal eigenvectors, one a column, of positive first elements: a solver's signs change with its rounding.
    """
    n = matrix.shape[-1]
    n_odd, n_even = n // 2, n - n // 2
    near, far = matrix[:, :n_even, :n_even], matrix[:, :n_even, : n_odd - 1 : -1]
    # Even parts are expanded in sums of two unit vectors over sqrt(2), and in that of the middle.
    of_pair = np.where(np.arange(n_even) < n_odd, 1.0, 0.5**0.5)
    even_value, even = _signed_eigh((near + far) * (of_pair[:, None] * of_pair))
    odd_value, odd = _signed_eigh((near - far)[:, :n_odd, :n_odd])
    vector = np.zeros(matrix.shape)
    vector[:, :n_even, :n_even] = even * (0.5**0.5 / of_pair)[:, None]
    vector[:, :n_odd, n_even:] = odd * 0.5**0.5
    vector[:, n_even:, :n_even] = vector[:, n_odd - 1 :: -1, :n_even]
    vector[:, n_even:, n_even:] = -vector[:, n_odd - 1 :: -1, n_even:]
    return np.concatenate([even_value, odd_value], axis=1), vector


def _signed_eigh(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues, and eigenvectors with positive first elements."""
    value, vector = np.linalg.eigh(matrix)
    return value, np.copysign(1.0, vector[:, :1]) * vector
