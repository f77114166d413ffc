"""Focal planes: detectors of layouts, wafers and tables, and masked detectors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from mapmaker.timestreams import FocalPlane
from surveysim.runtime.errors import SceneError
from surveysim.scene.instrument import Instrument as InstrumentSection
from surveysim.scene.passband import Passband
from surveysim.telescope.detector_properties import (
    DetectorCounts,
    DetectorProperties,
    only_beams,
    table_counts,
    table_properties,
)
from surveysim.telescope.illumination import (
    UNIFORM,
    GaussianIllumination,
    He11Illumination,
    Illumination,
    TableIllumination,
    gaussian_horn,
)
from surveysim.telescope.layouts import Lattice, placed_wafers

MAX_BEAMS = 8  # different beams of a camera: each takes a sky of its own
MAX_PLACES = 1000
_OBLIQUE = np.array([np.cos(1.0), np.sin(1.0)])


@dataclass(frozen=True)
class Camera:
    """Focal plane in the array frame, and the optics that couple its detectors.

    Attributes
    ----------
    focal_plane
        Positions of the detectors.
    f_lambda_rad
        One (f/#)lambda on the sky.
    illumination
        Beam of each pixel over the stop.
    lattices
        Lattice of each wafer, whose detectors follow those of the one before; none for a table of positions.
    properties
        Properties in which the detectors differ.
    counts
        Numbers of detectors; None for a camera of no scene.
    band
        Passband of the detectors; None for a single frequency.
    polarizations
        Polarizations that a detector absorbs; None where the scene does not say.
    """

    focal_plane: FocalPlane
    f_lambda_rad: float
    illumination: Illumination = UNIFORM
    lattices: tuple[Lattice, ...] = ()
    properties: DetectorProperties = DetectorProperties()
    counts: DetectorCounts | None = None
    band: Passband | None = None
    polarizations: int | None = None

    @property
    def n_det(self) -> int:
        """Number of live detectors."""
        return len(self.focal_plane.x_rad)

    @property
    def positions_f_lambda(self) -> np.ndarray:
        """Positions (n_det, 2) in (f/#)lambda."""
        return np.column_stack([self.focal_plane.x_rad, self.focal_plane.y_rad]) / self.f_lambda_rad

    @property
    def polarization_angle_rad(self) -> np.ndarray | None:
        """Angles (n_det,) of detectors that absorb one polarization; None where they have none, or absorb both."""
        return None if self.polarizations == 2 else self.focal_plane.angle_rad

    @property
    def lattice(self) -> Lattice | None:
        """The one lattice of all detectors; None for several wafers and tables."""
        return self.lattices[0] if len(self.lattices) == 1 else None

    @property
    def gap_f_lambda(self) -> float:
        """Distance of the closest detectors of two different wafers in (f/#)lambda; infinite for one."""
        if len(self.lattices) < 2:
            return math.inf
        from scipy.spatial import cKDTree

        ends = np.cumsum([len(lattice.cells) for lattice in self.lattices])[:-1]
        wafers = np.split(self.positions_f_lambda, ends)
        pairs = [(one, other) for number, one in enumerate(wafers) for other in wafers[:number]]
        return min(float(cKDTree(one).query(other)[0].min()) for one, other in pairs)

    @property
    def radius_rad(self) -> float:
        """Distance of the outermost detector from the centre."""
        return float(np.hypot(self.focal_plane.x_rad, self.focal_plane.y_rad).max())

    @cached_property
    def closest_rad(self) -> float:
        """Separation of the closest pair of positions; 0 for a single one."""
        positions = np.unique(np.column_stack([self.focal_plane.x_rad, self.focal_plane.y_rad]), axis=0)
        return closest_pair(positions)[0] if len(positions) > 1 else 0.0


@dataclass(frozen=True)
class CameraExtent:
    """Extent of the focal planes of all bands of a camera.

    Attributes
    ----------
    focal_plane
        Detectors of all bands; those of a camera of one band have no copy.
    radius_rad
        Distance of the outermost detector from the centre.
    closest_rad
        Separation of the closest pair of detectors of one band; 0 for single ones.
    """

    focal_plane: FocalPlane
    radius_rad: float
    closest_rad: float


def camera_extent(bands: Sequence[Camera]) -> CameraExtent:
    """Find the extent of the bands of a camera; it does not depend on their order."""
    radius, closest = max(band.radius_rad for band in bands), min(band.closest_rad for band in bands)
    if len(bands) == 1:
        return CameraExtent(bands[0].focal_plane, radius, closest)
    x, y = (np.concatenate([getattr(band.focal_plane, axis) for band in bands]) for axis in ("x_rad", "y_rad"))
    return CameraExtent(FocalPlane(x, y, bands[0].focal_plane.fwhm_rad), radius, closest)


def camera(section: InstrumentSection, seed: int) -> Camera:
    """Make the camera of a scene, without dead positions.

    Parameters
    ----------
    seed
        Seed of the scene, which chooses the dead detectors of a random yield.

    Raises
    ------
    ValueError
        For a dead position outside the layout, no live detector, two detectors at one position, horns that overlap
        their neighbours, too many different beams, or an unreadable table.
    """
    cam = _lattice_camera(section, seed) if section.positions is None else _table_camera(section)
    closest = cam.closest_rad / section.f_lambda_rad
    if section.horn_f_lambda is not None and 0 < closest < section.horn_f_lambda * (1 - 1e-9):
        raise SceneError(
            f"instrument.horn_f_lambda: found {section.horn_f_lambda:g}; {closest:.4g}, the closest pair's distance in "
            "(f/#)lambda, or less is expected"
        )
    return cam


def _lattice_camera(section: InstrumentSection, seed: int) -> Camera:
    wafers = placed_wafers(section, seed)
    positions = np.concatenate([wafer.positions_rad for wafer in wafers])
    check_distinct(positions)
    plane = FocalPlane(positions[:, 0].copy(), positions[:, 1].copy(), section.beam_fwhm_rad)
    total = sum(wafer.n_positions for wafer in wafers)
    of_wafers = tuple((len(wafer.positions_rad), wafer.n_positions) for wafer in wafers) if section.wafers else ()
    return Camera(
        plane,
        section.f_lambda_rad,
        illumination(section),
        tuple(wafer.lattice for wafer in wafers),
        counts=DetectorCounts(total, total - len(positions), wafers=of_wafers),
        band=section.band,
        polarizations=section.polarizations,
    )


def _table_camera(section: InstrumentSection) -> Camera:
    table = section.table
    rows = table.band_rows(section.table_band) & table.live
    x, y = table.positions_rad[rows].T
    angle, names = (table.columns[key][rows] if key in table.columns else None for key in ("angle", "name"))
    properties = table_properties(table, rows)
    only_beams(section, properties, MAX_BEAMS)
    check_distinct(np.unique(np.column_stack([x, y]), axis=0))  # detectors of a pair have angles of their own
    return Camera(
        FocalPlane(x.copy(), y.copy(), section.beam_fwhm_rad, angle, names),
        section.f_lambda_rad,
        illumination(section),
        properties=properties,
        counts=table_counts(table, section),
        band=section.band,
        polarizations=section.polarizations,
    )


def illumination(section: InstrumentSection) -> Illumination:
    """Make the beam of a pixel over the stop: from the table of the scene, its horns or its edge taper, or uniform."""
    if isinstance(section.illumination, Path):
        return TableIllumination(*section.illumination_table)
    if section.horn_f_lambda is not None:
        horn = He11Illumination if section.illumination == "he11" else gaussian_horn
        return horn(section.horn_f_lambda)
    return GaussianIllumination(section.edge_taper_db or 0.0)


def total_efficiency(section: InstrumentSection) -> float:
    """Compute the efficiency from window to detector, with the spillover of the beam; needs an `efficiency`."""
    return section.efficiency * illumination(section).efficiency


def stop_share(section: InstrumentSection, frequency_hz: np.ndarray) -> np.ndarray:
    """Compute the part (n,) of a pixel's beam that passes the stop at frequencies (n,) [Hz].

    The scene tells the illumination at the centre of the band.
    """
    beam = illumination(section)
    return np.array([beam.at(ratio).efficiency for ratio in (frequency_hz / section.band.centre_hz).tolist()])


def check_distinct(positions: np.ndarray) -> None:
    """Raise an error if two detectors have the same position (within 1e-6 of the extent)."""
    if len(positions) < 2:
        return
    distance, first, second = closest_pair(positions)
    if distance <= 1e-6 * float(np.ptp(positions, axis=0).max()):
        raise SceneError(
            f"instrument: detectors {first} and {second} have one position; different positions are expected"
        )


def closest_pair(positions: np.ndarray) -> tuple[float, int, int]:
    """Find the closest pair of (n, 2) positions, n of 2 or more: its distance, and its indices in increasing order.

    The positions are sorted along a line that is perpendicular to no axis of regular layouts. Pairs k places apart in
    this order are at least as far apart as along the line, so few k are enough.
    """
    # A k-d tree would do, but its import takes longer than the start of a small run.
    along = positions @ _OBLIQUE
    order = np.argsort(along, kind="stable")
    closest = (np.inf, 0, 0)
    for places in range(1, len(order)):
        first, second = order[:-places], order[places:]
        if (along[second] - along[first]).min() >= closest[0]:
            break
        if places > MAX_PLACES:  # positions of a table may lie on a line that is square to that one
            return _closest_pair_of_tree(positions)
        squared = ((positions[second] - positions[first]) ** 2).sum(axis=1)
        nearest = int(np.argmin(squared))
        distance = float(np.sqrt(squared[nearest]))
        if distance < closest[0]:
            pair = int(first[nearest]), int(second[nearest])
            closest = distance, min(pair), max(pair)
    return closest


def _closest_pair_of_tree(positions: np.ndarray) -> tuple[float, int, int]:
    from scipy.spatial import cKDTree

    distance, neighbour = cKDTree(positions).query(positions, k=2)
    first = int(np.argmin(distance[:, 1]))
    # With a twin at the same place either may come first.
    second = int(next(index for index in neighbour[first] if index != first))
    return float(distance[first, 1]), min(first, second), max(first, second)


def mask_by_separation(positions: np.ndarray, separation: float) -> np.ndarray:
    """Select detectors that are all at least `separation` apart (mask of section 5.2).

    Chosen greedily from the centre outwards, ties by angle. On a hexagonal layout this keeps every second position in
    both axes for separations between sqrt(3) and 2 pitches.
    """
    x, y = positions.T
    order = np.lexsort((np.round(np.arctan2(y, x), 9), np.round(np.hypot(x, y) / separation, 9)))
    # Only detectors in neighbouring squares of this side can be too close: others are not compared.
    squares = np.floor(positions / separation).astype(int).tolist()
    kept: dict[tuple[int, int], list[list[float]]] = {}
    found = []
    for index, place in zip(order.tolist(), positions[order].tolist(), strict=True):
        column, row = squares[index]
        near = (kept.get((column + i, row + j), ()) for i in (-1, 0, 1) for j in (-1, 0, 1))
        if all(math.dist(place, other) >= separation * (1 - 1e-9) for square in near for other in square):
            kept.setdefault((column, row), []).append(place)
            found.append(index)
    return np.array(sorted(found))
