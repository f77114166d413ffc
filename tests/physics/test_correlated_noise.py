"""Noise that adjacent detectors share: what is planted comes back, and white noise and a common sky leave none.

Errors are those of sampling: a mean over pairs of sample covariances is tr(A S), and of Gaussian modes with
covariance K it has the variance 2 tr(A K A K) / n with n degrees of freedom.
"""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker.cleaning import Cleaned, TemplateOptions, clean
from mapmaker.cleaning.templates import template_basis
from surveysim.paper.excess import excess_noise, residual_atmosphere, residual_by_track
from surveysim.paper.figures.pairs import correlation_histogram_figure, folded, separation_figure
from surveysim.paper.measured_survey import known_track
from surveysim.paper.measurement import (
    PAIR_CLEANINGS,
    PairNoise,
    camera_pairs,
    measure,
    pair_noise,
    supported_cleanings,
)
from surveysim.paper.tables import correlated_noise_table
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.telescope.pixel_coherence import correlation_factor
from surveysim.timestreams.low_frequency import excess_psd, excess_variance
from surveysim.timestreams.noise import draw_from_psd
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_weather
from surveysim.timestreams.simulation import observation_path
from tests.deviates import deviates
from tests.pixels import correlation_matrix
from tests.scenes import SMALL_SCENE
from tests.surveys import ARCMIN, fit, named, of_b2

RATE_HZ, N, N_SCAN = 10.0, 150, 40
LOW_MODES, HIGH_MODES = 15, 37  # of 15 s scans: up to 1 Hz, and between 2.5 Hz and Nyquist's 5 Hz
LYNX = "scenarios/lynx.toml"


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "small.toml"
    path.write_text(SMALL_SCENE, encoding="utf-8")
    return prepare(load_scene(path).model_copy(update={"score": None}))


@pytest.fixture(scope="module")
def lynx():
    return prepare(load_scene(LYNX, {"observations": 24}).model_copy(update={"score": None}))


def streams(factor: np.ndarray, psd_mk2_hz: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Scans (n_det, N_SCAN, N) of one-sided PSD, periodic, correlated as ``factor factor^T``."""
    drawn = draw_from_psd(psd_mk2_hz, (len(factor), N_SCAN), N, RATE_HZ, deviates(rng))
    return np.einsum("ij,jsn->isn", factor, drawn)


def white_streams(n_det: int, psd_mk2_hz: float, rng: np.random.Generator) -> np.ndarray:
    return streams(np.eye(n_det), np.full(N // 2 + 1, psd_mk2_hz), rng)


def as_cleaned(scans: np.ndarray, kept=None) -> Cleaned:
    n_det, n_scan, _ = scans.shape
    kept = np.ones(n_scan, bool) if kept is None else kept
    zeros = np.zeros(n_scan, int)
    return Cleaned(scans.reshape(n_det, -1).astype(np.float32), kept, np.ones((n_scan, n_det)), zeros, zeros)


def pair_weights(setup) -> np.ndarray:
    """A with tr(A S) the mean over adjacent pairs of a covariance S."""
    bins = camera_pairs(setup)
    weights = np.zeros((setup.camera.n_det, setup.camera.n_det))
    weights[bins.first[bins.adjacent], bins.second[bins.adjacent]] = 0.5 / bins.adjacent.sum()
    return weights + weights.T


def sampling_error(weights: np.ndarray, low: np.ndarray, high: np.ndarray, n_scan: int = N_SCAN) -> float:
    """Of tr(A S) up to 1 Hz less that above 2.5 Hz brought to the same bandwidth; covariances up to 1 Hz."""
    terms = [(low, 2 * LOW_MODES * n_scan), (high, 2 * HIGH_MODES * n_scan)]
    return float(np.sqrt(sum(2 * np.trace(weights @ k @ weights @ k) / n for k, n in terms)))


def test_planted_covariance_comes_back(setup):
    """4 mK^2 up to 1 Hz, 0.5 of it shared by neighbours, on white noise of 5 mK^2/Hz of which 6 % is."""
    rng, overlap = np.random.default_rng(1), correlation_matrix(setup.camera.positions_f_lambda, "field")
    weights, mean = pair_weights(setup), np.eye(setup.camera.n_det) / setup.camera.n_det
    shared = float(np.sum(weights * overlap))
    assert shared == pytest.approx(0.506, abs=0.001)
    white = 0.88 * np.eye(setup.camera.n_det) + 0.12 * overlap
    low = np.where(np.arange(N // 2 + 1) <= LOW_MODES, 4.0, 0.0)
    scans = streams(correlation_factor(overlap), low, rng)
    scans = scans + streams(correlation_factor(white), np.full(N // 2 + 1, 5.0), rng)
    found = pair_noise(as_cleaned(scans), camera_pairs(setup), RATE_HZ)
    k_low, k_high = 4 * overlap + 5 * white, 5 * white
    bound = 3 * sampling_error(weights, k_low, k_high)
    assert bound < 0.25
    assert found.adjacent_mk2 - found.adjacent_white_mk2 == pytest.approx(4 * shared, abs=bound)
    variance_bound = 3 * sampling_error(mean, k_low, k_high)
    assert found.variance_mk2 - found.white_mk2 == pytest.approx(4.0, abs=variance_bound)
    assert found.white_mk2 == pytest.approx(5.0, abs=variance_bound)
    assert found.adjacent_white_mk2 == pytest.approx(0.6 * shared, abs=bound)
    # The coefficient's own error is below (1 - rho^2) / sqrt(n) for one pair, let alone for the mean of all.
    planted = (4 + 0.6) * shared / 9
    assert found.adjacent_correlation == pytest.approx(planted, abs=3 / np.sqrt(2 * LOW_MODES * N_SCAN))


@pytest.mark.parametrize("name", PAIR_CLEANINGS)
@pytest.mark.parametrize("red", [False, True])
def test_white_noise_below_a_common_sky_has_no_excess(setup, name, red):
    """A perfectly common signal, 10^4 times stronger, leaves nothing but what templates take from white noise.

    The templates' white noise and the fitted responsivities take the same from both bands where the sky is white; a
    red one takes up to one of 30 modes of white noise from the lower band alone, a thirtieth of its (co)variance.
    """
    rng = np.random.default_rng(2)
    n_freq = N // 2 + 1
    shape = np.ones(n_freq)
    if red:
        shape = np.maximum(np.arange(n_freq), 1.0) ** (-8 / 3)
    common = streams(np.ones((1, 1)), 5e4 * shape, rng)
    scans = white_streams(setup.camera.n_det, 5.0, rng) + setup.camera.responsivity[:, None, None] * common
    bounds = np.arange(N_SCAN)[:, None] * N + [0, N]
    options = TemplateOptions(1e-8, 100)
    cleaned = clean(name, scans.reshape(setup.camera.n_det, -1), bounds, setup.camera.focal_plane, options=options)
    assert cleaned.kept.all()
    found = pair_noise(cleaned, camera_pairs(setup), RATE_HZ)
    basis = template_basis(setup.camera.focal_plane, PAIR_CLEANINGS[name])
    left = 5 * (np.eye(setup.camera.n_det) - basis.T @ basis)
    for weights, low, white in (
        (pair_weights(setup), found.adjacent_mk2, found.adjacent_white_mk2),
        (np.eye(setup.camera.n_det) / setup.camera.n_det, found.variance_mk2, found.white_mk2),
    ):
        expected, bound = np.sum(weights * left), 3 * sampling_error(weights, left, left)
        taken = abs(expected) / (2 * LOW_MODES) if red else 0.0
        assert abs(low - white) < bound + taken
        assert white == pytest.approx(expected, abs=bound + 0.02 * abs(expected))


def test_every_pair_is_counted_once_where_its_correlation_lies(setup):
    rng, bins = np.random.default_rng(3), camera_pairs(setup)
    found = pair_noise(as_cleaned(white_streams(setup.camera.n_det, 5.0, rng)), bins, RATE_HZ)
    assert found.adjacent_counts.sum() == bins.adjacent.sum() > 20
    assert found.distant_counts.sum() == (~bins.adjacent).sum() > 80
    # 1200 degrees of freedom: coefficients within 4.5 / sqrt(1200) = 0.13 of 0, five bins on either side; half below.
    counts = found.adjacent_counts + found.distant_counts
    assert counts[:34].sum() == counts[46:].sum() == 0
    assert counts[:40].sum() == pytest.approx(counts.sum() / 2, abs=4 * np.sqrt(counts.sum()) / 2)
    # All alike but for rounding: one everywhere.
    same = np.repeat(white_streams(1, 5.0, rng), setup.camera.n_det, axis=0)
    found = pair_noise(as_cleaned(same), bins, RATE_HZ)
    assert found.adjacent_counts[-1] == bins.adjacent.sum() and found.distant_counts[-1] == (~bins.adjacent).sum()
    np.testing.assert_allclose([found.adjacent_correlation, *found.correlation], 1.0, rtol=1e-6)


def test_discarded_scans_do_not_count(setup):
    rng, bins = np.random.default_rng(4), camera_pairs(setup)
    scans = white_streams(setup.camera.n_det, 5.0, rng)
    kept = np.arange(N_SCAN) % 3 > 0
    holes = np.where(kept[:, None], scans, 0.0)
    some = pair_noise(as_cleaned(holes, kept), bins, RATE_HZ)
    alone = pair_noise(replace(as_cleaned(scans[:, kept])), bins, RATE_HZ)
    assert some.variance_mk2 == pytest.approx(alone.variance_mk2, rel=1e-9)
    np.testing.assert_array_equal(some.distant_counts, alone.distant_counts)
    with pytest.raises(ValueError, match="found no scan that is kept"):
        pair_noise(as_cleaned(holes, np.zeros(N_SCAN, bool)), bins, RATE_HZ)


def test_cleanings_that_the_camera_does_not_support_are_left_out(setup, tmp_path):
    assert supported_cleanings(setup) == ("average", "quadratic")
    path = tmp_path / "six.toml"
    path.write_text(SMALL_SCENE.replace("rings = 2", "rings = 1"), encoding="utf-8")
    six = prepare(load_scene(path).model_copy(update={"score": None}))
    assert six.camera.n_det == 6
    assert list(measure(six, draw_observation(six, 0), 0).pair_noise) == ["average"]


@pytest.mark.slow
def test_the_thin_screen_says_what_average_subtraction_leaves():
    """Atmosphere alone, responsivities known: the mean over observations to their scatter, and 3 % of the model."""
    changes = {"observations": 24, "instrument.responsivity_scatter": 0.0}
    scene = load_scene(LYNX, changes).model_copy(update=dict.fromkeys(("score", "excess", "photon", "detector")))
    setup = prepare(scene)
    bins, ratio = camera_pairs(setup), []
    for number in range(24):
        weather, (_, pointing) = observation_weather(setup, number), observation_path(setup.observing, number)
        data = draw_observation(setup, number).data_mk
        scans = (data - data.mean(axis=0)).reshape(setup.camera.n_det, -1, N)
        found = pair_noise(as_cleaned(scans), bins, RATE_HZ)
        model = residual_by_track(setup, "average", np.sin(pointing.scan_elevation_rad).mean())
        predicted = weather.b2 * model(np.log(weather.wind_speed_rad_s * 15.0))
        ratio.append(np.array([found.adjacent_mk2, found.variance_mk2]) / predicted)
    error = np.std(ratio, axis=0) / np.sqrt(len(ratio))
    assert (error < 0.03).all()
    np.testing.assert_array_less(np.abs(np.mean(ratio, axis=0) - 1), 0.03 + 3 * error)
    # What is left of a layer so smooth after quadratic subtraction is thousands of times less.
    assert (residual_by_track(setup, "quadratic", 1.0)(np.log(0.13)) < 1e-3 * model(np.log(0.13))).all()


@pytest.mark.slow
def test_the_scene_s_excess_comes_back_but_for_what_cleaning_and_white_levels_take(lynx):
    """After quadratic subtraction neighbours keep tr(A P G P) of it, less the tail above 2.5 Hz counted as white.

    Fitted responsivities take one mode of every scan from a detector, which holds at most the largest eigenvalue of the
    excess noise's covariance in time. Responsivities of 5 % scatter change products by less than 1 %.
    """
    basis = template_basis(lynx.camera.focal_plane, PAIR_CLEANINGS["quadratic"])
    project = np.eye(lynx.camera.n_det) - basis.T @ basis
    overlap = correlation_matrix(lynx.camera.positions_f_lambda, "field")
    shared = np.sum(pair_weights(lynx) * (project @ overlap @ project))
    autocovariance = np.fft.irfft(excess_psd(lynx.scene.excess, 1.0, N, 2 * N, RATE_HZ), 2 * N) * RATE_HZ / 2
    covariance = autocovariance[np.abs(np.subtract.outer(np.arange(N), np.arange(N)))]
    modes = np.fft.rfft(np.eye(N), axis=0)[1:]
    power = np.einsum("kn,nm,km->k", modes, covariance, modes.conj()).real * 2 / N**2
    low, high = power[:LOW_MODES].sum(), power[LOW_MODES + 22 : -1].sum() * LOW_MODES / HIGH_MODES
    assert low == pytest.approx(1.0, abs=0.01) and 0.05 < high < 0.1
    centre = np.eye(N) - 1 / N
    strongest = np.linalg.eigvalsh(centre @ covariance @ centre)[-1] / N
    assert strongest < 0.25
    found = []
    for number in range(12):
        item = measure(lynx, draw_observation(lynx, number), number).pair_noise["quadratic"]
        variance = excess_variance(lynx.scene.excess, observation_weather(lynx, number).b2)
        found.append((item.adjacent_mk2 - item.adjacent_white_mk2) / variance)
    error = 3 * np.std(found) / np.sqrt(len(found)) + 0.01 * shared
    assert shared * (low - high - strongest) - error < np.mean(found) < shared * (low - high) + error


# ---------------------------------------------------------------- figures 14 and 15, Table 2


def made_noise(setup, k: int) -> PairNoise:
    """Excess of 2 k shared by neighbours and 4 k of detectors; correlations of 0.31 and -0.11, or 0.01 k."""
    bins = camera_pairs(setup)
    counts = np.zeros((2, 80), np.int32)
    counts[0, 52], counts[1, 35] = bins.adjacent.sum(), (~bins.adjacent).sum()
    by_separation = np.full(len(bins.count), 0.01 * k)
    return PairNoise(2.0 * k + 0.5, 2.0 * k + 0.5, 5.0, 0.5, *counts, 0.1 * k, by_separation)


@pytest.fixture(scope="module")
def paired(setup):
    """Eight observations of B2 as good as 0, in the order of their excess, and one without fit and cleaned streams."""
    whole = of_b2(setup, np.append(np.arange(1.0, 9.0), np.nan))
    items = []
    for k, item in enumerate(whole.measurements, start=1):
        noise = {name: replace(made_noise(setup, k), variance_mk2=4.0 * k + 5.0) for name in PAIR_CLEANINGS}
        items.append(replace(item, pair_noise=noise if k < 9 else {}))
    fits = tuple(None if one is None else fit(1e-9 * k) for k, one in enumerate(whole.fits, start=1))
    return replace(whole, measurements=tuple(items), fits=fits)


@pytest.mark.slow
def test_excess_is_what_white_noise_and_atmosphere_leave(setup, paired):
    for cleaning in PAIR_CLEANINGS:
        excess = excess_noise(paired, cleaning)
        np.testing.assert_allclose(excess.covariance_mk2[:8], 2.0 * np.arange(1, 9), rtol=1e-6)
        np.testing.assert_allclose(excess.variance_mk2[:8], 4.0 * np.arange(1, 9), rtol=1e-6)
        np.testing.assert_allclose(excess.fraction[:8], 0.5, rtol=1e-6)
        assert np.isnan(excess.covariance_mk2[8]) and np.isnan(excess.fraction[8])
    # The atmosphere's share is proportional to B2, more in detectors than in pairs, and hardly any of second order.
    brighter = replace(paired, fits=tuple(fit(1e4) for _ in paired.fits))
    average, quadratic = (residual_atmosphere(brighter, name) for name in PAIR_CLEANINGS)
    assert (average[1] > average[0]).all() and (quadratic < 0.01 * average).all()
    np.testing.assert_allclose(excess_noise(brighter, "average").covariance_mk2[0], 2.0 - average[0, 0])
    np.testing.assert_allclose(residual_atmosphere(paired, "average")[:, 1], 2e-13 * average[:, 1])
    low = tuple(replace(item, elevation_rad=np.full(len(item.elevation_rad), 0.7)) for item in paired.measurements)
    track = np.log(known_track(paired.measurements[0], 1.0, 1.0))
    there, here = (residual_by_track(setup, "average", np.sin(el))(track).mean(axis=0) for el in (0.7, 1.0))
    lower = residual_atmosphere(replace(brighter, measurements=low), "average")
    np.testing.assert_allclose(lower, (there / here)[:, None] * average, rtol=1e-6)
    # More than by the amplitude, sin(el)^(-8/3): the beam in the layer is smaller.
    assert (lower > (np.sin(0.7) / np.sin(1.0)) ** (-8 / 3) * 1.05 * average)[0, :8].all()
    with pytest.raises(ValueError, match="cleaning: found 'pca'; average, quadratic are expected"):
        residual_atmosphere(paired, "pca")
    # Without an excess there is no share of it.
    flat = {"average": replace(made_noise(setup, 1), variance_mk2=4.0)}
    none = replace(paired, measurements=tuple(replace(item, pair_noise=flat) for item in paired.measurements))
    assert np.isnan(excess_noise(none, "average").fraction).all()


def test_table_2_has_medians_of_quarters_beside_the_papers(paired):
    table = correlated_noise_table(paired)
    rows = table[(table["quantity"] == "adjacent correlated noise") & (table["cleaning"] == "quadratic")]
    np.testing.assert_array_equal(rows["observations"], [2, 2, 2, 2, 8])
    np.testing.assert_allclose(rows["ours"], [3, 7, 11, 15, 9], rtol=1e-6)
    np.testing.assert_array_equal(rows["paper_error"], [0.1, 0.1, 0.2, 0.3, 0.1])
    off = (rows["ours"] - rows["paper"]) / np.hypot(rows["error"], rows["paper_error"])
    np.testing.assert_allclose(rows["sigmas"], off)
    fractions = table[table["quantity"] == "adjacent correlation fraction"]
    np.testing.assert_allclose(fractions["ours"], 0.5, rtol=1e-6)
    white = table[table["quantity"] == "adjacent white correlation"]
    np.testing.assert_allclose(white["ours"], 0.1)
    np.testing.assert_array_equal(white["paper"], 0.05)
    assert len(white) == 2 and np.isnan(white["sigmas"]).all()


def test_histograms_are_of_magnitudes_and_add_up(setup, paired):
    np.testing.assert_array_equal(folded(np.array([[1, 2, 3, 4, 5, 6]])), [[7, 7, 7]])
    figure = correlation_histogram_figure(paired)
    assert figure.columns == 2 and len(figure.panels) == 4
    titles = [panel.title for panel in figure.panels]
    assert (
        titles[0] == "average subtraction, adjacent pairs" and titles[3] == "quadratic subtraction, non-adjacent pairs"
    )
    for panel, place in zip(figure.panels, (12, 12, 4, 4), strict=True):
        for label in ("all observations", "lowest quarter of B2", "highest quarter of B2"):
            steps = named(panel, label)
            expected = np.zeros(40)
            expected[place] = 1.0
            np.testing.assert_allclose(steps.y[:-1], expected)
            np.testing.assert_allclose(steps.x, np.linspace(0, 1, 41), atol=1e-12)
        band = next(series for series in panel.series if series.kind == "band")
        np.testing.assert_allclose(band.low, band.high)  # all observations alike
        assert panel.x_range == pytest.approx((0.0, 0.325))
    bins = camera_pairs(setup)
    assert f"{bins.adjacent.sum()} adjacent and {(~bins.adjacent).sum()} other pairs" in figure.caption
    assert "0 % (adjacent pairs, average), 0 % (adjacent pairs, quadratic), 100 % (non-adj" in figure.caption
    assert "10.0 ± 0.0 % after average subtraction" in figure.caption
    with pytest.raises(ValueError, match="found no observation with scans kept by average"):
        correlation_histogram_figure(of_b2(setup, np.arange(1.0, 9.0)))


def test_correlation_against_separation_is_a_median(setup, paired):
    left, right = separation_figure(paired).panels
    bins = camera_pairs(setup)
    for panel, label, median in (
        (left, "average subtraction", 4.5),
        (right, "quadratic, lowest", 1.5),
        (right, "average, highest", 7.5),
    ):
        series = named(panel, label)
        np.testing.assert_allclose(series.y, median * np.append(0.1, np.full(len(bins.count), 0.01)))
        np.testing.assert_allclose(series.x, np.append(40 / 60, bins.theta_rad / ARCMIN), rtol=1e-4)
        assert (series.high > series.y).all() and (series.low < series.y).all()
    assert "0.500 ± 0.000 (average)" in separation_figure(paired).caption
    with pytest.raises(ValueError, match="found no observation with scans kept by average"):
        separation_figure(of_b2(setup, np.arange(1.0, 9.0)))
