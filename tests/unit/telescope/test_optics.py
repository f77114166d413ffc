"""Radiative chains of scenes: [optics], its errors, and noise that follows the load of each observation."""

import math

import numpy as np
import pytest

from mapmaker.stream_psd import hann_psd
from surveysim.atmosphere.opacity import band_opacity, optical_depth, spectral_depth
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.passband import top_hat
from surveysim.scene.place import shipped_place
from surveysim.scene.scene import load_scene
from surveysim.scene.units import BOLTZMANN_J_K, PLANCK_J_S
from surveysim.telescope.illumination import gaussian_horn
from surveysim.telescope.noise_levels import white_levels
from surveysim.telescope.optics import scene_chain
from surveysim.telescope.photon_noise import chain_noise, photon_noise
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_levels, observation_weather
from tests.camera import BAND, CAMERA, HORNS, PHOTON, QUIET, SITE, STATED_SKY

HEIGHT = np.radians(55.0)


@pytest.fixture
def scene_of(tmp_path):
    def load(text: str, overrides=None):
        path = tmp_path / "scene.toml"
        path.write_text(QUIET + text)
        return load_scene(path, {**BAND, **(overrides or {})})

    return load


def black(nu, kelvin):
    return 1 / np.expm1(PLANCK_J_S * nu / (BOLTZMANN_J_K * kelvin))


def test_chain_of_a_scene_by_hand(scene_of):
    chain = scene_chain(scene_of(PHOTON + STATED_SKY, HORNS), None, np.nan, HEIGHT)
    assert [surface.name for surface in chain.surfaces] == ["sky", "mirrors", "filter", "stop", "lens", "detector"]
    nu = chain.band.nodes[0]
    share = np.array([gaussian_horn(item).efficiency for item in nu / 143e9])
    received = BOLTZMANN_J_K * 20 / (PLANCK_J_S * nu)
    received = 0.95 * received + 0.05 * black(nu, 270)
    received = 0.9 * received + 0.02 * black(nu, 50)
    received = share * received + (1 - share) * black(nu, 4)
    received = 0.4 * (0.95 * received + 0.05 * black(nu, 1))
    np.testing.assert_allclose(chain.occupation.sum(axis=0), received, rtol=1e-12)
    np.testing.assert_allclose(chain.transmission, 0.95 * 0.9 * share * 0.95 * 0.4, rtol=1e-12)
    assert 0.4 < share.mean() < 0.6


def test_stated_sky_alone_is_a_load(scene_of):
    """[optics] without elements is [photon.load] without warm optics."""
    found = white_levels(scene_of(PHOTON + '[optics]\nsky = "20 K"\n'), None, np.nan, HEIGHT)
    load = PHOTON + '[photon.load]\nsky = "20 K"\noptics = "0 K"\n'
    same = white_levels(scene_of(load), None, np.nan, HEIGHT)
    assert vars(found) == pytest.approx(vars(same), rel=1e-13)
    assert found.photon_mk2_hz == pytest.approx(photon_noise(20.0, 143e9, 0.15, 0.4, polarizations=1).psd_mk2_hz)


def test_sky_of_the_site(scene_of):
    """CMB through the atmosphere, and the atmosphere's own emission, at every frequency of the band."""
    scene = scene_of(PHOTON + CAMERA + SITE, HORNS)
    opacity = band_opacity(shipped_place("mauna_kea"), scene.instrument.band)
    chain = scene_chain(scene, opacity, 2.0, HEIGHT)
    assert [surface.name for surface in chain.surfaces][:3] == ["CMB", "atmosphere", "mirrors"]
    nu = chain.band.nodes[0]
    passed = np.exp(-spectral_depth(opacity, 2.0) / np.sin(HEIGHT))
    before = passed * black(nu, 2.7255) + (1 - passed) * black(nu, opacity.temperature_k)
    np.testing.assert_allclose(chain.occupation[:2].sum(axis=0), before * chain.to_detector[1], rtol=1e-12)
    np.testing.assert_allclose(chain.transmission, passed * chain.to_detector[1], rtol=1e-12)


@pytest.mark.parametrize("frequency_ghz", [143, 268])
def test_spectral_depth_averages_to_the_depth_of_the_band(frequency_ghz):
    """Within 0.5 %: cells of 1 GHz, interpolated between their centres."""
    opacity = band_opacity(shipped_place("mauna_kea"), top_hat(frequency_ghz * 1e9, 0.15))
    weight = opacity.band.nodes[1]
    for pwv in (0.5, 1.7, 3.5):
        mean = -math.log(weight @ np.exp(-spectral_depth(opacity, pwv)))
        assert mean == pytest.approx(float(optical_depth(opacity, pwv)), rel=5e-3)


def test_every_observation_has_its_own_load(scene_of):
    """Wetter is louder, for the noise of photons and of a KID, whose recombination noise goes as the load."""
    kid = '[detector.kid]\ngap = "0.19 meV"\npair_breaking_efficiency = 0.4\namplifier_nep = "0 W / Hz(1/2)"\n'
    setup = prepare(scene_of(PHOTON + CAMERA + SITE + kid, HORNS))
    water = [observation_weather(setup, number).pwv_mm for number in range(4)]
    levels = [observation_levels(setup, number) for number in range(4)]
    for name in ("photon_mk2_hz", "wave_mk2_hz", "aperture_weight", "detector_mk2_hz"):
        np.testing.assert_array_equal(np.argsort(water), np.argsort([getattr(item, name) for item in levels]))
    np.testing.assert_array_equal(np.argsort(water)[::-1], np.argsort([item.stop_weight for item in levels]))
    elevation = setup.observing.angles.elevation_rad.mean(axis=1)
    for pwv, height, level in zip(water, elevation, levels, strict=True):
        chain = scene_chain(setup.scene, setup.air.water.opacity, pwv, height)
        nep2 = 4 * 0.19e-3 * 1.602176634e-19 * chain_noise(chain).power_w / 0.4
        assert level.detector_mk2_hz == pytest.approx(nep2 * (1e3 / chain.w_per_k) ** 2, rel=1e-9)


def test_streams_have_the_noise_of_the_load(scene_of):
    """18 detectors, 4 x 18 scans of 240 samples: to 4 sqrt(2 / 1.5e5), 1.5 %, and what is shared."""
    kid = '[detector.kid]\ngap = "0.19 meV"\npair_breaking_efficiency = 0.4\namplifier_nep = "1e-17 W / Hz(1/2)"\n'
    longer = {"scan.scans": 18, "scan.duration": "24 s", "scan.step": "0.5 arcmin"}
    setup = prepare(scene_of(PHOTON + STATED_SKY + kid, HORNS | longer))
    data = np.concatenate([draw_observation(setup, number).data_mk for number in range(4)], axis=1)
    psd = hann_psd(data, 72, np.ones(72, bool), 10.0)[:, 2:-1].mean()
    levels = observation_levels(setup, 0)
    assert psd == pytest.approx(levels.photon_mk2_hz + levels.detector_mk2_hz, rel=0.02)
    assert 0.2 < levels.detector_mk2_hz / levels.photon_mk2_hz < 5  # neither would be missed


def test_shared_parts_are_those_of_the_load_before_the_stop(scene_of):
    text = PHOTON + STATED_SKY
    chain = scene_chain(scene_of(text, HORNS), None, np.nan, HEIGHT)
    power = chain.power_w(chain.occupation)
    field = white_levels(scene_of(text, HORNS), None, np.nan, HEIGHT)
    assert field.shared == pytest.approx(power[:3].sum() / power.sum(), rel=1e-12)
    hbt = white_levels(scene_of(text.replace("field", "hbt"), HORNS), None, np.nan, HEIGHT)
    wave = hbt.wave_mk2_hz / hbt.photon_mk2_hz
    assert hbt.shared == pytest.approx((hbt.aperture_weight + hbt.stop_weight) ** 2 * wave, rel=1e-12)
    assert 0 < hbt.stop_weight < 1 - hbt.aperture_weight < 0.2


TABLED = STATED_SKY.replace("transmission = 0.9\nemissivity = 0.02\n", 'transmission = "filter.ecsv"\n')
TABLE = """# %ECSV 1.0
# ---
# datatype:
# - {name: frequency, unit: GHz, datatype: float64}
# - {name: transmission, datatype: float64}
frequency transmission
100 1.0
130 0.7
160 0.9
"""


def test_transmission_from_a_table(scene_of, tmp_path):
    (tmp_path / "filter.ecsv").write_text(TABLE)
    chain = scene_chain(scene_of(PHOTON + TABLED, HORNS), None, np.nan, HEIGHT)
    expected = np.interp(chain.band.nodes[0] / 1e9, [100, 130, 160], [1.0, 0.7, 0.9])
    np.testing.assert_allclose(chain.surfaces[2].transmission, expected, rtol=1e-12)


@pytest.mark.parametrize(
    "edit, message",
    [
        (("emissivity = 0.05\n", ""), "'transmission', 'emissivity' or both are expected"),
        (
            ("transmission = 0.9\n", "transmission = 0.99\n"),
            "transmission of 0.99 and an emissivity of 0.02; 1 or less",
        ),
        (("emissivity = 0.05", "emissivity = 1.5"), "found 1.5; a number from 0 to 1, or the name of a file"),
        (("emissivity = 0.05", 'emissivity = "no.ecsv"'), "emissivity: .*no.ecsv: no such file in the folder"),
        (('side = "detector"', 'side = "stop"'), "found 'stop'; 'sky' or 'detector' is expected"),
        (('side = "sky"', 'side = "detector"'), "found 'filter' of side 'sky' after one of side 'detector'"),
        (('sky = "20 K"\n', ""), "optics.sky: missing; a temperature, or a site that it follows from, is expected"),
        (
            ('sky = "20 K"\n', 'sky = "20 K"\naperture = "2 m"\ncentral_obscuration = "3 m"\n'),
            "central_obscuration: found 3 m; less than the aperture, 2 m, is expected",
        ),
        (
            ('sky = "20 K"\n', 'sky = "20 K"\ncentral_obscuration = "3 m"\n'),
            "central_obscuration: found 3 without 'aperture', which it refers to",
        ),
        (
            ('sky = "20 K"\n', 'sky = "20 K"\naperture_efficiency = 0.7\n'),
            "aperture_efficiency: found 0.7 without 'aperture', which it refers to",
        ),
    ],
)
def test_errors_are_one_line(scene_of, edit, message):
    wrong = STATED_SKY.replace(*edit, 1)
    assert wrong != STATED_SKY
    with pytest.raises(SceneError, match=message) as caught:
        scene_of(PHOTON + wrong, HORNS)
    assert "\n" not in str(caught.value)


def test_a_table_that_does_not_cover_the_band(scene_of, tmp_path):
    (tmp_path / "filter.ecsv").write_text(TABLE.replace("160", "150"))
    with pytest.raises(SceneError, match="optics.elements: 'filter': .* 100 to 150 GHz; one that covers the passband"):
        prepare(scene_of(PHOTON + TABLED, HORNS))


def test_opaque_elements_are_refused(scene_of):
    opaque = STATED_SKY.replace("transmission = 0.9\n", "transmission = 0\n")
    assert opaque != STATED_SKY
    with pytest.raises(SceneError, match="optics.elements: 'filter': found a transmission of 0; 1e-06 or more"):
        prepare(scene_of(PHOTON + opaque, HORNS))


@pytest.mark.parametrize("spills", [HORNS, {"instrument.edge_taper": "3 dB"}])
def test_beams_that_spill_need_a_stop(scene_of, spills):
    """Half of the beam of a taper of 3 dB, more of that of a horn of one (f/#)lambda."""
    bare = STATED_SKY.replace('[optics.stop]\ntemperature = "4 K"\n', "")
    with pytest.raises(SceneError, match="optics.stop: missing; 0.[56].* of each pixel's beam spills on it"):
        prepare(scene_of(PHOTON + bare, spills))
    assert scene_chain(scene_of(PHOTON + bare), None, np.nan, HEIGHT).transmission[0] > 0


@pytest.mark.parametrize(
    "text, message",
    [
        (PHOTON, "photon: exactly one of 'psd', 'load' .a section. and a section .optics. is expected"),
        (
            PHOTON + '[photon.load]\nsky = "20 K"\noptics = "0 K"\n' + STATED_SKY,
            "photon.load: found together with .optics., which sets it",
        ),
        (
            '[detector.kid]\ngap = "0.19 meV"\npair_breaking_efficiency = 0.4\namplifier_nep = "0 W / Hz(1/2)"\n',
            "detector.kid: its noise depends on the load; 'photon.load' or .optics. is expected",
        ),
    ],
)
def test_loads_that_are_given_twice_or_not_at_all(scene_of, text, message):
    with pytest.raises(SceneError, match=message):
        scene_of(text)
