"""Low-order trends of the layer, drawn jointly for all scans of an observation.

For a steep spectrum a scan is nearly a straight line whose slope resembles that of the scan before: most of it comes
from scales far above a scan's. Strips (`surveysim.atmosphere.screen_simulation`) are drawn independently for each scan.
Four trends are therefore defined for every scan, contrasts t = w T between the values T of the field at 5 x 3 points of
its strip: slope along, gradient across, curvature along, and the product of both coordinates. (Neighbouring scans share
1e-3 of the curvature across.) Their covariance follows from the structure function D between the points of all scans,
in one frame of the layer,

    C_st = -1/2 w_s D(r_s - r_t) w_t^T,

and one draw gives the trends t of all scans. Each strip is conditioned on its trends (kriging),

    T -> T + K C^-1 (t - w T),

with C the covariance of the strip's trends and K that of the field with them. Since w T and t have the same
distribution, the distribution of a strip is unchanged, and the joint distribution of the trends is that of the layer.
Smaller scales of different scans are independent. The mean of a scan is unchanged: every cleaning removes it.

Covariances are exact within a group of nine scans and between neighbouring groups. In longer observations a group is
drawn given the one before, so the time is proportional to the number of scans.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from surveysim.atmosphere import trend_kernels as kernels
from surveysim.atmosphere.screen_simulation import StripCache
from surveysim.atmosphere.thin_screen import Screen, structure_table
from surveysim.runtime.rng import NormalDeviates

# Gauss-Legendre nodes of the points along a strip, from -1 to 1; across it they are at both edges and in the middle.
# Slopes of scans of 4 to 17 beams correlate as those of all their samples within 0.001 at b = 11/3.
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(5)
_GROUP = 9
# Steps, in beams, of the grid that a strip's change is interpolated on (cubic). It is as smooth as the structure
# function, which has a term in r^(b + 1). Trends are imposed to 1 % of their standard deviation, 10 % at b = 2/3.
_COARSE, _COARSE_ROUGH = 1.0 / 3.0, 1.0 / 12.0


@dataclass(frozen=True)
class StripPoints:
    """Points of the strips of n_scan scans, and the trends of the field at them.

    Attributes
    ----------
    screen
    step_rad
        Lattice step.
    lane, column : (n_scan, 15)
        Lattice points.
    place_rad : (n_scan, 15, 2)
        Their positions in the layer.
    weight : (n_scan, 4, 15)
        Weights of the field's values in each trend.
    used : (n_scan,)
        Columns that detectors see.
    """

    screen: Screen
    step_rad: float
    lane: np.ndarray
    column: np.ndarray
    place_rad: np.ndarray
    weight: np.ndarray
    used: np.ndarray

    def scans(self, first: int, end: int) -> "StripPoints":
        """Select scans `first` to `end - 1`."""
        names = ("lane", "column", "place_rad", "weight", "used")
        return replace(self, **{name: getattr(self, name)[first:end] for name in names})


def strip_points(
    strips: StripCache, corner_rad: np.ndarray, direction: np.ndarray, length_rad: np.ndarray
) -> StripPoints:
    """Choose the points of strips that define the trends.

    Parameters
    ----------
    strips : StripCache
    corner_rad : (n_scan, 2)
        First point of each strip in the layer.
    direction : (n_scan, 2)
        Unit vectors along the strips.
    length_rad : (n_scan,)
        Length of the strips that detectors see.
    """
    end = length_rad / strips.step_rad
    column = np.repeat(np.rint(np.outer(end, 0.5 * (_NODES + 1.0))).astype(np.int64), 3, axis=1)
    last = strips.n_lane - 1
    lane = np.tile([0, last // 2, last], (len(end), 5))
    x, y = 2.0 * column / np.maximum(end, 1.0)[:, None] - 1.0, 2.0 * lane / last - 1.0
    share = np.repeat(_NODE_WEIGHTS, 3) / (3.0 * _NODE_WEIGHTS.sum())
    weight = np.stack([x, y, 1.5 * x**2 - 0.5, x * y], axis=1) * share
    weight -= weight.sum(axis=-1, keepdims=True) * share
    weight[np.abs(weight).max(axis=-1) < 1e-9] = 0.0  # coincident points, except for rounding
    across = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    place = corner_rad[:, None] + strips.step_rad * (
        column[..., None] * direction[:, None] + lane[..., None] * across[:, None]
    )
    return StripPoints(strips.screen, strips.step_rad, lane, column, place, weight, np.ceil(end).astype(np.int64) + 4)


@dataclass(frozen=True)
class ScanTrends:
    """Trends that the strips of some scans are conditioned on, per unit amplitude.

    Attributes
    ----------
    points
    value : (n_scan, 4)
        Trends t.
    table
        `structure_table` of the screen.
    """

    points: StripPoints
    value: np.ndarray
    table: tuple[np.ndarray, np.ndarray]

    def scans(self, first: int, end: int) -> "ScanTrends":
        """Select scans `first` to `end - 1`."""
        return replace(self, value=self.value[first:end], points=self.points.scans(first, end))

    def impose(self, scans: Sequence[int], strips: np.ndarray) -> None:
        """Condition strips on the trends of some scans, in place.

        Parameters
        ----------
        scans
        strips : (n_scan, n_lane, n_x)
            Realizations of unit amplitude.

        Raises
        ------
        ValueError
            For strips that lack one of their scan's points.
        """
        item, (_, n_lane, n_x) = self.points, strips.shape
        some = np.array(scans)
        lane, column, step = item.lane[some], item.column[some], item.step_rad
        if not (lane.min() >= 0 and lane.max() < n_lane and column.min() >= 0 and column.max() < n_x):
            raise ValueError(
                f"found strips of {(n_lane, n_x)}; {lane.max() + 1} by {column.max() + 1} or more are expected"
            )
        coarse = (_COARSE if item.screen.index >= 3.0 else _COARSE_ROUGH) * item.screen.beam_rad / step
        stride, cells = max(1, int(coarse)), max(1, ceil((n_lane - 1) / coarse))
        points = lane, column, item.place_rad[some], item.weight[some], np.minimum(item.used[some], n_x)
        kernels.impose_trends(strips, self.value[some], *points, step, stride, cells, *self.table)


def draw_trends(item: StripPoints, deviates: NormalDeviates) -> ScanTrends:
    """Draw the trends of consecutive scans, four normals a scan."""
    normals, table = deviates.draw(item.weight.shape[:2], dtype=np.float64), structure_table(item.screen)
    return ScanTrends(item, kernels.draw_trends(item.place_rad, item.weight, normals, _GROUP, *table), table)
