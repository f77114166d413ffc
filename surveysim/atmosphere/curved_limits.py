"""Check, before any draw, that the rectangles of curved tracks can be built, in any wind up to the fastest."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from surveysim.atmosphere.curved_tracks import curved_tracks
from surveysim.atmosphere.screen_simulation import SlantStrips, StripCache
from surveysim.atmosphere.strip_factors import points_along
from surveysim.atmosphere.strip_limits import check_size, check_strip
from surveysim.runtime.errors import OutOfRangeError

# Directions and speeds, over the fastest, of the winds that are tried; the widest rectangles are those of calm air or
# of a wind across the track.
_DIRECTIONS, _SPEEDS = np.arange(12) * np.pi / 6, (0.25, 0.5, 1.0)
# Most scans of an observation and samples of a scan whose tracks are computed.
_SCANS, _SAMPLES = 24, 400
# Rectangles may be larger by this factor in winds and scans between those.
_MARGIN = 1.05


@dataclass(frozen=True)
class BoresightMotion:
    """Directions of the boresight in one observation, (n_scan, n) each."""

    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray
    time_s: np.ndarray

    def thinned(self) -> "BoresightMotion":
        """Select evenly spread scans and samples, with the first and the last of them."""
        n_scan, n = self.time_s.shape
        scans, samples = (
            np.unique(np.linspace(0, size - 1, min(size, most)).astype(int))
            for size, most in ((n_scan, _SCANS), (n, _SAMPLES))
        )
        some = np.ix_(scans, samples)
        return BoresightMotion(self.azimuth_rad[some], self.elevation_rad[some], self.time_s[some])


def check_curved_strips(strips: SlantStrips, wind_rad_s: float, motions: Sequence[BoresightMotion]) -> int:
    """Check that the strips for curved tracks can be built.

    Parameters
    ----------
    strips
    wind_rad_s
        Fastest wind.
    motions
        Some observations.

    Returns
    -------
    int
        Largest number of elements of matrices, or of points, of a strip.

    Raises
    ------
    OutOfRangeError
        With the size of the rectangle and its wind, where a strip can't be built.
    """
    found = {item.size: item for item in _rectangles(strips, wind_rad_s, motions)}
    for item in found.values():
        _check(check_size, item)
    # The others are smaller in one direction at least, so smooth strips are not longer.
    return _check(check_strip, found[max(found, key=lambda size: size[0] * size[1])])


@dataclass(frozen=True)
class _Rectangle:
    """The largest rectangle of an observation in some wind."""

    strips: StripCache
    length_rad: float
    half_width_rad: float
    wind_rad_s: float

    @property
    def size(self) -> tuple[int, int]:
        """Lanes and points along the strip."""
        return self.strips.n_lane, points_along(self.length_rad, self.strips.step_rad)


def _check(check: Callable[[StripCache, float], int], item: _Rectangle) -> int:
    try:
        return check(item.strips, item.length_rad)
    except OutOfRangeError as error:
        length, width = np.degrees(item.length_rad), np.degrees(2 * item.half_width_rad)
        raise OutOfRangeError(
            f"{error} (the tracks of a scan through the layer fill {length:.3g} by {width:.3g} deg, in wind of"
            f" {np.degrees(item.wind_rad_s) * 60:.3g} arcmin / s)"
        ) from None


def _rectangles(strips: SlantStrips, wind_rad_s: float, motions: Sequence[BoresightMotion]) -> Iterator[_Rectangle]:
    """Yield the largest rectangle of each observation, in each wind."""
    winds = [0j, *(wind_rad_s * speed * np.exp(1j * angle) for speed in _SPEEDS for angle in _DIRECTIONS)]
    for motion in motions:
        some = motion.thinned()
        centre = some.elevation_rad.mean(axis=1)
        for wind in winds:
            tracks = curved_tracks(
                azimuth_rad=some.azimuth_rad,
                elevation_rad=some.elevation_rad,
                time_s=some.time_s,
                centre_rad=centre,
                layer_velocity_rad_s=np.array([wind.real, wind.imag]) / np.sin(centre)[:, None],
                radius_rad=strips.half_width_rad,
            )
            half_width = _MARGIN * float(tracks.half_width_rad.max())
            cache = strips.at(float(np.sin(centre).min()), half_width)
            yield _Rectangle(cache, _MARGIN * float(tracks.length_rad.max()), half_width, abs(wind))
