"""Binned maps: sums and hits per pixel, co-adding, FITS and HEALPix files."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.errors import InputError
from mapmaker.files import atomic_write, one_line, regular_file
from mapmaker.fits_images import write_images
from mapmaker.geometry import (
    MapGeometry,
    check_nside,
    pixel_centres,
    plane_directions,
    same_geometry,
    wcs_cards,
)
from mapmaker.validation import (
    argument_error,
    bounds_of_scans,
    flags,
    integers,
    number,
    pixel_numbers,
    reals,
    single_precision,
)

# Optional cards of a map's header, with the values that do not change the coordinates of `wcs_cards`: FK5 agrees with
# ICRS within 0.1 arcsec.
_AS_BY_DEFAULT = {
    "CUNIT1": ("deg",),
    "CUNIT2": ("deg",),
    "PC1_1": (1,),
    "PC2_2": (1,),
    "PC1_2": (0,),
    "PC2_1": (0,),
    "CROTA1": (0,),
    "CROTA2": (0,),
    "LONPOLE": (180,),
    "RADESYS": ("ICRS", "FK5"),
    "EQUINOX": (2000,),
}
_TURNS_OR_DISTORTS = re.compile(r"CD[12]_[12]|P[VS][12]_\d+|[AB]P?_ORDER|(CPDIS|CQDIS|D2IMDIS)[12]")
STOKES = ("I",)  # Stokes parameters of a map, its first axis
HITS_UNIT, INVERSE_VARIANCE_UNIT = "count", "mK-2"  # units of weights in FITS


@dataclass(frozen=True)
class BinnedMap:
    """Map on square pixels.

    Attributes
    ----------
    geometry
    weighted_sum : (n_stokes, n_y, n_x)
        [mK times the unit of the weight]; the Stokes parameters are those of `STOKES`, I alone.
    weight, hits : (n_stokes, n_y, n_x)
    weight_unit
        "count" for weights that are hits, as from `bin_map`; "mK-2" for inverse variances.
    """

    geometry: MapGeometry
    weighted_sum: np.ndarray
    weight: np.ndarray
    hits: np.ndarray
    weight_unit: str = INVERSE_VARIANCE_UNIT

    @property
    def signal_mk(self) -> np.ndarray:
        """Map (n_stokes, n_y, n_x) in mK; 0 in unobserved pixels."""
        return weighted_mean(self.weighted_sum, self.weight)


def map_shape(geometry: MapGeometry) -> tuple[int, int, int]:
    """Shape (n_stokes, n_y, n_x) of the planes of a map."""
    return len(STOKES), geometry.n_y, geometry.n_x


def weighted_mean(weighted_sum: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Divide `weighted_sum` by `weight`, 0 where the weight is 0; leading axes broadcast."""
    return np.divide(weighted_sum, weight, out=np.zeros_like(weighted_sum), where=weight > 0)


def bin_map(
    geometry: MapGeometry, data_mk: np.ndarray, index: np.ndarray, bounds: np.ndarray, *, kept: np.ndarray
) -> BinnedMap:
    """Bin the kept scans of time-streams, with weight 1 for each sample.

    Parameters
    ----------
    geometry
    data_mk : (n_det, n_samp)
    index : (n_det, n_samp)
        Pixels from `pixel_indices`; -1 off the map.
    bounds : (n_scan, 2)
        Scans [start, stop).
    kept : (n_scan,)
        Flags of the scans to bin.

    Raises
    ------
    ValueError
        For shapes and types that do not match, pixels outside the map, scans outside the streams or overlapping, and
        values on the map that are not finite in kept scans.
    """
    from mapmaker.kernels.pixels import bin_samples

    data = reals("data_mk", data_mk, ("n_det", "n_samp"), finite=False)
    n_pixel = geometry.n_y * geometry.n_x
    index = pixel_numbers(index, data.shape, n_pixel)
    bounds = bounds_of_scans(bounds, data.shape[1])
    kept = flags("kept", kept, (len(bounds),), empty=True)
    total, hits = np.zeros(n_pixel), np.zeros(n_pixel, np.int64)
    bin_samples(data, index, bounds, kept, total, hits)
    # The sums are checked instead of the samples, because there are fewer pixels.
    if not np.isfinite(total).all():
        raise argument_error(
            "data_mk", "values that are not finite in kept scans", "finite ones, or kept False for them, are"
        )
    shape = map_shape(geometry)
    return BinnedMap(geometry, total.reshape(shape), hits.reshape(shape).astype(float), hits.reshape(shape), HITS_UNIT)


def coadd(maps: Sequence[BinnedMap], weights: Sequence[float]) -> BinnedMap:
    """Co-add maps of one geometry.

    Parameters
    ----------
    maps
    weights : (n_map,)
        Inverse variances a sample [1/mK^2] for maps whose weights are hits; plain factors for maps whose weights are
        inverse variances.

    Raises
    ------
    ValueError
        For no map, different geometries, and weights that are not finite and at least 0; and as `checked_map`.
    """
    if not maps:
        raise ValueError("found no map; one or more are expected")
    weights = reals("weights", weights, (len(maps),), least=0).tolist()
    for k, item in enumerate(maps):
        if not same_geometry(item.geometry, maps[0].geometry):
            raise ValueError(f"map {k} has another geometry than map 0: {item.geometry} and {maps[0].geometry}")
    maps = [checked_map(item, f"maps[{k}]") for k, item in enumerate(maps)]
    total: Any = sum(w * item.weighted_sum for item, w in zip(maps, weights, strict=True))
    weight: Any = sum(w * item.weight for item, w in zip(maps, weights, strict=True))
    hits: Any = sum(item.hits for item in maps)
    return BinnedMap(maps[0].geometry, total, weight, hits)


def half_difference(one: BinnedMap, other: BinnedMap) -> BinnedMap:
    """Noise map of the co-add of two maps, from their difference.

    For maps of the weights V and W, ``(m_V - m_W) sqrt(V W) / (V + W)`` has the variance of the co-add, ``1 / (V +
    W)``, if weights are inverse variances up to a factor. The sky, which is the same in both, cancels. Pixels that one
    map lacks are unobserved.

    Raises
    ------
    ValueError
        As `coadd`, and for weights of different units.
    """
    if one.weight_unit != other.weight_unit:
        raise argument_error("weight_unit", f"{one.weight_unit!r} and {other.weight_unit!r}", "maps of one unit are")
    both = coadd([one, other], [1.0, 1.0])
    seen = (one.weight > 0) & (other.weight > 0)
    scale = np.sqrt(one.weight * other.weight, out=np.zeros(seen.shape), where=seen)
    return replace(
        both,
        weighted_sum=(one.signal_mk - other.signal_mk) * scale,
        weight=np.where(seen, both.weight, 0.0),
        hits=np.where(seen, both.hits, 0),
        weight_unit=one.weight_unit,
    )


def checked_map(item: BinnedMap, name: str = "map") -> BinnedMap:
    """Check a map and convert its planes to native types.

    Raises
    ------
    ValueError
        For planes of another shape than the geometry's, sums that are not finite, weights and hits that are not finite
        and at least 0, and unknown units of weights.
    """
    shape = map_shape(item.geometry)
    if item.weight_unit not in (HITS_UNIT, INVERSE_VARIANCE_UNIT):
        raise argument_error(f"{name}.weight_unit", item.weight_unit, f"{HITS_UNIT!r} or {INVERSE_VARIANCE_UNIT!r} is")
    return replace(
        item,
        weighted_sum=reals(f"{name}.weighted_sum", item.weighted_sum, shape),
        weight=reals(f"{name}.weight", item.weight, shape, least=0),
        hits=integers(f"{name}.hits", item.hits, shape, least=0).astype(np.int64, copy=False),
    )


def write_fits(path: str | Path, item: BinnedMap, header: Mapping[str, object]) -> None:
    """Write signal, weight and hits of Stokes I as image extensions (n_y, n_x) with one WCS, atomically.

    Raises
    ------
    ValueError
        As `checked_map`, for values beyond single precision, and for a header that FITS cannot hold.
    """
    item = checked_map(item)
    base = wcs_cards(item.geometry)
    planes = [
        ("SIGNAL", single_precision("signal_mk", item.signal_mk), "mK"),
        ("WEIGHT", single_precision("weight", item.weight), item.weight_unit),
        ("HITS", item.hits.astype(_integers(item.hits)), ""),
    ]
    write_images(path, header, [(name, data[0], base, unit) for name, data, unit in planes])


def _integers(hits: np.ndarray) -> type:
    """Smaller integer type of FITS that holds all hits."""
    return np.int32 if hits.max(initial=0) < 2**31 else np.int64


def read_fits(path: str | Path) -> BinnedMap:
    """Read a map in the format of `write_fits`; compressed, scaled and integer images are converted.

    Raises
    ------
    InputError
        In one line that names the file: for one that is unreadable, truncated or no regular file, for planes whose
        shapes or WCS differ or do not fit `MapGeometry`, and for other units or invalid values.
    """
    from astropy.io import fits

    regular_file(path, "map file")
    try:
        with fits.open(path, memmap=False) as file:
            return _map_of(file)
    except Exception as error:  # astropy raises nearly every kind of exception for a mangled file
        raise InputError(f"{path}: not a whole map file ({one_line(error)})") from None


def _map_of(file: Any) -> BinnedMap:
    planes = {name: _plane(name, file[name]) for name in ("SIGNAL", "WEIGHT", "HITS")}
    geometry = _geometry_of("SIGNAL", file["SIGNAL"].header, planes["SIGNAL"].shape)
    for name in ("WEIGHT", "HITS"):
        if not same_geometry(_geometry_of(name, file[name].header, planes[name].shape), geometry):
            raise argument_error(name, f"other coordinates or the shape {planes[name].shape}", "those of SIGNAL are")
    units = {name: str(file[name].header.get("BUNIT", "")).strip() for name in planes}
    if units["SIGNAL"] != "mK":
        raise argument_error("SIGNAL", f"the unit {units['SIGNAL']!r}", "'mK' is")
    weight, hits = planes["WEIGHT"], planes["HITS"]
    if not np.array_equal(hits, np.rint(hits)):
        raise argument_error("HITS", "numbers with fractions", "whole numbers are")
    # Files of other programs may have NaN in unobserved pixels.
    signal = np.where((weight == 0) & np.isnan(planes["SIGNAL"]), 0.0, planes["SIGNAL"])
    with np.errstate(over="ignore", invalid="ignore"):  # the check finds what is not finite
        total = signal * weight
    item = BinnedMap(geometry, total[None], weight[None], hits.astype(np.int64)[None], units["WEIGHT"])
    return checked_map(item, "planes")


def _plane(name: str, image: Any) -> np.ndarray:
    if image.data is None or not hasattr(image, "shape"):
        raise argument_error(name, type(image).__name__, "an image is")
    return reals(name, image.data, ("n_y", "n_x"), finite=name == "HITS").astype(float)


def _geometry_of(name: str, header: Any, shape: tuple[int, int]) -> MapGeometry:
    """Read the geometry from a header; raises ValueError where it is not of square pixels about its centre."""
    n_y, n_x = shape
    ra_deg = number("CRVAL1", header["CRVAL1"], least=-720, most=720)  # two turns at most
    dec_deg, pixel_deg = (number(key, header[key]) for key in ("CRVAL2", "CDELT2"))
    ra_rad, dec_rad, pixel_rad = np.radians([ra_deg, dec_deg, pixel_deg]).tolist()
    geometry = MapGeometry(ra_rad, dec_rad, pixel_rad, n_x, n_y)
    cards = wcs_cards(geometry)
    for key in ("CRPIX1", "CRPIX2", "CDELT1", "CTYPE1", "CTYPE2"):
        wanted, found = cards[key][0], header.get(key)
        same = found == wanted if isinstance(wanted, str) else bool(np.isclose(number(key, found), wanted, 1e-9))
        if not same:
            raise argument_error(f"{name}: {key}", found, f"{wanted} is")
    for key, allowed in _AS_BY_DEFAULT.items():
        if key in header and header[key] not in allowed:
            raise argument_error(f"{name}: {key}", header[key], f"{allowed[0]} or no such card is")
    for key in filter(_TURNS_OR_DISTORTS.fullmatch, header):
        raise argument_error(
            name, f"coordinates that {key} turns, shears or distorts", "none of CD, PC, PV, CROTA and SIP is"
        )
    return geometry


def write_healpix(path: str | Path, item: BinnedMap, nside: int) -> None:
    """Write Stokes I re-binned to HEALPix (partial sky, nested): signal, weight and hits, atomically.

    Each tangent-plane pixel goes to the HEALPix pixel of its centre; weights add.

    Parameters
    ----------
    path
    item
    nside
        A power of two up to `finest_nside`; a larger one would leave holes.

    Raises
    ------
    ValueError
        As `checked_map`, and for an `nside` that is not allowed.
    """
    check_nside("nside", nside, item.geometry.pixel_rad)
    import healpy

    item = checked_map(item)
    rows, columns = np.nonzero(item.weight[0] > 0)
    xi, eta = (plane[rows, columns] for plane in pixel_centres(item.geometry))
    ra, dec = plane_directions(item.geometry, xi, eta)
    pixel, slot = np.unique(healpy.ang2pix(nside, np.pi / 2 - dec, ra, nest=True), return_inverse=True)
    total, weight, hits = (
        np.bincount(slot, plane[0, rows, columns], len(pixel)) for plane in (item.weighted_sum, item.weight, item.hits)
    )
    planes = {"weighted_sum": total, "weight": weight, "hits": hits}
    write_healpix_pixels(path, nside, pixel=pixel, **planes, weight_unit=item.weight_unit)


def write_healpix_pixels(
    path: str | Path,
    nside: int,
    *,
    pixel: np.ndarray,
    weighted_sum: np.ndarray,
    weight: np.ndarray,
    hits: np.ndarray,
    weight_unit: str,
) -> None:
    """Write sums on HEALPix pixels (partial sky, nested) as signal, weight and hits, atomically.

    Parameters
    ----------
    path, nside
    pixel : (n_pixel,)
        Numbers, increasing.
    weighted_sum, weight, hits : (n_pixel,)
        As in `BinnedMap`; weights are above 0.
    weight_unit
    """
    from astropy.io import fits

    table_columns = [
        fits.Column("PIXEL", "K", array=pixel),
        fits.Column("SIGNAL", "E", "mK", array=single_precision("signal_mk", weighted_sum / weight)),
        fits.Column("WEIGHT", "E", weight_unit, array=single_precision("weight", weight)),
        fits.Column("HITS", "J" if _integers(hits) is np.int32 else "K", array=hits),
    ]
    table = fits.BinTableHDU.from_columns(table_columns)
    keywords = {"PIXTYPE": "HEALPIX", "ORDERING": "NESTED", "NSIDE": nside, "COORDSYS": "C"}
    table.header.update(keywords | {"INDXSCHM": "EXPLICIT", "OBJECT": "PARTIAL"})
    # healpy's writer needs the whole sphere in memory: 10 GB at nside 8192.
    with atomic_write(path) as partial:
        fits.HDUList([fits.PrimaryHDU(), table]).writeto(partial, overwrite=True)
