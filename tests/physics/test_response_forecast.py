"""Response of the detectors and pointing errors: surveys against the forecast, which has them in closed form."""

import numpy as np
import pytest

from surveysim import run
from surveysim.atmosphere.opacity import band_opacity, optical_depth
from surveysim.forecasting.forecast import forecast
from surveysim.forecasting.response_filters import drift_left, stream_filters
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.rng import normal_deviates
from surveysim.scene.scene import load_scene
from surveysim.telescope.smooth_process import smooth_process
from tests.scenes import SMALL_SCENE, write_scene

# Each place is seen in both directions alike, and the patch resolves the bins.
DENSE = {"excess": None, "sky": None, "score.mask_separation_f_lambda": None, "map.pixel": "20 arcsec"}
DENSE |= {"scan.scans": 120, "scan.step": "0.4 arcmin", "scan.duration": "12 s", "score.size": "36 arcmin"}
NO_LAYER = {"atmosphere": None, "photon": None, "cleaning.algorithm": "none", "scan.sample_rate": "20 Hz"}
NO_LAYER |= {"score.signal_sims.skies": 6, "score.signal_sims.observations": 4}
SLOW = {"time_constants.value": "0.1 s"}


def surveyed(tmp_path, settings, text=SMALL_SCENE):
    """A run, its forecast, and flags of the scored bins."""
    scene = load_scene(write_scene(tmp_path, text), DENSE | settings)
    result = run(scene, engine=SERIAL)
    return result.scores, forecast(prepare(scene)).scores, result.setup.analysis.region.selected


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The survey without sections of the response."""
    return surveyed(tmp_path_factory.mktemp("plain"), NO_LAYER)


@pytest.mark.parametrize(
    "settings",
    [
        SLOW,
        SLOW | {"time_constants.deconvolution_error": 0.0},
        SLOW | {"time_constants.deconvolution_error": 0.3},
        {"pointing_errors.jitter": "8 arcsec"},
        {"pointing_errors.positions": "8 arcsec"},
        {"crosstalk.neighbour_fraction": 0.05},
    ],
)
def test_transfer_functions(tmp_path, plain, settings):
    """The fraction that each leaves of the signal, on the same skies: a filter, a beam, a matrix."""
    found, expected, scored = surveyed(tmp_path, NO_LAYER | settings)
    left = (found["actual"].transfer_function.transmission / plain[0]["actual"].transfer_function.transmission)[scored]
    closed = (expected["actual"].transmission / plain[1]["actual"].transmission)[scored]
    np.testing.assert_allclose(left, closed, rtol=0.015)
    if "time_constants.deconvolution_error" not in settings:
        assert np.abs(closed - 1).max() > 0.08


@pytest.mark.slow
def test_detector_noise_rises_with_the_deconvolution_alone(tmp_path):
    """Of the same noise: as the mean of 1 + (w tau)^2 over the directions of the scans; not at all without it."""
    settings, noises = NO_LAYER | {"observations": 16, "score.jackknives": 64}, []
    for item in ({}, SLOW, SLOW | {"time_constants.deconvolution_error": 0.0}):
        found, expected, scored = surveyed(tmp_path, settings | item)
        noises.append(np.array([of["actual"].noise_psd[scored] for of in (found, expected)]))
    plain, slow, deconvolved = noises
    np.testing.assert_allclose(slow, plain, rtol=1e-5)
    ratio, closed = deconvolved / plain
    # A bin has 90 modes and more in each of 16 maps, whose ratio scatters by up to half of the rise.
    np.testing.assert_allclose(ratio, closed, rtol=0.04)
    assert closed.max() > 1.8


def test_white_levels(tmp_path):
    """Of photon and detector noise behind time constants and their deconvolution: the filters of the streams."""
    settings = DENSE | NO_LAYER | SLOW | {"photon.psd": "2 mK2/Hz", "photon.coherent_fraction": 0.0}
    settings |= {"photon.coherence": "none", "time_constants.deconvolution_error": 0.1}
    setup = prepare(load_scene(write_scene(tmp_path), {key: settings[key] for key in settings if key != "photon"}))
    found, filters = observe(setup, 0, False), stream_filters(setup, setup.analysis.pipelines[0])
    frequency = np.linspace(2.5, 10, 500)[1:-1]
    parts = [(2.0, "light"), (2.5, "output")]
    expected = sum(psd * filters.power(frequency, origin).mean() for psd, origin in parts)
    n = 18 * 120 * 150  # frequencies of all scans
    np.testing.assert_allclose(found.white_mk2_hz, expected, rtol=4 / np.sqrt(n) + 2e-3)
    assert abs(expected / 4.5 - 1) > 0.3


@pytest.mark.slow
def test_drifts_leak_the_layer(tmp_path):
    """Of known responsivities that drift: the common layer times their variance, in streams after cleaning."""
    settings = {"photon": None, "scan.scans": 60, "scan.step": "0.8 arcmin", "observations": 16}
    settings |= {"instrument.responsivity_scatter": 0.0, "instrument.layout.rings": 3, "score.ell_min": 2000}
    settings |= {"atmosphere.b2": "[3000, 3100, 3200] mK2 rad(-5/3)", "cleaning.responsivities": "known"}
    settings |= {"detector.psd": "1 mK2/Hz", "score.signal_sims.observations": 1}
    drift = {"responsivity_drift.rms": 0.03, "responsivity_drift.time_scale": "60 s"}
    noises = []
    for item in ({}, drift):
        found, expected, scored = surveyed(tmp_path, settings | item)
        noises.append([np.sum(of["uncorrelated"].noise_psd[scored]) for of in (found, expected)])
    (steady, steady_closed), (drifting, drifting_closed) = noises
    # 36 detectors with 120 independent drifts each: 2 % of the leakage, in each of a few modes of the layer.
    np.testing.assert_allclose(drifting / steady, drifting_closed / steady_closed, rtol=0.08)
    assert drifting_closed / steady_closed > 1.5


@pytest.mark.parametrize("seconds", [5.0, 20.0, 100.0])
def test_drift_that_fits_leave(seconds):
    """Variance about the mean over a time: of draws, and its limits."""
    values = smooth_process(3000, seconds, 20.0, normal_deviates(5, "test")).at(np.linspace(0, seconds, 400))
    left = values.var(axis=1)
    assert abs(left.mean() - drift_left(20.0, seconds)) < 4 * left.std() / np.sqrt(3000) + 0.004
    assert drift_left(20.0, 1e-3) < 1e-8 and drift_left(1e-3, 20.0) > 0.999


def test_a_load_takes_signal_and_layer(tmp_path):
    """A responsivity of 1 - k L leaves its square of the sky's power."""
    site = 'site = "mauna_kea"\npwv_probabilities = [0.5]\npwv = "[2] mm"\nspectral_index = "11/3"'
    text = SMALL_SCENE.replace('spectral_index = "11/3"', site)
    settings = {"instrument.bandwidth": 0.15, "photon": None, "score.signal_sims.skies": 2}
    load = {"responsivity_drift.load_coefficient": "0.01 / K", "responsivity_drift.calibration_elevation": "90 deg"}
    kept = []
    for item in ({}, load):
        found, expected, scored = surveyed(tmp_path, settings | item, text)
        of = found["actual"].transfer_function.transmission, expected["actual"].transmission
        kept.append([values[scored] for values in of])
    scene = prepare(load_scene(write_scene(tmp_path, text), settings)).scene
    opacity = band_opacity(scene.place, scene.instrument.band)
    depth = [float(optical_depth(opacity, 2.0, airmass=airmass)) for airmass in (1 / np.sin(np.radians(55)), 1.0)]
    load_k = opacity.temperature_k * (np.exp(-depth[1]) - np.exp(-depth[0]))
    for (without, with_load), rtol in zip(zip(*kept, strict=True), (1e-3, 1e-10), strict=True):
        np.testing.assert_allclose(with_load / without, (1 - 0.01 * load_k) ** 2, rtol=rtol)
    assert load_k > 2


def test_crosstalk_of_a_part_of_the_detectors_is_told(tmp_path):
    """Forecasts of a masked array neglect it; they say how much power it adds to large structures: (1 + 2 e)^2."""
    scene = load_scene(write_scene(tmp_path), {"crosstalk.neighbour_fraction": 0.05})
    effects = {name: {item.name: item for item in of.effects} for name, of in forecast(prepare(scene)).scores.items()}
    (masked,) = (name for name in effects if name.startswith("masked"))
    assert {name for name in effects if "crosstalk" in effects[name]} == {masked}
    assert effects[masked]["crosstalk"].flagged and 0.15 < effects[masked]["crosstalk"].size <= 1.1**2 - 1 + 1e-12
