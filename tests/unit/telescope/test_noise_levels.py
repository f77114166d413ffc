"""White levels of observations: stated, from a load, from water, from a noise-equivalent power."""

import numpy as np
import pytest
from scipy.special import j1

from mapmaker.stream_psd import hann_psd
from surveysim.atmosphere.opacity import band_opacity, optical_depth
from surveysim.forecasting.forecast import forecast
from surveysim.paper.published import published
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.passband import top_hat
from surveysim.scene.place import shipped_place
from surveysim.scene.scene import load_scene
from surveysim.telescope.illumination import gaussian_horn
from surveysim.telescope.noise_levels import WhiteLevels, white_levels
from surveysim.telescope.photon_noise import photon_noise
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_levels, observation_weather
from tests.scenes import SMALL_SCENE, without_sections

BAND = {"instrument.bandwidth": 0.15, "instrument.efficiency": 0.4, "instrument.polarizations": 1}
QUIET = without_sections(SMALL_SCENE, "atmosphere", "excess", "photon", "detector", "sky", "score").replace(
    '"average"', '"none"'
)
LOAD = """
[photon]
coherence = "field"
[photon.load]
sky = "10 K"
optics = "30 K"
"""
SITE = """
[atmosphere]
site = "mauna_kea"
spectral_index = "11/3"
layer_height = "1000 m"
illuminated_aperture = "8 m"
wind_median = "31 arcmin / s"
wind_log_scatter = 0.4
[photon]
coherence = "field"
[photon.load]
optics = "30 K"
"""
HEIGHT = np.radians(55.0)


@pytest.fixture
def scene_of(tmp_path):
    def load(text: str, overrides=None):
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return load_scene(path, {**BAND, **(overrides or {})})

    return load


def test_stated_levels_are_taken(scene_of):
    stated = '[photon]\npsd = "2.5 mK2/Hz"\ncoherent_fraction = 0.1\ncoherence = "field"\n'
    scene = scene_of(QUIET + stated + '[detector]\npsd = "1.5 mK2/Hz"\n')
    assert white_levels(scene, None, np.nan, HEIGHT) == WhiteLevels(
        photon_mk2_hz=2.5, aperture_weight=0.1, shared=0.1, detector_mk2_hz=1.5
    )


BOLOCAM = '[photon]\npsd = "2.5 mK2/Hz"\ncoherent_fraction = 0.1\nbose_fraction = 0.69\ncoherence = "field"\n'


def bose_share(psd_mk2_hz, frequency_hz, bandwidth, efficiency, polarizations):
    """Bunching's share of a PSD: it goes as the load squared, shot noise as the load, so that one load fits."""
    one = photon_noise(1.0, frequency_hz, bandwidth, efficiency, polarizations=polarizations)
    shot, bose = one.shot_psd_mk2_hz, one.bose_psd_mk2_hz
    load_k = (np.sqrt(shot**2 + 4 * bose * psd_mk2_hz) - shot) / (2 * bose)
    assert photon_noise(
        load_k, frequency_hz, bandwidth, efficiency, polarizations=polarizations
    ).psd_mk2_hz == pytest.approx(2.5)
    return bose * load_k**2 / psd_mk2_hz


@pytest.mark.parametrize("coherence, expected", [("field", 0.0506), ("hbt", 0.0018)])
def test_neighbours_of_bolocam(scene_of, coherence, expected):
    """At 0.7 (f/#)lambda: 0.1 gamma by the paper's hypothesis, (0.1^2 of the Bose share) gamma^2 by bunching."""
    scene = scene_of(QUIET + BOLOCAM.replace('"field"', f'"{coherence}"'))
    levels = white_levels(scene, None, np.nan, HEIGHT)
    x = 0.7 * np.pi
    gamma = 2 * j1(x) / x
    found = levels.shared * (gamma if coherence == "field" else gamma**2)
    assert found == pytest.approx(expected, abs=5e-5)  # 5.1 % and 0.18 %
    # The share in 2.5 mK^2/Hz, 15 % at 143 GHz, by the efficiency of section 1.1 and two polarizations.
    paper = published()["blip"]["143"]
    share = bose_share(2.5, 143e9, 0.15, paper["efficiency"], 2)
    assert scene.photon.bose_fraction == pytest.approx(share, abs=0.005)
    assert levels.shared == (0.1 if coherence == "field" else pytest.approx(0.01 * 0.69, rel=1e-12))


def test_streams_of_neighbours_share_bunching_alone(scene_of):
    """Correlation of neighbours in streams of a load that is all beam: the Bose share times gamma^2, to 4 sigma."""
    text = QUIET + BOLOCAM.replace('"field"', '"hbt"').replace("0.1\n", "1.0\n")
    setup = prepare(scene_of(text, {"scan.duration": "600 s", "scan.speed": "1 arcsec / s"}))
    data = draw_observation(setup, 0).data_mk.astype(float)
    positions = setup.camera.positions_f_lambda
    distance = np.hypot(*(positions[:, None] - positions).T)
    near = np.triu(distance < 0.8, 1)
    gamma = 2 * j1(np.pi * 0.7) / (np.pi * 0.7)
    found = np.corrcoef(data)[near]
    # Pairs share detectors: at most all of them scatter together.
    assert found.mean() == pytest.approx(0.69 * gamma**2, abs=4 / np.sqrt(data.shape[1]))


def test_levels_of_stages_left_out_are_zero(scene_of):
    scene = scene_of(QUIET + '[detector]\npsd = "1.5 mK2/Hz"\n')
    assert white_levels(scene, None, np.nan, HEIGHT) == WhiteLevels(detector_mk2_hz=1.5)


def test_stated_load(scene_of):
    """40 K in all; a stated load is in temperatures above the atmosphere already."""
    levels = white_levels(scene_of(QUIET + LOAD), None, np.nan, HEIGHT)
    noise = photon_noise(40.0, 143e9, 0.15, 0.4, polarizations=1)
    assert levels.photon_mk2_hz == pytest.approx(noise.psd_mk2_hz, rel=1e-12)
    assert levels.shared == pytest.approx(0.25, rel=1e-12)


def test_shared_part_of_hbt_is_bunching_of_the_sky(scene_of):
    scene = scene_of(QUIET + LOAD.replace('"field"', '"hbt"'))
    levels = white_levels(scene, None, np.nan, HEIGHT)
    noise = photon_noise(40.0, 143e9, 0.15, 0.4, polarizations=1)
    bose = noise.bose_psd_mk2_hz / noise.psd_mk2_hz
    assert 0.1 < bose < 0.9  # neither of the two alone would do
    assert levels.shared == pytest.approx(0.25**2 * bose, rel=1e-12)


@pytest.mark.parametrize("coherence", ["field", "hbt"])
def test_no_load_shares_nothing(scene_of, coherence):
    scene = scene_of(QUIET + LOAD.replace("10 K", "0 K").replace("30 K", "0 K").replace("field", coherence))
    assert white_levels(scene, None, np.nan, HEIGHT) == WhiteLevels()


def test_sky_s_load_follows_the_water(scene_of):
    """T (1 - t) above the window, and noise over what the atmosphere lets through."""
    scene = scene_of(QUIET + SITE)
    opacity = band_opacity(shipped_place("mauna_kea"), top_hat(143e9, 0.15))
    for pwv, height in ((0.5, HEIGHT), (2.0, HEIGHT), (2.0, np.radians(35))):
        passed = float(np.exp(-optical_depth(opacity, pwv, airmass=1 / np.sin(height))))
        sky = opacity.temperature_k * (1 - passed)
        levels = white_levels(scene, opacity, pwv, height)
        alone = photon_noise(sky + 30.0, 143e9, 0.15, 0.4, polarizations=1)
        assert levels.photon_mk2_hz == pytest.approx(alone.psd_mk2_hz / passed**2, rel=1e-9)
        assert levels.shared == pytest.approx(sky / (sky + 30), rel=1e-9)


def test_sky_s_load_through_a_line_is_that_of_the_spectrum(scene_of):
    """Transmission of 175 to 195 GHz at two airmasses, from the cells of the opacity: not that of tau over sin el."""
    scene = scene_of(QUIET + SITE, {"instrument.frequency": "185 GHz", "instrument.bandwidth": 20 / 185})
    opacity = band_opacity(shipped_place("mauna_kea"), top_hat(185e9, 20 / 185))
    cells = [
        float(optical_depth(band_opacity(shipped_place("mauna_kea"), top_hat(nu * 1e9, 1 / nu)), 2.0))
        for nu in np.arange(175.5, 195)
    ]
    passed = np.mean(np.exp(-2 * np.array(cells)))
    sky = opacity.temperature_k * (1 - passed)
    alone = photon_noise(sky + 30.0, 185e9, 20 / 185, 0.4, polarizations=1)
    levels = white_levels(scene, opacity, 2.0, np.radians(30))
    assert levels.photon_mk2_hz == pytest.approx(alone.psd_mk2_hz / passed**2, rel=1e-3)
    assert np.exp(-2 * optical_depth(opacity, 2.0)) < 0.9 * passed


def test_more_water_and_more_air_are_more_noise_and_more_of_it_shared(scene_of):
    scene, opacity = scene_of(QUIET + SITE), band_opacity(shipped_place("mauna_kea"), top_hat(143e9, 0.15))
    wet = [white_levels(scene, opacity, pwv, HEIGHT) for pwv in (0.5, 1.0, 2.0, 4.0)]
    low = [white_levels(scene, opacity, 1.0, np.radians(height)) for height in (90, 60, 40, 30)]
    for rising in (wet, low):
        assert (np.diff([item.photon_mk2_hz for item in rising]) > 0).all()
        assert (np.diff([item.shared for item in rising]) > 0).all()


def test_noise_equivalent_power(scene_of):
    """(NEP / (k dnu eta n_pol))^2, so with the inverse square of the efficiency, and over the transmission at a site.

    1e-17 W/sqrt(Hz) over 1.380649e-23 * 21.45e9 * 0.4 = 1.18460e-13 W/K is 84.4168 uK/sqrt(Hz).
    """
    nep = '[detector]\nnep = "1e-17 W / Hz(1/2)"\n'
    level = white_levels(scene_of(QUIET + nep), None, np.nan, HEIGHT).detector_mk2_hz
    assert level == pytest.approx(0.0844168**2, rel=1e-5)
    for key, value, ratio in (("efficiency", 0.8, 4), ("polarizations", 2, 4), ("bandwidth", 0.3, 4)):
        other = scene_of(QUIET + nep, {f"instrument.{key}": value})
        assert white_levels(other, None, np.nan, HEIGHT).detector_mk2_hz == pytest.approx(level / ratio, rel=1e-12)
    opacity = band_opacity(shipped_place("mauna_kea"), top_hat(143e9, 0.15))
    passed = np.exp(-optical_depth(opacity, 2.0, airmass=1 / np.sin(HEIGHT)))
    at_site = white_levels(scene_of(QUIET + SITE + nep), opacity, 2.0, HEIGHT).detector_mk2_hz
    assert at_site == pytest.approx(level / passed**2, rel=1e-9)


def test_horns_lose_what_they_spill(scene_of):
    """Less light on a detector whose noise is its own, by the share of a horn's beam within the stop."""
    layout = {"instrument.layout.pitch_f_lambda": 1.2}
    nep = QUIET + '[detector]\nnep = "1e-17 W / Hz(1/2)"\n'
    bare = white_levels(scene_of(nep, layout), None, np.nan, HEIGHT).detector_mk2_hz
    horn = white_levels(scene_of(nep, {**layout, "instrument.horn_f_lambda": 1.0}), None, np.nan, HEIGHT)
    share = gaussian_horn(1.0).efficiency
    assert share < 0.6
    assert horn.detector_mk2_hz == pytest.approx(bare / share**2, rel=1e-12)


@pytest.mark.parametrize("coherence", ["field", "hbt"])
def test_streams_have_the_level_and_what_neighbours_share(scene_of, coherence):
    """18 detectors, 4 x 18 scans of 240 samples: 3e5 deviates, of which the Hann taper's PSD loses half.

    The level to 4 sqrt(2 / 1.5e5), 1.5 %, more where they are shared; correlations of 17 280 samples, over 30 pairs and
    more: 4 / sqrt(5e5), 0.6 %.
    """
    mostly_sky = LOAD.replace("field", coherence).replace("10 K", "40 K").replace("30 K", "10 K")
    scene = scene_of(
        QUIET + mostly_sky + '[detector]\nnep = "1e-17 W / Hz(1/2)"\n',
        {"scan.scans": 18, "scan.duration": "24 s", "scan.step": "0.5 arcmin"},
    )
    setup = prepare(scene)
    levels = observation_levels(setup, 0)
    data = np.concatenate([draw_observation(setup, number).data_mk for number in range(4)], axis=1)
    psd = hann_psd(data, 72, np.ones(72, bool), 10.0)[:, 2:-1].mean()
    total = levels.photon_mk2_hz + levels.detector_mk2_hz
    assert psd == pytest.approx(total, rel=0.02)
    place = setup.camera.positions_f_lambda
    apart = np.hypot(*(place[:, None] - place).transpose(2, 0, 1))
    near = np.isclose(apart, 0.7, atol=1e-6)
    gamma = 0.5062 if coherence == "field" else 0.5062**2  # 2 J1(pi s) / (pi s) at 0.7
    shared = levels.shared * levels.photon_mk2_hz / total
    assert near.sum() >= 60
    assert np.corrcoef(data)[near].mean() == pytest.approx(shared * gamma, abs=0.006)
    assert shared * gamma > 0.03


def test_every_observation_has_its_own_water(scene_of):
    setup = prepare(scene_of(QUIET + SITE))
    water = [observation_weather(setup, number).pwv_mm for number in range(4)]
    levels = [observation_levels(setup, number).photon_mk2_hz for number in range(4)]
    assert len(set(water)) == 4
    np.testing.assert_array_equal(np.argsort(water), np.argsort(levels))


def test_water_counts_in_a_forecast(scene_of):
    """All else equal, a wetter year is worth less."""
    text = SMALL_SCENE[SMALL_SCENE.index("[score]") :] + SITE
    dry, wet = (
        forecast(prepare(scene_of(QUIET + text, {"atmosphere.pwv": water}))).scores["white"].band.sigma_ukcmb2
        for water in ("[0.5, 0.501, 0.502, 0.503, 0.504] mm", "[4, 4.01, 4.02, 4.03, 4.04] mm")
    )
    assert wet > 1.05 * dry


@pytest.mark.parametrize(
    "text, missing",
    [
        (QUIET + LOAD, "instrument.bandwidth"),
        (QUIET + LOAD, "instrument.efficiency"),
        (QUIET + LOAD, "instrument.polarizations"),
        (QUIET + '[detector]\nnep = "1e-17 W / Hz(1/2)"\n', "instrument.efficiency"),
    ],
)
def test_power_needs_an_instrument(tmp_path, text, missing):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(SceneError, match=f"{missing}: missing; '(photon.load|detector.nep)' needs it"):
        load_scene(path, {key: value for key, value in BAND.items() if key != missing})


@pytest.mark.parametrize(
    "text, message",
    [
        (LOAD.replace('sky = "10 K"\n', ""), "photon.load.sky: missing; a temperature, or a site"),
        (LOAD.replace("[photon.load]", 'psd = "1 mK2/Hz"\n[photon.load]'), "one of 'psd' and 'load'"),
        (
            LOAD.replace("[photon.load]", "coherent_fraction = 0.1\n[photon.load]"),
            "found without 'psd'; 'load' sets it",
        ),
        ('[photon]\npsd = "1 mK2/Hz"\ncoherence = "none"\n', "coherent_fraction: missing; 'psd' needs it"),
        (
            BOLOCAM.replace("bose_fraction = 0.69\n", "").replace("field", "hbt"),
            "photon.bose_fraction: missing; 'psd'",
        ),
        (
            LOAD.replace("[photon.load]", "bose_fraction = 0.1\n[photon.load]"),
            "bose_fraction: found without 'psd'; 'load' sets it",
        ),
        (
            '[detector]\npsd = "1 mK2/Hz"\nnep = "1e-17 W / Hz(1/2)"\n',
            "exactly one of 'psd', 'nep', 'bolometer'",
        ),
        ("[detector]\n", "exactly one of 'psd', 'nep', 'bolometer'"),
    ],
)
def test_levels_that_are_stated_wrongly(scene_of, text, message):
    with pytest.raises(SceneError, match=message):
        scene_of(QUIET + text)
