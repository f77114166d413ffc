"""Depths for point sources beside public calculators: `python docs/calculators.py` writes the table of the page.

Formulas and numbers of the calculators are from their documentation, as the page says.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import surveysim
from surveysim.atmosphere.opacity import band_opacity, optical_depth
from surveysim.forecasting.forecast import forecast
from surveysim.metrics.map_noise import MapNoise, scored_map
from surveysim.metrics.point_source import quantities
from surveysim.reduction.setup import Setup, prepare
from surveysim.results.metrics import forecast_metrics
from surveysim.scene.metrics import PointSourceDepth
from surveysim.scene.passband import read_passband
from surveysim.scene.scene import Scene
from surveysim.scene.units import BOLTZMANN_J_K, CMB_TEMPERATURE_K, LIGHT_M_S, PLANCK_J_S
from surveysim.telescope.sensitivity import sensitivity

PAGE = Path(__file__).parent / "validation" / "sources.md"
BEGIN, END = "<!-- table of docs/calculators.py -->\n", "<!-- end of the calculators -->\n"
METRIC = PointSourceDepth(kind="point_source", ell_min=0)
MJY = 1e-29  # W / m^2 / Hz
# AtLAST sensitivity calculator (github.com/ukatc/AtLAST_sensitivity_calculator), documentation, "Using the calculator":
# its default inputs, and the system temperature and efficiency that it prints for them.
ATLAST = {"frequency_hz": 406e9, "width_hz": 100e6, "polarizations": 2, "t_s": 100.0}
T_SYS_K, ETA_A, ETA_S, DISH_M = 205.82149141522652, 0.5931321480347472, 0.99, 50.0
PRINTED_SEFD = 4.88003172682879e-24  # W / m^2 / Hz
# Its system temperature of MUSCAT, a camera of KIDs: page "MUSCAT system temperature" and the telescope's parameters.
MUSCAT_HZ, MUSCAT_WIDTH_HZ, ETA_CHIP, GAP_EV, ETA_PB = 277.5e9, 45e9, 0.5, 200e-6, 0.4
ETA_EFF, T_AMBIENT_K, ROUGHNESS_M = 0.95, 270.0, 25e-6
PWV_MM, ELEVATION_RAD = 0.952, math.pi / 4  # "Weather calculations": 25 %, and its default elevation


@dataclass(frozen=True)
class Comparison:
    """A number of a calculator beside the program's.

    `tolerance` is the allowed distance of their ratio from `ratio`, which follows from the difference that is `stated`.
    """

    name: str
    quantity: str
    unit: str
    program: Callable[[], float]
    published: Callable[[], float]
    ratio: float
    tolerance: float
    stated: str


def with_metric(scene: Scene) -> Scene:
    """A scene with the metric of this page."""
    return scene.model_copy(update={"score": scene.score.model_copy(update={"metrics": (METRIC,)})})


def atlast_scene(frequency_hz: float, width_hz: float, efficiency: float, extra: dict[str, Any]) -> Scene:
    """AtLAST with the calculator's aperture: 50 m and an aperture efficiency."""
    keys = {
        "instrument.frequency": f"{frequency_hz} Hz",
        "instrument.bandwidth": width_hz / frequency_hz,
        "optics.aperture": f"{DISH_M} m",
        "optics.aperture_efficiency": efficiency,
        "map.pixel": "0.5 arcsec",
        "score.size": "1 arcmin",
        "score.ell_bin": 40_000,
        "score.ell_max": 400_000,
    }
    return surveysim.load_scene("atlast_220", keys | extra)


def atlast_depth() -> float:
    """Metric `point_source` [mJy] of a detector of the calculator's system temperature, 100 s on the source.

    Its one-sided PSD is 2 T^2 / (n_pol width). A source gets the seconds within half a beam, which its squared profile
    fills.
    """
    scene = with_metric(atlast_scene(ATLAST["frequency_hz"], ATLAST["width_hz"], ETA_A, {}))
    region = scored_map(prepare(scene))
    net_mk = 1e3 * T_SYS_K / math.sqrt(ATLAST["polarizations"] * ATLAST["width_hz"])
    exposure = ATLAST["t_s"] / (region.beam_sr / 2)
    white = np.full(len(region.ell), (net_mk * region.ukcmb_per_mk) ** 2 / exposure)
    noise = MapNoise(region, "white", 1, white, np.ones(len(white)), lambda: exposure)
    return quantities(noise, METRIC)[0].value


def atlast_sensitivity() -> float:
    """Sensitivity of the calculator [mJy], ``SEFD / (eta_s sqrt(n_pol width t))``."""
    return atlast_sefd() / (ETA_S * math.sqrt(ATLAST["polarizations"] * ATLAST["width_hz"] * ATLAST["t_s"])) / MJY


def atlast_sefd() -> float:
    """System equivalent flux density of the calculator [W/m^2/Hz], ``2 k T_sys / (eta_A A)``."""
    return 2 * BOLTZMANN_J_K * T_SYS_K / (ETA_A * math.pi * DISH_M**2 / 4)


def muscat_scene() -> Scene:
    """MUSCAT on AtLAST: the forward efficiency is an element that emits, and chip and cold optics the efficiency."""
    element = {"name": "forward", "temperature": f"{T_AMBIENT_K} K", "side": "sky", "emissivity": 1 - ETA_EFF}
    kid = {"gap": f"{GAP_EV} eV", "pair_breaking_efficiency": ETA_PB, "amplifier_nep": "0 W / Hz(1/2)"}
    changes = {
        "instrument.efficiency": ETA_CHIP,
        "instrument.horn_f_lambda": None,
        "instrument.illumination": "uniform",
        "optics.stop": None,
        "optics.elements": [element],
        "detector.nep": None,
        "detector.kid": kid,
    }
    return atlast_scene(MUSCAT_HZ, MUSCAT_WIDTH_HZ, muscat_eta_a(), changes)


def muscat_eta_a() -> float:
    """Aperture efficiency of the calculator: illumination, spill-over, polarization, blocking and roughness."""
    return 0.8 * 0.95 * 0.995 * 0.94 * math.exp(-((4 * math.pi * ROUGHNESS_M * MUSCAT_HZ / LIGHT_M_S) ** 2))


def muscat_nefd() -> float:
    """NEFD of the program [mJy sqrt(s)]."""
    scene = muscat_scene()
    opacity = band_opacity(scene.place, scene.instrument.band)
    return sensitivity(scene, opacity, PWV_MM, ELEVATION_RAD).nefd_mjy_rts


def muscat_sensitivity() -> float:
    """Sensitivity of the calculator in one second [mJy], at the band's centre under the program's sky."""
    scene = muscat_scene()
    opacity = band_opacity(scene.place, scene.instrument.band)
    passed = math.exp(-float(optical_depth(opacity, PWV_MM, airmass=1 / math.sin(ELEVATION_RAD))))
    photon = PLANCK_J_S * MUSCAT_HZ

    def emitted(temperature_k: float) -> float:
        return photon / math.expm1(photon / (BOLTZMANN_J_K * temperature_k))

    sky = (1 - passed) * emitted(opacity.temperature_k) + passed * emitted(CMB_TEMPERATURE_K)
    load = 2 * MUSCAT_WIDTH_HZ * ETA_CHIP * ((1 - ETA_EFF) * emitted(T_AMBIENT_K) + ETA_EFF * sky)
    gap = GAP_EV * 1.602176634e-19
    nep = math.sqrt(2 * load * photon + 2 * load**2 / (2 * MUSCAT_WIDTH_HZ) + 4 * gap * load / ETA_PB)
    t_sys = nep / (BOLTZMANN_J_K * ETA_CHIP * ETA_EFF * passed * math.sqrt(2 * 2 * MUSCAT_WIDTH_HZ))
    sefd = 2 * BOLTZMANN_J_K * t_sys / (muscat_eta_a() * math.pi * DISH_M**2 / 4)
    return sefd / (ETA_S * math.sqrt(2 * MUSCAT_WIDTH_HZ)) / MJY


@cache
def mapping_speed(camera: str, ell_max: int) -> float:
    """Forecast of the metric's mapping speed [deg^2 / (mJy^2 h)], with cleaning, less the time of turnarounds."""
    setup: Setup = prepare(with_metric(surveysim.load_scene(camera, {"score.ell_max": ell_max})))
    region = scored_map(setup)
    speed = forecast_metrics(setup, forecast(setup))["actual"]["point_source.mapping_speed"].value
    return speed * region.hours / region.scan_hours


def mustang2_noise() -> float:
    """Noise of a point source [uJy] after an hour over the 21.8 square arcminutes of the daisy."""
    return 1e3 * math.sqrt(21.8 / 3600 / mapping_speed("mustang2", 142_000))


def mustang2_y() -> float:
    """Compton parameter per uK of Rayleigh-Jeans temperature, times 1e7."""
    band = read_passband("mustang2")
    return 1e7 * 1e-6 / abs(band.sz_k_cmb / band.cmb_per_rj)


COMPARISONS = (
    Comparison(
        "AtLAST calculator, 406 GHz",
        "sensitivity in 100 s",
        "mJy",
        atlast_depth,
        atlast_sensitivity,
        ETA_S,
        0.01,
        "its efficiency eta_s = 0.99 is left out",
    ),
    Comparison(
        "AtLAST calculator, MUSCAT",
        "NEFD of a detector",
        "mJy sqrt(s)",
        muscat_nefd,
        muscat_sensitivity,
        ETA_S,
        0.03,
        "as above; integrals over the band for its centre",
    ),
    Comparison(
        "TolTEC's page, 1.1 mm",
        "mapping speed",
        "deg2 / (mJy2 h)",
        lambda: 2 * mapping_speed("toltec_1.1mm", 264_000),
        lambda: 12.0,
        7 / 12,
        5 / 12,
        "the largest of 2 to 12; twice the metric, as a source has a beam there and half a beam here",
    ),
    Comparison(
        "MUSTANG-2, guide of GBO",
        "noise in one hour",
        "uJy",
        mustang2_noise,
        lambda: 56.2,
        0.5,
        0.1,
        "maps with cut data, smoothed to 10 arcsec; coverage and detector NEP are assumed",
    ),
    Comparison(
        "MUSTANG-2, guide of GBO",
        "y per temperature",
        "1e-7 / uK",
        mustang2_y,
        lambda: 2.74,
        1.0,
        0.05,
        "a band with straight sides; not relativistic",
    ),
)


def table() -> str:
    """Markdown: each number beside the program's."""
    head = "| calculator | quantity | unit | program | its value | ratio | difference |\n"
    head += "|---|---|---|---:|---:|---:|---|\n"
    rows = []
    for item in COMPARISONS:
        ours, published = item.program(), item.published()
        numbers = f"{ours:.3g}", f"{published:.3g}", f"{ours / published:.2f}"
        rows.append("| " + " | ".join((item.name, item.quantity, item.unit, *numbers, item.stated)) + " |\n")
    return head + "".join(rows)


def with_table(text: str) -> str:
    """Text of the page with the table of today."""
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n{table()}\n{END}{rest.split(END)[1]}"


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
