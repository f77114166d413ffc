"""Realizations of the thin screen: one random strip of the layer for every scan.

In the frame of the moving layer all detectors of a scan at constant velocity follow parallel straight lines;
`surveysim.atmosphere.strip_factors` builds strips along them. Strips are independent of each other;
`surveysim.atmosphere.scan_trends` conditions them on the trends that scans share.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from itertools import accumulate
from math import ceil, log2, radians
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.chunks import row_chunks
from surveysim.atmosphere.strip_factors import Strip, build_strip, factorize_dense, lanes, points_along
from surveysim.atmosphere.thin_screen import Screen, at_elevation
from surveysim.atmosphere.wide_strips import across_modes, factorize_wide
from surveysim.runtime.rng import NormalDeviates

if TYPE_CHECKING:
    from surveysim.atmosphere.scan_trends import ScanTrends

_STEP_MAX_RAD = radians(40.0 / 3600.0)
_STEPS_PER_BEAM, _FEWEST_STEPS_PER_BEAM, _STEPS_PER_PAIR = 14, 4, 8
# Classes of elevations in each factor of two of 1 / sin(el).
_SLANTS = 4
# Classes of widths of rectangles in each factor of two.
_WIDTHS = 4
# Most lanes of rectangles for curved tracks that need no Fourier transform across.
_DENSE_LANES = 48
# Names of the kernels that look strips up, by `numerics.interpolation`.
LOOK_UPS = {"nearest": "add_screen_nearest", "linear": "add_screen", "cubic": "add_screen_cubic"}


@dataclass(frozen=True)
class StripCache:
    """Strips of one screen and width, built on first use, with lengths of powers of two.

    Attributes
    ----------
    screen
    half_width_rad
        Largest distance of a track from the middle.
    step_rad
        Lattice step.
    interpolation
        A key of `LOOK_UPS`.
    precision
        "float32" or "float64".
    wide
        Whether the strips are rectangles for curved tracks: those of many lanes have Fourier transforms across.
    strips
        Strips by number of points along them.
    """

    screen: Screen
    half_width_rad: float
    step_rad: float
    interpolation: str = "linear"
    precision: str = "float32"
    wide: bool = False
    strips: dict = field(default_factory=dict, repr=False, compare=False)

    @property
    def n_lane(self) -> int:
        """Number of lanes of the strips."""
        return lanes(self.half_width_rad, self.step_rad, self._fewest_lanes)

    @property
    def strip_half_width_rad(self) -> float:
        """Largest distance of a track from the middle of the strips [rad]."""
        return 0.5 * (self.n_lane - 1) * self.step_rad

    @property
    def factorize(self) -> Callable[..., Strip]:
        """Function that builds a strip of a given size."""
        return factorize_wide if self.wide and self.n_lane > _DENSE_LANES else factorize_dense

    @property
    def _fewest_lanes(self) -> int:
        return 4 if self.interpolation == "cubic" else 2

    def strip_for(self, length_rad: float) -> Strip:
        """Strip for tracks up to `length_rad` long; raises ValueError as `build_strip`."""
        n_x = points_along(length_rad, self.step_rad)
        if n_x not in self.strips:
            self.strips[n_x] = build_strip(
                self.screen,
                length_rad=length_rad,
                half_width_rad=self.half_width_rad,
                step_rad=self.step_rad,
                precision=self.precision,
                fewest_lanes=self._fewest_lanes,
                factorize=self.factorize,
            )
        return self.strips[n_x]


@dataclass(frozen=True)
class SlantStrips:
    """Strips of one screen for a layer seen at any elevation.

    The distance of a layer at the height h is h / sin(el), so on the sky it is a smaller copy of the layer at the
    zenith, including beam and outer scale. With angles over sin(el), strips of the screen at the zenith serve all
    elevations; they are wider by 1 / sin(el), with a coarser lattice by the same factor. Elevations are sorted into
    classes of 19 % in 1 / sin(el), which use the strips of their lowest elevation. Rectangles that hold curved tracks
    are sorted into classes of 19 % in width; those of straight scans are as wide as the focal plane.

    Attributes
    ----------
    screen
        The layer at the zenith.
    half_width_rad, closest_rad
        Half width of the focal plane and closest separation of detectors, on the sky.
    scale
        Factor on `strip_step`.
    interpolation, precision
        As in `StripCache`.
    caches
        Strips by classes of elevation and width.
    """

    screen: Screen
    half_width_rad: float
    closest_rad: float
    scale: float = 1.0
    interpolation: str = "linear"
    precision: str = "float32"
    caches: dict = field(default_factory=dict, repr=False, compare=False)

    def forget(self) -> None:
        """Free the strips; they are built again when they are asked for."""
        self.caches.clear()

    def at(self, sine: float, half_width_rad: float = 0.0) -> StripCache:
        """`StripCache` for the lowest elevation of an observation, given by its sine.

        `half_width_rad` is the largest distance of a track from the middle of its rectangle, in angles over sin(el).
        """
        number = ceil(-_SLANTS * log2(sine) - 1e-9)
        slant = 2.0 ** (number / _SLANTS)
        step = self.scale * strip_step(at_elevation(self.screen, 1.0 / slant), self.closest_rad) * slant
        narrow = max(self.half_width_rad * slant, 0.5 * step)
        wider = max(0, ceil(_WIDTHS * log2(half_width_rad / narrow) - 1e-9)) if half_width_rad > narrow else 0
        if (number, wider) not in self.caches:
            half_width = narrow * 2.0 ** (wider / _WIDTHS) if wider else self.half_width_rad * slant
            self.caches[number, wider] = StripCache(
                self.screen, half_width, step, self.interpolation, self.precision, wide=wider > 0
            )
        return self.caches[number, wider]


def strip_step(screen: Screen, closest_rad: float) -> float:
    """Lattice step for bilinear look-up by detectors at least `closest_rad` apart [rad].

    The step is a fourteenth of the beam and at most 40 arcsec. The first limit preserves the structure function: within
    3 % at 0.67 arcmin and above for b >= 2, 0.2 % for b = 11/3. The second preserves the residual of a quadratic in an
    8 arcmin field of view: at b = 11/3 its variance is within 5 % from 1000 m up and 10 % at 375 m. For b < 2 the sharp
    edge of the beam makes the field rough on every scale: at b = 2/3 and 1000 m the structure function is 22 % low at
    0.67 arcmin, and within 3 % only from 4 arcmin up. For detectors that are far apart an eighth of their separation
    suffices, up to a quarter of the beam.
    """
    wide = closest_rad / _STEPS_PER_PAIR
    step = max(screen.beam_rad / _STEPS_PER_BEAM, min(wide, screen.beam_rad / _FEWEST_STEPS_PER_BEAM))
    return min(step, max(wide, _STEP_MAX_RAD))


# ---------------------------------------------------------------- realizations


def draw_strips(strip: Strip, deviates: NormalDeviates, first: Sequence[int]) -> np.ndarray:
    """Draw independent realizations of a strip, of unit amplitude.

    Each takes `strip.n_deviates` deviates, from its position `first` on. The structure function holds for points up to
    `strip.length_rad` apart.

    Returns
    -------
    (n_strip, n_lane, n_x) array
        Of the type of the strip's columns; lattice points are `strip.step_rad` apart.
    """
    from scipy.fft import irfft

    from surveysim.atmosphere.screen_kernels import combine_columns

    normals = np.empty((len(first), strip.n_deviates), np.float32)
    if list(first) == list(range(first[0], first[-1] + 1, strip.n_deviates)):
        deviates.fill(normals, first[0])
    else:
        for row, position in zip(normals, first, strict=True):
            deviates.fill(row, position)
    real, n_freq = strip.columns.dtype, len(strip.start) - 1
    # Higher modes are zero. The inverse transform uses only the real parts of the real modes.
    modes = np.zeros((len(first), strip.n_lane, strip.n_x // 2 + 1), np.result_type(real, np.complex64))
    combine_columns(strip.columns, strip.start, normals, modes)
    if strip.n_across:
        above = normals[:, 2 * len(strip.columns) : -1]
        modes[:, :, n_freq : n_freq + len(strip.amplitude)] = across_modes(strip, above)
    layers = irfft(modes, n=strip.n_x, axis=-1, overwrite_x=True)
    slopes = (normals[:, -1] * strip.ramp_std * strip.step_rad).astype(real)
    layers += slopes[:, None, None] * np.arange(strip.n_x, dtype=real)
    return layers


@dataclass(frozen=True)
class Tracks:
    """Tracks of n_scan scans over their strips, in the frame of the layer.

    Attributes
    ----------
    motion_rad_s : (n_scan, 2)
        Velocity of the boresight against the layer.
    direction : (n_scan, 2)
        Unit vector along it and along the strip.
    length_rad : (n_scan,)
        Length of the strip that detectors see.
    x_rad, y_rad : (n_scan, n_det)
        First position of each detector on the strip.
    corner_rad : (n_scan, 2)
        First point of the strip, relative to the first position of the boresight.
    """

    motion_rad_s: np.ndarray
    direction: np.ndarray
    length_rad: np.ndarray
    x_rad: np.ndarray
    y_rad: np.ndarray
    corner_rad: np.ndarray

    def scans(self, first: int, end: int) -> "Tracks":
        """Select scans `first` to `end - 1`."""
        return Tracks(*(getattr(self, item.name)[first:end] for item in fields(self)))


def scan_tracks(
    scan_bounds: np.ndarray,
    *,
    sample_rate_hz: float,
    offsets_rad: np.ndarray,
    velocity_rad_s: np.ndarray,
    layer_velocity_rad_s: np.ndarray,
    strips: StripCache,
    extent_rad: np.ndarray | None = None,
) -> Tracks:
    """Tracks of scans over their strips; parameters and errors as for `add_atmosphere`.

    `extent_rad` (n_scan, n, 2) are offsets that the strips hold, by default those of the detectors. Tracks of one
    extent see one layer.
    """
    motion = np.asarray(velocity_rad_s, dtype=float) - np.asarray(layer_velocity_rad_s, dtype=float)
    speed = np.hypot(*motion.T)
    direction = np.where(speed[:, None] > 0.0, motion, [1.0, 0.0]) / np.where(speed > 0.0, speed, 1.0)[:, None]
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    along, across = (np.einsum("sdi,si->sd", offsets_rad, axis) for axis in (direction, normal))
    extent = along if extent_rad is None else np.einsum("sdi,si->sd", extent_rad, direction)
    widest, half = float(np.abs(across).max(initial=0.0)), strips.strip_half_width_rad
    if widest > half + 1e-6 * strips.step_rad:
        raise ValueError(f"detector {widest:g} rad from the middle of the strip found; half_width_rad allows {half:g}")
    first = extent.min(axis=1, keepdims=True)
    track = speed * (np.diff(scan_bounds, axis=1)[:, 0] - 1) / sample_rate_hz
    y = np.clip(across + half, 0.0, 2.0 * half)
    corner = first * direction - half * normal
    return Tracks(motion, direction, np.ptp(extent, axis=1) + track, np.maximum(along - first, 0), y, corner)


def add_atmosphere(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    *,
    sample_rate_hz: float,
    offsets_rad: np.ndarray,
    velocity_rad_s: np.ndarray,
    layer_velocity_rad_s: np.ndarray,
    amplitude_mk: np.ndarray,
    strips: StripCache,
    deviates: NormalDeviates,
    trends: "ScanTrends | None" = None,
) -> None:
    """Add the emission of the moving layer to time-streams, in place.

    Angles and speeds are those of a layer at the zenith: at the elevation el they are larger than on the sky by 1 /
    sin(el), and the amplitude is sqrt(B2 / sin(el)). The common offset of a scan's streams is arbitrary, as the mean of
    each scan is removed. Without relative motion the streams are constant.

    Parameters
    ----------
    data_mk : (n_det, n_samp)
        Streams, float32 or float64.
    scan_bounds : (n_scan, 2)
        First sample and end of each scan.
    sample_rate_hz
    offsets_rad : (n_scan, n_det, 2)
        Offsets (xi, eta) of the detectors from the boresight.
    velocity_rad_s, layer_velocity_rad_s : (n_scan, 2)
        Velocities (xi, eta) of boresight and layer.
    amplitude_mk : (n_scan,)
        sqrt(B2).
    strips : StripCache
    deviates
    trends : ScanTrends, optional
        Trends that the scans share. Without them the scans are independent, like those of different nights.

    Raises
    ------
    ValueError
        Where a detector is outside the width of the strip.
    """
    motion = {
        "offsets_rad": offsets_rad,
        "velocity_rad_s": velocity_rad_s,
        "layer_velocity_rad_s": layer_velocity_rad_s,
    }
    tracks = scan_tracks(scan_bounds, sample_rate_hz=sample_rate_hz, **motion, strips=strips)
    add_along_tracks(
        data_mk,
        scan_bounds,
        sample_rate_hz=sample_rate_hz,
        tracks=tracks,
        amplitude_mk=amplitude_mk,
        strips=strips,
        deviates=deviates,
        trends=trends,
    )


def add_along_tracks(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    *,
    sample_rate_hz: float,
    tracks: Tracks,
    amplitude_mk: np.ndarray,
    strips: StripCache,
    deviates: NormalDeviates,
    trends: "ScanTrends | None" = None,
    mean_removed: bool = False,
) -> None:
    """Add the emission of the moving layer along given `tracks` of the scans; else as `add_atmosphere`.

    With `mean_removed` the layer has a mean of 0 over the strip of each scan, as a realization that others join, and an
    amplitude (n_scan, n) of each sample.
    """
    from surveysim.atmosphere import screen_kernels

    add_layer = getattr(screen_kernels, LOOK_UPS[strips.interpolation])
    step = strips.step_rad
    steps = (np.hypot(*tracks.motion_rad_s.T) / (sample_rate_hz * step)).tolist()
    x, y = tracks.x_rad / step, np.minimum(tracks.y_rad / step, strips.n_lane - 1.0)
    for strip, scans, first in alike_strips(strips, tracks.length_rad):
        layers = draw_strips(strip, deviates, first)
        if trends is not None:
            trends.impose(scans, layers)
        for scan, layer in zip(scans, layers, strict=True):
            track, (start, stop) = (x[scan], y[scan], steps[scan]), scan_bounds[scan]
            if mean_removed:
                seen = np.zeros((len(data_mk), stop - start), data_mk.dtype)
                add_layer(seen, 0, stop - start, centred(layer, tracks.length_rad[scan] / step), *track, 1.0)
                screen_kernels.add_weighted(data_mk, start, seen, amplitude_mk[scan])
            else:
                add_layer(data_mk, start, stop, layer, *track, float(amplitude_mk[scan]))


def centred(layer: np.ndarray, end: float) -> np.ndarray:
    """Subtract the mean over the points of a strip (n_lane, n_x) up to a column `end` from these, in place."""
    used = layer[:, : ceil(end) + 3]
    used -= used.mean()
    return layer


def alike_strips(strips: StripCache, length_rad: np.ndarray) -> Iterator[tuple[Strip, list[int], list[int]]]:
    """Yield scans that have strips of one size, as many as fit in a chunk, and their first deviates."""
    of_scans = [strips.strip_for(length) for length in length_rad.tolist()]
    first = list(accumulate((strip.n_deviates for strip in of_scans), initial=0))
    for n_x in dict.fromkeys(strip.n_x for strip in of_scans):
        alike = [scan for scan, strip in enumerate(of_scans) if strip.n_x == n_x]
        strip = of_scans[alike[0]]
        for chunk in row_chunks(len(alike), strip.n_lane * n_x):
            scans = alike[chunk]
            yield strip, scans, [first[scan] for scan in scans]
