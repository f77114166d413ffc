"""Splits of a survey into parts: which observation, scan and detector belongs to which part.

Parts of the split by night are whole nights, or single observations without dates, dealt out in turn. Turns rotate:
with an even number of parts one part would otherwise have all scans along right ascension. The rule does not depend on
the length of a survey. The halves of the array are interleaved: cleaning acts alike on both, whereas it takes other
modes of the sky from one side of the array than from the other.
"""

from dataclasses import dataclass

import numpy as np

from mapmaker.geometry import MapGeometry
from mapmaker.timestreams import FocalPlane
from surveysim.reduction.scored_region import padded_side
from surveysim.runtime.errors import SceneError
from surveysim.runtime.numbers import plural
from surveysim.scene.scene import Scene
from surveysim.scene.spectra import ARRAY, DIRECTION, FEWEST_OBSERVATIONS, NIGHT

_ROW_RAD = 1e-9  # detectors at y within so little are in one row
_HALVES = {DIRECTION: ("there", "back"), ARRAY: ("even", "odd")}


@dataclass(frozen=True)
class Split:
    """A split of the data into parts, whose maps are `maps` among all split maps."""

    name: str
    parts: tuple[str, ...]
    first: int

    @property
    def maps(self) -> slice:
        """Places of the maps of its parts."""
        return slice(self.first, self.first + len(self.parts))


@dataclass(frozen=True, eq=False)
class SurveySplits:
    """Splits of a survey.

    Attributes
    ----------
    splits
        Splits in the order of the scene.
    night : (n_obs,)
        Night of each observation, numbered from 0 over the nights that have observations; observations themselves
        without dates.
    dated
        Whether observations have dates.
    half : (n_det,)
        Half of the array of each detector, 0 or 1.
    """

    splits: tuple[Split, ...]
    night: np.ndarray
    dated: bool
    half: np.ndarray

    @property
    def n_map(self) -> int:
        """Number of split maps."""
        return sum(len(split.parts) for split in self.splits)

    @property
    def within(self) -> tuple[Split, ...]:
        """Splits of each observation, whose parts share its weather."""
        return tuple(split for split in self.splits if split.name != NIGHT)

    def of(self, name: str) -> Split | None:
        """Return the split with a name; None without it."""
        return next((split for split in self.splits if split.name == name), None)

    @property
    def night_parts(self) -> np.ndarray:
        """Parts (n_obs,) of the split by night that have the observations."""
        return _dealt(self.night, len(self.of(NIGHT).parts))

    def parts_of(
        self, split: Split, *, first_scan: int, n_scans: int, rows: np.ndarray
    ) -> list[tuple[np.ndarray, ...]]:
        """Detectors (n_row,) bool and scans (n_scans,) bool of each part of a split within observations.

        Parameters
        ----------
        first_scan
            Number of the first of these scans in its observation.
        rows
            Numbers of the detectors, (n_row,).
        """
        all_rows, all_scans = np.ones(len(rows), bool), np.ones(n_scans, bool)
        if split.name == DIRECTION:
            sense = (first_scan + np.arange(n_scans)) % 2
            return [(all_rows, sense == part) for part in (0, 1)]
        return [(self.half[rows] == part, all_scans) for part in (0, 1)]


def check_bins(scene: Scene, geometry: MapGeometry) -> None:
    """Raise SceneError for bins narrower than the modes of the patch, some of which would be without one."""
    if scene.spectra is None:
        return
    step = 2 * np.pi / (padded_side(scene.score.size_rad, geometry) * geometry.pixel_rad) * (1 - 1e-9)
    if scene.spectra.ell_bin < step:
        raise SceneError(
            f"spectra.ell_bin: found {scene.spectra.ell_bin}; {np.ceil(step):.0f} or more is expected, the distance of"
            " the modes of the scored patch"
        )


def survey_splits(
    scene: Scene, plane: FocalPlane, start_mjd: np.ndarray | None, block: np.ndarray | None
) -> SurveySplits | None:
    """Split a survey; None without a section [spectra].

    Parameters
    ----------
    plane
        Detectors.
    start_mjd : (n_obs,)
        Starts of the observations; None without dates.
    block : (n_obs,)
        Blocks of observations with independent weather; None where nights are independent.

    Raises
    ------
    SceneError
        For parts without `FEWEST_OBSERVATIONS` observations, and half arrays without a detector.
    """
    if scene.spectra is None:
        return None
    names, splits = scene.spectra.splits, list[Split]()
    for name in names:
        parts = tuple(map(str, range(scene.spectra.parts))) if name == NIGHT else _HALVES[name]
        splits.append(Split(name, parts, sum(len(split.parts) for split in splits)))
    night = np.arange(scene.observations) if start_mjd is None else _nights(scene, start_mjd, block)
    found = SurveySplits(tuple(splits), night, start_mjd is not None, _halves(plane))
    if NIGHT in names:
        _check_parts(scene, found)
    if ARRAY in names and len(plane.x_rad) < 2:
        raise SceneError(f"spectra.splits: found {ARRAY!r} with one detector; two or more are expected")
    return found


def _nights(scene: Scene, start_mjd: np.ndarray, block: np.ndarray | None) -> np.ndarray:
    """Night (n_obs,) of each observation, from noon to noon of local mean time, numbered from 0.

    Where the weather drifts, a night ends at the earliest with a block of independent weather.
    """
    date = np.floor(start_mjd + scene.schedule.longitude_rad / (2 * np.pi) - 0.5)
    begins, last = np.zeros(len(date), int), 0
    for number in range(1, len(date)):
        if date[number] != date[number - 1] and (block is None or block[number] != block[last]):
            begins[number], last = 1, number
    return np.cumsum(begins)


def _halves(plane: FocalPlane) -> np.ndarray:
    """Half of each detector (n_det,): every second one, in rows along x."""
    rows = np.round(plane.y_rad / _ROW_RAD)
    half = np.empty(len(rows), int)
    half[np.lexsort((plane.x_rad, rows))] = np.arange(len(rows)) % 2
    return half


def _dealt(night: np.ndarray, n_part: int) -> np.ndarray:
    """Parts (n_obs,) that the nights of observations are dealt to."""
    return (night + night // n_part) % n_part


def _check_parts(scene: Scene, found: SurveySplits) -> None:
    """Raise SceneError for a part with too few observations."""

    def enough(n_part: int) -> bool:
        return np.bincount(_dealt(found.night, n_part), minlength=n_part).min() >= FEWEST_OBSERVATIONS

    if enough(scene.spectra.parts):
        return
    nights = plural(int(found.night[-1]) + 1, "night")
    given = plural(scene.observations, "observation") + (f" in {nights}" if found.dated else "")
    most = max((n_part for n_part in range(2, scene.spectra.parts) if enough(n_part)), default=0)
    expected = f"at most {most} parts are" if most else "a longer survey is"
    raise SceneError(
        f"spectra.parts: found {scene.spectra.parts} with {given}; {expected} expected, with"
        f" {FEWEST_OBSERVATIONS} observations or more in each"
    )
