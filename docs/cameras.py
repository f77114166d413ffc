"""Cameras that ship beside published numbers: `python docs/cameras.py` writes the table of validation/cameras.md."""

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import surveysim
from surveysim.atmosphere.opacity import BandOpacity, band_opacity, optical_depth
from surveysim.scene.scene import Scene
from surveysim.scene.units import BOLTZMANN_J_K
from surveysim.telescope.focal_plane import total_efficiency
from surveysim.telescope.noise_levels import sky_transmission, white_levels
from surveysim.telescope.photon_noise import power_per_k, power_w

HERE = Path(__file__).parent
PAGE = HERE / "validation" / "cameras.md"
BEGIN, END = "<!-- table of docs/cameras.py -->\n", "<!-- end of the table -->\n"
SPEED_OF_LIGHT_M_S = 299_792_458.0
ARCMIN2_PER_DEG2 = 3600.0
Number = Mapping[str, Any]


@dataclass(frozen=True)
class Conditions:
    """A camera under some weather: its scene, water [mm] and elevation [rad], and the opacity of its site."""

    scene: Scene
    opacity: BandOpacity | None
    pwv_mm: float
    elevation_rad: float

    @property
    def net_k_rts(self) -> float:
        """Noise-equivalent temperature of a detector [K_RJ sqrt(s)], above the atmosphere."""
        levels = white_levels(self.scene, self.opacity, self.pwv_mm, self.elevation_rad)
        return 1e-3 * math.sqrt((levels.photon_mk2_hz + levels.detector_mk2_hz) / 2)

    @property
    def net_ukcmb_rts(self) -> float:
        """The same in CMB temperature [uK_CMB sqrt(s)]."""
        return 1e6 * self.net_k_rts * self.scene.instrument.cmb_per_rj

    @property
    def jansky_per_k(self) -> float:
        """Flux density [Jy] of a point source whose peak is 1 K_RJ in the Gaussian beam."""
        band, fwhm = self.scene.instrument.band, self.scene.instrument.beam_fwhm_rad
        solid_angle = math.pi / (4 * math.log(2)) * fwhm**2
        return 1e26 * 2 * BOLTZMANN_J_K * (band.centre_hz / SPEED_OF_LIGHT_M_S) ** 2 * solid_angle

    @property
    def nefd_mjy_rts(self) -> float:
        """Noise-equivalent flux density of a detector [mJy sqrt(s)], above the atmosphere."""
        return 1e3 * self.net_k_rts * self.jansky_per_k


def conditions(number: Number) -> Conditions:
    """Scene and weather of a published number."""
    scene = _scene(number["camera"])
    air, band = scene.atmosphere, scene.instrument.band
    opacity = band_opacity(air.site, band) if air and air.site else None
    pwv = number.get("pwv", math.exp(np.interp(0.5, air.pwv_probabilities, np.log(air.pwv_mm))) if opacity else 0.0)
    elevation = number.get("elevation", math.degrees(scene.fixed_pointing.elevation_rad))
    return Conditions(scene, opacity, pwv, math.radians(elevation))


@cache
def _scene(camera: str) -> Scene:
    return surveysim.load_scene(camera)


def _array_net(at: Conditions, number: Number) -> float:
    return at.net_ukcmb_rts / math.sqrt(number["pixels"])


def _map_depth(at: Conditions, number: Number) -> float:
    area = number["area_deg2"] * ARCMIN2_PER_DEG2
    return _array_net(at, number) * math.sqrt(area / number["time_s"])


def _nefd_ratio(at: Conditions, number: Number) -> float:
    other = conditions(dict(number) | {"pwv": number["over_pwv"]})
    return at.nefd_mjy_rts / other.nefd_mjy_rts


def _nefd_at_transmission(at: Conditions, number: Number) -> float:
    """NEFD in the water that gives a line-of-sight transmission."""
    water = np.geomspace(at.opacity.pwv_mm[0], at.opacity.pwv_mm[-1], 500)
    passed = np.exp(-optical_depth(at.opacity, water) / math.sin(at.elevation_rad))
    pwv = float(np.interp(number["transmission"], passed[::-1], water[::-1]))
    return Conditions(at.scene, at.opacity, pwv, at.elevation_rad).nefd_mjy_rts


def _jansky_per_pw(at: Conditions, number: Number) -> float:
    section = at.scene.instrument
    per_k = power_per_k(section.band.width_hz, total_efficiency(section), section.polarizations)
    return at.jansky_per_k / (1e12 * per_k)


def _load(at: Conditions, number: Number) -> float:
    """Absorbed power [pW]."""
    section, load = at.scene.instrument, at.scene.photon.load
    passed = sky_transmission(at.scene, at.opacity, at.pwv_mm, at.elevation_rad)
    sky = at.opacity.temperature_k * (1 - passed) if load.sky_k is None else load.sky_k
    efficiency = total_efficiency(section)
    return 1e12 * power_w(sky + load.optics_k, section.band.width_hz, efficiency, section.polarizations)


def _opacity(at: Conditions, number: Number) -> float:
    return float(optical_depth(at.opacity, at.pwv_mm)) / math.sin(at.elevation_rad)


# By kind: what the table calls it, and the function.
KINDS: dict[str, tuple[str, Callable[[Conditions, Number], float]]] = {
    "array_net": ("NET of the array", _array_net),
    "detector_net": ("NET of a detector", lambda at, number: at.net_ukcmb_rts * math.sqrt(number.get("parts", 1))),
    "detector_net_rj": ("NET of a detector", lambda at, number: 1e3 * at.net_k_rts),
    "nefd": ("NEFD of a detector", lambda at, number: at.nefd_mjy_rts),
    "nefd_ratio": ("NEFD, ratio", _nefd_ratio),
    "nefd_at_transmission": ("NEFD of a detector", _nefd_at_transmission),
    "jansky_per_pw": ("flux per power", _jansky_per_pw),
    "load": ("absorbed load", _load),
    "opacity": ("opacity along the line of sight", _opacity),
    "map_depth": ("depth of the map", _map_depth),
}


def numbers() -> list[dict[str, Any]]:
    """Published numbers of `cameras.toml`."""
    return tomllib.loads((HERE / "cameras.toml").read_text(encoding="utf-8"))["number"]


def ours(number: Number) -> float:
    """Compute the program's value of a published number, in its unit."""
    return KINDS[number["kind"]][1](conditions(number), number)


def table() -> str:
    """Markdown: each published number beside the program's."""
    head = "| camera | quantity | unit | program | published | ratio | source |\n|---|---|---|---:|---:|---:|---|\n"
    rows = []
    for number in numbers():
        value, mark = ours(number), " *" if number.get("calibrated") else ""
        cells = (
            f"`{number['camera']}`",
            KINDS[number["kind"]][0],
            number["unit"],
            f"{value:.3g}",
            f"{number['value']:.3g}",
            f"{value / number['value']:.2f}{mark}",
            number["source"],
        )
        rows.append("| " + " | ".join(cells) + " |\n")
    return head + "".join(rows)


def with_table(text: str) -> str:
    """Text of the page with the table of today."""
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n{table()}\n{END}{rest.split(END)[1]}"


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
