"""Band-averaged optical depth of a place against water vapour and airmass, and the atmospheric noise that scales with
it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache

import numpy as np

from surveysim.atmosphere.cubic_spline import CubicSpline, stack_of, stacked_splines
from surveysim.atmosphere.opacity_tables import OpacityTable, opacity_table
from surveysim.runtime.errors import OutOfRangeError
from surveysim.scene.passband import Passband
from surveysim.scene.place import Place
from surveysim.scene.sites import OWN


@dataclass(frozen=True, eq=False)  # each band of a place has one record, by which its splines are looked up
class BandOpacity:
    """Opacity of a place in a band.

    Attributes
    ----------
    place
    band
        Passband.
    pwv_mm : (n,)
        Columns of precipitable water vapour.
    optical_depth : (n,)
        Zenith optical depth at these columns.
    cell_share : (k,)
        Shares of the band in the cells of the opacity table that it covers.
    cell_depth : (k, n)
        Zenith optical depth of these cells.
    spectral_depth : (m, n)
        Zenith optical depth at each node of the band.
    temperature_k
        Physical temperature of the water vapour.
    """

    place: Place
    band: Passband
    pwv_mm: np.ndarray
    optical_depth: np.ndarray
    cell_share: np.ndarray
    cell_depth: np.ndarray
    spectral_depth: np.ndarray
    temperature_k: float

    @cached_property
    def spectral_spline(self) -> Callable[..., np.ndarray]:
        """Cubic splines of `spectral_depth` against water vapour [mm]: arrays (m,) of a single number."""
        return stacked_splines(self.pwv_mm, self.spectral_depth)


@cache
def band_opacity(place: Place, band: Passband) -> BandOpacity:
    """Average the opacity table of a place over a band: -ln of the mean transmission.

    Cells of the table are weighted by their share of the band. Tables of sites that ship cover 80 to 420 GHz; beyond,
    the table of all heights takes their place.

    Raises
    ------
    OutOfRangeError
        For a place or a band beyond the table, and for a band without width.
    InputError
        For a file that is no table of opacity.
    """
    table = opacity_table(place)
    low, high = (edge / 1e9 for edge in band.edges_hz)
    if place.name != OWN and not _covers(table, band):
        table = opacity_table(replace(place, opacity=None))
    if not _covers(table, band):
        first, last = table.edge_hz[[0, -1]] / 1e9
        raise OutOfRangeError(
            f"found a band of {low:g} to {high:g} GHz; bands within {first:g} to {last:g} GHz are allowed"
        )
    share = band.cell_shares(table.edge_hz)
    share, depth = share[share > 0], table.optical_depth[share > 0]
    averaged = _mean_depth(share, depth, 1.0)
    averaged.setflags(write=False)
    at_nodes = _at_nodes(table.edge_hz, table.optical_depth, band)
    return BandOpacity(place, band, table.pwv_mm, averaged, share, depth, at_nodes, table.temperature_k)


def _mean_depth(share: np.ndarray, depth: np.ndarray, airmass: float) -> np.ndarray:
    """Optical depth (n,) of cells (k, n) with shares (k,) at an airmass: -ln of their mean transmission."""
    clearest = depth.min(axis=0)  # its transmission may be too small a number
    return airmass * clearest - np.log(share @ np.exp(-airmass * (depth - clearest)))


@lru_cache(maxsize=4096)  # observations have an airmass each; the draws of a forecast share them
def _slant_spline(band: BandOpacity, airmass: float) -> CubicSpline:
    """Cubic spline of the optical depth at an airmass against water vapour [mm]."""
    return CubicSpline(band.pwv_mm, _mean_depth(band.cell_share, band.cell_depth, airmass))


def _covers(table: OpacityTable, band: Passband) -> bool:
    low, high = band.edges_hz
    return bool(table.edge_hz[0] <= low < high <= table.edge_hz[-1])


def _at_nodes(edge_hz: np.ndarray, depth: np.ndarray, band: Passband) -> np.ndarray:
    """Interpolate optical depths (k, n) of cells linearly to the nodes of a band (m, n)."""
    centre_hz = (edge_hz[1:] + edge_hz[:-1]) / 2
    return np.array([np.interp(band.nodes[0], centre_hz, column) for column in depth.T]).T


def optical_depth(band: BandOpacity, pwv_mm: float | np.ndarray, *, airmass: float = 1.0) -> np.ndarray:
    """Interpolate the optical depth at an airmass, at zenith water columns of any shape [mm].

    It is ``-ln <exp(-airmass tau)>``, averaged over the band. It grows less than the airmass where lines of the band
    saturate.

    Raises
    ------
    ValueError
        Outside the table.
    """
    return _slant_spline(band, airmass)(_allowed(band, pwv_mm))


def spectral_depth(band: BandOpacity, pwv_mm: float) -> np.ndarray:
    """Interpolate the zenith optical depth (m,) at the nodes of the band; raises as `optical_depth`."""
    return band.spectral_spline(float(_allowed(band, pwv_mm)))


def optical_depth_slope(band: BandOpacity, pwv_mm: float | np.ndarray, *, airmass: float = 1.0) -> np.ndarray:
    """Derivative of `optical_depth` with the zenith water column [1/mm], of any shape; raises as `optical_depth`."""
    return _slant_spline(band, airmass)(_allowed(band, pwv_mm), 1)


def fluctuation_factor_mk2(band: BandOpacity, pwv_mm: float | np.ndarray) -> np.ndarray:
    """Squared amplitude of fluctuations of the water column by its own size [mK^2], for columns of any shape [mm].

    It is ``(C d tau / dC)^2 B_atm^2``, to which B2 is proportional, in temperature above the atmosphere: the emission
    changes by B_atm d(1 - exp(-tau)), and the measured signal is divided by the transmission exp(-tau). This is the
    factor at the zenith; `slant_factor` has its change with the airmass. B_atm is the Rayleigh-Jeans brightness of the
    atmosphere. The factor replaces ``(C d eps / dC)^2
    B_atm^2`` of section 3.3, where the paper has eps = 1 - exp(tau).

    Raises
    ------
    ValueError
        As `optical_depth`.
    """
    return (np.asarray(pwv_mm) * optical_depth_slope(band, pwv_mm) * band.temperature_k * 1e3) ** 2


def slant_factor(band: BandOpacity, pwv_mm: float | np.ndarray, *, airmass: float | np.ndarray) -> np.ndarray:
    """Power of fluctuations of the slant column at an airmass over those of an equal column at the zenith.

    It is ``((d tau(X, C) / dC / X) / (d tau(1, C) / dC))^2`` with the optical depth ``tau(X, C)`` of the band at the
    airmass X. A change c of the slant column is one of c / X at the zenith, and in temperature above the atmosphere the
    emission changes by ``B_atm d tau(X, C) / dC c / X``. The factor is 1 at a single frequency, and below 1 where
    lines of the band saturate. It multiplies B2; the geometric ``sin(el)^(1 - b)`` is a factor of its own. Columns and
    airmasses have one shape, or one of them is a number.

    Raises
    ------
    ValueError
        As `optical_depth`.
    """
    pwv_mm, airmass = _allowed(band, pwv_mm), np.asarray(airmass, dtype=float)
    distinct, member = np.unique(airmass, return_inverse=True)
    splines = stack_of([_slant_spline(band, item) for item in distinct.tolist()])
    slope = splines(pwv_mm, 1, member.reshape(airmass.shape)) / airmass
    return (slope / optical_depth_slope(band, pwv_mm)) ** 2


def _allowed(band: BandOpacity, pwv_mm: float | np.ndarray) -> np.ndarray:
    pwv_mm = np.asarray(pwv_mm, dtype=float)
    first, last = band.pwv_mm[0], band.pwv_mm[-1]
    wrong = ~((pwv_mm >= first) & (pwv_mm <= last))
    if wrong.any():
        raise OutOfRangeError(
            f"found {pwv_mm[wrong].flat[0]:g} mm of water vapour; {first:g} to {last:g} mm is allowed"
        )
    return pwv_mm
