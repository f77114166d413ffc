"""Optical depth of a site's zenith against water vapour, averaged over a band, and the noise it scales.

Tables of the `am` atmospheric model lie in ``tables/`` with the script that builds them.
"""

import re
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files

import numpy as np

from surveysim.runtime.errors import OutOfRangeError
from surveysim.scene.sites import SITES


@dataclass(frozen=True)
class BandOpacity:
    """A site seen through a top-hat band: zenith optical depth (n,) at columns of water vapour (n,) [mm].

    `temperature_k` is the physical temperature of the water vapour, `bandwidth` the width over the centre.
    """

    site: str
    frequency_hz: float
    bandwidth: float
    pwv_mm: np.ndarray
    optical_depth: np.ndarray
    temperature_k: float

    @cached_property
    def spline(self):
        """Cubic spline through the optical depths, against water [mm]."""
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.pwv_mm, self.optical_depth)


@cache
def band_opacity(site: str, frequency_hz: float, bandwidth: float) -> BandOpacity:
    """Average a site's table over a top-hat band: -ln of the mean transmission.

    Cells at the band's edges count by the part that lies inside. Raises ValueError for a site without a
    table, and for a band that is empty or leaves the table.
    """
    edge_ghz, pwv_mm, depth, temperature_k = _table(site)
    low, high = (frequency_hz * (1 + side * bandwidth / 2) / 1e9 for side in (-1, 1))
    if not (edge_ghz[0] <= low < high <= edge_ghz[-1]):
        raise OutOfRangeError(
            f"found a band of {low:g} to {high:g} GHz; bands within {edge_ghz[0]:g} to {edge_ghz[-1]:g} GHz are allowed"
        )
    inside = np.diff(np.clip(edge_ghz, low, high))
    averaged = -np.log(inside @ np.exp(-depth) / (high - low))
    averaged.setflags(write=False)
    return BandOpacity(site, frequency_hz, bandwidth, pwv_mm, averaged, temperature_k)


@cache
def _table(site):
    """Cell edges (m + 1,) [GHz], PWV (n,) [mm], optical depth (m, n), temperature [K]."""
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


def optical_depth(band: BandOpacity, pwv_mm) -> np.ndarray:
    """Zenith optical depth at water columns of any shape [mm]: a cubic spline, for it is nearly a straight line.

    Raises ValueError outside the table.
    """
    return band.spline(_allowed(band, pwv_mm))


def optical_depth_slope(band: BandOpacity, pwv_mm) -> np.ndarray:
    """Derivative of the zenith optical depth with the water column [1/mm], any shape; errors as `optical_depth`."""
    return band.spline(_allowed(band, pwv_mm), 1)


def fluctuation_factor_mk2(band: BandOpacity, pwv_mm) -> np.ndarray:
    """Amplitude of constant fractional fluctuations of the water column in the band, squared [mK^2], any shape.

    ``(C d tau / dC)^2 B_atm^2``, in temperature above the atmosphere as noise and sky are: the emission changes by
    B_atm d(1 - exp(-tau)), and what is measured is over the transmission exp(-tau), at any elevation. The brightness of
    the atmosphere is its temperature, Rayleigh-Jeans. B2 is proportional to it. It stands for ``(C d eps / dC)^2
    B_atm^2`` of section 3.3, where the paper's eps is 1 - exp(tau). Errors as `optical_depth`.
    """
    return (np.asarray(pwv_mm) * optical_depth_slope(band, pwv_mm) * band.temperature_k * 1e3) ** 2


def _allowed(band, pwv_mm):
    pwv_mm = np.asarray(pwv_mm, dtype=float)
    first, last = band.pwv_mm[0], band.pwv_mm[-1]
    wrong = ~((pwv_mm >= first) & (pwv_mm <= last))
    if wrong.any():
        raise OutOfRangeError(
            f"found {pwv_mm[wrong].flat[0]:g} mm of water vapour; {first:g} to {last:g} mm is allowed"
        )
    return pwv_mm
