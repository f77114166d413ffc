"""Mangled files of time-streams: what is read equals what the file holds, is valid, and can be cleaned and mapped."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.mangle import mangled_bytes, pick
from tests.fuzz.outcomes import Outcome, check, outcome_of_error

N_DET, N_SCAN, SAMPLES = 5, 3, 20
PER_SAMPLE = ("time_s", "ra_deg", "dec_deg", "array_angle_deg", "scan")
NAMES = ("data", *PER_SAMPLE, "x_arcmin", "y_arcmin")
SAME_KINDS = {"data": (">f4", "<f8", ">f8"), "scan": (">i8", "i4", "i2", ">i2", "i1")}
OTHER_KINDS = (
    "i4",
    ">i2",
    "u1",
    "f2",
    "c16",
    "S8",
    "object",
    "bool",
    "compound",
    "group",
    "scalar",
    "empty",
    "enum",
    "u8",
)
NUMBERS = (np.nan, np.inf, -np.inf, 1e300, -1e300, 91.0, 720.0, 1e30, -91.0)


def streams() -> Any:
    """Time-streams of three scans."""
    from mapmaker.timestreams import FocalPlane, Timestreams

    rng = np.random.default_rng(3)
    n = N_SCAN * SAMPLES
    scan = np.repeat(np.arange(N_SCAN), SAMPLES)
    scan[::SAMPLES] = -1
    air = np.cumsum(rng.normal(size=n))
    plane = FocalPlane(np.radians([0, 1, -1, 0, 0]) / 60, np.radians([0, 0, 0, 1, -1]) / 60, np.radians(1 / 60))
    ra = np.radians(132.3 + np.tile(np.linspace(-0.05, 0.05, SAMPLES), N_SCAN))
    dec = np.radians(44.8 + np.repeat(np.arange(N_SCAN), SAMPLES) / 60)
    data = (air + rng.normal(size=(N_DET, n))).astype(np.float32)
    return Timestreams(data, np.arange(n) / 10.0, ra, dec, np.zeros(n), scan, plane, {"seed": 3})


def prepare(folder: Path) -> bytes:
    """The bytes of a good file, read, cleaned and mapped once."""
    from mapmaker.formats import write_timestreams

    path = folder / "good.h5"
    write_timestreams(path, streams())
    raw = path.read_bytes()
    os.chdir(folder)
    Path("mangled.h5").write_bytes(raw)
    if tried(exact=True).kind != "right":
        raise AssertionError("the file that is mangled is refused")
    return raw


def mangled(base: bytes, rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A mangled file in the working directory."""
    path = Path("mangled.h5")
    how = int(rng.integers(12))
    if how == 0:
        path.write_bytes(mangled_bytes(base, rng))
        return "bytes", lambda: tried(exact=False)
    if how == 1:
        return _no_file(path, base, rng), lambda: tried(exact=False)
    path.write_bytes(base)
    import h5py

    with h5py.File(path, "r+") as file:
        label, good = (_of_kind, _of_value, _of_structure, _of_attribute, _of_scan)[how % 5](file, rng)
    return label, lambda: tried(exact=True, good=good)


def _no_file(path: Path, base: bytes, rng: np.random.Generator) -> str:
    how = int(rng.integers(6))
    if how == 0:
        os.mkfifo(path)
    elif how == 1:
        path.mkdir()
    elif how == 2:
        path.symlink_to("missing.h5")
    elif how == 3:
        path.symlink_to("mangled.h5")
    elif how == 4:
        path.write_bytes(b"")
    else:
        path.write_bytes(base[: int(rng.integers(len(base)))])
    return ("FIFO", "folder", "dangling link", "link to itself", "empty", "truncated")[how]


def _of_kind(file: Any, rng: np.random.Generator) -> tuple[str, bool | None]:
    """Another type of a data set: one that holds the same numbers, or one that does not."""
    import h5py

    name = pick(rng, NAMES)
    values = file[name][()]
    del file[name]
    if rng.random() < 0.4:
        kind = pick(rng, SAME_KINDS.get(name, ("<f4", ">f8", ">f4")))
        file.create_dataset(name, data=values.astype(kind), compression=pick(rng, (None, "gzip")), chunks=True)
        return f"{name} as {kind}", True
    kind = pick(rng, OTHER_KINDS)
    if kind == "group":
        file.create_group(name)
    elif kind == "scalar":
        file[name] = 1.0
    elif kind == "empty":
        file[name] = h5py.Empty("f8")
    elif kind == "object":
        file.create_dataset(name, data=np.full(values.shape, "text", object), dtype=h5py.string_dtype())
    elif kind == "compound":
        file[name] = np.zeros(values.shape, [("a", "f8"), ("b", "i4")])
    elif kind == "enum":
        file.create_dataset(name, data=np.zeros(values.shape, "i4"), dtype=h5py.enum_dtype({"a": 0, "b": 1}, "i4"))
    else:
        with np.errstate(all="ignore"):
            file[name] = values.astype(kind)
    harmless = kind in ("i4", ">i2", "f2") or kind in ("u1", "u8")
    return f"{name} as {kind}", None if harmless else False


def _of_value(file: Any, rng: np.random.Generator) -> tuple[str, bool | None]:
    name = pick(rng, NAMES[:5] + NAMES[6:])
    value = pick(rng, NUMBERS)
    place = int(rng.integers(file[name].shape[-1]))
    with np.errstate(all="ignore"):
        file[name][..., place] = value
    finite_angle = np.isfinite(value) and abs(value) < 1e4
    good = None if finite_angle or name == "data" else False
    if name == "dec_deg" and abs(value) > 90:
        good = False
    return f"{name}[{place}] = {value}", good


def _of_structure(file: Any, rng: np.random.Generator) -> tuple[str, bool | None]:
    import h5py

    name = pick(rng, NAMES)
    values = file[name][()]
    how = int(rng.integers(9))
    if how == 8:
        file.create_dataset("extra", data=np.zeros(3))
        return "an extra data set", True
    del file[name]
    if how == 0:
        return f"without {name}", False
    if how == 1:
        file[name] = values[..., :-1]
    elif how == 2:
        file[name] = values[..., None]
    elif how == 3:
        file[name] = np.zeros((0,) * values.ndim, values.dtype)
    elif how == 4:
        file[name] = h5py.SoftLink("/nowhere")
    elif how == 5:
        file[name] = h5py.ExternalLink("other.h5", "/x")
    elif how == 6:
        file[name] = h5py.SoftLink(f"/{name}")
    else:
        file.create_dataset(name, shape=(2**31,) * values.ndim, dtype=values.dtype, chunks=(1024,) * values.ndim)
    words = ("", "a sample short", "an axis more", "empty", "dangling", "external", "circular", "vast")
    return f"{name}: {words[how]}", False


def _of_attribute(file: Any, rng: np.random.Generator) -> tuple[str, bool | None]:
    if rng.random() < 0.3:
        value = pick(rng, (np.arange(3), "text", b"bytes\xff", np.nan, True, "x" * 9000))
        file.attrs["note"] = value
        return f"attribute note = {value!r}"[:200], None
    value = pick(
        rng,
        (0.0, -60.0, np.nan, np.inf, "60", "wide", np.array([60.0, 60.0]), b"60", 1e300, None, True, np.array([60.0])),
    )
    del file.attrs["fwhm_arcsec"]
    if value is not None:
        file.attrs["fwhm_arcsec"] = value
    return f"fwhm_arcsec = {value!r}", None if isinstance(value, np.ndarray) and value.size == 1 else False


def _of_scan(file: Any, rng: np.random.Generator) -> tuple[str, bool | None]:
    scan = file["scan"][()]
    del file["scan"]
    how = int(rng.integers(7))
    if how == 0:
        scan[-3:] = 0
        good = False
    elif how == 1:
        scan, good = scan.astype(np.uint8), None  # 255 for -1
    elif how == 2:
        scan, good = scan + 0.5, False
    elif how == 3:
        scan, good = np.where(scan < 0, -1, scan + 100), True
    elif how == 4:
        scan[:] = -1
        good = None
    elif how == 5:
        scan, good = np.where(scan < 0, -7, scan), None
    else:
        scan, good = scan.astype(np.uint64), None
    file["scan"] = scan
    return ("scan in pieces", "uint8", "halves", "from 100", "none", "-7 in turnarounds", "uint64")[how], good


def tried(exact: bool, good: bool | None = None) -> Outcome:
    """Read the file, check what is read, clean and map it.

    `good` says whether it has to be accepted, or refused; `exact` whether the file's numbers are known.
    """
    import mapmaker as mm

    try:
        found = mm.read_timestreams("mangled.h5")
    except Exception as error:
        outcome = outcome_of_error(error, (ValueError,))
        if good and outcome.kind == "refused":
            return Outcome("silent", f"good, but refused: {outcome.text}")
        return outcome
    check(good is not False, f"accepted; scan {np.unique(found.scan)[:5]}, fwhm {found.focal_plane.fwhm_rad!r}")
    valid(found)
    if exact:
        _as_in_file(found)
    return mapped(found)


def valid(streams: Any) -> None:
    """Raise Silent for streams with values that no reader may accept."""
    check(
        streams.data_mk.ndim == 2 and streams.data_mk.dtype in (np.float32, np.float64), f"data {streams.data_mk.dtype}"
    )
    check(streams.data_mk.dtype.isnative, "data that are not in the machine's order of bytes")
    n_det, n_samp = streams.data_mk.shape
    check(n_det and n_samp, f"streams of {n_det} detectors and {n_samp} samples")
    angles = streams.ra_rad, streams.dec_rad, streams.array_angle_rad
    check(all(np.isfinite(item).all() and item.shape == (n_samp,) for item in (*angles, streams.time_s)), "pointing")
    check(np.abs(streams.dec_rad).max() <= np.pi / 2 + 1e-9, "declinations beyond a pole")
    scan = streams.scan
    check(scan.dtype.kind == "i" and scan.dtype.isnative and scan.shape == (n_samp,), f"scan {scan.dtype}")
    starts = scan[np.r_[True, np.diff(scan) != 0]]
    starts = starts[starts >= 0]
    check(len(set(starts.tolist())) == len(starts), "scans in pieces")
    plane = streams.focal_plane
    check(np.isfinite(plane.fwhm_rad) and 0 < plane.fwhm_rad < np.pi, f"fwhm {plane.fwhm_rad!r}")
    check(np.isfinite(plane.x_rad).all() and np.isfinite(plane.y_rad).all(), "positions that are not finite")


def _as_in_file(streams: Any) -> None:
    import h5py

    with h5py.File("mangled.h5") as file:
        wanted = {name: np.asarray(file[name][()], dtype=float) for name in NAMES}
    scan = wanted["scan"]
    scan = np.where(scan == 255, -1, scan) if scan.max() == 255 else scan
    degrees = {"ra_deg": streams.ra_rad, "dec_deg": streams.dec_rad, "array_angle_deg": streams.array_angle_rad}
    found = {name: np.degrees(values) for name, values in degrees.items()}
    found |= {"data": streams.data_mk, "time_s": streams.time_s}
    found |= {
        "x_arcmin": np.degrees(streams.focal_plane.x_rad) * 60,
        "y_arcmin": np.degrees(streams.focal_plane.y_rad) * 60,
    }
    for name, values in found.items():
        check(np.allclose(values, wanted[name], rtol=1e-6, atol=1e-9, equal_nan=True), f"{name} was read otherwise")
    inside = scan >= 0
    check(np.array_equal(streams.scan >= 0, inside), "turnarounds were read otherwise")
    check(np.array_equal(streams.scan[inside], scan[inside]), "scans were read otherwise")


def mapped(streams: Any) -> Outcome:
    """Clean and bin: finite maps, no more hits than samples; ValueError is a refusal."""
    import mapmaker as mm

    try:
        cleaned = mm.clean(
            "average", streams.data_mk, streams.scan_bounds, streams.focal_plane, options=mm.TemplateOptions(1e-8, 100)
        )
        centre = mm.mean_direction(streams.ra_rad, streams.dec_rad)
        geometry = mm.covering_geometry(*centre, np.radians(20 / 3600), np.radians(0.2))
        index = mm.pixel_indices(geometry, streams)
        item = mm.bin_map(geometry, cleaned.data_mk, index, streams.scan_bounds, kept=cleaned.kept)
    except Exception as error:
        return outcome_of_error(error, (ValueError,))
    check(np.isfinite(item.signal_mk).all(), "a map that is not finite")
    lengths = np.diff(streams.scan_bounds, axis=1)[:, 0][cleaned.kept]
    check(item.hits.sum() <= lengths.sum() * len(streams.data_mk), "more hits than samples")
    return Outcome("right")
