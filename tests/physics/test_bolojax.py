"""Loads, NEPs and NETs of the example instruments of bolojax against its own results, within 1 %.

`tests/data/bolojax` has the instruments, the results and the script that made them. Each channel becomes a scene here:
absorption of metals and dielectrics by the formulas below, spillover and scattering as emissivity.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from surveysim.scene.scene import load_scene
from surveysim.scene.units import BOLTZMANN_J_K, PLANCK_J_S, to_float
from surveysim.telescope.optics import scene_chain
from surveysim.telescope.sensitivity import sensitivity
from tests.scenes import SMALL_SCENE, without_sections

FOLDER = Path(__file__).parents[1] / "data" / "bolojax"
RESULTS = json.loads((FOLDER / "results.json").read_text())
CHANNELS = [(name, channel) for name in ("comprehensive", "example") for channel in RESULTS[name]]
SKY = ("cmb", "dust", "synchrotron", "atmosphere")
BARE = without_sections(
    SMALL_SCENE, "instrument", "atmosphere", "excess", "photon", "detector", "sky", "score"
).replace('"average"', '"none"')
LIGHT_M_S, VACUUM_OHM = 299792458.0, 376.730313668


def occupation(nu, kelvin):
    return 1 / np.expm1(PLANCK_J_S * nu / (BOLTZMANN_J_K * kelvin))


def rj_per_cmb(nu):
    """Slope of the Rayleigh-Jeans temperature of a black body at 2.7255 K."""
    x = PLANCK_J_S * nu / (BOLTZMANN_J_K * 2.7255)
    return np.exp(x) * (x / np.expm1(x)) ** 2


def value(text, unit, place=0):
    """A number of the YAML files: bare, with a unit, or one for each channel of a camera."""
    text = text[place] if isinstance(text, list) else text
    return to_float(text, unit) if isinstance(text, str) else float(text)


def element_loss(element, nu, place):
    """Transmission and emissivity (n,) of an element of the YAML files."""
    kelvin = value(element["temperature"], "K")
    absorbed = np.full(len(nu), value(element.get("absorption", 0.0), "", place))
    if "conductivity" in element:  # a metal: 4 R_s / Z_0, R_s = sqrt(pi nu mu_0 / sigma)
        absorbed = 4 * np.sqrt(math.pi * nu * 4e-7 * math.pi / element["conductivity"]) / VACUUM_OHM
    if "loss_tangent" in element:
        depth = element["index"] * element["loss_tangent"] * element["thickness"]
        absorbed = 1 - np.exp(-2 * math.pi * depth * nu / LIGHT_M_S)
    passed, emitted = (1 - absorbed) * (1 - element.get("reflection", 0.0)), absorbed
    for kind in ("spillover", "scatter_frac"):
        lost = value(element.get(kind, 0.0), "", place)
        warm = value(element.get(f"{kind.removesuffix('_frac')}_temp", element["temperature"]), "K")
        passed, emitted = passed * (1 - lost), emitted + lost * occupation(nu, warm) / occupation(nu, kelvin)
    return passed, np.minimum(emitted, 1 - passed)


def table(path, name, nu, values):
    rows = "".join(f"{one / 1e9!r} {other!r}\n" for one, other in zip(nu.tolist(), values.tolist(), strict=True))
    header = f"# - {{name: frequency, unit: GHz, datatype: float64}}\n# - {{name: {name}, datatype: float64}}\n"
    path.write_text(f"# %ECSV 1.0\n# ---\n# datatype:\n{header}frequency {name}\n{rows}")


def scene_of(folder, name, channel):
    """Scene of a channel, and the surfaces' names."""
    config = yaml.safe_load((FOLDER / f"{name}.yaml").read_text())["instrument"]
    of_camera, of_channel = channel.split(".")
    camera = config["camera_config"]["default"] | config["camera_config"]["elements"][of_camera]
    own = camera["chan_config"]["elements"]
    section, place = config["channel_default"] | own[of_channel], list(own).index(of_channel)
    result = RESULTS[name][channel]
    nu = np.array(result["frequency_hz"])
    response = np.array(result["response"])
    table(folder / "band.ecsv", "transmission", nu, response)
    # Waists are pixel_size / waist_factor there, 0.6435 of the radius here.
    pixels = value(section["pixel_size"], "mm") * 1e-3 / camera["f_number"] * value(section["band_center"], "GHz") * 1e9
    centre = float(np.trapezoid(nu * response, nu) / np.trapezoid(response, nu))
    horn = (
        2 / 0.6435 / section["waist_factor"] * pixels / LIGHT_M_S * centre / value(section["band_center"], "GHz") / 1e9
    )
    lines = [
        f"""
[photon]
coherence = "none"
[instrument]
passband = "band.ecsv"
beam_fwhm = "30 arcsec"
f_lambda = "30 arcsec"
responsivity_scatter = 0
camera_rotation_range = "0 deg"
horn_f_lambda = {horn}
efficiency = {response.max()}
polarizations = 1
[instrument.layout]
rings = 1
pitch_f_lambda = 10
[detector.bolometer]
conductance = "{result["G"]} W / K"
critical_temperature = "{section["Tc"]}"
bath_temperature = "{camera["bath_temperature"]}"
exponent = {section["carrier_index"]}
amplifier_nep = "{result["NEP_read"]} W / Hz(1/2)"
[optics]
sky = "{centre * PLANCK_J_S / BOLTZMANN_J_K * occupation(centre, 2.7255)} K"
"""
    ]
    # Their atmosphere is as bright as a black body, here a warmer surface that emits as much.
    brightness, passed = np.loadtxt(FOLDER / "atacama_atm.txt")[0, 2:]
    losses = {"atmosphere": ("400 K", np.full(len(nu), passed), occupation(nu, brightness) / occupation(nu, 400.0))}
    sides, side = {"atmosphere": "sky"}, "sky"
    for item in config["optics_config"]["elements"]:
        ((element, changes),) = item.items()
        merged = config["optics_config"]["default"] | changes
        if merged.get("type") == "aperture_stop":
            side = "detector"
            lines.append(f'[optics.stop]\ntemperature = "{merged["temperature"]}"\n')
            continue
        losses[element] = (merged["temperature"], *element_loss(merged, nu, place))
        sides[element] = side
    for element, (kelvin, passed, emitted) in losses.items():
        table(folder / f"{element}_t.ecsv", "transmission", nu, passed)
        table(folder / f"{element}_e.ecsv", "emissivity", nu, emitted)
        lines.append(
            f'[[optics.elements]]\nname = "{element}"\nside = "{sides[element]}"\ntemperature = "{kelvin}"\n'
            f'transmission = "{element}_t.ecsv"\nemissivity = "{element}_e.ecsv"\n'
        )
    (folder / "scene.toml").write_text(BARE + "\n" + "".join(lines))
    return load_scene(folder / "scene.toml")


@pytest.mark.parametrize("name, channel", CHANNELS)
def test_instruments_of_bolojax(tmp_path, name, channel):
    expected = RESULTS[name][channel]
    scene = scene_of(tmp_path, name, channel)
    found = sensitivity(scene, None, math.nan, 1.0)
    assert found.load_w == pytest.approx(expected["opt_power"], rel=3e-3)
    photon = math.sqrt(found.nep2["shot"] + found.nep2["wave"])
    assert photon == pytest.approx(expected["NEP_ph"], rel=0.01)
    assert math.sqrt(found.nep2["phonon"]) == pytest.approx(expected["NEP_bolo"], rel=1e-6)
    assert found.nep_w_rthz == pytest.approx(expected["NEP"], rel=0.01)
    assert found.net_mkcmb_rts == pytest.approx(1e3 * expected["NET"], rel=0.01)
    # It converts by the mean over the band, here temperatures are those that the chain passes: up to 1.6 % apart.
    nu, weight = scene.instrument.band.nodes
    passed = weight * scene_chain(scene, None, math.nan, 1.0).transmission
    converted = found.net_mk_rts * rj_per_cmb(np.array(expected["frequency_hz"])).mean()
    converted *= passed.sum() / (passed @ rj_per_cmb(nu))
    assert converted == pytest.approx(1e3 * expected["NET_RJ"], rel=0.01)
    assert found.net_mk_rts == pytest.approx(1e3 * expected["NET_RJ"], rel=0.02)
    # Its saturation power is three times the load.
    assert found.saturation_w == pytest.approx(expected["P_sat"], rel=1e-6)
    loads = {element.name: element.load_w for element in found.elements}
    for element, load in expected["load_w"].items():
        if element not in SKY and load > 1e-3 * found.load_w:
            assert loads["stop" if element == "aperture" else element] == pytest.approx(load, rel=5e-3)
