"""Sources of catalogues, and clusters of galaxies, on the grid of the simulated sky, through Gaussian beams."""

import math

import numpy as np

from mapmaker.geometry import MapGeometry, pixel_centres, plane_offsets
from mapmaker.profiles import arnaud_profile, beta_profile
from surveysim.scene.passband import Passband
from surveysim.scene.sky import SkyCatalogue, SkyCluster

_REACH = 6.0  # of a source's stamp, in standard deviations: 1.5e-8 of its peak
_SIGMA = math.sqrt(8 * math.log(2))  # full width at half maximum of a Gaussian over its standard deviation
_FAINTEST = 1e-8  # amplitude that the beam leaves at the highest multipole of a cluster
_NODES, _RADII = 16, 1000  # of a panel of the integral, and of the table of a profile


def catalogue_mk(
    section: SkyCatalogue,
    geometry: MapGeometry,
    fwhm_rad: tuple[float, ...],
    band: Passband,
    *,
    flux_scale: float,
) -> np.ndarray:
    """Make the sky (n_beam, n_y, n_x) [mK RJ] of a catalogue through beams of some widths (n_beam,).

    Parameters
    ----------
    flux_scale
        Peak temperature of a point source in a beam, over its flux density, times the squared width of the beam
        [mK rad^2/Jy].
    """
    table, (x, y) = section.table, source_offsets(section, geometry)
    flux_jy = band_flux_jy(section, band)
    found = np.zeros((len(fwhm_rad), geometry.n_y, geometry.n_x))
    xi, eta = pixel_centres(geometry)
    for plane, width in zip(found, fwhm_rad, strict=True):
        total = np.hypot(width, table.fwhm_rad)
        peak_mk = flux_jy * flux_scale / total**2
        for place in np.flatnonzero(np.isfinite(x)):
            columns, across = _profile(xi[0], x[place], total[place] / _SIGMA)
            rows, along = _profile(eta[:, 0], y[place], total[place] / _SIGMA)
            plane[np.ix_(rows, columns)] += peak_mk[place] * np.outer(along, across)
    return found


def _profile(axis_rad: np.ndarray, centre_rad: float, sigma_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Cells of an axis near the centre of a Gaussian, and its values there."""
    cells = np.flatnonzero(np.abs(axis_rad - centre_rad) <= _REACH * sigma_rad)
    return cells, np.exp(-((axis_rad[cells] - centre_rad) ** 2) / (2 * sigma_rad**2))


def source_offsets(section: SkyCatalogue, geometry: MapGeometry) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (n,) east and north [rad] of the sources of a catalogue in the plane; NaN behind it."""
    return plane_offsets(geometry, section.table.ra_rad, section.table.dec_rad)


def band_flux_jy(section: SkyCatalogue, band: Passband) -> np.ndarray:
    """Mean flux densities (n,) of the sources of a catalogue over a band."""
    table = section.table
    if table.spectral_index is None:
        return table.flux_jy * band.power_law(section.flux_frequency_hz, section.spectral_index)
    return table.flux_jy * np.array([band.power_law(section.flux_frequency_hz, item) for item in table.spectral_index])


def cluster_mk(section: SkyCluster, geometry: MapGeometry, fwhm_rad: tuple[float, ...], band: Passband) -> np.ndarray:
    """Make the sky (n_beam, n_y, n_x) [mK RJ] of a cluster through beams of some widths (n_beam,)."""
    xi, eta = pixel_centres(geometry)
    x, y = plane_offsets(geometry, section.ra_rad, section.dec_rad)
    distance = np.hypot(xi - x, eta - y)
    centre_mk = 1e3 * section.y0 * band.sz_k_cmb / band.cmb_per_rj
    return np.stack([centre_mk * profile_in_beam(section, distance, width) for width in fwhm_rad])


def profile_in_beam(section: SkyCluster, distance_rad: np.ndarray, fwhm_rad: float) -> np.ndarray:
    """Profile of a cluster, 1 in its centre before the beam, convolved with a Gaussian beam, at any distances.

    The inverse Hankel transform of the profile times the beam, tabulated against the distance.
    """
    from scipy.interpolate import CubicSpline
    from scipy.special import j0

    highest = math.sqrt(-2 * math.log(_FAINTEST)) * _SIGMA / fwhm_rad
    part, weight = _panels(32 + math.ceil(highest * float(distance_rad.max()) / 4))
    ell = highest * part**3  # the profile of a flat beta model diverges at 0
    measure = weight * 3 * highest * part**2 * ell / (2 * np.pi)
    transform = _transform(section, ell) * np.exp(-((ell * fwhm_rad / _SIGMA) ** 2) / 2)
    # Close radii within the beam, where the profile is steep, and ever wider ones beyond.
    steps = np.linspace(0, np.arcsinh(float(distance_rad.max()) / fwhm_rad), _RADII)
    radius = fwhm_rad * np.sinh(steps)
    table = j0(radius[:, None] * ell) @ (measure * transform)
    return CubicSpline(radius, table)(distance_rad)


def _panels(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of an integral from 0 to 1, by Gauss and Legendre in some panels."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    nodes = (np.arange(count)[:, None] + (1 + node) / 2) / count
    return nodes.ravel(), np.tile(weight / 2 / count, count)


def _transform(section: SkyCluster, ell: np.ndarray) -> np.ndarray:
    if section.profile == "arnaud":
        return arnaud_profile(ell, section.theta_500_rad)
    return beta_profile(ell, section.core_radius_rad, section.beta)
