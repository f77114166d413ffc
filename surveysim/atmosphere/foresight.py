"""Whether strips of the layer can be made, foreseen before any is drawn, by the rules that make them."""

from math import ceil

from surveysim.atmosphere.factors import (
    build_strip,
    check_elements,
    check_points,
    lane_spectra,
    points_along,
    used_modes,
)
from surveysim.atmosphere.screen import StripCache

# Operations of eigenvectors that take some hundred milliseconds, and the fewest lanes that tell rough from smooth.
_MOST_WORK, _FEWEST_LANES = 1e7, 4


def check_strip(strips: StripCache, length_rad: float) -> int:
    """Raise ValueError as `build_strip` where it would for tracks up to `length_rad` long; give back the strip's size.

    The size is that of all frequencies' matrices, in elements. Where the eigenvectors take long, those of the first few
    lanes stand for them: what a strip lacks in smoothness it lacks along its length.
    """
    n_lane, step = strips.n_lane, strips.step_rad
    n_x = points_along(length_rad, step)
    check_points(n_x, n_lane, step, strips.screen)
    used = n_x // 2 + 1
    if used * n_lane**2 > _MOST_WORK / n_lane:
        used = used_modes(strips.screen, lane_spectra(strips.screen, n_x, n_lane, step)[1], n_x, step)
        check_elements(used, n_x, n_lane, step)
    lanes = n_lane
    while lanes > _FEWEST_LANES and used * lanes**3 > _MOST_WORK:
        lanes = max(_FEWEST_LANES, ceil(lanes / 2))
    build_strip(strips.screen, length_rad, 0.5 * (lanes - 1) * step, step, strips.precision, lanes)
    return used * n_lane**2
