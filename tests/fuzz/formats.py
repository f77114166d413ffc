"""Mangled files of TOAST and of MUSTANG-2: what is read is valid and can be cleaned and mapped, or refused."""

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.mangle import mangled_bytes, pick
from tests.fuzz.outcomes import Outcome, check, outcome_of_error
from tests.fuzz.streams import mapped, streams, valid

DATA_SETS = (
    "detdata/signal",
    "detdata/flags",
    "shared/times",
    "shared/boresight_radec",
    "shared/flags",
    "intervals/scanning",
    "metadata/other/scan_numbers",
    "instrument/focalplane",
)
NEEDED = ("detdata/signal", "shared/times", "shared/boresight_radec", "instrument/focalplane")
COLUMNS = ("PIXID", "DX", "DY", "TIME", "SCAN", "FNU", "UFNU")
NUMBERS = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e30, 7.0, -7.0)
ATTRIBUTES = ("toast_format_version", "observation_detectors", "observation_detector_flags")
VALUES = (0, 3, -1, 1e300, "text", "[", "[1, 2]", '{"D0": "x"}', "null", b"bytes\xff", np.arange(3))
UNITS = ("W", "Jy/beam", "m", "K2", "", "nonsense", "\u212b", b"\xff", 3)


def prepare(folder: Path) -> dict[str, bytes]:
    """The bytes of a good file of each format, read, cleaned and mapped once."""
    from mapmaker.formats import write_timestreams

    os.chdir(folder)
    bases = {}
    for format in ("toast", "mustang2"):
        with warnings.catch_warnings(action="ignore"):
            write_timestreams("mangled", streams(), format)
        bases[format] = Path("mangled").read_bytes()
        if tried(True).kind != "right":
            raise AssertionError("the file that is mangled is refused")
    return bases


def mangled(base: dict[str, bytes], rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A mangled file in the working directory."""
    path, format = Path("mangled"), pick(rng, tuple(base))
    raw = base[format]
    how = int(rng.integers(6))
    if how == 0:
        path.write_bytes(mangled_bytes(raw, rng))
        return f"{format}: bytes", lambda: tried(None)
    if how == 1:
        path.write_bytes(raw[: int(rng.integers(len(raw)))])
        return f"{format}: truncated", lambda: tried(None)
    path.write_bytes(raw)
    label, good = (_toast if format == "toast" else _fits)(path, rng)
    return f"{format}: {label}", lambda: tried(good)


def _toast(path: Path, rng: np.random.Generator) -> tuple[str, bool | None]:
    import h5py

    with h5py.File(path, "r+") as file:
        how = int(rng.integers(5))
        if how == 0:
            name, value = pick(rng, ATTRIBUTES), pick(rng, VALUES)
            file.attrs[name] = value
            return f"{name} = {value!r}", None
        if how == 1:
            unit = pick(rng, UNITS)
            file["detdata/signal"].attrs["units"] = unit
            return f"unit {unit!r}", False
        name = pick(rng, DATA_SETS)
        if how == 2:
            return _of_structure(file, name, rng)
        values = file[name][()]
        if values.dtype.kind == "V":
            return _of_structure(file, name, rng)
        if how == 3 and values.dtype.kind == "f":
            value = pick(rng, NUMBERS)
            values.flat[int(rng.integers(values.size))] = value
            good = None if name in ("detdata/signal", "intervals/scanning") else False
            label = f"{name} with {value}"
        else:
            kind = pick(rng, ("S8", "c16", "f2", "u1", ">f8", ">i4", "object"))
            with np.errstate(all="ignore"):
                values = np.full(values.shape, "text", object) if kind == "object" else values.astype(kind)
            label, good = f"{name} as {kind}", False if kind in ("S8", "c16", "object") else None
        attributes = dict(file[name].attrs)
        del file[name]
        file.create_dataset(name, data=values, dtype=h5py.string_dtype() if values.dtype == object else None)
        file[name].attrs.update(attributes)
    return label, good


def _of_structure(file: Any, name: str, rng: np.random.Generator) -> tuple[str, bool | None]:
    import h5py

    values = file[name][()]
    del file[name]
    how = int(rng.integers(7))
    if how == 0:
        return f"without {name}", False if name in NEEDED else None
    if how == 1:
        file.create_group(name)
    elif how == 2:
        file[name] = h5py.ExternalLink("other.h5", "/x")
    elif how == 3:
        file[name] = h5py.SoftLink("/nowhere")
    elif how == 4:
        file[name] = values[..., :-1]
    elif how == 5:
        file[name] = h5py.Empty("f8")
    else:
        file.create_dataset(name, shape=(2**31,) * values.ndim, dtype=values.dtype, chunks=(1024,) * values.ndim)
    words = ("", "a group", "external", "dangling", "one less", "empty", "vast")
    # The beam needs the last column of the table only; a detector less is found.
    return f"{name}: {words[how]}", False


def _fits(path: Path, rng: np.random.Generator) -> tuple[str, bool | None]:
    """Change columns or cards of the table, or the cards of the file itself."""
    from astropy.io import fits

    how = int(rng.integers(4))
    if how == 0:
        raw = bytearray(path.read_bytes())
        place = 2880 + 80 * int(rng.integers(30)) + int(rng.integers(10, 40))  # of the table's header
        raw[place : place + 1] = pick(rng, (b"9", b"0", b"-", b"'", b" ", b"\0", b"\xff"))
        path.write_bytes(raw)
        return "a card", None
    with fits.open(path, memmap=False) as file, warnings.catch_warnings(action="ignore"):
        columns = {column.name: [np.array(file[1].data[column.name]), column.unit] for column in file[1].columns}
        header = {"BMAJ": file[1].header["BMAJ"]}
    name, good = pick(rng, COLUMNS), False
    values = columns[name][0]
    if how == 1:
        del columns[name]
        label, good = f"without {name}", None if name == "SCAN" else False
    elif how == 2 and values.dtype.kind == "f":
        value = pick(rng, NUMBERS)
        values[int(rng.integers(len(values)))] = value
        label, good = f"{name} with {value}", None if name in ("FNU", "UFNU") or abs(value) == 7 else False
    else:
        unit = pick(rng, [each for each in UNITS if isinstance(each, str) and each.isascii() and each])
        columns[name][1] = unit
        label, good = f"{name} in {unit}", False if name in ("DX", "DY", "TIME", "FNU") else None
    made = [
        fits.Column(key, "D" if array.dtype.kind == "f" else "K", unit=unit, array=array)
        for key, (array, unit) in columns.items()
    ]
    with warnings.catch_warnings(action="ignore"):
        table = fits.BinTableHDU.from_columns(made)
        table.header.update(header)
        fits.HDUList([fits.PrimaryHDU(), table]).writeto(path, overwrite=True)
    return label, good


def tried(good: bool | None) -> Outcome:
    """Read the file, check what is read, clean and map it; `good` says whether it has to be accepted, or refused."""
    import mapmaker as mm

    try:
        found = mm.read_timestreams("mangled")
    except Exception as error:
        outcome = outcome_of_error(error, (ValueError,))
        return (
            Outcome("silent", f"good, but refused: {outcome.text}") if good and outcome.kind == "refused" else outcome
        )
    check(good is not False, "accepted")
    valid(found)
    return mapped(found)
