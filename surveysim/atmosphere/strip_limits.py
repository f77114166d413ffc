"""Check, before any draw, that strips of the layer can be built."""

from functools import lru_cache
from math import ceil, log2

from surveysim.atmosphere.screen_simulation import StripCache
from surveysim.atmosphere.strip_factors import (
    N_X_MAX,
    build_strip,
    check_elements,
    check_points,
    lane_spectra,
    longest_track,
    points_along,
    used_modes,
)
from surveysim.atmosphere.thin_screen import Screen
from surveysim.atmosphere.wide_strips import check_wide, factorize_wide
from surveysim.runtime.errors import OutOfRangeError

# Operations for eigenvectors that take at most a second, and the smallest number of lanes that shows smoothness.
_MOST_WORK, _FEWEST_LANES = 1e8, 4
# Strips of a period of so many beams and so many points have negligible negative eigenvalues, up to this index.
_LONG_BEAMS, _LONG_POINTS, _LONG_INDEX = 64, 128, 3.9
# The same for wide strips, with an outer scale of so many beams too, and steps of this fraction of one or more.
_WIDE_INDEX, _WIDE_STEP = 3.7, 1 / 32


def check_strip(strips: StripCache, length_rad: float) -> int:
    """Check that strips for tracks up to a length can be built.

    Strips have a power of two of points; where a strip is too smooth for its length, the next power is used. If the
    longest strip can be built, so can shorter ones. The exception is strips with more points than the next power
    allows; the longest of these is tried as well.

    Parameters
    ----------
    strips
    length_rad
        Longest track.

    Returns
    -------
    int
        Elements of the covariance matrices of all frequencies, or points of a wide strip.

    Raises
    ------
    ValueError
        Where a strip can't be built.
    """
    n_lane, step, n_x = strips.n_lane, strips.step_rad, check_size(strips, length_rad)
    if strips.factorize is factorize_wide:
        if not _is_surely_wide(strips, n_x):
            strips.strip_for(length_rad)
        return n_x * n_lane
    used = _used(strips.screen, n_x, n_lane, step)
    check_elements(used, n_x, n_lane, step)
    sizes = [] if _is_surely_built(strips, n_x) else sorted({n_x, min(n_x, N_X_MAX)})
    for size in sizes:
        _try(strips.screen, n_x=size, n_lane=n_lane, step_rad=step, used=used, precision=strips.precision)
    return used * n_lane**2


def check_size(strips: StripCache, length_rad: float) -> int:
    """Count the points along a strip for tracks up to a length; raises ValueError for strips too large to hold."""
    n_x = points_along(length_rad, strips.step_rad)
    check = check_wide if strips.factorize is factorize_wide else check_points
    check(n_x, strips.n_lane, strips.step_rad, strips.screen)
    return n_x


def _is_surely_built(strips: StripCache, n_x: int) -> bool:
    """Return whether strips of `n_x` points can be built, as so many doublings make them long."""
    n_lane, step, beam = strips.n_lane, strips.step_rad, strips.screen.beam_rad
    n_long = max(n_x, _LONG_POINTS, 2 ** ceil(log2(_LONG_BEAMS * beam / step)))
    if n_long > N_X_MAX or strips.screen.index > _LONG_INDEX:
        return False
    try:
        check_points(n_long, n_lane, step, strips.screen)
        check_elements(n_long // 2 + 1, n_long, n_lane, step)
    except OutOfRangeError:
        return False
    return True


def _is_surely_wide(strips: StripCache, n_x: int) -> bool:
    """Return whether wide strips of `n_x` points can be built without doubling."""
    screen, step = strips.screen, strips.step_rad
    beams = min(n_x * step, screen.outer_scale_rad) / screen.beam_rad
    return beams >= _LONG_BEAMS and step >= _WIDE_STEP * screen.beam_rad and screen.index <= _WIDE_INDEX


@lru_cache(maxsize=32)  # points of a sweep have similar layers
def _used(screen: Screen, n_x: int, n_lane: int, step_rad: float) -> int:
    """Count the frequencies whose matrices are built; all, where these are few."""
    if _work(n_x // 2 + 1, n_lane) <= _MOST_WORK:
        return n_x // 2 + 1
    return used_modes(screen, lane_spectra(screen, n_x, n_lane, step_rad)[1], n_x, step_rad)


@lru_cache(maxsize=32)
def _try(screen: Screen, *, n_x: int, n_lane: int, step_rad: float, used: int, precision: str) -> None:
    """Build a strip, or its first few lanes where the eigenvectors of all would take long.

    If those are too smooth, so is the whole: the matrices of a few lanes are submatrices of the full ones, so their
    eigenvalues are bounded by the smallest of these (Cauchy interlacing).
    """
    lanes = n_lane
    while lanes > _FEWEST_LANES and _work(used, lanes) > _MOST_WORK:
        lanes = max(_FEWEST_LANES, ceil(lanes / 2))
    build_strip(
        screen,
        length_rad=longest_track(n_x, step_rad),
        half_width_rad=0.5 * (lanes - 1) * step_rad,
        step_rad=step_rad,
        precision=precision,
        fewest_lanes=lanes,
    )


def _work(used: int, lanes: int) -> int:
    # Small matrices take as long as those of a dozen lanes.
    return used * lanes**2 * max(lanes, 12)
