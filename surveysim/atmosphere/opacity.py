"""Band-averaged optical depth of a site's zenith against water vapour, and the atmospheric noise that scales with it.

Tables of the `am` atmospheric model are in ``tables/``, with the script that builds them.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files

import numpy as np

from surveysim.atmosphere.cubic_spline import CubicSpline, stacked_splines
from surveysim.runtime.errors import OutOfRangeError
from surveysim.scene.passband import Passband
from surveysim.scene.sites import SITES


@dataclass(frozen=True)
class BandOpacity:
    """Opacity of a site in a band.

    Attributes
    ----------
    site
    band
        Passband.
    pwv_mm : (n,)
        Columns of precipitable water vapour.
    optical_depth : (n,)
        Zenith optical depth at these columns.
    spectral_depth : (m, n)
        The same at each node of the band.
    temperature_k
        Physical temperature of the water vapour.
    """

    site: str
    band: Passband
    pwv_mm: np.ndarray
    optical_depth: np.ndarray
    spectral_depth: np.ndarray
    temperature_k: float

    @cached_property
    def spline(self) -> Callable[..., np.ndarray]:
        """Cubic spline of the optical depth against water vapour [mm]."""
        return CubicSpline(self.pwv_mm, self.optical_depth)

    @cached_property
    def spectral_spline(self) -> Callable[..., np.ndarray]:
        """Cubic splines of `spectral_depth` against water vapour [mm]: arrays (m,) of a single number."""
        return stacked_splines(self.pwv_mm, self.spectral_depth)


@cache
def band_opacity(site: str, band: Passband) -> BandOpacity:
    """Average a site's opacity table over a band: -ln of the mean transmission.

    Cells of the table are weighted by their share of the band.

    Raises
    ------
    ValueError
        For a site without a table, and for a band that is empty or extends beyond the table.
    """
    edge_ghz, pwv_mm, depth, temperature_k = _table(site)
    low, high = (edge / 1e9 for edge in band.edges_hz)
    if not (edge_ghz[0] <= low < high <= edge_ghz[-1]):
        raise OutOfRangeError(
            f"found a band of {low:g} to {high:g} GHz; bands within {edge_ghz[0]:g} to {edge_ghz[-1]:g} GHz are allowed"
        )
    averaged = -np.log(band.cell_shares(edge_ghz * 1e9) @ np.exp(-depth))
    averaged.setflags(write=False)
    return BandOpacity(site, band, pwv_mm, averaged, _at_nodes(edge_ghz, depth, band), temperature_k)


def _at_nodes(edge_ghz: np.ndarray, depth: np.ndarray, band: Passband) -> np.ndarray:
    """Interpolate optical depths (k, n) of cells linearly to the nodes of a band (m, n)."""
    centre_hz = (edge_ghz[1:] + edge_ghz[:-1]) / 2 * 1e9
    return np.array([np.interp(band.nodes[0], centre_hz, column) for column in depth.T]).T


@cache
def _table(site: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Read cell edges (m + 1,) [GHz], PWV (n,) [mm], optical depth (m, n) and temperature [K] of a site."""
    if site not in SITES:
        raise OutOfRangeError(f"found site {site!r}; {', '.join(SITES)} are allowed")
    text = (files("surveysim.atmosphere") / "tables" / f"opacity_{site}.ecsv").read_text(encoding="utf-8")
    # By numpy, as astropy's tables take long to import.
    names, *rows = (line for line in text.splitlines() if not line.startswith("#"))
    values = np.loadtxt(rows)
    centre_ghz, depth = values[:, 0], np.ascontiguousarray(values[:, 1:])
    edge_ghz = np.append(centre_ghz - 0.5, centre_ghz[-1] + 0.5)
    pwv_mm = np.array([float(name.removeprefix("pwv_")) for name in names.split()[1:]])
    pwv_mm.setflags(write=False)
    return edge_ghz, pwv_mm, depth, float(re.search(r"atmosphere_temperature: ([\d.]+)", text)[1])


def optical_depth(band: BandOpacity, pwv_mm: float | np.ndarray) -> np.ndarray:
    """Interpolate the zenith optical depth at water columns of any shape [mm].

    Raises
    ------
    ValueError
        Outside the table.
    """
    return band.spline(_allowed(band, pwv_mm))


def spectral_depth(band: BandOpacity, pwv_mm: float) -> np.ndarray:
    """Interpolate the zenith optical depth (m,) at the nodes of the band; raises as `optical_depth`."""
    return band.spectral_spline(float(_allowed(band, pwv_mm)))


def optical_depth_slope(band: BandOpacity, pwv_mm: float | np.ndarray) -> np.ndarray:
    """Derivative of the zenith optical depth with the water column [1/mm], of any shape; raises as `optical_depth`."""
    return band.spline(_allowed(band, pwv_mm), 1)


def fluctuation_factor_mk2(band: BandOpacity, pwv_mm: float | np.ndarray) -> np.ndarray:
    """Squared amplitude of fluctuations of the water column by its own size [mK^2], for columns of any shape [mm].

    It is ``(C d tau / dC)^2 B_atm^2``, to which B2 is proportional, in temperature above the atmosphere: the emission
    changes by B_atm d(1 - exp(-tau)), and the measured signal is divided by the transmission exp(-tau), at any
    elevation. B_atm is the Rayleigh-Jeans brightness of the atmosphere. The factor replaces ``(C d eps / dC)^2
    B_atm^2`` of section 3.3, where the paper has eps = 1 - exp(tau).

    Raises
    ------
    ValueError
        As `optical_depth`.
    """
    return (np.asarray(pwv_mm) * optical_depth_slope(band, pwv_mm) * band.temperature_k * 1e3) ** 2


def _allowed(band: BandOpacity, pwv_mm: float | np.ndarray) -> np.ndarray:
    pwv_mm = np.asarray(pwv_mm, dtype=float)
    first, last = band.pwv_mm[0], band.pwv_mm[-1]
    wrong = ~((pwv_mm >= first) & (pwv_mm <= last))
    if wrong.any():
        raise OutOfRangeError(
            f"found {pwv_mm[wrong].flat[0]:g} mm of water vapour; {first:g} to {last:g} mm is allowed"
        )
    return pwv_mm
