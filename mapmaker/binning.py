"""Binned maps: sums and hits per pixel, co-adding, FITS and HEALPix out."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapmaker.files import whole_file
from mapmaker.geometry import MapGeometry, pixel_centres, plane_directions, same_geometry, wcs_cards
from mapmaker.kernels.pixels import bin_samples


@dataclass(frozen=True)
class BinnedMap:
    """A map: `weighted_sum` [mK * weight], `weight` and `hits`, each (n_y, n_x)."""

    geometry: MapGeometry
    weighted_sum: np.ndarray
    weight: np.ndarray
    hits: np.ndarray

    @property
    def signal_mk(self) -> np.ndarray:
        """The map in mK, 0 where nothing was observed."""
        return weighted_mean(self.weighted_sum, self.weight)


def weighted_mean(weighted_sum: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """`weighted_sum / weight`, 0 where the weight is 0; leading axes broadcast."""
    return np.divide(weighted_sum, weight, out=np.zeros_like(weighted_sum), where=weight > 0)


def bin_map(
    geometry: MapGeometry, data_mk: np.ndarray, index: np.ndarray, bounds: np.ndarray, kept: np.ndarray
) -> BinnedMap:
    """Bin the kept scans of (n_det, n_samp) streams, each sample with weight 1.

    `index` is what `geometry.pixel_indices` gives; `bounds` (n_scan, 2); `kept` (n_scan,) bool.
    """
    total = np.zeros(geometry.n_y * geometry.n_x)
    hits = np.zeros(geometry.n_y * geometry.n_x, np.int64)
    bin_samples(data_mk, index, bounds, kept, total, hits)
    shape = (geometry.n_y, geometry.n_x)
    return BinnedMap(geometry, total.reshape(shape), hits.reshape(shape).astype(float), hits.reshape(shape))


def coadd(maps: list[BinnedMap], weights: list[float]) -> BinnedMap:
    """The sum of maps of one geometry, each with its weight [1/mK^2 a sample].

    Raises ValueError when there is no map or the geometries differ.
    """
    if not maps:
        raise ValueError("found no map; one or more are expected")
    for number, item in enumerate(maps):
        if not same_geometry(item.geometry, maps[0].geometry):
            raise ValueError(f"map {number} has another geometry than map 0: {item.geometry} and {maps[0].geometry}")
    total = sum(w * item.weighted_sum for item, w in zip(maps, weights, strict=True))
    weight = sum(w * item.weight for item, w in zip(maps, weights, strict=True))
    return BinnedMap(maps[0].geometry, total, weight, sum(item.hits for item in maps))


def write_fits(path: str | Path, item: BinnedMap, header: Mapping[str, object]) -> None:
    """Write signal, weight and hits as image extensions with one WCS, atomically."""
    from astropy.io import fits

    base = fits.Header([(keyword, *card) for keyword, card in wcs_cards(item.geometry).items()])
    planes = [("SIGNAL", item.signal_mk, "mK"), ("WEIGHT", item.weight, "mK-2"), ("HITS", item.hits, "")]
    images = [fits.PrimaryHDU()]
    for key, value in header.items():
        images[0].header[key] = value
    for name, data, unit in planes:
        kind = _integers(data) if name == "HITS" else np.float32
        image = fits.ImageHDU(data.astype(kind), header=base, name=name)
        image.header["BUNIT"] = unit
        images.append(image)
    with whole_file(path) as partial:
        fits.HDUList(images).writeto(partial, overwrite=True)


def _integers(hits: np.ndarray) -> type:
    """The smaller type of the integers of FITS that holds all hits."""
    return np.int32 if hits.max(initial=0) < 2**31 else np.int64


def read_fits(path: str | Path) -> BinnedMap:
    """Read a map written by `write_fits`; raises ValueError for an unreadable or truncated file."""
    from astropy.io import fits

    try:
        with fits.open(path, memmap=False) as file:
            signal, weight, hits = (file[name].data.astype(float) for name in ("SIGNAL", "WEIGHT", "HITS"))
            header = file["SIGNAL"].header
            center = np.radians([header["CRVAL1"], header["CRVAL2"]])
            pixel = float(np.radians(header["CDELT2"]))
    except (OSError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{path}: not a whole map file ({error})") from None
    geometry = MapGeometry(float(center[0]), float(center[1]), pixel, signal.shape[1], signal.shape[0])
    return BinnedMap(geometry, signal * weight, weight, hits.astype(np.int64))


def write_healpix(path: str | Path, item: BinnedMap, nside: int) -> None:
    """Write the map re-binned to HEALPix (partial sky, nested): signal, weight and hits, atomically.

    Each tangent-plane pixel goes to the HEALPix pixel of its centre; weights add.
    """
    import healpy
    from astropy.io import fits

    rows, columns = np.nonzero(item.weight > 0)
    xi, eta = (plane[rows, columns] for plane in pixel_centres(item.geometry))
    ra, dec = plane_directions(item.geometry, xi, eta)
    pixel, slot = np.unique(healpy.ang2pix(nside, np.pi / 2 - dec, ra, nest=True), return_inverse=True)
    total, weight, hits = (
        np.bincount(slot, plane[rows, columns], len(pixel)) for plane in (item.weighted_sum, item.weight, item.hits)
    )
    columns = [
        fits.Column("PIXEL", "K", array=pixel),
        fits.Column("SIGNAL", "E", "mK", array=total / weight),
        fits.Column("WEIGHT", "E", "mK-2", array=weight),
        fits.Column("HITS", "J" if _integers(hits) is np.int32 else "K", array=hits),
    ]
    table = fits.BinTableHDU.from_columns(columns)
    keywords = {"PIXTYPE": "HEALPIX", "ORDERING": "NESTED", "NSIDE": nside, "COORDSYS": "C"}
    table.header.update(keywords | {"INDXSCHM": "EXPLICIT", "OBJECT": "PARTIAL"})
    # healpy's own writer wants the whole sphere in memory: 10 GB at nside 8192.
    with whole_file(path) as partial:
        fits.HDUList([fits.PrimaryHDU(), table]).writeto(partial, overwrite=True)
