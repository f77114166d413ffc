"""Cameras that ship beside published numbers: `python docs/cameras.py` writes the table of validation/cameras.md."""

import math
import tomllib
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import surveysim
from surveysim.atmosphere.opacity import BandOpacity, band_opacity, optical_depth
from surveysim.atmosphere.water import pwv_quantile
from surveysim.scene.scene import Scene
from surveysim.telescope.diffraction import beam_width
from surveysim.telescope.focal_plane import illumination
from surveysim.telescope.sensitivity import Sensitivity, sensitivity

HERE = Path(__file__).parent
PAGE = HERE / "validation" / "cameras.md"
BEGIN, END = "<!-- table of docs/cameras.py -->\n", "<!-- end of the table -->\n"
SPEED_OF_LIGHT_M_S = 299_792_458.0
ARCMIN2_PER_DEG2 = 3600.0
Number = Mapping[str, Any]


def camera_scene(number: Number) -> Scene:
    """Scene of the camera of a number, in its band if the camera has several."""
    return _scene(number["camera"], number.get("band"))


@cache
def _scene(camera: str, band: str | None) -> Scene:
    return surveysim.load_bands(camera).bands[band] if band else surveysim.load_scene(camera)


def site_opacity(scene: Scene) -> BandOpacity | None:
    """Opacity of a scene's site in its band; None without a site."""
    return band_opacity(scene.place, scene.instrument.band) if scene.place else None


def elevation_rad(scene: Scene, number: Number) -> float:
    """Elevation that a number is for: the scene's, unless its source names one."""
    return math.radians(number["elevation"]) if "elevation" in number else scene.fixed_pointing.elevation_rad


def detector(number: Number) -> Sensitivity:
    """Sensitivity of a detector in the water and elevation of a number."""
    scene = camera_scene(number)
    opacity = site_opacity(scene)
    pwv = math.nan if opacity is None else number.get("pwv", float(pwv_quantile(scene.atmosphere, 0.5)))
    return sensitivity(scene, opacity, pwv, elevation_rad(scene, number))


def _detector_net(number: Number) -> float:
    return 1e3 * detector(number).net_mkcmb_rts * math.sqrt(number.get("parts", 1))


def _array_net(number: Number) -> float:
    return 1e3 * detector(number).net_mkcmb_rts / math.sqrt(number["pixels"])


def _map_depth(number: Number) -> float:
    """Depth of a map [uK arcmin] whose area [deg^2] the array covers evenly in the time [s]."""
    return _array_net(number) * math.sqrt(number["area_deg2"] * ARCMIN2_PER_DEG2 / number["time_s"])


def _mapping_speed(number: Number) -> float:
    """Beams of the array over the squared NEFD [deg^2 / (mJy^2 h)]; a beam has the area pi FWHM^2 / (4 ln 2)."""
    beam_deg2 = math.pi / (4 * math.log(2)) * (_beam(number) / 3600) ** 2
    return number["pixels"] * beam_deg2 * 3600 / detector(number).nefd_mjy_rts ** 2


def _source_rms(number: Number) -> float:
    """Noise of a point source [mJy] that a matched filter finds in a map of even coverage."""
    sigma_arcmin = _beam(number) / 60 / math.sqrt(8 * math.log(2))
    beams = number["area_arcmin2"] / (math.pi * sigma_arcmin**2)
    return detector(number).nefd_mjy_rts * math.sqrt(beams / (number["pixels"] * number["time_s"]))


def _nefd_ratio(number: Number) -> float:
    other = dict(number) | {"pwv": number["over_pwv"]}
    return detector(number).nefd_mjy_rts / detector(other).nefd_mjy_rts


def _nefd_at_transmission(number: Number) -> float:
    """NEFD in the water that gives a transmission along the line of sight."""
    scene = camera_scene(number)
    opacity, elevation = site_opacity(scene), elevation_rad(scene, number)
    water = np.geomspace(opacity.pwv_mm[0], opacity.pwv_mm[-1], 500)
    passed = np.exp(-optical_depth(opacity, water, airmass=1 / math.sin(elevation)))
    pwv = float(np.interp(number["transmission"], passed[::-1], water[::-1]))
    return sensitivity(scene, opacity, pwv, elevation).nefd_mjy_rts


def _jansky_per_pw(number: Number) -> float:
    """Flux density above the atmosphere per absorbed power that it would give without atmosphere [Jy/pW]."""
    scene = camera_scene(number)
    found = detector(number)
    airmass = 1 / math.sin(found.elevation_rad)
    passed = math.exp(-float(optical_depth(site_opacity(scene), found.pwv_mm, airmass=airmass)))
    return passed * 1e-15 / found.w_per_mjy


def _opacity(number: Number) -> float:
    scene = camera_scene(number)
    airmass = 1 / math.sin(elevation_rad(scene, number))
    return float(optical_depth(site_opacity(scene), number["pwv"], airmass=airmass))


def _beam(number: Number) -> float:
    """Width of the diffracted beam of the scene's aperture [arcsec]."""
    scene = camera_scene(number)
    optics, section = scene.optics, scene.instrument
    width = beam_width(illumination(section), optics.central_obscuration_m / optics.aperture_m)
    return math.degrees(width * SPEED_OF_LIGHT_M_S / section.band.centre_hz / optics.aperture_m) * 3600


# By kind: what the table calls it, and the function.
KINDS: dict[str, tuple[str, Callable[[Number], float]]] = {
    "array_net": ("NET of the array", _array_net),
    "detector_net": ("NET of a detector", _detector_net),
    "detector_net_rj": ("NET of a detector", lambda number: detector(number).net_mk_rts),
    "nefd": ("NEFD of a detector", lambda number: detector(number).nefd_mjy_rts),
    "mapping_speed": ("mapping speed", _mapping_speed),
    "source_rms": ("noise of a point source", _source_rms),
    "nefd_ratio": ("NEFD, ratio", _nefd_ratio),
    "nefd_at_transmission": ("NEFD of a detector", _nefd_at_transmission),
    "jansky_per_pw": ("flux per power", _jansky_per_pw),
    "load": ("absorbed load", lambda number: 1e12 * detector(number).load_w),
    "opacity": ("opacity along the line of sight", _opacity),
    "map_depth": ("depth of the map", _map_depth),
    "beam": ("beam (FWHM)", _beam),
}


def numbers() -> list[dict[str, Any]]:
    """Published numbers of `cameras.toml`."""
    return tomllib.loads((HERE / "cameras.toml").read_text(encoding="utf-8"))["number"]


def ours(number: Number) -> float:
    """Compute the program's value of a published number, in its unit."""
    return KINDS[number["kind"]][1](number)


def table() -> str:
    """Markdown: each published number beside the program's."""
    head = "| camera | quantity | unit | program | published | ratio | source |\n|---|---|---|---:|---:|---:|---|\n"
    rows = []
    for number in numbers():
        value, mark = ours(number), " *" if number.get("calibrated") else ""
        cells = (
            f"`{number['camera']}`{', ' * ('band' in number)}{number.get('band', '')}",
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
