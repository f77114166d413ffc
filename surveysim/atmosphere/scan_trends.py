"""Low-order trends of the layer, drawn jointly for all scans of an observation.

Where the spectrum is steep, a scan is hardly more than a straight line, and its slope is much that of the scan before:
the air is another, but most of the slope comes from scales far above a scan's. Strips
(`surveysim.atmosphere.screen_simulation`) are drawn scan by scan and know nothing of each other. So for every scan four
trends are defined, contrasts between the field's values at 5 x 3 lattice points of its strip: slope along, gradient
across, curvature along, and the product of both places. (Neighbouring scans share a thousandth of the curvature
across.) Their covariance over all scans follows from the structure function between the points, in one frame of the
layer, and one draw gives all scans' trends t. A strip T is then conditioned on its own (kriging),

    T + K C^-1 (t - w T),

with w T the trends that it was drawn with, C their covariance and K that of the field with them. Since w T and t have
one distribution, the strip's own stays exactly as it was, and the trends' joint distribution is that of the layer. The
smaller scales of different scans are independent. The mean of a scan is left as it is: every cleaning removes it.

Covariances are exact within a group of nine scans and between neighbouring groups; of longer observations, a group is
drawn given the one before, so that the time it takes goes with the number of scans.
"""

from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from surveysim.atmosphere import trend_kernels as kernels
from surveysim.atmosphere.screen_simulation import StripCache
from surveysim.atmosphere.thin_screen import Screen, structure_table

# Of the points along a strip, over its length from -1 to 1 (Gauss and Legendre); across it they are at both edges and
# in the middle. Slopes of scans of 4 to 17 beams correlate as those of all their samples within 0.001 at b = 11/3.
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(5)
_GROUP = 9
# Steps, in beams, of the grid between which a strip's change is cubic: it is as smooth as the structure function, which
# has a term in r^(b + 1). Trends are then given to 1 % of their standard deviation, to 10 % at b = 2/3.
_COARSE, _COARSE_ROUGH = 1.0 / 3.0, 1.0 / 12.0


@dataclass(frozen=True)
class Swaths:
    """Points of the strips of n_scan scans, lattices of `step_rad`, and the trends that the field has there.

    `lane`, `column` (n_scan, 15): lattice points; `place_rad` (n_scan, 15, 2): their places in the layer; `weight`
    (n_scan, 4, 15): weights of the field's values in each trend; `used` (n_scan,): columns that detectors see.
    """

    screen: Screen
    step_rad: float
    lane: np.ndarray
    column: np.ndarray
    place_rad: np.ndarray
    weight: np.ndarray
    used: np.ndarray

    def scans(self, first: int, end: int) -> "Swaths":
        """Those of scans `first` to `end - 1`, counted from 0 again."""
        names = ("lane", "column", "place_rad", "weight", "used")
        return replace(self, **{name: getattr(self, name)[first:end] for name in names})


def swaths(strips: StripCache, corner_rad: np.ndarray, direction: np.ndarray, length_rad: np.ndarray) -> Swaths:
    """Points of the strips of a `StripCache` that lie in the layer from a corner (n_scan, 2) on.

    `direction` (n_scan, 2), unit vectors along the strips, of which detectors see `length_rad` (n_scan,).
    """
    end = length_rad / strips.step_rad
    column = np.repeat(np.rint(np.outer(end, 0.5 * (_NODES + 1.0))).astype(np.int64), 3, axis=1)
    last = strips.n_lane - 1
    lane = np.tile([0, last // 2, last], (len(end), 5))
    x, y = 2.0 * column / np.maximum(end, 1.0)[:, None] - 1.0, 2.0 * lane / last - 1.0
    share = np.repeat(_NODE_WEIGHTS, 3) / (3.0 * _NODE_WEIGHTS.sum())
    weight = np.stack([x, y, 1.5 * x**2 - 0.5, x * y], axis=1) * share
    weight -= weight.sum(axis=-1, keepdims=True) * share
    weight[np.abs(weight).max(axis=-1) < 1e-9] = 0.0  # points that are one, but for rounding
    across = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    place = corner_rad[:, None] + strips.step_rad * (
        column[..., None] * direction[:, None] + lane[..., None] * across[:, None]
    )
    return Swaths(strips.screen, strips.step_rad, lane, column, place, weight, np.ceil(end).astype(np.int64) + 4)


@dataclass(frozen=True)
class Trends:
    """Trends (n_scan, 4) that the strips of some scans are to have, per unit amplitude.

    `table` is the `structure_table` of the screen.
    """

    swaths: Swaths
    value: np.ndarray
    table: tuple[np.ndarray, np.ndarray]

    def scans(self, first: int, end: int) -> "Trends":
        """Those of scans `first` to `end - 1`, counted from 0 again."""
        return replace(self, value=self.value[first:end], swaths=self.swaths.scans(first, end))

    def impose(self, scan: int, strip: np.ndarray) -> None:
        """Give a strip (n_lane, n_x) of unit amplitude the trends of a scan, in place.

        Raises ValueError for a strip that lacks one of the scan's points.
        """
        item = self.swaths
        lane, column, step = item.lane[scan], item.column[scan], item.step_rad
        if not (lane.min() >= 0 and lane.max() < len(strip) and column.min() >= 0 and column.max() < strip.shape[1]):
            raise ValueError(
                f"found a strip of {strip.shape}; {lane.max() + 1} by {column.max() + 1} or more is expected"
            )
        weight = kernels.point_weights(
            strip, lane, column, item.place_rad[scan], item.weight[scan], self.value[scan], *self.table
        )
        coarse = (_COARSE if item.screen.index >= 3.0 else _COARSE_ROUGH) * item.screen.beam_rad / step
        stride, cells = max(1, int(coarse)), max(1, ceil((len(strip) - 1) / coarse))
        used = min(int(item.used[scan]), strip.shape[1])
        kernels.add_covariances(strip, used, lane, column, weight, step, stride, cells, *self.table)


def draw_trends(item: Swaths, rng: np.random.Generator) -> Trends:
    """Trends of consecutive scans, from one draw of four normals a scan."""
    normals, table = rng.standard_normal(item.weight.shape[:2]), structure_table(item.screen)
    return Trends(item, kernels.draw_trends(item.place_rad, item.weight, normals, _GROUP, *table), table)
