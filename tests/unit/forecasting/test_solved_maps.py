"""Forecasts of solved maps: sums over directions, baselines, noise models, and limits that are known."""

import numpy as np
import pytest

from mapmaker.destriping import BaselineWeight
from mapmaker.gls import GlsOptions, measure_noise
from mapmaker.timestreams import FocalPlane
from surveysim.forecasting.forecast import forecast, why_no_forecast
from surveysim.forecasting.likelihood import _weights, likelihood_sums, noise_bands
from surveysim.forecasting.mode_response import ring_modes
from surveysim.forecasting.observing_conditions import observing_conditions, survey_draws
from surveysim.forecasting.solved_maps import SolvedSums, solved_bins
from surveysim.forecasting.time_filters import baseline_filter
from surveysim.forecasting.track_motions import AZIMUTHS, TrackMotions
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.telescope.scans import samples_per_scan
from tests.scenes import SMALL_SCENE, without_sections, write_scene

UNMASKED = SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", "")
ML = {"map.maker": "maximum_likelihood", "map.maximum_likelihood.band_edges": "[0.4, 1.6] Hz"}
DESTRIPED = {"map.maker": "destriped", "map.destriped.baseline": "2 s"}


def _tracks(*directions):
    """A straight track that sees one place along some of 32 directions in half a turn, for equal times."""
    weight = np.zeros((1, 1, AZIMUTHS))
    weight[0, 0, list(directions)] = 1 / len(directions)
    nothing = np.zeros(0)
    return TrackMotions(True, np.ones(1), np.ones((1, 1)), nothing, nothing, np.ones(1), weight, nothing)


@pytest.mark.parametrize(("directions", "noise"), [((0, 16), 2.0), ((5, 21), 2.0), ((0, 8, 16, 24), 2.0)])
def test_information_of_all_directions_adds_up(directions, noise):
    """Scans along x have the information cos^2 of the azimuth: perpendicular ones make 1/2 in any azimuth together."""
    modes = ring_modes(np.array([1000.0, 5000.0]))
    information = np.cos(np.angle(modes.wave))[None] ** 2
    found = solved_bins(modes, SolvedSums(information, information, information), _tracks(*directions))
    np.testing.assert_allclose(found[0], noise, rtol=3e-3)  # cubic interpolation between azimuths
    np.testing.assert_allclose(found[1], 1.0, rtol=1e-9)


def test_noise_is_deconvolved_by_the_normal_matrix():
    modes = ring_modes(np.array([1000.0]))
    ones = np.ones((1, *modes.wave.shape))
    noise, transmission = solved_bins(modes, SolvedSums(0.5 * ones, 3 * ones, 0.25 * ones), _tracks(0, 16))
    assert noise == pytest.approx(12.0) and transmission == pytest.approx(0.25)


@pytest.mark.parametrize(("n_samp", "length"), [(120, 30), (121, 40), (120, 500), (90, 20)])
def test_baselines_are_those_of_the_map_maker(n_samp, length):
    """Up to a sample at the middle of a scan of an odd number of samples in an even number of pieces."""
    data = np.random.default_rng(1).standard_normal((3, n_samp))
    data -= data.mean(axis=1, keepdims=True)
    weight = BaselineWeight(np.ones(3), length)
    expected = weight.apply(data[None], np.zeros((3, n_samp), int), np.array([[0, n_samp]]))[0]
    np.testing.assert_allclose(baseline_filter(n_samp, length).apply(data.T).T, expected, atol=1e-12)


def test_noise_model_of_white_noise_and_a_common_mode_is_exact():
    """Its inverse is (1 - c c^T / (n + 1 / 4)) / 2 for the covariance 2 + 8 c c^T, with equal gains c."""
    n_det, ones, place = 30, np.ones(30), np.random.default_rng(1).standard_normal((2, 30))
    covariance = 2 * np.eye(n_det) + 8 * np.outer(ones, ones)
    [(weight, n_found)] = _weights(covariance[None], np.array([1000]), place[0] + 1j * place[1], GlsOptions())
    assert n_found == 0
    np.testing.assert_allclose(weight, (np.eye(n_det) - np.outer(ones, ones) / (n_det + 0.25)) / 2, atol=1e-12)


def test_noise_model_is_that_of_the_map_maker():
    """Measured on 200 scans of 40 samples, against the one of the known covariance, in the same band."""
    rng, n_det = np.random.default_rng(2), 12
    gain = 1 + 0.1 * rng.standard_normal(n_det)
    data = 2 * gain[:, None] * rng.standard_normal(8000) + rng.standard_normal((n_det, 8000))
    bounds, plane = np.arange(200)[:, None] * 40 + [0, 40], FocalPlane(*rng.standard_normal((2, n_det)), 1.0)
    options, covariance = GlsOptions((0.0, np.inf)), 4 * np.outer(gain, gain) + np.eye(n_det)
    measured = measure_noise(data, bounds, plane, 10.0, options)
    of_model = np.diag(measured.inverse_white[0]) - measured.inverse_modes[0] @ measured.inverse_modes[0].T
    [(found, _)] = _weights(covariance[None], np.array([39 * 200]), plane.x_rad + 1j * plane.y_rad, options)
    np.testing.assert_allclose(of_model, found, atol=5 * np.sqrt(2 / 7800) * np.abs(found).max())


def test_bands_hold_the_cosine_modes_of_a_scan(tmp_path):
    setup = prepare(load_scene(write_scene(tmp_path, UNMASKED)))
    bands = noise_bands(setup.observing.scans, GlsOptions().band_edges_hz)
    step = 10.0 / (2 * samples_per_scan(setup.observing.scans))
    assert sum(band.n_mode for band in bands) == samples_per_scan(setup.observing.scans) - 1
    at_hz = step * np.arange(1, samples_per_scan(setup.observing.scans))
    assert [int(band.holds(at_hz).sum()) for band in bands] == [band.n_mode for band in bands]


def test_white_noise_has_the_noise_of_a_binned_map(tmp_path):
    """2.5 mK^2/Hz at 10 Hz are 12.5 mK^2 a sample, where a mode is above the scan's lowest frequencies."""
    text = without_sections(UNMASKED, "atmosphere", "excess", "photon", "sky").replace('"average"', '"none"')
    setup = prepare(load_scene(write_scene(tmp_path, text)))
    conditions = observing_conditions(setup, survey_draws(setup, 0, 4))
    pipeline, options = setup.analysis.pipelines[0], GlsOptions((0.0, np.inf))
    modes, sums, each = likelihood_sums(setup, pipeline, conditions, np.ones(4), options)
    at_hz = np.abs(modes.wave.real) * setup.observing.scans.speed_rad_s / (2 * np.pi)
    fast = (at_hz > 0.5) & (at_hz < 4)
    np.testing.assert_allclose((sums.noise / sums.normal**2)[0][fast], 12.5, rtol=2e-2)
    np.testing.assert_allclose((sums.signal / sums.normal)[0], 1, rtol=3e-3)  # gains of 5 % rms
    assert not each.layer.any() and not each.taken.any()


def test_readout_noise_has_its_spectrum(tmp_path):
    """With a knee of 1 Hz and the slope 1, each detector's own noise has (1 + 1 Hz / f) times its white level."""
    text = without_sections(UNMASKED, "atmosphere", "excess", "photon", "sky").replace('"average"', '"none"')
    text += '[readout_noise.detector]\nknee = "1 Hz"\nslope = 1\n'
    setup = prepare(load_scene(write_scene(tmp_path, text), ML))
    assert why_no_forecast(setup) is None
    conditions = observing_conditions(setup, survey_draws(setup, 0, 4))
    pipeline, options = setup.analysis.pipelines[0], GlsOptions((0.0, np.inf))
    modes, sums, _ = likelihood_sums(setup, pipeline, conditions, np.ones(4), options)
    at_hz = np.abs(modes.wave.real) * setup.observing.scans.speed_rad_s / (2 * np.pi)
    fast = (at_hz > 1.5) & (at_hz < 4)  # the taper averages a convex spectrum, which exceeds 1 / f at lower ones
    found = (sums.noise / sums.normal**2)[0][fast]
    np.testing.assert_allclose(found, 12.5 * (1 + 1 / at_hz[fast]), rtol=3e-2)


@pytest.mark.parametrize(("maker", "most"), [(ML, 0.7), (DESTRIPED, 0.9)])
def test_forecasts_of_solved_maps(tmp_path, maker, most):
    """Without cleaning, they have less noise than a binned map, and more signal: the means of scans come back."""
    path, none = write_scene(tmp_path, UNMASKED), {"cleaning.algorithm": "none"}
    binned, solved = (forecast(prepare(load_scene(path, none | keys))).scores["actual"] for keys in ({}, maker))
    assert solved.band.sigma_ukcmb2 < most * binned.band.sigma_ukcmb2
    assert [effect.name for effect in solved.effects][0] == "map-maker"
    assert (solved.transmission >= binned.transmission).all() and solved.transmission[-1] == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"time_constants.value": "5 ms"}, "time_constants: found without a closed form for maximum-likelihood maps"),
        (
            {"cleaning.algorithm": ["highpass", "average"], "cleaning.highpass_frequency": "0.2 Hz"},
            "cleaning by 'highpass' has no closed form for maximum-likelihood maps",
        ),
        ({"cleaning.algorithm": ["average", "planar"]}, "cleaning by average+planar is no projection"),
    ],
)
def test_maximum_likelihood_maps_without_a_forecast(tmp_path, keys, reason):
    setup = prepare(load_scene(write_scene(tmp_path, UNMASKED), ML | keys))
    assert why_no_forecast(setup) == reason
