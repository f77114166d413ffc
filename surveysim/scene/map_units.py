"""Units of maps of the sky, and their conversion to Rayleigh-Jeans temperature in a band."""

import math
from dataclasses import dataclass
from typing import Literal

from surveysim.scene.passband import Passband
from surveysim.scene.units import BOLTZMANN_J_K

SR_PER_FWHM2 = math.pi / (4 * math.log(2))  # solid angle of a Gaussian beam over its squared width
_W_PER_JY = 1e-26


@dataclass(frozen=True)
class MapUnit:
    """A unit of a map: its kind, and its size in K, Jy/sr, Jy/beam or y."""

    kind: Literal["rj", "cmb", "intensity", "flux", "compton"]
    size: float


UNITS = {
    "K_RJ": MapUnit("rj", 1.0),
    "mK_RJ": MapUnit("rj", 1e-3),
    "uK_RJ": MapUnit("rj", 1e-6),
    "K_CMB": MapUnit("cmb", 1.0),
    "mK_CMB": MapUnit("cmb", 1e-3),
    "uK_CMB": MapUnit("cmb", 1e-6),
    "Jy/sr": MapUnit("intensity", 1.0),
    "MJy/sr": MapUnit("intensity", 1e6),
    "Jy/beam": MapUnit("flux", 1.0),
    "mJy/beam": MapUnit("flux", 1e-3),
    "Compton y": MapUnit("compton", 1.0),
}
_NAMES = {name.lower().replace("_", "").replace(" ", ""): name for name in UNITS} | {"y": "Compton y"}
_TEMPERATURES = {"k", "mk", "uk", "muk", "µk", "kelvin"}


def unit_of_header(text: str) -> str | None:
    """Name the unit of a FITS header, such as "K_CMB", "Jy/beam", "MJy sr-1"; None for another."""
    plain = text.strip().lower().replace("beam-1", "/beam").replace("sr-1", "/sr").replace("beam^-1", "/beam")
    plain = plain.replace("µ", "u").replace("mu", "u").replace("sr^-1", "/sr").replace("_", "").replace(" ", "")
    return _NAMES.get(plain.replace("./", "/"))


def contradicts(unit: str, text: str) -> bool:
    """Tell whether a unit of a header, if it can be read, is of another kind than `unit`."""
    named = unit_of_header(text)
    if named is not None:
        return UNITS[named] != UNITS[unit]
    return text.strip().lower() in _TEMPERATURES and UNITS[unit].kind not in ("rj", "cmb")


def rj_mk_per_unit(
    unit: str,
    band: Passband,
    *,
    frequency_hz: float | None,
    spectral_index: float | None,
    own_fwhm_rad: float,
    beam_fwhm_rad: float,
    area_m2: float,
) -> float:
    """Rayleigh-Jeans temperature [mK] in a band for a value of 1 in a unit.

    Parameters
    ----------
    frequency_hz, spectral_index
        Frequency of the value, and index of the brightness as a power of frequency. None for the spectrum of the unit:
        Rayleigh-Jeans, CMB anisotropy or the thermal Sunyaev-Zeldovich effect.
    own_fwhm_rad
        Width of the map's own beam, which "Jy/beam" refers to.
    beam_fwhm_rad, area_m2
        Beam and effective area of the telescope. A source of the flux density S has the peak ``S A / 2 k`` in the beam,
        as point sources do.
    """
    found = UNITS[unit]
    if found.kind == "compton":
        return 1e3 * found.size * band.sz_k_cmb / band.cmb_per_rj
    if found.kind in ("intensity", "flux"):
        per_sr = found.size if found.kind == "intensity" else found.size / (SR_PER_FWHM2 * own_fwhm_rad**2)
        in_beam_jy = per_sr * SR_PER_FWHM2 * beam_fwhm_rad**2 * band.power_law(frequency_hz, spectral_index)
        return 1e3 * _W_PER_JY * in_beam_jy * area_m2 / (2 * BOLTZMANN_J_K)
    if frequency_hz is None:
        return 1e3 * found.size / (1.0 if found.kind == "rj" else band.cmb_per_rj)
    # A Rayleigh-Jeans temperature goes as the brightness over the squared frequency.
    there = 1.0 if found.kind == "rj" else 1 / Passband((frequency_hz,), (1.0,)).cmb_per_rj
    return 1e3 * found.size * there * band.power_law(frequency_hz, spectral_index - 2)
