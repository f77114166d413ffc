"""A cleaned file on the map: pixels, weights and halves of its samples; and a folder of such files."""

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapmaker.geometry import MapGeometry, pixel_indices
from mapmaker.normal_equations import NoiseWeight
from mapmaker.pipeline.dropped import OFF_MAP, SAMPLES, Dropped
from mapmaker.pipeline.one_file import CleanedFile
from mapmaker.pipeline.splits import Split, first_half

_ALIGNED = 64  # bytes: kernels are compiled for aligned arrays


@dataclass(frozen=True)
class MappedFile:
    """A cleaned file on the map.

    Attributes
    ----------
    item
    index : (n_det, n_samp)
        Pixels; -1 off the map, for lost samples, and in scans that a detector is left out of.
    weight : (n_det, n_scan)
        Weight of a sample; 0 in scans that a detector is left out of.
    halves : (n_split, n_det, n_scan) bool
        True for scans in the first half of each division.
    noise
        Inverse noise covariance, for makers that solve the normal equations.
    """

    item: CleanedFile
    index: np.ndarray
    weight: np.ndarray
    halves: np.ndarray
    noise: NoiseWeight | None = None

    @property
    def samples(self) -> int:
        """Number of samples in the map."""
        pairs = zip(self.item.bounds, self.weight.T, strict=True)
        return sum(int(np.sum((self.index[:, a:b] >= 0) & (weight > 0)[:, None])) for (a, b), weight in pairs)

    @property
    def off_map(self) -> tuple[Dropped, ...]:
        """Samples that look beyond the edge of the map."""
        item, missed = self.item, 0
        for (start, stop), used in zip(item.bounds, item.used.T, strict=True):
            good = ~item.streams.flags[:, start:stop] & used[:, None]
            missed += int(np.sum((self.index[:, start:stop] < 0) & good))
        return (Dropped(item.name, SAMPLES, OFF_MAP, samples=missed),) if missed else ()


def mapped_file(
    geometry: MapGeometry,
    item: CleanedFile,
    weight: np.ndarray,
    *,
    splits: Sequence[Split],
    place: tuple[int, int],
    order: dict[str, int],
) -> MappedFile:
    """Put a cleaned file on the map.

    Parameters
    ----------
    geometry
    item
    weight : (n_det,)
        Weight of a sample.
    splits
    place
        Number of the file, and number of files.
    order
        Number of each detector, by name; new ones are added.
    """
    for label in item.labels:
        order.setdefault(str(label), len(order))
    index = pixel_indices(geometry, item.streams)
    for (start, stop), used in zip(item.bounds, item.used.T, strict=True):
        index[~used, start:stop] = -1
    halves = [first_half(split, item, place, order) for split in splits]
    shape = (len(splits), *item.used.shape)
    return MappedFile(item, index, np.where(item.used, weight[:, None], 0.0), np.array(halves, bool).reshape(shape))


class FileStore:
    """Mapped files in a folder, for map-makers that need them several times.

    Their arrays are mapped into memory, so that only those in use take any.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder, self.records = Path(folder), list[tuple[bytes, list[slice]]]()

    def add(self, item: MappedFile) -> None:
        """Add a file."""
        arrays: list[pickle.PickleBuffer] = []
        record, places = pickle.dumps(item, protocol=5, buffer_callback=arrays.append), []
        with open(self._path(len(self.records)), "wb") as file:
            for array in arrays:
                begin = file.seek(-(-file.tell() // _ALIGNED) * _ALIGNED)
                places.append(slice(begin, begin + file.write(array.raw())))
            file.truncate(max(1, file.tell()))
        self.records.append((record, places))

    def files(self) -> Iterator[MappedFile]:
        """Yield all files, in the order in which they came."""
        for number, (record, places) in enumerate(self.records):
            content = np.memmap(self._path(number), mode="c")
            yield pickle.loads(record, buffers=[content[place] for place in places])

    def _path(self, number: int) -> Path:
        return self.folder / f"{number}.arrays"
