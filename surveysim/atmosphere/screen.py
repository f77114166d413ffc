"""Realizations of the thin screen: one random strip of the layer for every scan.

Strips know nothing of each other; the trends that scans share are given to them by `surveysim.atmosphere.trends`.

In the frame of the moving layer all detectors of a scan at constant velocity follow straight parallel
lines. A scan therefore needs a strip of the layer that is long along the relative velocity (x) and as wide
as the focal plane (y): `n_lane` lanes of `n_x` lattice points.

The field has stationary increments but, without an outer scale, no finite variance, and much of its
gradient comes from scales beyond any box. Intrinsic circulant embedding along x (Stein 2002, J. Comput.
Graph. Stat. 11, 587) deals with both: with D the structure function, the covariance

    C(x, dy) = -(D(r) - a x^2) / 2,   r^2 = x^2 + dy^2,   a = D'(L/2) / L,

continued with period L = n_x step has zero slope at the seam x = L/2; an independent linear ramp along x,
of slope variance a, gives back what a x^2 took away. The higher odd derivatives jump at the seam and would
put negative power at high frequencies, where the beam leaves almost none; so C is made smooth and even
about the seam over its last quarter. The structure function on the lattice is then exact up to the seam's
beginning, and longer tracks are not allowed.

A Fourier transform along x turns C into one small matrix per frequency, whose eigenvectors are the factors
kept in `Strip`. At zero frequency C is positive for contrasts between lanes alone, so the constant is
projected out: a common offset of a strip is of no consequence, since the mean of every scan is removed.
"""

from dataclasses import dataclass, field
from math import ceil, log2, pi, radians

import numpy as np
import scipy.fft
from threadpoolctl import threadpool_limits

from surveysim.atmosphere.spectrum import LAG_MAX, Screen, at_elevation, structure_function, structure_slope
from surveysim.kernels import screen as kernels

_STEP_MAX_RAD = radians(40.0 / 3600.0)
_STEPS_PER_BEAM, _FEWEST_STEPS_PER_BEAM, _STEPS_PER_PAIR = 14, 4, 8
# Share of half a period that is bent to make the seam smooth, and the number of even powers fitted there.
_SEAM = 0.25
_SEAM_TERMS = 4
# Modes that add less than this share to the differences between lattice neighbours are left out; all that are left
# out, of which long strips have very many, add no more than the second.
_NEGLIGIBLE, _NEGLIGIBLE_SUM = 1e-9, 1e-3
# Negative power looks like roughness: it hardly changes the structure function, but 2e-4 of it adds 7 % to
# what a quadratic in the field of view leaves at 1000 m, and 7e-4 adds 40 % at 375 m. The spline of the
# structure function must be as smooth for the same reason.
_CLIPPED_MAX = 1e-5
_N_X_MIN, _N_X_MAX = 32, 2**17
# Classes of elevations in each factor of two of 1 / sin(el).
_SLANTS = 4
# Lattice points, and elements of all frequencies' matrices, that a few gigabytes hold.
_MOST_POINTS, _MOST_ELEMENTS = 2**24, 10**8
LOOK_UPS = {
    "nearest": kernels.add_screen_nearest,
    "linear": kernels.add_screen,
    "cubic": kernels.add_screen_cubic,
}


@dataclass(frozen=True)
class Strip:
    """Factors of strips of one size, per unit amplitude; made once and drawn from many times.

    columns (n_total, n_lane) float32 or float64: eigenvectors scaled to the standard deviation of each part of a mode
    in an unnormalized DFT; those of frequency k are rows start[k]:start[k + 1], and no frequency above
    n_freq has any. ramp_std [1/rad] is the standard deviation of the slope along x. clipped_fraction is the
    share of the variance of neighbour differences in negative eigenvalues, which were set to zero.
    """

    step_rad: float
    n_x: int
    n_lane: int
    ramp_std: float
    columns: np.ndarray
    start: np.ndarray
    clipped_fraction: float

    @property
    def length_rad(self):
        """Longest track [rad] for which the structure function is exact."""
        return 0.5 * (1.0 - _SEAM) * self.n_x * self.step_rad

    @property
    def half_width_rad(self):
        """Largest distance [rad] of a track from the strip's middle."""
        return 0.5 * (self.n_lane - 1) * self.step_rad


@dataclass(frozen=True)
class StripCache:
    """Strips of one screen and width, made when first asked for, in lengths of powers of two.

    They are drawn with `precision`, "float32" or "float64", and looked up by `interpolation`, one of `LOOK_UPS`.
    """

    screen: Screen
    half_width_rad: float
    step_rad: float
    interpolation: str = "linear"
    precision: str = "float32"
    strips: dict = field(default_factory=dict, repr=False, compare=False)

    @property
    def n_lane(self):
        """Number of lanes of the strips."""
        return lanes(self.half_width_rad, self.step_rad, self._fewest_lanes)

    @property
    def strip_half_width_rad(self):
        """Largest distance [rad] of a track from the strips' middle."""
        return 0.5 * (self.n_lane - 1) * self.step_rad

    @property
    def _fewest_lanes(self):
        return 4 if self.interpolation == "cubic" else 2

    def strip_for(self, length_rad):
        """The strip for tracks up to `length_rad` long; raises ValueError as `build_strip` does."""
        n_x = _points_along(length_rad, self.step_rad)
        if n_x not in self.strips:
            self.strips[n_x] = build_strip(
                self.screen, length_rad, self.half_width_rad, self.step_rad, self.precision, self._fewest_lanes
            )
        return self.strips[n_x]


@dataclass(frozen=True)
class SlantStrips:
    """Strips of one screen for a layer that is seen at any elevation.

    A layer at the height h is h / sin(el) away, so that on the sky it is a smaller copy of itself at the zenith, beam
    and outer scale too: with angles over sin(el), strips of the screen at the zenith serve all elevations. They need
    to be 1 / sin(el) wider, and have lattices as much coarser; elevations come in classes of 19 % in 1 / sin(el), each
    with the strips of its lowest. `half_width_rad` and `closest_rad` between detectors are on the sky; `scale` is the
    factor of `strip_step`.
    """

    screen: Screen
    half_width_rad: float
    closest_rad: float
    scale: float = 1.0
    interpolation: str = "linear"
    precision: str = "float32"
    caches: dict = field(default_factory=dict, repr=False, compare=False)

    def at(self, sine):
        """`StripCache` for an elevation of this sine, the least of an observation."""
        number = ceil(-_SLANTS * log2(sine) - 1e-9)
        if number not in self.caches:
            slant = 2.0 ** (number / _SLANTS)
            step = self.scale * strip_step(at_elevation(self.screen, 1.0 / slant), self.closest_rad) * slant
            self.caches[number] = StripCache(
                self.screen, self.half_width_rad * slant, step, self.interpolation, self.precision
            )
        return self.caches[number]


def strip_step(screen, closest_rad):
    """Lattice step [rad] for bilinear look-up by detectors `closest_rad` apart or more.

    A fourteenth of the beam, 40 arcsec at most. The first keeps the structure function: within 3 % at 0.67
    arcmin and above for b >= 2, 0.2 % for b = 11/3. The second is for what is left after a quadratic in an 8
    arcmin field of view has been removed: at b = 11/3 within 5 % of its variance from 1000 m up and 10 % at
    375 m, where a share of the wide beam alone would not do. For b < 2 the beam's sharp edge makes the field
    rough on every scale: at b = 2/3 and 1000 m the structure function is 22 % low at 0.67 arcmin and within 3 %
    only from 4 arcmin up. Detectors that are far apart do with an eighth of their separation, up to a quarter of
    the beam.
    """
    wide = closest_rad / _STEPS_PER_PAIR
    step = max(screen.beam_rad / _STEPS_PER_BEAM, min(wide, screen.beam_rad / _FEWEST_STEPS_PER_BEAM))
    return min(step, max(wide, _STEP_MAX_RAD))


# ---------------------------------------------------------------- factors


@threadpool_limits.wrap(limits=1)  # eigenvectors differ in their last bits between numbers of BLAS threads
def build_strip(screen, length_rad, half_width_rad, step_rad, precision="float32", fewest_lanes=2):
    """Factors of a strip for tracks up to `length_rad` long within +-`half_width_rad` of its middle.

    The period is the smallest power of two of steps that holds the length, doubled as long as more than 1e-5
    of the variance of neighbour differences has negative eigenvalues: that happens where the field is smooth
    over the period, on tracks of a few beams or for b > 5. Raises ValueError when no period does, and for strips
    too long or too wide to hold.
    """
    n_lane = lanes(half_width_rad, step_rad, fewest_lanes)
    n_x = _points_along(length_rad, step_rad)
    if n_x * n_lane > _MOST_POINTS or n_x * step_rad > 2.0 * LAG_MAX * screen.beam_rad:
        raise ValueError(_too_large(n_x, n_lane, step_rad))
    strip = _factorize(screen, n_x, n_lane, step_rad, precision)
    while strip.clipped_fraction > _CLIPPED_MAX:
        n_x *= 2
        if n_x > _N_X_MAX:
            raise ValueError(
                f"no strip of {n_lane} lanes {step_rad:g} rad apart for {screen}: negative eigenvalues with"
                f" {strip.clipped_fraction:.2g} of the variance found; at most {_CLIPPED_MAX:g} is allowed,"
                " use a smaller outer scale or shorter scans"
            )
        strip = _factorize(screen, n_x, n_lane, step_rad, precision)
    return strip


def lanes(half_width_rad, step_rad, fewest):
    """Number of lanes of a strip of a half width, `fewest` or more."""
    return max(fewest, ceil(2.0 * half_width_rad / step_rad) + 1)


def _too_large(n_x, n_lane, step_rad):
    return (
        f"a strip of the layer of {n_x} by {n_lane} points {step_rad:.3g} rad apart found; {_MOST_POINTS:.3g} points,"
        f" {LAG_MAX:g} beams and {_MOST_ELEMENTS:.3g} elements of covariance are allowed: shorter scans, a slower"
        " wind, a lower layer, a smaller camera or a larger numerics.screen_step need less"
    )


def _points_along(length_rad, step_rad):
    """Smallest power of two of lattice points whose half, without the seam, is longer than the length."""
    return max(_N_X_MIN, 2 ** ceil(log2(2.0 / (1.0 - _SEAM) * (length_rad / step_rad + 1.0))))


def _factorize(screen, n_x, n_lane, step_rad, precision):
    """Strip of a given size, whatever its clipped fraction."""
    ramp_variance, density = _lane_spectra(screen, n_x, n_lane, step_rad)
    total = 2.0 * float(structure_function(screen, step_rad))
    value, vector, share = _eigen_modes(density, n_x, step_rad, total)
    share /= total
    kept = share > min(_NEGLIGIBLE, 0.1 * _NEGLIGIBLE_SUM / share.size)
    # A real mode (k = 0 or Nyquist) has all its variance, n_x times the eigenvalue, in one part, the others
    # half of it.
    part = np.full(n_x // 2 + 1, 0.5 * n_x)
    part[[0, -1]] = n_x
    scale = np.sqrt(np.maximum(value, 0.0) * part[: len(value), None])
    columns = (vector * scale[:, None, :]).transpose(0, 2, 1)[kept]
    start = np.concatenate([[0], np.cumsum(kept.sum(axis=1))])
    n_freq = int(np.searchsorted(start, start[-1]))
    clipped = max(0.0, -float(share[share < 0.0].sum()))
    return Strip(
        step_rad,
        n_x,
        n_lane,
        ramp_variance**0.5,
        columns.astype(precision),
        start[: n_freq + 1].astype(np.int64),
        clipped,
    )


def _lane_spectra(screen, n_x, n_lane, step_rad):
    """Ramp variance [1/rad^2], and spectra (n_x/2 + 1, n_lane): DFT along x of C, lanes 0, 1, ... apart."""
    half = 0.5 * n_x * step_rad
    ramp_variance = max(0.0, float(structure_slope(screen, half)) / (2.0 * half))
    x = step_rad * np.arange(n_x // 2 + 1)
    distance = np.hypot(x[:, None], step_rad * np.arange(n_lane))
    covariance = -0.5 * (structure_function(screen, distance) - ramp_variance * x[:, None] ** 2)
    return ramp_variance, scipy.fft.dct(_smooth_seam(covariance), type=1, axis=0)


def _smooth_seam(covariance):
    """Covariance (n_x/2 + 1, n_lane) made smooth and even about its last row, the seam.

    Over the last _SEAM of its length it goes over into the best-fitting polynomial that is even about the
    seam.
    """
    n = int(_SEAM * (covariance.shape[0] - 1))
    s = np.arange(n, -1, -1.0) / n  # 1 where the change begins, 0 at the seam
    even = s[:, None] ** np.arange(0, 2 * _SEAM_TERMS, 2)
    far = slice(0, max(_SEAM_TERMS, n // 2))
    end = covariance[-n - 1 :]
    coefficients = np.linalg.lstsq(even[far], end[far], rcond=None)[0]
    step = np.clip((1.0 - s) / 0.8, 0.0, 1.0)
    step = step**4 * (35.0 - 84.0 * step + 70.0 * step**2 - 20.0 * step**3)
    return np.concatenate([covariance[: -n - 1], end + step[:, None] * (even @ coefficients - end)])


def _eigen_modes(density, n_x, step_rad, total):
    """Eigenvalues (n_freq, n_lane), eigenvectors (n_freq, n_lane, n_lane) and shares (n_freq, n_lane).

    A mode's share is what it adds to the variance of the difference of neighbours along x plus of that
    across; without the ramp all shares add to `total`, 2 D(step). Frequencies above the last that could matter are
    left out. Raises ValueError where the matrices would be too large.
    """
    n_lane = density.shape[1]
    lane, k = np.arange(n_lane), np.arange(n_x // 2 + 1)
    weight = np.full(k.size, 2.0 / n_x)
    weight[[0, -1]] = 1.0 / n_x
    along = weight * (2.0 * np.sin(pi * k / n_x)) ** 2
    # No eigenvalue exceeds its matrix' largest absolute row sum.
    bound = np.abs(density).sum(axis=1) * (along + weight)
    used = 1 + int(np.flatnonzero(bound[1:] > 1e-2 * _NEGLIGIBLE * bound[1:].sum()).max()) + 1
    # The sum of bounds is far above the total where a strip is long and its field red.
    share = along * density[:, 0] + 2.0 * weight * (density[:, 0] - density[:, 1])
    above = np.flatnonzero(np.cumsum(share[::-1])[::-1] > _NEGLIGIBLE_SUM * total)
    used = max(used, 1 + int(above.max(initial=0)))
    if used * n_lane**2 > _MOST_ELEMENTS:
        raise ValueError(_too_large(n_x, n_lane, step_rad))
    matrix = density[:used, np.abs(lane[:, None] - lane)]
    matrix[0] -= matrix[0].mean(axis=0)
    matrix[0] -= matrix[0].mean(axis=1)[:, None]
    value, vector = np.linalg.eigh(matrix)
    across = np.square(np.diff(vector, axis=1)).sum(axis=1) / (n_lane - 1)
    return value, vector, value * (along[:used, None] / n_lane + weight[:used, None] * across)


# ---------------------------------------------------------------- realizations


def draw_strip(strip, rng):
    """One realization (n_lane, n_x) of unit amplitude, from one draw of 2 n_total + 1 normals.

    It has the type of the strip's columns. The structure function holds for points up to `strip.length_rad` apart;
    lattice points are strip.step_rad apart.
    """
    normals = rng.standard_normal(2 * len(strip.columns) + 1, dtype=np.float32)
    real = strip.columns.dtype
    modes = np.empty((strip.n_lane, len(strip.start) - 1), np.result_type(real, np.complex64))
    kernels.combine_columns(strip.columns, strip.start, normals, modes)
    # The inverse transform takes the modes above as zero, and only the real parts of the real modes.
    layer = scipy.fft.irfft(modes, n=strip.n_x, axis=1, overwrite_x=True)
    layer += np.arange(strip.n_x, dtype=real) * real.type(normals[-1] * strip.ramp_std * strip.step_rad)
    return layer


@dataclass(frozen=True)
class Tracks:
    """Tracks of n_scan scans over their strips, in the frame of the layer.

    `motion_rad_s` (n_scan, 2): velocity of the boresight against the layer; `direction` (n_scan, 2): unit vector along
    it and along the strip; `length_rad` (n_scan,): part of the strip that detectors see; `x_rad`, `y_rad` (n_scan,
    n_det): first place of each detector on the strip; `corner_rad` (n_scan, 2): the strip's first point, relative to
    the first place of the boresight.
    """

    motion_rad_s: np.ndarray
    direction: np.ndarray
    length_rad: np.ndarray
    x_rad: np.ndarray
    y_rad: np.ndarray
    corner_rad: np.ndarray


def scan_tracks(scan_bounds, sample_rate_hz, offsets_rad, velocity_rad_s, layer_velocity_rad_s, strips):
    """Tracks of scans, given as to `add_atmosphere`, which raises the same errors."""
    motion = np.asarray(velocity_rad_s, dtype=float) - np.asarray(layer_velocity_rad_s, dtype=float)
    speed = np.hypot(*motion.T)
    direction = np.where(speed[:, None] > 0.0, motion, [1.0, 0.0]) / np.where(speed > 0.0, speed, 1.0)[:, None]
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    along, across = (np.einsum("sdi,si->sd", offsets_rad, axis) for axis in (direction, normal))
    widest, half = float(np.abs(across).max(initial=0.0)), strips.strip_half_width_rad
    if widest > half + 1e-6 * strips.step_rad:
        raise ValueError(f"detector {widest:g} rad from the middle of the strip found; half_width_rad allows {half:g}")
    first = along.min(axis=1, keepdims=True)
    track = speed * (np.diff(scan_bounds, axis=1)[:, 0] - 1) / sample_rate_hz
    y = np.clip(across + half, 0.0, 2.0 * half)
    return Tracks(motion, direction, np.ptp(along, axis=1) + track, along - first, y, first * direction - half * normal)


def add_atmosphere(
    data_mk,
    scan_bounds,
    sample_rate_hz,
    offsets_rad,
    velocity_rad_s,
    layer_velocity_rad_s,
    amplitude_mk,
    strips,
    rng,
    *,
    trends=None,
):
    """Add the emission of the moving layer to time streams, in place.

    data_mk (n_det, n_samp) float32 or float64 [mK]; scan_bounds (n_scan, 2) first sample and end of each
    scan; offsets_rad (n_scan, n_det, 2) detectors' offsets (xi, eta) from the boresight; velocity_rad_s and
    layer_velocity_rad_s (n_scan, 2) velocities of boresight and layer (xi, eta); amplitude_mk (n_scan,)
    sqrt(B2); strips a `StripCache`. Angles and speeds are those of a layer at the zenith: at an elevation el
    all are 1 / sin(el) larger than on the sky, and the amplitude is sqrt(B2 / sin(el)).

    Every scan has a strip of its own, with the trends that `trends`, `Trends` of these scans, gives it; without them
    the scans are independent of each other, like scans of different nights. The common offset of a scan's streams is
    arbitrary, as the mean of each scan is removed. Without relative motion the streams are constant. Raises ValueError
    when a detector lies outside the strip's width.
    """
    tracks = scan_tracks(scan_bounds, sample_rate_hz, offsets_rad, velocity_rad_s, layer_velocity_rad_s, strips)
    step = strips.step_rad
    rows = zip(scan_bounds, amplitude_mk, tracks.motion_rad_s, tracks.length_rad, strict=True)
    for scan, ((start, stop), amplitude, motion, length) in enumerate(rows):
        layer = draw_strip(strips.strip_for(float(length)), rng)
        if trends is not None:
            trends.impose(scan, layer)
        dx = float(np.hypot(*motion)) / (sample_rate_hz * step)
        y0 = np.minimum(tracks.y_rad[scan] / step, len(layer) - 1.0)
        LOOK_UPS[strips.interpolation](data_mk, start, stop, layer, tracks.x_rad[scan] / step, y0, dx, float(amplitude))
