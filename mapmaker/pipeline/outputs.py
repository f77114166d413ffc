"""Files of `mapmaker clean-and-map`: maps, tables, report; all of them, or none."""

import os
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from pathlib import Path

import numpy as np

from mapmaker.binning import INVERSE_VARIANCE_UNIT, write_fits, write_healpix_pixels
from mapmaker.errors import InputError
from mapmaker.files import atomic_write, write_ecsv
from mapmaker.pipeline.dropped import dropped_columns
from mapmaker.pipeline.report_page import write_report
from mapmaker.pipeline.run import DetectorRecord, FileRecord, Result

REPORT = "report.html"
# Names of files that this program writes, which it may replace.
_OURS = re.compile(
    r"(map|healpix)\.fits|noise/[a-z]+(_\d+)?\.fits|(dropped|files|detectors|noise_psd)\.ecsv|config\.json|report\.html"
)


def check_directory(directory: Path, force: bool) -> None:
    """Raise InputError for a directory that is none, or has files already without `force`."""
    if directory.exists() and not directory.is_dir():
        raise InputError(f"{directory}: found a file; a directory is expected")
    if directory.is_dir() and not force and any(directory.iterdir()):
        raise InputError(f"{directory}: found files in it; --force replaces results, --out writes elsewhere")


@contextmanager
def replaced(directory: Path) -> Iterator[Path]:
    """Context manager for a temporary folder, whose files replace those of `directory` if the block succeeds.

    Results of an earlier run are removed; other files stay. After a failure the directory is as before.
    """
    made = [path for path in (directory, *directory.parents) if not path.exists()]
    directory.mkdir(parents=True, exist_ok=True)
    new = directory / f".new.{os.getpid()}.part"
    new.mkdir()
    try:
        yield new
        _move(new, directory)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        for path in made:  # only those that are empty
            with suppress(OSError):
                path.rmdir()
        raise
    shutil.rmtree(new, ignore_errors=True)


def _move(new: Path, directory: Path) -> None:
    names = {str(path.relative_to(new)) for path in new.rglob("*") if path.is_file()}
    for path in list(directory.rglob("*")):
        name = str(path.relative_to(directory))
        if _OURS.fullmatch(name) and name not in names and path.is_file():
            path.unlink()
    for name in sorted(names):
        (directory / name).parent.mkdir(exist_ok=True)
        os.replace(new / name, directory / name)
    with suppress(OSError):
        (directory / "noise").rmdir()


def write_outputs(directory: Path, result: Result) -> None:
    """Write all files of a result."""
    header = {"NFILES": sum(item.used for item in result.files)}
    write_fits(directory / "map.fits", result.maps.map, header)
    for split, item in zip(result.maps.splits, result.maps.noise, strict=True):
        if item.weight.any():
            write_fits(directory / "noise" / f"{split.name}.fits", item, header | {"SPLIT": split.name})
    if result.maps.healpix is not None:
        sums = result.maps.healpix
        seen = sums.hits > 0
        planes = {"weighted_sum": sums.weighted_sum[seen], "weight": sums.weight[seen], "hits": sums.hits[seen]}
        write_healpix_pixels(
            directory / "healpix.fits",
            sums.nside,
            pixel=sums.pixels[seen],
            **planes,
            weight_unit=result.maps.map.weight_unit,
        )
    write_tables(directory, result)
    with atomic_write(directory / "config.json") as partial:
        partial.write_text(result.config.model_dump_json(indent=2) + "\n", encoding="utf-8")
    write_report(directory / REPORT, result)


def write_tables(directory: Path, result: Result) -> None:
    """Write the tables of what was left out, of files, of detectors, and of noise PSDs."""
    write_ecsv(directory / "dropped.ecsv", dropped_columns(result.dropped), {}, {})
    of_weight = {"weight": "mK-2"} if result.maps.map.weight_unit == INVERSE_VARIANCE_UNIT else {}
    write_ecsv(directory / "files.ecsv", _columns(result.files), of_weight, {})
    units = {"noise_mk": "mK", "white_mk": "mK"} | of_weight
    write_ecsv(directory / "detectors.ecsv", _columns(result.detectors), units, {})
    if result.spectra is not None:
        found = result.spectra
        columns = {"ell": found.ell, "ell_low": found.edges_ell[:-1], "ell_high": found.edges_ell[1:]}
        for name, psd, n_modes in zip(found.names, found.psd_mk2, found.n_modes, strict=True):
            columns |= {name: psd, f"{name}_modes": n_modes}
        write_ecsv(directory / "noise_psd.ecsv", columns, dict.fromkeys(found.names, "mK2 sr"), {})


def _columns(records: Sequence[FileRecord | DetectorRecord]) -> dict[str, np.ndarray]:
    names = [(item.name, item.type) for item in fields(records[0])]
    return {name: np.array([getattr(record, name) for record in records], kind) for name, kind in names}
