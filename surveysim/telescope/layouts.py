"""Positions of detectors on the lattices of wafers: hexagons, round fields of view, squares and rhombi."""

from dataclasses import dataclass

import numpy as np

from surveysim.runtime.errors import SceneError
from surveysim.runtime.rng import generator
from surveysim.scene.instrument import Instrument, Layout, Wafer

MAX_RINGS = 60
YIELD = "yield"  # name of the random purpose
HEXAGONAL, SQUARE = 0.5, 0.0  # cosines between the axes of lattices


@dataclass(frozen=True, eq=False)
class Lattice:
    """Live detectors of one wafer on its lattice.

    Attributes
    ----------
    cells : (n_det, 2)
        Integer coordinates along the two axes.
    pitch_rad
        Distance between neighbouring cells.
    cosine
        Cosine of the angle between the axes: 1/2 for a hexagonal lattice, 0 for a square one.
    """

    cells: np.ndarray
    pitch_rad: float
    cosine: float

    @property
    def positions_rad(self) -> np.ndarray:
        """Positions (n_det, 2) from the cell (0, 0), the first axis along x."""
        q, r = self.cells.T
        return self.pitch_rad * np.column_stack([q + self.cosine * r, np.sqrt(1 - self.cosine**2) * r])


@dataclass(frozen=True, eq=False)
class PlacedWafer:
    """Live detectors of one wafer in the array frame.

    Attributes
    ----------
    positions_rad : (n_det, 2)
    lattice
    n_positions
        Number of positions, dead ones included.
    """

    positions_rad: np.ndarray
    lattice: Lattice
    n_positions: int


def placed_wafers(section: Instrument, seed: int) -> tuple[PlacedWafer, ...]:
    """Place the layout or the wafers of an instrument, without dead positions.

    Raises
    ------
    SceneError
        For a dead position outside its layout, a wafer without a live detector, and a field of view of too many rings.
    """
    if section.layout is not None:
        return (_placed(section.layout, "instrument.layout", section.f_lambda_rad, seed, 0),)
    return tuple(
        _placed(wafer, f"instrument.wafers.{number}", section.f_lambda_rad, seed, number)
        for number, wafer in enumerate(section.wafers)
    )


def _placed(layout: Layout | Wafer, key: str, f_lambda_rad: float, seed: int, number: int) -> PlacedWafer:
    pitch = layout.pitch_f_lambda * f_lambda_rad
    cells, positions = _all_positions(layout, key, pitch)
    live = _live(layout, key, len(positions), seed, number)
    positions, cells = positions[live], cells[live]
    if isinstance(layout, Wafer):
        cos, sin = np.cos(layout.rotation_rad), np.sin(layout.rotation_rad)
        positions = positions @ np.array([[cos, sin], [-sin, cos]]) + [layout.offset_x_rad, layout.offset_y_rad]
    return PlacedWafer(positions, Lattice(cells, pitch, SQUARE if layout.shape == "square" else HEXAGONAL), len(live))


def _live(layout: Layout | Wafer, key: str, n: int, seed: int, number: int) -> np.ndarray:
    """Flag the live positions (n,): neither in the list of dead ones nor lost at random."""
    live = alive(n, layout.dead, f"{key}.dead")
    count = round(layout.yield_fraction * np.count_nonzero(live))
    if count == 0:
        raise SceneError(f"{key}.yield: found {layout.yield_fraction:g}, no detector of {n}; a live one is expected")
    order = generator(seed, YIELD, realization=number).permutation(np.flatnonzero(live))
    live[order[count:]] = False
    return live


def alive(n: int, dead: tuple[int, ...], key: str) -> np.ndarray:
    """Flag the positions (n,) that are not dead; raises SceneError for one that does not exist or appears twice."""
    if any(not 0 <= index < n for index in dead) or len(set(dead)) != len(dead):
        raise SceneError(f"{key}: found {list(dead)}; different numbers from 0 to {n - 1} are expected")
    if len(dead) == n:
        raise SceneError(f"{key}: found all {len(dead)} positions; one live detector is expected")
    live = np.ones(n, bool)
    live[list(dead)] = False
    return live


def _all_positions(layout: Layout | Wafer, key: str, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Cells and positions (n, 2) [rad] of a layout about its centre, dead ones included.

    A round field of view holds as many pixels as its area holds cells, those nearest to its centre. Counting pixels
    with centres inside would make the number jump by a fifth as the pitch changes.
    """
    if layout.side is not None:
        return _grid(layout.side, pitch, SQUARE if layout.shape == "square" else HEXAGONAL)
    if layout.rings is not None:
        return hexagon_cells(layout.rings, pitch)
    radius = layout.field_of_view_rad / 2
    # Pixels of that area lie within its radius and a pitch; a ring of the hexagon is at least 0.87 pitches further out.
    rings = int((radius + pitch) / (np.sqrt(0.75) * pitch)) + 1
    if rings > MAX_RINGS:
        raise SceneError(f"{key}.field_of_view: found {rings} rings in it; {MAX_RINGS} or fewer are expected")
    count = max(1, round(np.pi * radius**2 / (np.sqrt(0.75) * pitch**2)))
    cells, positions = hexagon_cells(rings, pitch)
    return cells[:count], positions[:count]


def hexagon(rings: int, pitch: float) -> np.ndarray:
    """Positions (3 n (n+1) + 1, 2) of `rings` rings around a centre, in the unit of `pitch`.

    Ordered by distance from the centre, then by angle: 127 positions for six rings.
    """
    return hexagon_cells(rings, pitch)[1]


def hexagon_cells(rings: int, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Cells (n, 2) of a hexagonal lattice, along axes 60 degrees apart, and positions (n, 2) as `hexagon`."""
    q, r = np.meshgrid(np.arange(-rings, rings + 1), np.arange(-rings, rings + 1), indexing="ij")
    inside = np.abs(q + r) <= rings
    return _ordered(np.column_stack([q[inside], r[inside]]), pitch, HEXAGONAL)


def _grid(side: int, pitch: float, cosine: float) -> tuple[np.ndarray, np.ndarray]:
    """Cells and positions of `side` times `side` detectors about their centre: a square or a rhombus."""
    q, r = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    return _ordered(np.column_stack([q.ravel(), r.ravel()]), pitch, cosine)


def _ordered(cells: np.ndarray, pitch: float, cosine: float) -> tuple[np.ndarray, np.ndarray]:
    """Sort cells by the distance of their positions from the centre, then by angle."""
    q, r = (cells - cells.mean(axis=0)).T
    x, y = q + cosine * r, np.sqrt(1 - cosine**2) * r
    order = np.lexsort((np.round(np.arctan2(y, x), 9), np.round(np.hypot(x, y), 9)))
    return cells[order], pitch * np.column_stack([x, y])[order]
