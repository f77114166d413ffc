"""Scenes of other programs' descriptions of cameras: `new NAME --from FILE`."""

import json
import math
from pathlib import Path

import pytest

from surveysim.reduction.setup import prepare
from surveysim.results.sensitivity import sensitivities
from surveysim.scene.scene import load_scene
from surveysim.telescope.detector_noise import saturation_power_w

BOLOJAX = Path(__file__).parents[2] / "data" / "bolojax"
RESULTS = json.loads((BOLOJAX / "results.json").read_text())
SKY = ("cmb", "dust", "synchrotron", "atmosphere")
CAMERA = """
instrument:
  site: Pole
  elevation: 55.0
  pwv: 0.4
  obs_time: 1 yr
  optics_config:
    default: {temperature: 250 K, absorption: 0.0, reflection: 0.0}
    elements:
      - mirror: {type: mirror, conductivity: 3.6e+7, surface_rough: 20.0e-6, scatter_temp: 270 K}
      - window: {temperature: 270 K, absorption: [0.01, 0.02], spillover: 0.03, reflection: 0.02}
      - baffle: {absorption: 0.5}
      - stop: {type: aperture_stop, temperature: 4 K}
      - lens: {type: dielectric, temperature: 4 K, thickness: 10 mm, index: 3.4, loss_tangent: 1.0e-4}
      - filter: {temperature: 1 K, absorption: {var_type: dist, fname: filter.txt}}
  channel_default:
    pixel_size: 6 mm
    waist_factor: 3
    det_eff: {var_type: gauss, value: 0.7, errors: 0.1}
    num_det_per_water: 74
    carrier_index: 3
    Tc: 450 mK
    squid_nei: 10
    bolo_resistance: 1.0
    Yield: 0.9
    colour: blue
  camera_config:
    default: {f_number: 1.7, bath_temperature: 250 mK}
    elements:
      east:
        skip_optical_elements: [baffle]
        chan_config:
          elements:
            low: {band_center: 95 GHz, fractional_bandwidth: 0.25, psat: 20 pW}
            high:
              band_center: 150 GHz
              fractional_bandwidth: 0.25
              psat: 40 pW
              band_response: {var_type: dist, fname: band.txt}
"""
ALIASES = "a0: &a0 []\n" + "".join(f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]\n" for n in range(8))
BAND = "# GHz\n130 0.0 0.01\n140 0.8 0.01\n160 0.8 0.01\n170 0.0 0.01\n"
FILTER = "100 0.01\n200 0.03\n"


@pytest.fixture
def camera(tmp_path, monkeypatch):
    """A file of two channels in the current directory."""
    monkeypatch.chdir(tmp_path)
    for name, text in {"camera.yaml": CAMERA, "band.txt": BAND, "filter.txt": FILTER}.items():
        Path(name).write_text(text)
    return Path("camera.yaml")


def imported(call, path, *options):
    code, out, error = call("new", "mine", "--from", str(path), "--aperture", "6 m", *options)
    assert (code, error) == (0, "")
    return out, load_scene("mine")


def test_fields_become_keys(call, camera):
    out, scene = imported(call, camera, "--channel", "east/high")
    assert "scenarios/mine.toml: a scene of camera.yaml" in out
    section, optics = scene.instrument, scene.optics
    assert section.band.edges_hz == pytest.approx((130e9, 170e9))
    assert section.efficiency == pytest.approx(0.7 * 0.8)
    f_lambda = 1.7 * 299792458 / 150e9
    assert section.layout.pitch_f_lambda == pytest.approx(6e-3 / f_lambda, rel=1e-5)
    assert section.edge_taper_db == pytest.approx(10 / math.log(10) * math.pi**2 / 2 * (2e-3 / f_lambda) ** 2, rel=1e-5)
    assert (section.layout.rings, section.layout.yield_fraction, section.polarizations) == (3, 0.9, 2)
    assert (optics.aperture_m, optics.stop.temperature_k) == (6.0, 4.0)
    assert (scene.atmosphere.site, scene.atmosphere.pwv_mm) == ("south_pole", (0.4,))
    assert math.degrees(scene.fixed_pointing.elevation_rad) == pytest.approx(55)
    bolometer = scene.detector.bolometer
    assert saturation_power_w(bolometer) == pytest.approx(2 * 40e-12, rel=1e-5)  # of two detectors
    load = sensitivities(prepare(scene))["median"].load_w
    nep = 10e-12 * math.sqrt(2) * math.sqrt(1.0 * (40e-12 - load / 2))
    assert bolometer.amplifier_nep_w_rthz == pytest.approx(nep, rel=1e-4)


def test_losses_of_elements(call, camera):
    _, scene = imported(call, camera, "--channel", "east/high")
    found = {element.name: element for element in scene.optics.elements}
    assert list(found) == ["mirror", "mirror, scatter", "window", "lens", "filter"]
    ohmic = 4 * math.sqrt(math.pi * 150e9 * 4e-7 * math.pi / 3.6e7) / 376.730313668
    ruze = 1 - math.exp(-((4 * math.pi * 20e-6 * 150e9 / 299792458) ** 2))
    tangent = 1 - math.exp(-2 * math.pi * 3.4 * 1e-4 * 10e-3 * 150e9 / 299792458)
    assert found["mirror"].emissivity == pytest.approx(ohmic)
    assert (found["mirror, scatter"].emissivity, found["mirror, scatter"].temperature_k) == (pytest.approx(ruze), 270)
    assert found["window"].emissivity == pytest.approx(0.02 + 0.03)  # the second value: that of the second channel
    assert found["window"].transmission == pytest.approx(0.98 * 0.98 * 0.97)
    assert found["lens"].emissivity == pytest.approx(tangent)
    assert found["filter"].emissivity == pytest.approx(0.02)  # mean over 130 to 170 GHz
    assert [element.side for element in found.values()] == ["sky"] * 3 + ["detector"] * 2


def test_no_field_is_dropped_in_silence(call, camera):
    out, _ = imported(call, camera, "--channel", "east/high")
    unused = [line for line in out.splitlines() if line.startswith("not used: ")]
    assert unused == [
        "not used: instrument.obs_time: the scene has a survey of its own",
        "not used: instrument.channel_default.det_eff.errors: a distribution is its central value",
        "not used: instrument.channel_default.colour: unknown",
        "not used: east/low: another channel",
    ]
    text = Path("scenarios/mine.toml").read_text()
    assert all(f"# {line.replace('not', 'Not', 1)}\n" in text for line in unused)


def test_scene_runs(call, camera):
    imported(call, camera, "--channel", "east/high")
    assert call("run", "mine", "--set", "observations=2", "--set", "score.jackknives=8", "--no-figures")[0] == 0


@pytest.mark.parametrize("name, channel", [("comprehensive", "cam_1.chan_1"), ("example", "cam_1.chan_2")])
def test_loads_of_bolojax(call, tmp_path, monkeypatch, name, channel):
    """Surfaces load a detector as in bolojax itself; to 1 %, as losses are those at the band's centre."""
    monkeypatch.chdir(tmp_path)
    _, scene = imported(call, BOLOJAX / f"{name}.yaml", "--channel", channel.replace(".", "/"))
    expected = RESULTS[name][channel]["load_w"]
    found = {element.name: element.load_w / 2 for element in sensitivities(prepare(scene))["median"].elements}
    found["window"] += found.pop("window, spillover")
    found["aperture"] = found.pop("stop")
    for element, load in expected.items():
        if element not in SKY and load > 1e-3 * sum(expected.values()):
            assert found[element] == pytest.approx(load, rel=0.01), element


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("site: Pole", "site: Plateau", "instrument.site: found 'Plateau'; one of atacama, pole,"),
        ("elevation: 55.0", "elevation: 55 mm", "instrument.elevation: found '55 mm'; a quantity in units like 'deg'"),
        ("pwv: 0.4", "pwv: {mean: 0.4}", "pwv: found {'mean': '0.4'}; a number is expected"),
        ("Tc: 450 mK", "Tc: 200 mK", "bath_temperature: found '250 mK'; a number above 0 to 0.2 K is expected"),
        ("Tc: 450 mK", "Tc: null", "Tc: missing; a number above 0 K is expected"),
        ("pixel_size: 6 mm", "pixel_size: 0 mm", "pixel_size: found '0 mm'; a number above 0 m is expected"),
        ("[0.01, 0.02]", "[0.01]", None),
        ("[0.01, 0.02]", "[]", "absorption: found 0 values; one for each channel is expected"),
        ("[0.01, 0.02]", "1.5", "absorption: found '1.5'; a number from 0 to 1 is expected"),
        ("type: dielectric", "type: plastic", "type: found 'plastic'; one of element, mirror, dielectric, aperture_s"),
        ("fname: band.txt", "fname: no.txt", "band_response: no.txt: can't be read (No such file or directory)"),
        ("skip_optical_elements: [baffle]", "skip_optical_elements: baffle", "a list of names is expected"),
        ("    elements:\n      east:", "    elements:\n      - east:", "a mapping is expected"),
        ("instrument:", "instruments:", "instrument.camera_config.elements: missing; a mapping is expected"),
        ("CAMERA", "[", "not a valid YAML file"),
        ("CAMERA", "- 1", "a mapping with the key instrument is expected"),
        ("CAMERA", "a: " + "[" * 30 + "]" * 30, "nested too deeply"),
        ("CAMERA", ALIASES, "found 10000 values or more"),
        ("CAMERA", "x: \udcff", "not UTF-8"),
    ],
)
def test_errors_are_one_line(call, camera, old, new, message):
    text = new if old == "CAMERA" else CAMERA.replace(old, new)
    assert text != CAMERA
    camera.write_text(text, errors="surrogateescape")
    code, _, error = call("new", "mine", "--from", "camera.yaml", "--aperture", "6 m", "--channel", "east/high")
    if message is None:
        assert (code, error) == (0, "")
        return
    assert code == 2 and error.count("\n") == 1 and error.startswith("camera.yaml: ") and message in error
    assert not Path("scenarios/mine.toml").exists()


FROM = ["--from", "camera.yaml"]
WITH_APERTURE = [*FROM, "--aperture", "6 m"]


@pytest.mark.parametrize(
    "options, message",
    [
        ([], "exactly one of --like and --from is expected"),
        ([*FROM, "--like", "lynx"], "exactly one of --like and --from is expected"),
        (["--like", "lynx", "--aperture", "6 m"], "--aperture: found without --from"),
        (["--like", "lynx", "--channel", "a/b"], "--channel: found without --from"),
        (FROM, "--aperture: missing; the diameter of the telescope, such as '6 m', is expected"),
        ([*FROM, "--aperture", "6"], "--aperture: found '6'; a quantity in units like 'm' is expected"),
        ([*FROM, "--aperture", "6 km"], "--aperture: found 6000 m; 0.01 m to 1000 m are expected"),
        (WITH_APERTURE, "camera.yaml: found 2 channels; --channel with one of east/low, east/high is expected"),
        ([*WITH_APERTURE, "--channel", "east/hi"], "camera.yaml: --channel: found 'east/hi'; "),
        (["--from", "none.yaml", "--aperture", "6 m"], "none.yaml: can't be read (No such file or directory)"),
    ],
)
def test_options_of_new(call, camera, options, message):
    code, _, error = call("new", "mine", *options)
    assert code == 2 and error.startswith(message) and error.count("\n") == 1
