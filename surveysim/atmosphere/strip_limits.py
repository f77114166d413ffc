"""Whether strips of the layer can be made, foreseen before any is drawn, by the rules that make them."""

from functools import lru_cache
from math import ceil

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

# Operations of eigenvectors that take a second at most, and the fewest lanes that tell rough from smooth.
_MOST_WORK, _FEWEST_LANES = 1e8, 4


def check_strip(strips: StripCache, length_rad: float) -> int:
    """Raise ValueError where a strip for tracks up to `length_rad` long, or shorter ones, can't be made.

    Gives back the size of all frequencies' matrices, in elements. Strips come in powers of two of points, and one that
    is too smooth for its length takes the next: where the longest can be made, so can shorter ones, but for those of
    more points than that goes up to, of which the longest is tried too.
    """
    n_lane, step = strips.n_lane, strips.step_rad
    n_x = points_along(length_rad, step)
    check_points(n_x, n_lane, step, strips.screen)
    used = _used(strips.screen, n_x, n_lane, step)
    check_elements(used, n_x, n_lane, step)
    for size in sorted({n_x, min(n_x, N_X_MAX)}):
        _try(strips.screen, size, n_lane, step, used, strips.precision)
    return used * n_lane**2


@lru_cache(maxsize=32)  # points of a sweep have layers alike
def _used(screen: Screen, n_x: int, n_lane: int, step_rad: float) -> int:
    """Frequencies whose matrices are made, or all where these are few."""
    if _work(n_x // 2 + 1, n_lane) <= _MOST_WORK:
        return n_x // 2 + 1
    return used_modes(screen, lane_spectra(screen, n_x, n_lane, step_rad)[1], n_x, step_rad)


@lru_cache(maxsize=32)
def _try(screen: Screen, n_x: int, n_lane: int, step_rad: float, used: int, precision: str) -> None:
    """Make a strip, or where its eigenvectors take long one of its first few lanes alone.

    If those are too smooth, so is the whole: matrices of a few lanes lie within those of all, and no eigenvalue of
    theirs is less than the least of these (Cauchy).
    """
    lanes = n_lane
    while lanes > _FEWEST_LANES and _work(used, lanes) > _MOST_WORK:
        lanes = max(_FEWEST_LANES, ceil(lanes / 2))
    build_strip(screen, longest_track(n_x, step_rad), 0.5 * (lanes - 1) * step_rad, step_rad, precision, lanes)


def _work(used: int, lanes: int) -> int:
    # Small matrices take no less time each than those of some dozen lanes.
    return used * lanes**2 * max(lanes, 12)
