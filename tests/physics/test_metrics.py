"""Metrics of white noise against formulas by hand, and simulated ones against their forecasts and errors."""

import numpy as np
import pytest

from surveysim.forecasting.forecast import forecast
from surveysim.metrics.band_powers import covariance, measured_covariance
from surveysim.metrics.map_noise import noise_of_score
from surveysim.reduction.setup import prepare
from surveysim.results.metrics import drawn_metrics
from surveysim.results.results import survey_result
from surveysim.scene.scene import load_scene
from surveysim.survey.run import run_observations
from surveysim.survey.scores import noise_parts
from tests.scenes import SMALL_SCENE, without_sections, write_scene

ARCMIN = np.pi / 180 / 60
BINS = (4000, 8000, 12_000)
POWER_UKCMB2 = 1e5  # as large as the noise of a mode at ell = 6000, about
WHITE = (
    (
        without_sections(SMALL_SCENE, "sky", "atmosphere", "excess", "photon")
        .replace('noise_only_sets = ["uncorrelated", "white"]', "noise_only_sets = []")
        .replace("mask_separation_f_lambda = 1.3\n", "")
        .replace("responsivity_scatter = 0.05", "responsivity_scatter = 0.0")
        .replace('algorithm = "average"', 'algorithm = "none"')
        .replace('psd = "2.5 mK2 / Hz"', 'psd = "5 mK2 / Hz"')
    )
    + f"""
[[score.metrics]]
kind = "band_powers"
edges = {list(BINS)}
spectrum = "flat"
band_power = "{POWER_UKCMB2} uK2"

[[score.metrics]]
kind = "largest_scale"

[[score.metrics]]
kind = "array_net"

[[score.metrics]]
kind = "time_to"
of = "flat_band_power.sigma"
value = 1000
"""
)
# Scans and map are long against the wavelengths: their ends matter to less than 1 %.
WIDE = {"observations": 8, "scan.scans": 130, "scan.step": "2 arcmin", "scan.duration": "70 s"}
WIDE |= {"instrument.layout.rings": 3, "score.size": "180 arcmin", "score.ell_bin": 500}
SMALL = {"observations": 16, "scan.scans": 20, "scan.step": "2 arcmin", "scan.duration": "12 s"}
SMALL |= {"instrument.layout.rings": 3, "score.size": "24 arcmin", "score.ell_bin": 500, "score.jackknives": 64}


def setup_of(folder, keys):
    return prepare(load_scene(write_scene(folder, WHITE), keys))


def run_of(setup):
    return survey_result(setup, run_observations(setup, None), wall_s=0.0, workers=1)


def test_white_noise_by_hand(tmp_path):
    """Every metric of a forecast within 1 % of a formula that knows the survey's keys alone.

    Lines of scans 2 arcmin apart at 4 arcmin/s give each point n_det / (2 x 4) detector-seconds per square arcmin in
    each observation. 5 mK^2/Hz are a NET of sqrt(5 / 2) mK sqrt(s). Errors of band powers are those of Knox (1995).
    """
    setup = setup_of(tmp_path, WIDE)
    found = {key: item.value for key, item in drawn_metrics(setup, forecast(setup))["actual"].items()}
    n_det, to_ukcmb = setup.camera.n_det, 1e3 * setup.scene.instrument.cmb_per_rj
    net_mk = np.sqrt(5 / 2)
    noise = (net_mk * to_ukcmb) ** 2 * (2 * ARCMIN) * (4 * ARCMIN) / (8 * n_det)
    ell = np.arange(BINS[0], BINS[-1]) + 0.5
    beam = np.exp(-((ell * ARCMIN) ** 2) / (8 * np.log(2)))  # of 1 arcmin, squared
    pixel = np.exp(-((ell * ARCMIN / 2) ** 2) / 12)  # of half of that, to the second order
    flat = 2 * np.pi / (ell * (ell + 1)) * beam * pixel
    # Half of the side is cosine edges: the mean of T^2 and T^4 over the side are 11/16 and 163/256.
    share = (180 * ARCMIN) ** 2 * (11 / 16) ** 4 / (163 / 256) ** 2 / (4 * np.pi)

    def knox(low, high, power):
        inside = (ell > low) & (ell < high)
        return np.sum(((2 * ell + 1) * share / 2 * (flat / (noise + power * flat)) ** 2)[inside]) ** -0.5

    hours = 8 * (130 * 72 - 2) / 3600
    expected = {
        "flat_band_power.sigma": knox(BINS[0], BINS[-1], 0.0),
        "band_powers.amplitude": knox(BINS[0], BINS[-1], POWER_UKCMB2) / POWER_UKCMB2,
        "array_net.array_rj": net_mk / np.sqrt(n_det),
        "array_net.array_cmb": net_mk / np.sqrt(n_det) * to_ukcmb / 1e3,
        "array_net.detector_rj": net_mk,
        "array_net.detector_cmb": net_mk * to_ukcmb / 1e3,
        "time_to.hours": hours * knox(BINS[0], BINS[-1], 0.0) / 1000,
    }
    for low, high in zip(BINS, BINS[1:], strict=False):
        expected[f"band_powers.sigma_{low}_{high}"] = knox(low, high, 0.0)
        expected[f"band_powers.total_{low}_{high}"] = knox(low, high, POWER_UKCMB2)
    assert {key: value for key, value in found.items() if key in expected} == pytest.approx(expected, rel=0.01)
    assert np.isnan(found.pop("largest_scale.ell")) and found.keys() == expected.keys()


def test_half_of_the_power_by_hand(tmp_path):
    """Subtraction of the mean leaves ``1 - |g|^2`` of a mode, g being the mean of its phases over the detectors.

    The mean of a scan of length L takes ``sinc^2(k L / 2)`` of it along the scan; scans go along both axes in turn.
    """
    text = SMALL_SCENE.replace("responsivity_scatter = 0.05", "responsivity_scatter = 0.0")
    path = write_scene(tmp_path, text + '\n[[score.metrics]]\nkind = "largest_scale"\n')
    keys = {**WIDE, "observations": 2}
    setup = prepare(load_scene(path, keys))
    found = drawn_metrics(setup, forecast(setup))["actual"]["largest_scale.ell"].value
    plane, ell = setup.camera.focal_plane, np.linspace(2000, 5000, 301)
    angle = np.arange(180) * np.pi / 180
    along = np.outer(np.cos(angle), plane.x_rad) + np.outer(np.sin(angle), plane.y_rad)
    mean = np.abs(np.exp(1j * ell[:, None, None] * along).mean(axis=-1)) ** 2
    scan = [np.sinc(np.outer(ell, part(angle)) * 70 * 4 * ARCMIN / (2 * np.pi)) ** 2 for part in (np.cos, np.sin)]
    left = np.mean((1 - mean) ** 2, axis=1) * np.mean((1 - np.mean(scan, axis=0)) ** 2, axis=1)
    assert found == pytest.approx(np.interp(0.5, left, ell), rel=0.01)


def test_simulated_metrics_are_their_forecasts(tmp_path):
    """Each within 3 of its errors, of a survey of a second."""
    result = run_of(setup_of(tmp_path, SMALL))
    metrics = dict(result.metrics["actual"])
    scale = metrics.pop("largest_scale.ell")  # of scans without cleaning, below the lowest bin of the forecast
    assert scale.quoted.response.budget.noise == 0 and len(metrics) == 11
    for key, item in metrics.items():
        assert 0 < item.error < 0.15 * item.value, key
        assert abs(item.value - item.forecast) < 3 * item.error, key


def test_measured_covariance_is_the_analytic_one(tmp_path):
    """K sign-flipped co-adds know a variance to sqrt(2 / (K - 1)), and a correlation to 1 / sqrt(K - 1)."""
    setup = setup_of(tmp_path, SMALL)
    result = run_of(setup)
    item, (chosen, *_) = result.scores["actual"], setup.scene.score.metrics
    noise, _ = noise_of_score(setup, item)
    signs, common = noise_parts(setup.analysis, item)
    assert signs > 0 and common > 0
    used = item.weights[item.weights > 0]
    found = measured_covariance(noise, chosen, item.noise_psds, np.sum(used**2) / np.sum(used) ** 2)
    expected = covariance(noise, chosen, own_variance=False)
    n_free = setup.scene.score.jackknives - 1
    np.testing.assert_allclose(np.diag(found) / np.diag(expected), 1, atol=3 * np.sqrt(2 / n_free))
    one, other = (matrix[0, 1] / np.sqrt(matrix[0, 0] * matrix[1, 1]) for matrix in (found, expected))
    assert one == pytest.approx(other, abs=3 / np.sqrt(n_free))


@pytest.mark.slow
def test_errors_are_the_scatter_over_seeds(tmp_path):
    """Of 24 surveys: a variance from 24 draws is known to sqrt(2 / 24); three times that."""
    keys = ("flat_band_power.sigma", "band_powers.sigma_8000_12000", "band_powers.amplitude", "array_net.array_rj")
    pulls = {key: [] for key in keys}
    for seed in range(24):
        setup = setup_of(tmp_path, {**SMALL, "seed": seed + 1})
        metrics = run_of(setup).metrics["actual"]
        for key in keys:
            pulls[key].append((metrics[key].value - metrics[key].forecast) / metrics[key].error)
    for key, found in pulls.items():
        assert np.var(found, ddof=1) == pytest.approx(1, abs=3 * np.sqrt(2 / 24)), key
        assert abs(np.mean(found)) < 3 / np.sqrt(24) + 0.3, key
