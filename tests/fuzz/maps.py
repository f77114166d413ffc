"""Mangled map files: what is read is what an independent reader of FITS finds, or the file is refused."""

import gzip
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.mangle import mangled_bytes, pick
from tests.fuzz.outcomes import Outcome, check, outcome_of_error

PLANES = ("SIGNAL", "WEIGHT", "HITS")
CARDS = {
    "CRVAL1": (np.nan, 1e300, "text", 720.0, -10.0, None),
    "CRVAL2": (91.0, "text", None, -200.0),
    "CDELT1": (0.0, 1 / 180, -1 / 90, "text", None, 1e300),
    "CDELT2": (0.0, -1 / 180, 1 / 90, "text", None, 1e300, 1e-300),
    "CRPIX1": (1.0, 1e9, "text", None, 4.25),
    "CRPIX2": (1.0, 1e9, "text", None, 0.0),
    "CTYPE1": ("GLON-TAN", "RA---SIN", "RA---CAR", "", None, "DEC--TAN"),
    "CTYPE2": ("GLAT-TAN", "DEC--SIN", "", None),
    "CUNIT1": ("rad", "arcsec", "nonsense"),
    "CUNIT2": ("rad", "arcsec"),
    "PC1_1": (0.0, 0.7, -1.0),
    "PC1_2": (0.5, 1.0),
    "CD1_1": (1.0,),
    "LONPOLE": (90.0, 0.0),
    "RADESYS": ("FK4", "GALACTIC"),
    "EQUINOX": (1950.0,),
    "BUNIT": ("K", "uK", "Jy/beam", "", "mK", None, "nonsense"),
    "BSCALE": (2.0, 0.0, "text"),
    "BZERO": (5.0,),
    "NAXIS1": (3, 10**9, -1, "text"),
    "BITPIX": (8, 64, 7),
    "EXTNAME": ("OTHER", "WEIGHT"),
}
HARMLESS = ("mK", "deg")


def prepare(folder: Path) -> bytes:
    """The bytes of a good map."""
    from mapmaker.binning import BinnedMap, read_fits, write_fits
    from mapmaker.geometry import MapGeometry

    rng = np.random.default_rng(4)
    hits = rng.integers(0, 5, (1, 7, 9))
    weight = hits * 0.25
    item = BinnedMap(
        MapGeometry(np.radians(132.3), np.radians(44.8), np.radians(1 / 180), 9, 7),
        rng.normal(size=hits.shape) * weight,
        weight,
        hits,
    )
    path = folder / "good.fits"
    write_fits(path, item, {"OBJECT": "a test"})
    read_fits(path)
    os.chdir(folder)
    Path("mangled.fits").write_bytes(path.read_bytes())
    if tried(good=True).kind != "right":
        raise AssertionError("the map that is mangled is refused")
    return path.read_bytes()


def mangled(base: bytes, rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A mangled map in the working directory."""
    path, how = Path("mangled.fits"), int(rng.integers(10))
    if how < 2:
        path.write_bytes(mangled_bytes(base, rng))
        return "bytes", lambda: tried(None)
    if how == 2:
        kind = pick(rng, ("FIFO", "folder", "dangling link", "empty", "truncated", "gzip"))
        if kind == "FIFO":
            os.mkfifo(path)
        elif kind == "folder":
            path.mkdir()
        elif kind == "dangling link":
            path.symlink_to("missing")
        else:
            path.write_bytes(
                {"empty": b"", "truncated": base[: int(rng.integers(len(base)))], "gzip": gzip.compress(base)}[kind]
            )
        return kind, lambda: tried(None if kind in ("gzip", "truncated") else False)
    from astropy.io import fits

    path.write_bytes(base)
    with fits.open(path, memmap=False) as file:
        hdus = [hdu.copy() for hdu in file]
    label, good = (_of_card if how < 7 else _of_plane)(hdus, rng)
    try:
        fits.HDUList(hdus).writeto(path, overwrite=True, output_verify="ignore")
    except Exception as error:  # astropy does not write it: bytes do
        path.write_bytes(mangled_bytes(base, rng))
        return f"bytes, as {type(error).__name__}", lambda: tried(None)
    return label, lambda: tried(good)


def _of_card(hdus: list[Any], rng: np.random.Generator) -> tuple[str, bool | None]:
    """A header card changed in one plane or in all."""
    card = pick(rng, tuple(CARDS))
    value = pick(rng, CARDS[card])
    places = [1, 2, 3] if rng.random() < 0.5 else [int(rng.integers(1, 4))]
    for place in places:
        header = hdus[place].header
        if value is None:
            header.remove(card, ignore_missing=True)
        elif isinstance(value, float) and not np.isfinite(value):
            header[card] = 12345.678
            header.cards[card].verify("ignore")
        else:
            header[card] = value
    return f"{card} = {value!r} in planes {places}", None


def _of_plane(hdus: list[Any], rng: np.random.Generator) -> tuple[str, bool | None]:
    """Another content of a plane."""
    from astropy.io import fits

    place = int(rng.integers(1, 4))
    data, header = hdus[place].data, hdus[place].header
    how = int(rng.integers(12))
    good: bool | None = False
    if how == 0:
        del hdus[place]
    elif how == 1:
        hdus[place] = fits.ImageHDU(data[0], header, name=PLANES[place - 1])
    elif how == 2:
        hdus[place] = fits.ImageHDU(data[:, :-1], header, name=PLANES[place - 1])
    elif how == 3:
        hdus[place] = fits.ImageHDU(data[None].repeat(2, 0), header, name=PLANES[place - 1])
    elif how == 4:
        hdus[place] = fits.ImageHDU(None, name=PLANES[place - 1])
    elif how == 5:
        hdus[place] = fits.BinTableHDU.from_columns([fits.Column("A", "E", array=[1.0])], name=PLANES[place - 1])
    elif how == 6:
        hdus[place] = fits.ImageHDU(data.astype(np.float64), header, name=PLANES[place - 1])
        good = True
    elif how == 7:
        hdus[2].data[2, 2] = np.nan
    elif how == 8:
        hdus[2].data[2, 2] = -3.0
    elif how == 9:
        hdus[1].data[np.unravel_index(np.argmax(hdus[2].data), hdus[2].data.shape)] = pick(rng, (np.nan, np.inf))
    elif how == 10:
        hdus[3] = fits.ImageHDU(hdus[3].data - 10, hdus[3].header, name="HITS")
    else:
        hdus.reverse()
        hdus[0], hdus[-1] = hdus[-1], hdus[0]
        hdus[1:] = hdus[1:][:3]
        good = None
    words = ["missing", "1-D", "narrower", "3-D", "no-data", "table", "float64"]
    words += ["NaN-weight", "negative-weight", "bad-signal", "negative-hits", "order"]
    return f"plane {PLANES[place - 1]}: {words[how]}", good


def tried(good: bool | None) -> Outcome:
    """Read the map, and compare with astropy's own reading of file and coordinates."""
    import warnings

    import mapmaker as mm

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            item = mm.read_fits("mangled.fits")
    except Exception as error:
        outcome = outcome_of_error(error, (ValueError,))
        return (
            Outcome("silent", f"good, but refused: {outcome.text}") if good and outcome.kind == "refused" else outcome
        )
    check(good is not False, "accepted")
    shape = item.hits.shape
    check(
        len(shape) == 3 and item.weight.shape == shape == item.weighted_sum.shape,
        f"planes of {shape}, {item.weight.shape}",
    )
    check(np.isfinite(item.weight).all() and (item.weight >= 0).all(), "weights that are negative or not finite")
    check((item.hits >= 0).all() and item.hits.dtype.kind == "i", "hits that are negative or no integers")
    check(np.isfinite(item.signal_mk).all(), "a signal that is not finite")
    try:
        _as_astropy(item)
    except (ValueError, LookupError, TypeError, ArithmeticError) as error:
        return Outcome("silent", f"accepted; astropy refuses it: {' '.join(str(error).split())[:200]}")
    return Outcome("right")


def _as_astropy(item: Any) -> None:
    """Values and directions of all pixels agree with astropy's."""
    import warnings

    from astropy.io import fits
    from astropy.wcs import WCS

    import mapmaker.geometry as geometry

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with fits.open("mangled.fits", memmap=False) as file:
            planes = {name: np.asarray(file[name].data, float) for name in PLANES}
            units = {name: file[name].header.get("BUNIT", "") for name in PLANES}
            coordinates = [WCS(file[name].header) for name in PLANES]
        _, ny, nx = item.hits.shape
        corners = np.array([[0, 0], [nx - 1, 0], [0, ny - 1], [nx - 1, ny - 1], [nx // 2, ny // 2]])
        wanted = [wcs.celestial.wcs_pix2world(corners, 0) if wcs.has_celestial else None for wcs in coordinates]
    check(units["SIGNAL"] == "mK", f"a signal in {units['SIGNAL']!r} was read as mK")
    seen = planes["WEIGHT"] > 0
    check(np.allclose(item.signal_mk[0][seen], planes["SIGNAL"][seen], rtol=1e-5), "the signal was read otherwise")
    check(
        np.allclose(item.weight[0], planes["WEIGHT"]) and np.allclose(item.hits[0], planes["HITS"]),
        "weights or hits were read otherwise",
    )
    xi, eta = (plane[corners[:, 1], corners[:, 0]] for plane in geometry.pixel_centres(item.geometry))
    ra, dec = np.degrees(geometry.plane_directions(item.geometry, xi, eta))
    for name, wcs, of in zip(PLANES, coordinates, wanted, strict=True):
        check(of is not None and wcs.wcs.ctype[0].startswith("RA---TAN"), f"{name}: no RA---TAN in the file")
        turn = (of[:, 0] - ra + 180) % 360 - 180
        off = np.hypot(turn * np.cos(np.radians(dec)), of[:, 1] - dec)
        check(
            np.nanmax(off) < 1e-3 * np.degrees(item.geometry.pixel_rad) and np.isfinite(off).all(),
            f"{name}: directions are {np.max(off):.3g} deg off",
        )
