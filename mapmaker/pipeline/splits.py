"""Divisions of the data into halves, whose maps differ by noise alone."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mapmaker.geometry import MapGeometry, mean_direction, plane_offsets
from mapmaker.pipeline.config import JackknifeSection
from mapmaker.pipeline.one_file import CleanedFile

_TRIES = 50  # random divisions for each one that is wanted


@dataclass(frozen=True)
class Split:
    """A division of the data into halves.

    Attributes
    ----------
    name
        Name in files: "files_1", "time", "direction" or "detectors".
    kind
        "files", "time", "direction" or "detectors".
    first_files
        Numbers of the files in the first half, for divisions by files.
    """

    name: str
    kind: str
    first_files: frozenset[int] = frozenset()


def make_splits(section: JackknifeSection, n_file: int, maker: str = "binned") -> tuple[Split, ...]:
    """Divisions that a configuration asks for; those by files need two files.

    Maximum likelihood weighs what detectors share, which a change of sign of half of them turns into something else:
    it has no division by detectors.
    """
    splits: list[Split] = []
    for kind in section.splits:
        if kind == "detectors" and maker == "maximum_likelihood":
            continue
        if kind == "files":
            halves = _halves_of_files(n_file, section.files, section.seed, "time" in section.splits)
            splits += [Split(f"files_{k}", kind, half) for k, half in enumerate(halves, 1)]
        else:
            splits.append(Split(kind, kind))
    return tuple(splits)


def _halves_of_files(n_file: int, wanted: int, seed: int, no_later: bool) -> list[frozenset[int]]:
    """Different random halves of the files, with file 0 in none; fewer where there are not so many.

    With `no_later` the later half is none of them: the division in time has it, where files are even in number.
    """
    rng, found = np.random.default_rng(seed), list[frozenset[int]]()
    later = frozenset(range(n_file // 2, n_file)) if no_later and n_file % 2 == 0 else None
    for _ in range(_TRIES * wanted if n_file > 1 else 0):
        half = frozenset((1 + rng.permutation(n_file - 1)[: n_file // 2]).tolist())
        if half not in (*found, later):
            found.append(half)
        if len(found) == wanted:
            break
    return found


def first_half(split: Split, item: CleanedFile, place: tuple[int, int], order: Mapping[str, int]) -> np.ndarray:
    """Flags (n_det, n_scan) of the scans of each detector that are in the first half.

    Parameters
    ----------
    split
    item
    place
        Number of the file, and number of files.
    order
        Number of each detector, in the order of their first appearance.
    """
    number, n_file = place
    n_det, n_scan = item.used.shape
    if split.kind == "files":
        return np.full((n_det, n_scan), number in split.first_files)
    if split.kind == "time":
        scans = (number + (np.arange(n_scan) + 0.5) / n_scan) / n_file < 0.5
        return np.tile(scans, (n_det, 1))
    if split.kind == "direction":
        return np.tile(_forward(item), (n_det, 1))
    return np.tile(np.array([order[label] % 2 == 0 for label in item.labels])[:, None], (1, n_scan))


def _forward(item: CleanedFile) -> np.ndarray:
    """Flags (n_scan,) of the scans that move to the east, or to the north if all move along a meridian."""
    streams, bounds = item.streams, item.bounds
    ra, dec = streams.ra_rad, streams.dec_rad
    centre = mean_direction(ra[bounds[:, 0]], dec[bounds[:, 0]])
    east, north = plane_offsets(MapGeometry(*centre, 1e-6, 1, 1), ra, dec)
    steps = np.array([(item[bounds[:, 1] - 1] - item[bounds[:, 0]]) for item in (east, north)])
    # The axis of the largest extent; its sign points to the east, or to the north.
    axis = np.linalg.svd(steps, full_matrices=False)[0][:, 0]
    main = axis * np.sign(axis[0] if abs(axis[0]) > 1e-6 else axis[1])
    return main @ steps > 0
