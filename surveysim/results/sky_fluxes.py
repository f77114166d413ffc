"""Fluxes of the sources and clusters of a scene in its maps, before and after scans and cleaning.

A flux is compensated aperture photometry: the sum over a disc about the source, less that over a ring of equal area
around it. Its radius is the full width at half maximum of the source behind the beam. What cleaning leaves of it is
expected from the transfer function and the profile of the source.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mapmaker.binning import weighted_mean
from mapmaker.geometry import MapGeometry, pixel_centres, plane_offsets
from mapmaker.spectrum import mode_multiplicity
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.setup import Setup
from surveysim.scene.map_units import SR_PER_FWHM2
from surveysim.scene.scene import Scene
from surveysim.scene.sky import SkyCluster
from surveysim.survey.coadds import CoAdds, jackknife_signs, noise_weights
from surveysim.telescope.diffraction import effective_area_m2
from surveysim.timestreams.fixed_sky import peak_mk_per_jy
from surveysim.timestreams.sky_sources import band_flux_jy, profile_in_beam

MOST_SOURCES = 200  # of a scene


@dataclass(frozen=True)
class SourceFlux:
    """Flux of a source or a cluster in the maps of one data set, in a compensated aperture.

    Attributes
    ----------
    source, kind
        Name, and part of the scene's sky.
    ra_rad, dec_rad
        Direction.
    catalogue_mjy
        Flux density in the band that the scene gives; NaN for a cluster.
    aperture_rad
        Radius of the disc.
    input_mjy, output_mjy
        In the sky that goes in, and in the map of it without noise. All that lies in the aperture counts.
    transfer
        Share of a flux of this profile that the transfer function leaves.
    measured_mjy, error_mjy
        In the co-added map of the actual data, and its noise: that of sign-flipped co-adds in apertures anywhere on the
        patch, scaled by the weights.
    """

    source: str
    kind: Literal["point source", "catalogue", "cluster"]
    ra_rad: float
    dec_rad: float
    catalogue_mjy: float
    aperture_rad: float
    input_mjy: float
    output_mjy: float
    transfer: float
    measured_mjy: float
    error_mjy: float

    @property
    def ratio(self) -> float:
        """Output over input, both over their transfer: 1 where the transfer function is right."""
        return self.output_mjy / self.transfer / self.input_mjy if self.transfer and self.input_mjy else math.nan


@dataclass(frozen=True)
class _Source:
    name: str
    kind: Literal["point source", "catalogue", "cluster"]
    ra_rad: float
    dec_rad: float
    flux_jy: float
    size_rad: float
    cluster: SkyCluster | None = None


def source_fluxes(
    setup: Setup,
    coadds: CoAdds,
    data_set: str,
    *,
    geometry: MapGeometry,
    maps: tuple[np.ndarray, np.ndarray],
    weight: np.ndarray,
    transfer: np.ndarray,
) -> tuple[SourceFlux, ...]:
    """Measure the fluxes of sources whose aperture the patch holds: those of the scene file, then the brightest.

    Parameters
    ----------
    geometry
        Pixels of the patch.
    maps : (n, n) each
        Sky that goes in, and map that comes out [mK RJ].
    weight : (n, n)
        Weights of the map.
    transfer : (n_pad, n_pad // 2 + 1)
        Amplitude transfer function of the modes of the padded patch.
    """
    analysis, patch = setup.analysis, setup.analysis.region.patch
    s = analysis.data_set_names.index(data_set)
    there = coadds.weight[s][patch, patch]
    measured = weighted_mean(coadds.sums[s][patch, patch], there)
    psd = _noise_psd(analysis, _without_sky(analysis, coadds, s, measured, there), there)
    width_rad = float(analysis.beams.fwhm_rad @ analysis.beams.share)
    to_mjy = (
        1e3
        * geometry.pixel_rad**2
        / (peak_mk_per_jy(setup.scene) * SR_PER_FWHM2 * setup.scene.instrument.beam_fwhm_rad**2)
    )
    found = []
    for source in sorted(_sources(setup.scene), key=_order)[:MOST_SOURCES]:
        radius = math.hypot(width_rad, source.size_rad)
        aperture = _aperture(geometry, source, radius, weight * there)
        if aperture is None:
            continue
        fluxes = [to_mjy * float(np.sum(aperture * item)) for item in (*maps, measured)]
        share = _left(_profile(geometry, source, width_rad), aperture, transfer)
        found.append(
            SourceFlux(
                source=source.name,
                kind=source.kind,
                ra_rad=source.ra_rad,
                dec_rad=source.dec_rad,
                catalogue_mjy=math.nan if source.cluster else 1e3 * source.flux_jy,
                aperture_rad=radius,
                input_mjy=fluxes[0],
                output_mjy=fluxes[1],
                transfer=share,
                measured_mjy=fluxes[2],
                error_mjy=to_mjy * _scatter(aperture, there, psd),
            )
        )
    return tuple(found)


def _without_sky(
    analysis: AnalysisSetup, coadds: CoAdds, data_set: int, measured: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Sign-flipped co-adds (K, n, n) less the sky that an uneven share of signs leaves in them, of the map's noise."""
    signs = np.stack([jackknife_signs(analysis.scene, first) for first in range(coadds.first, coadds.end)], axis=1)
    each = noise_weights(coadds.noise_mk2()[:, data_set])
    uneven = (signs @ each / max(each.sum(), 1e-300))[:, None, None]
    flipped = weighted_mean(coadds.flipped[:, data_set], weight) - uneven * measured
    return flipped / np.sqrt(np.maximum(1 - uneven**2, 1e-9))


def _noise_psd(analysis: AnalysisSetup, flipped: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Power of the noise in each mode of the padded patch, over that of white noise with the variance of the weights.

    The noise is even, but for the weights (n, n).
    """
    from scipy.fft import rfft2

    region = analysis.region
    modes = rfft2(region.pad(region.taper * np.sqrt(weight) * flipped), workers=1)
    return np.mean(np.abs(modes) ** 2, axis=0) / np.sum(region.taper**2)


def _scatter(aperture: np.ndarray, weight: np.ndarray, psd: np.ndarray) -> float:
    """Noise of a flux: that of its aperture anywhere on the patch, with the weight at its place."""
    from scipy.fft import rfft2

    n_pad, used = len(psd), aperture != 0
    power = np.abs(rfft2(aperture, (n_pad, n_pad), workers=1)) ** 2 * mode_multiplicity(n_pad, n_pad).reshape(psd.shape)
    squares = aperture[used] ** 2
    variance = np.sum(power * psd) / n_pad**2 * np.sum(squares / weight[used]) / np.sum(squares)
    return float(np.sqrt(variance))


def _order(source: _Source) -> tuple[bool, float]:
    """Place of a source: those of the scene file before those of catalogues, each by brightness."""
    return source.kind == "catalogue", -abs(source.flux_jy)


def _sources(scene: Scene) -> Iterator[_Source]:
    """All sources of a scene; the flux of a cluster is that of its centre in the beam, for their order alone."""
    from surveysim.timestreams.sky_maps import source_peak_mk

    band, area_m2, of_jy = scene.instrument.band, effective_area_m2(scene), peak_mk_per_jy(scene)
    for number, item in enumerate(scene.sky.point_sources):
        flux_jy = source_peak_mk(item, band, area_m2) / of_jy
        yield _Source(f"point source {number}", "point source", item.ra_rad, item.dec_rad, flux_jy, 0.0)
    for section in scene.sky.catalogues:
        table, flux = section.table, band_flux_jy(section, band)
        columns = (values.tolist() for values in (table.ra_rad, table.dec_rad, flux, table.fwhm_rad))
        for name, ra_rad, dec_rad, flux_jy, size_rad in zip(table.names, *columns, strict=True):
            yield _Source(name, "catalogue", ra_rad, dec_rad, flux_jy, size_rad)
    for number, cluster in enumerate(scene.sky.clusters):
        peak_jy = 1e3 * cluster.y0 * band.sz_k_cmb / band.cmb_per_rj / of_jy
        size_rad = cluster.theta_500_rad or cluster.core_radius_rad
        yield _Source(f"cluster {number}", "cluster", cluster.ra_rad, cluster.dec_rad, peak_jy, size_rad, cluster)


def _distance(geometry: MapGeometry, source: _Source) -> np.ndarray:
    xi, eta = pixel_centres(geometry)
    x, y = plane_offsets(geometry, source.ra_rad, source.dec_rad)
    return np.hypot(xi - x, eta - y)


def _aperture(geometry: MapGeometry, source: _Source, radius_rad: float, weight: np.ndarray) -> np.ndarray | None:
    """Weights (n, n) of the pixels in a flux; None unless all have data and lie on the patch."""
    x, y = plane_offsets(geometry, source.ra_rad, source.dec_rad)
    outer_rad = math.sqrt(2) * radius_rad
    if not max(abs(x), abs(y)) + outer_rad <= geometry.n_x * geometry.pixel_rad / 2:  # NaN behind the plane
        return None
    distance = _distance(geometry, source)
    disc, ring = distance <= radius_rad, (distance > radius_rad) & (distance <= outer_rad)
    if not (disc.any() and ring.any() and (weight[disc | ring] > 0).all()):
        return None
    return disc - ring * (disc.sum() / ring.sum())


def _profile(geometry: MapGeometry, source: _Source, fwhm_rad: float) -> np.ndarray:
    """Profile (n, n) of a source behind the beam, of any height."""
    distance = _distance(geometry, source)
    if source.cluster is not None:
        return profile_in_beam(source.cluster, distance, fwhm_rad)
    return 2.0 ** (-((2 * distance / math.hypot(fwhm_rad, source.size_rad)) ** 2))


def _left(profile: np.ndarray, aperture: np.ndarray, transfer: np.ndarray) -> float:
    """Share of a flux that a transfer function leaves."""
    from scipy.fft import rfft2

    n_pad = len(transfer)
    before, weight = (rfft2(item, (n_pad, n_pad), workers=1) for item in (profile, aperture))
    both = (before.conj() * weight).real * mode_multiplicity(n_pad, n_pad).reshape(transfer.shape)
    return float(np.sum(both * transfer) / np.sum(both))
