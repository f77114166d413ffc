"""Command ``mapmaker convert``: time-streams in files of another format."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from mapmaker.formats import TimestreamFormat


def convert(
    files: Annotated[list[Path], typer.Argument(metavar="FILES", help="Files of one observation each, of any format.")],
    to: Annotated[str, typer.Option(metavar="FORMAT", help="hdf5, toast, g3 or mustang2.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Directory of the converted files.")],
    beam: Annotated[
        float | None,
        typer.Option(metavar="ARCSEC", help="FWHM of the beam, in place of the files', which some formats can lack."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files.")] = False,
) -> None:
    """Convert files of time-streams to another format; the format of each file is recognized by its content.

    A line names what the format cannot hold.
    """
    from mapmaker.formats import named_format

    wanted, beam_rad = named_format(to), _radians(beam)
    for path, target in zip(files, _targets(files, out, wanted, force), strict=True):
        _convert(path, target, wanted, beam_rad)


def _radians(beam_arcsec: float | None) -> float | None:
    """Beam [rad] of an option; raises InputError for one out of range."""
    import math

    from mapmaker.errors import InputError

    if beam_arcsec is None:
        return None
    if not 0 < beam_arcsec < 3600:
        raise InputError(f"--beam: found {beam_arcsec}; a number above 0 and below 3600 is expected")
    return math.radians(beam_arcsec / 3600)


def _targets(files: list[Path], out: Path, wanted: "TimestreamFormat", force: bool) -> list[Path]:
    """Paths to write to; raises InputError for one path of two files, and existing files unless `force`."""
    from mapmaker.errors import InputError
    from mapmaker.formats import suffix

    targets = [out / f"{path.name.removesuffix(suffix(path))}{wanted.suffixes[0]}" for path in files]
    for number, target in enumerate(targets):
        if target in targets[:number]:
            raise InputError(f"{target}: found two files of this name; different names are expected")
        if target.exists() and not force:
            raise InputError(f"{target}: found a file; --force replaces it")
    return targets


def _convert(path: Path, target: Path, wanted: "TimestreamFormat", beam_rad: float | None) -> None:
    import warnings

    from mapmaker.errors import ArgumentError, InputError
    from mapmaker.formats import read_timestreams, write_timestreams
    from mapmaker.printable import complain, say

    streams = read_timestreams(path, fwhm_rad=beam_rad)
    with warnings.catch_warnings(record=True, action="always", category=UserWarning) as said:
        try:
            write_timestreams(target, streams, wanted.name)
        except ArgumentError as error:  # values of a file that the format cannot hold
            raise InputError(f"{target}: {error}") from None
    for each in said:
        complain(each.message)
    n_det, n_samp = streams.data_mk.shape
    say(f"{path} -> {target}: {n_det} detectors, {n_samp} samples, {len(streams.scan_bounds)} scans")
