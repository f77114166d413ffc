"""Cleaning and mapping of many files, one at a time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from mapmaker.errors import InputError, InsufficientDataError
from mapmaker.files import one_line
from mapmaker.formats import read_timestreams
from mapmaker.pipeline.config import Config
from mapmaker.pipeline.dropped import FILE, OFF_MAP, UNREADABLE, Dropped, UnusableFileError
from mapmaker.pipeline.field import Field, extended, map_geometry, stated_field
from mapmaker.pipeline.makers import iterated_maps, solved_maps, with_noise
from mapmaker.pipeline.mapped_file import FileStore, MappedFile, mapped_file
from mapmaker.pipeline.maps import Maps
from mapmaker.pipeline.noise_spectra import NoiseSpectra, noise_spectra
from mapmaker.pipeline.one_file import CleanedFile, clean_file
from mapmaker.pipeline.splits import make_splits
from mapmaker.pipeline.sums import MapSums


@dataclass(frozen=True)
class FileRecord:
    """Use of one file: whether it is in the map, and how much of it.

    Attributes
    ----------
    name
    used
        Whether it is in the map.
    n_det, n_det_used, n_scan, n_scan_used
    samples, samples_used
        Samples within scans of all detectors, and those in the map.
    weight
        Mean weight of a sample; 0 for files that are not used.
    """

    name: str
    used: bool
    n_det: int = 0
    n_det_used: int = 0
    n_scan: int = 0
    n_scan_used: int = 0
    samples: int = 0
    samples_used: int = 0
    weight: float = 0.0


@dataclass(frozen=True)
class DetectorRecord:
    """A detector in one file: noise a sample, before and after the low frequencies, weight and scans."""

    file: str
    detector: str
    noise_mk: float
    white_mk: float
    weight: float
    scans: int
    samples: int


@dataclass(frozen=True)
class Result:
    """Maps of all files, and what was left out of them."""

    config: Config
    maps: Maps
    fwhm_rad: float
    spectra: NoiseSpectra | None
    files: tuple[FileRecord, ...]
    detectors: tuple[DetectorRecord, ...]
    dropped: tuple[Dropped, ...]


Show = Callable[[str, int, int], None]  # told what is done, the number of files that are finished, and of all


def clean_and_map(
    paths: Sequence[str | Path],
    config: Config,
    show: Show = lambda what, done, total: None,
    scratch: str | Path | None = None,
) -> Result:
    """Clean files of time-streams and map them.

    One file is in memory at a time. Files are read twice, unless the configuration states centre and size of the map.

    Parameters
    ----------
    paths
    config
    show
        Function that shows the progress.
    scratch
        Folder for temporary copies of the streams, which all makers but "binned" need.

    Raises
    ------
    InputError
        If nothing of any file can be used, with a line for each file; and for a map that is too large.
    """
    names = _names(paths)
    bad: dict[str, tuple[Dropped, ...]] = {}
    field = _field(paths, names, config, bad, show)
    geometry = map_geometry(field, config.map)
    good = [(path, name) for path, name in zip(paths, names, strict=True) if name not in bad]
    splits = make_splits(config.jackknives, len(good), config.map.maker)
    sums = MapSums(geometry, splits, config.map.weights == "uniform", config.map.healpix_nside)
    outcomes = {name: _Outcome(FileRecord(name, False), (), dropped) for name, dropped in bad.items()}
    order: dict[str, int] = {}
    with TemporaryDirectory(dir=scratch, prefix="streams.") as folder:
        store = FileStore(folder)
        add = sums.add if config.map.maker == "binned" else store.add
        for number, (path, name) in enumerate(good):
            put = partial(mapped_file, geometry, splits=splits, place=(number, len(good)), order=order)
            outcomes[name] = _outcome(path, name, config, put=put, add=add)
            show("cleaning", number + 1, len(good))
        used = any(item.file.used for item in outcomes.values())
        maps = _made(config, store, sums, show) if used else None
    dropped = tuple(row for item in outcomes.values() for row in item.dropped)
    if maps is None:
        raise _nothing_left(dropped)
    if not maps.map.hits.any():
        raise InsufficientDataError(f'maker "{config.map.maker}": its last cleaning discarded all scans')
    files = tuple(outcomes[name].file for name in names)
    detectors = tuple(row for name in names for row in outcomes[name].detectors)
    return Result(config, maps, field.fwhm_rad, noise_spectra(maps, field.fwhm_rad), files, detectors, dropped)


@dataclass(frozen=True)
class _Outcome:
    """Records of one file and its detectors, and the data left out of it."""

    file: FileRecord
    detectors: tuple[DetectorRecord, ...]
    dropped: tuple[Dropped, ...]


def _outcome(
    path: str | Path, name: str, config: Config, *, put: Callable[..., MappedFile], add: Callable[[MappedFile], None]
) -> _Outcome:
    """Clean a file, put it on the map, and add it to the maps."""
    try:
        item = clean_file(name, read_timestreams(path, fwhm_rad=config.input.fwhm), config)
        weight = sample_weights(item, config.map.weights)
        file = put(item, weight)
        if not file.samples:
            row = Dropped(name, FILE, OFF_MAP, detail="no good sample is on the map")
            raise UnusableFileError((*item.dropped, *file.off_map, row))
        add(with_noise(file, config))
    except InputError as error:
        return _Outcome(FileRecord(name, False), (), _of_error(path, name, error))
    dropped = (*item.dropped, *file.off_map)
    return _Outcome(_file_record(item, weight), tuple(_detector_records(item, weight)), dropped)


def _made(config: Config, store: FileStore, sums: MapSums, show: Show) -> Maps:
    """Make the maps of the files in the sums, or in the store."""
    if config.map.maker == "binned":
        return sums.maps()
    make = iterated_maps if config.map.maker == "iterative" else solved_maps
    return make(store, sums, config, lambda passes: show("pass over the files", passes, 0))


def _names(paths: Sequence[str | Path]) -> list[str]:
    """Names of the files in tables: as short as they differ."""
    short = [Path(path).name for path in paths]
    names = short if len(set(short)) == len(short) else [str(path) for path in paths]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{twice}: found twice among the files; different files are expected")
    return names


def _field(
    paths: Sequence[str | Path], names: Sequence[str], config: Config, bad: dict[str, tuple[Dropped, ...]], show: Show
) -> Field:
    """Read the pointing of all files, until place and size of the map are known; adds files that can't be used."""
    field = None
    for number, (path, name) in enumerate(zip(paths, names, strict=True)):
        try:
            field = _with_file(field, path, name, config)
        except InputError as error:
            bad[name] = _of_error(path, name, error)
        show("reading", number + 1, len(paths))
        if _stated(config) and field:
            break
    if field is None:
        raise _nothing_left([item for items in bad.values() for item in items])
    return field


def _with_file(field: Field | None, path: str | Path, name: str, config: Config) -> Field:
    """Extend a field by a file, which is not kept in memory."""
    streams = read_timestreams(path, fwhm_rad=config.input.fwhm)
    return stated_field(streams, config.map) if _stated(config) else extended(field, name, streams, config.map)


def _stated(config: Config) -> bool:
    return config.map.centre is not None and config.map.size is not None


def _of_error(path: str | Path, name: str, error: InputError) -> tuple[Dropped, ...]:
    if isinstance(error, UnusableFileError):
        return error.dropped
    return (Dropped(name, FILE, UNREADABLE, detail=one_line(error).removeprefix(f"{path}: ")),)


def _nothing_left(dropped: Sequence[Dropped]) -> InsufficientDataError:
    reasons = [f"{item.file}: {item.reason}: {item.detail}" for item in dropped if item.what == FILE]
    return InsufficientDataError("\n".join(["nothing is left to map", *reasons]))


def sample_weights(item: CleanedFile, kind: str) -> np.ndarray:
    """Weight (n_det,) of a sample of each detector [1/mK^2], or 1 for "uniform"."""
    if kind == "uniform":
        return np.ones(len(item.variance_mk2))
    seen = item.variance_mk2 > 0
    weight = np.divide(1.0, item.variance_mk2, out=np.zeros(len(seen)), where=seen)
    if kind == "file" and seen.any():
        return np.full(len(weight), 1 / item.variance_mk2[seen].mean())
    return weight


def _used_samples(item: CleanedFile) -> np.ndarray:
    """Samples (n_det,) that are not lost, in the scans that are used."""
    lost = item.streams.flags
    counts = [(~lost[:, a:b]).sum(axis=1) * used for (a, b), used in zip(item.bounds, item.used.T, strict=True)]
    return np.sum(counts, axis=0)


def _file_record(item: CleanedFile, weight: np.ndarray) -> FileRecord:
    n_det, n_scan = item.found
    used = _used_samples(item)
    return FileRecord(
        name=item.name,
        used=True,
        n_det=n_det,
        n_det_used=len(item.labels),
        n_scan=n_scan,
        n_scan_used=len(item.bounds),
        samples=n_det * int((item.streams.scan >= 0).sum()),
        samples_used=int(used.sum()),
        weight=float(np.average(weight, weights=used)) if used.any() else 0.0,
    )


def _detector_records(item: CleanedFile, weight: np.ndarray) -> list[DetectorRecord]:
    columns = zip(
        item.labels.tolist(),
        np.sqrt(item.variance_mk2).tolist(),
        item.white_mk.tolist(),
        weight.tolist(),
        item.used.sum(axis=1).tolist(),
        _used_samples(item).tolist(),
        strict=True,
    )
    return [DetectorRecord(item.name, *row) for row in columns]
