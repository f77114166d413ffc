"""Metrics `point_source` and `cluster`: white noise by hand, profiles and spectra, and the options of a scene."""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker.profiles import arnaud_profile, beta_profile
from mapmaker.transfer_function import pixel_window
from surveysim.metrics.errors import quantity_responses
from surveysim.metrics.map_noise import MapNoise, scored_map
from surveysim.metrics.registry import metric_functions
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.passband import Passband, top_hat
from surveysim.scene.scene import load_scene
from surveysim.scene.units import BOLTZMANN_J_K
from surveysim.telescope.diffraction import effective_area_m2
from tests.scenes import SMALL_SCENE, write_scene

METRICS_TEXT = """
[[score.metrics]]
kind = "point_source"
ell_min = 0

[[score.metrics]]
kind = "point_source"
name = "scored"

[[score.metrics]]
kind = "cluster"
profile = "arnaud"
theta_500 = "2 arcmin"
ell_min = 0

[[score.metrics]]
kind = "cluster"
name = "isothermal"
profile = "beta"
core_radius = "30 arcsec"
beta = 1.0
ell_min = 0
"""
NET, EXPOSURE = 1.3, 4e9  # mK sqrt(s) of a detector, detector-seconds per sr


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    """Pixels a tenth of the beam, and multipoles up to 40000, where the beam leaves nothing."""
    path = write_scene(tmp_path_factory.mktemp("sources"), SMALL_SCENE + METRICS_TEXT)
    return prepare(load_scene(path, {"map.pixel": "6 arcsec", "score.ell_max": 40000}))


@pytest.fixture(scope="module")
def white(setup):
    """A map of white noise that keeps all of the signal."""
    region = scored_map(setup)
    psd = np.full(len(region.ell), (NET * region.ukcmb_per_mk) ** 2 / EXPOSURE)
    return MapNoise(region, "actual", 18, psd, np.ones(len(psd)), lambda: EXPOSURE)


def found(setup, noise):
    return {
        f"{name}.{item.name}": item.value
        for name, function in metric_functions(setup.scene.score).items()
        for item in function(noise)
    }


def test_point_sources_in_white_noise(setup, white):
    """NEFD of a detector over the root of its seconds within half a beam, and half of the beams that the array has."""
    values, scene = found(setup, white), setup.scene
    variance = (scene.instrument.beam_fwhm_rad / np.sqrt(8 * np.log(2))) ** 2
    nefd = NET * 1e-3 * 2 * BOLTZMANN_J_K / effective_area_m2(scene) / 1e-29  # mJy sqrt(s)
    depth = nefd / np.sqrt(EXPOSURE * np.pi * variance)
    assert values["point_source.depth_mjy"] == pytest.approx(depth, rel=0.01)
    assert values["point_source.depth_mk"] == pytest.approx(NET / np.sqrt(EXPOSURE * np.pi * variance), rel=0.01)
    scans, turnarounds = 4 * 6.0, 3 * 2.0
    speed = 18 * np.pi * variance * np.degrees(1) ** 2 / nefd**2 * 3600 * scans / (scans + turnarounds)
    assert values["point_source.mapping_speed"] == pytest.approx(speed, rel=0.01)
    # Without the lowest multipoles: an integral that begins at 4000.
    assert values["scored.depth_mjy"] == pytest.approx(depth * np.exp(4000**2 * variance / 2), rel=0.01)


def test_clusters_in_white_noise(setup, white):
    """By a sum over every tenth multipole, for the temperature of the effect at 143 GHz."""
    values, region = found(setup, white), white.map
    ell = np.arange(5.0, 40000, 10)
    seen = 10 * ell / (2 * np.pi) * setup.analysis.beams.window(ell) * pixel_window(ell, np.radians(6 / 3600))
    x = 143.0 / 56.79  # h nu / k T_CMB: 56.79 GHz for 2.7255 K
    kelvin = 2.7255 * (x / np.tanh(x / 2) - 4)
    for name, profile in (
        ("cluster", arnaud_profile(ell, np.radians(2 / 60))),
        ("isothermal", beta_profile(ell, np.radians(30 / 3600), 1.0)),
    ):
        sigma = np.sqrt(white.noise_psd[0] / np.sum(seen * profile**2))
        assert values[f"{name}.depth_y0"] == pytest.approx(sigma / abs(1e6 * kelvin), rel=0.01)
    assert region.sz_ukcmb == pytest.approx(1e6 * kelvin, rel=1e-3)


def test_noise_and_transfer_function_scale_the_depths(setup, white):
    before, after = found(setup, white), found(setup, white.scaled(noise=4.0, transmission=0.25))
    for key in before:
        factor = {"sigma": 16, "mapping_speed": 1 / 16}.get(key.partition(".")[2], 4)
        assert after[key] == pytest.approx(factor * before[key], rel=1e-12)


def test_bins_without_noise_or_signal_do_not_count(setup, white):
    """Below the scored multipoles a forecast may have no noise, and far above the beam no signal."""
    whole, functions = found(setup, white), metric_functions(setup.scene.score)
    first, last = np.arange(len(white.map.ell)) < 1, white.map.ell > 30000
    for odd in (-0.3, 0.0, np.nan):
        passed = np.where(last, odd, 1.0)
        item = replace(white, noise_psd=np.where(first, 0.0, white.noise_psd), transmission=passed)
        scored, every = (functions[name](item)[1].value for name in ("scored", "point_source"))
        assert scored == pytest.approx(whole["scored.depth_mk"], rel=1e-5)
        assert every > whole["point_source.depth_mk"]


def test_responses_are_those_of_finite_differences(setup, white):
    """The closed forms of d ln value / d ln N, in noise that changes with multipole."""
    noise = white.scaled(noise=1 + 1e4 / np.maximum(white.map.ell, 1000), transmission=1 - np.exp(-white.map.ell / 9e3))
    functions = metric_functions(setup.scene.score)
    for name, function in ((name, functions[name]) for name in ("point_source", "isothermal")):
        closed = quantity_responses(function, noise)

        def bare(item, function=function):
            return tuple(replace(quantity, response=None) for quantity in function(item))

        for key, (_, *rows) in quantity_responses(bare, noise).items():
            np.testing.assert_allclose(closed[key][1:], rows, atol=1e-6, err_msg=f"{name}.{key}")


def test_notes_tell_of_confusion_and_of_the_beam_that_the_score_leaves_out(tmp_path):
    path = write_scene(tmp_path, SMALL_SCENE + METRICS_TEXT)
    region = scored_map(prepare(load_scene(path)))
    n_bin = len(region.ell)
    noise = MapNoise(region, "actual", 18, np.ones(n_bin), np.ones(n_bin), lambda: EXPOSURE)
    functions = metric_functions(load_scene(path).score)
    lost = np.exp(-(12000**2) * np.radians(1 / 60) ** 2 / (8 * np.log(2)))
    assert {item.note for item in functions["scored"](noise)} == {
        f"without confusion; score.ell_max leaves out {100 * lost:.0f} % of the beam's power"
    }
    assert [item.note for item in functions["cluster"](noise)] == ["without confusion; non-relativistic"]


def test_effect_of_clusters_over_bands():
    """Null at x = 3.83, 217.5 GHz for 2.7255 K; -2 y T at low frequencies."""
    assert top_hat(1e9, 0.0).sz_k_cmb == pytest.approx(-2 * 2.7255, rel=1e-4)
    assert top_hat(217.5e9, 0.0).sz_k_cmb == pytest.approx(0, abs=0.01)
    assert top_hat(214e9, 0.0).sz_k_cmb < 0 < top_hat(221e9, 0.0).sz_k_cmb
    two = Passband((90e9, 90.0001e9, 149.9999e9, 150e9), (1.0, 0.0, 0.0, 1.0))  # two lines of equal power
    x = np.array([90, 150]) / 56.7902
    weight = x**2 * np.exp(x) / np.expm1(x) ** 2
    expected = 2.7255 * np.average(x / np.tanh(x / 2) - 4, weights=weight)
    assert two.sz_k_cmb == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('kind = "cluster"', "score.metrics.0.profile: missing"),
        (
            'kind = "cluster"\nprofile = "arnaud"',
            "score.metrics.0.theta_500: missing; it is expected with the profile 'arnaud'",
        ),
        (
            'kind = "cluster"\nprofile = "arnaud"\ntheta_500 = "1 arcmin"\nbeta = 1',
            "score.metrics.0.beta: found with the profile 'arnaud'",
        ),
        (
            'kind = "cluster"\nprofile = "beta"\nbeta = 1',
            "score.metrics.0.core_radius: missing; it is expected with the profile 'beta'",
        ),
        (
            'kind = "point_source"\nell_min = 11000',
            "found ell_min = 11000 in 'point_source'; 10000 or less is expected, which leaves a bin of 2000 below",
        ),
    ],
)
def test_errors_name_key_and_choices(tmp_path, entry, message):
    path = write_scene(tmp_path, f"{SMALL_SCENE}\n[[score.metrics]]\n{entry}\n")
    with pytest.raises(SceneError) as error:
        load_scene(path)
    assert message in str(error.value)
