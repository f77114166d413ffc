"""Cameras of detectors that differ: noise levels, responsivities, efficiencies and time constants of a table."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.table import Column, Table
from scipy.signal import lfilter

from mapmaker.geometry import pixel_indices
from mapmaker.timestreams import FocalPlane
from mapmaker.transfer_function import beam_window, pixel_window
from surveysim import run
from surveysim.forecasting.forecast import forecast
from surveysim.forecasting.mode_response import projected_array, stream_power
from surveysim.forecasting.observing_conditions import (
    independent_noise,
    noise_correlations,
    population_conditions,
    white_shapes,
)
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.results.agreement import forecast_agreement
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.scene.units import BOLTZMANN_J_K
from surveysim.telescope.beams import beams_of
from surveysim.telescope.lattice_noise import NoiseCorrelation
from surveysim.telescope.layouts import hexagon
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_levels
from surveysim.timestreams.response import write_sky_signal
from surveysim.timestreams.response_kernels import low_pass
from surveysim.timestreams.simulation import camera_white, observation_path
from surveysim.timestreams.time_constants import pole_coefficients
from tests import naive
from tests.pixels import correlation_matrix
from tests.scenes import SMALL_SCENE, write_scene

RATE = 10.0
UNITS = {"nep": "W / Hz(1/2)", "psd": "mK2 / Hz", "beam_fwhm": "arcsec", "time_constant": "s", "angle": "deg"}
N_DET = 19
TABLE = {"instrument.layout": None, "instrument.responsivity_scatter": 0.0}
NOISE_ONLY = dict.fromkeys(("atmosphere", "excess", "sky", "score")) | {"cleaning.algorithm": "none"}
POWER = {"instrument.bandwidth": 0.15, "instrument.efficiency": 0.3, "instrument.polarizations": 1}
RNG = np.random.default_rng(7)
SPREAD = RNG.uniform(0.5, 2.0, N_DET)


@pytest.fixture
def scene_with(tmp_path):
    """Function that makes a scene of a table with the positions of the small scene and some more columns."""

    def make(columns, settings, text=SMALL_SCENE):
        x, y = hexagon(2, 40.0).T
        table = Table({"x": Column(x, unit="arcsec"), "y": Column(y, unit="arcsec")} | columns)
        for name, values in columns.items():
            table[name] = Column(values, unit=UNITS.get(name, getattr(values, "unit", None)))
        name = f"camera_{len(list(tmp_path.iterdir()))}.ecsv"  # files of one name are taken as one
        table.write(tmp_path / name)
        return load_scene(write_scene(tmp_path, text), TABLE | {"instrument.positions": name} | settings)

    return make


def covariance(setup):
    """Covariance of the samples of all pairs of detectors, and their number."""
    data = draw_observation(setup, 0).data_mk.astype(float)
    return data @ data.T / data.shape[1], data.shape[1]


def agrees(found, expected, n):
    """Whether a covariance scatters about the expected one as Wishart's, all pairs within 4.5 standard deviations."""
    spread = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / n)
    return (np.abs(found - expected) < 4.5 * spread).all()


@pytest.mark.parametrize("photon", [True, False])
@pytest.mark.parametrize("column", ["psd", "nep"])
def test_detector_noise_of_each(scene_with, column, photon):
    """Its PSD is the table's, or (nep / (k dnu eta))^2; photon noise is that of the scene, shared as in the scene."""
    if column == "nep":
        nep = 3e-17 * SPREAD
        psd = (1e3 * nep / (BOLTZMANN_J_K * 0.15 * 143e9 * 0.3)) ** 2
        columns = {"nep": nep}
    else:
        psd = 2.0 * SPREAD
        columns = {"psd": psd}
    settings = {"scan.scans": 400, "detector.psd": None, "photon.psd": "2 mK2/Hz", "photon.coherent_fraction": 0.8}
    settings |= NOISE_ONLY | POWER | ({} if photon else {"photon": None})
    settings = {key: value for key, value in settings.items() if photon or not key.startswith("photon.")}
    ready = prepare(scene_with(columns, settings | ({} if photon else {"photon": None})))
    found, n = covariance(ready)
    overlap = correlation_matrix(ready.camera.positions_f_lambda, "field")
    expected = np.diag(psd) + photon * 2.0 * (0.2 * np.eye(N_DET) + 0.8 * overlap)
    assert agrees(found, expected * RATE / 2, n)
    assert not agrees(found, (np.eye(N_DET) * psd.mean() + expected - np.diag(psd)) * RATE / 2, n)


@pytest.mark.parametrize("coherence", ["field", "none"])
def test_noise_of_an_efficiency(scene_with, coherence):
    """In temperature, shot noise goes as 1 / e, bunching does not change, and noise of an NEP goes as 1 / e^2."""
    settings = {"scan.scans": 400, "photon.psd": "2 mK2/Hz", "photon.bose_fraction": 0.4, "photon.coherence": coherence}
    settings |= {"photon.coherent_fraction": 0.7, "detector.psd": "1 mK2/Hz"}
    ready = prepare(scene_with({"efficiency": SPREAD}, settings | NOISE_ONLY))
    photon = 2.0 * (0.6 / SPREAD + 0.4)
    shared = 0.7 * photon
    overlap = correlation_matrix(ready.camera.positions_f_lambda, coherence)
    expected = np.diag(photon - shared + 1.0 / SPREAD**2) + np.sqrt(np.outer(shared, shared)) * overlap
    found, n = covariance(ready)
    assert agrees(found, expected * RATE / 2, n)
    assert not agrees(found, np.diag(np.diag(expected)).mean() * N_DET * np.eye(N_DET) * RATE / 2, n)


def test_shot_noise_of_a_load(scene_with):
    """An efficiency e of the table is e times that of the instrument."""
    text = SMALL_SCENE.replace('psd = "2.5 mK2 / Hz"\ncoherent_fraction = 0.1\n', "") + (
        '\n[photon.load]\nsky = "20 K"\noptics = "10 K"\n'
    )
    one = prepare(scene_with({"efficiency": np.full(N_DET, 0.5)}, NOISE_ONLY | POWER, text))
    other = prepare(scene_with({}, NOISE_ONLY | POWER | {"instrument.efficiency": 0.15}, text))
    white = camera_white(one.camera, observation_levels(one, 0))
    wanted = observation_levels(other, 0)
    np.testing.assert_allclose(white.shared + white.alone, wanted.photon_mk2_hz, rtol=1e-12)
    np.testing.assert_allclose(white.shared, wanted.photon_mk2_hz * wanted.shared, rtol=1e-12)


def test_responsivities_of_the_table(scene_with):
    """They have a mean of 1, and the sky is seen with them."""
    ready = prepare(scene_with({"responsivity": SPREAD}, NOISE_ONLY))
    np.testing.assert_allclose(ready.camera.responsivity, SPREAD / SPREAD.mean(), rtol=1e-14)
    _, pointing = observation_path(ready.observing, 0)
    signal = np.zeros((N_DET, len(pointing.time_s)), np.float32)
    write_sky_signal(ready, pointing, np.ones((ready.sky.geometry.n_y, ready.sky.geometry.n_x), np.float32), signal)
    np.testing.assert_allclose(signal.mean(axis=1), SPREAD / SPREAD.mean(), rtol=1e-6)


# ---------------------------------------------------------------- time constants


def test_low_pass_against_the_slow_twin():
    rng = np.random.default_rng(1)
    data = rng.standard_normal((3, 40))
    coefficients = pole_coefficients(np.array([0.0, 0.05, 0.7]), RATE)
    expected = naive.low_pass(data, 20, *coefficients)
    low_pass(data, 20, *coefficients)
    np.testing.assert_allclose(data, expected, rtol=1e-13)


def test_coefficients_against_quadrature():
    """They sum to 1, a signal at rest, whatever the time constant; those on both sides of a change of method agree."""
    tau = np.array([0.0, 1e-9, 1e-3, 0.0999999, 0.1000001, 3.0, 1e4])
    decay, taps = pole_coefficients(tau, RATE)
    np.testing.assert_allclose(decay + taps.sum(axis=1), 1, rtol=1e-13)
    np.testing.assert_allclose(taps[0], [0, 0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(taps[3], taps[4], atol=1e-6)
    # For a very long one: the integral of the cubic through four samples, -1/24, 13/24, 13/24, -1/24, over tau.
    np.testing.assert_allclose(taps[-1] * tau[-1] * RATE, np.array([-1, 13, 13, -1]) / 24, rtol=1e-4)


def test_low_pass_of_a_ramp():
    """A ramp lags by its time constant, after a start at rest; the first and last intervals are not straight."""
    time = np.arange(400) / RATE
    ramp = time[None].copy()
    low_pass(ramp, 400, *pole_coefficients(np.array([0.3]), RATE))
    expected = time - 0.3 * (1 - np.exp(-time / 0.3))
    np.testing.assert_allclose(ramp[0], expected, atol=0.1 / RATE)
    np.testing.assert_allclose(ramp[0, 60:-1], expected[60:-1], rtol=1e-8)


@pytest.mark.parametrize(("share", "error"), [(0.05, 3e-4), (0.1, 3e-3), (0.2, 0.04)])
@pytest.mark.parametrize("tau", [0.01, 0.1, 0.4])
def test_low_pass_of_a_wave(share, error, tau):
    """It leaves 1 / (1 + 2 pi i f tau) of a wave, to an error that grows with its share of the sample rate."""
    time, omega = np.arange(600) / RATE, 2 * np.pi * share * RATE
    wave = np.sin(omega * time)[None].copy()
    low_pass(wave, 600, *pole_coefficients(np.array([tau]), RATE))
    response = 1 / (1 + 1j * omega * tau)
    expected = np.imag(response * np.exp(1j * omega * time))
    np.testing.assert_allclose(wave[0, 60:-1], expected[60:-1], atol=error * abs(response))


def test_time_constants_of_zero_change_nothing(scene_with):
    """But that photon and detector noise are drawn apart."""
    signal = {"photon": None, "detector.psd": "1e-12 mK2/Hz"}
    quick = draw_observation(prepare(scene_with({"time_constant": np.zeros(N_DET)}, signal)), 0).data_mk
    plain = draw_observation(prepare(scene_with({}, signal)), 0).data_mk
    np.testing.assert_array_equal(quick, plain)


def test_streams_pass_the_time_constants(scene_with):
    """Layer, excess and sky do, scan by scan, each detector by its own."""
    tau = np.linspace(0, 0.3, N_DET)
    signal = {"photon": None, "detector.psd": "1e-12 mK2/Hz"}
    slow = draw_observation(prepare(scene_with({"time_constant": tau}, signal)), 0).data_mk
    plain = draw_observation(prepare(scene_with({}, signal)), 0).data_mk
    expected = naive.low_pass(plain.astype(float), plain.shape[1] // 4, *pole_coefficients(tau, RATE))
    np.testing.assert_allclose(slow, expected, atol=2e-6 * np.abs(plain).max())


def test_photon_noise_passes_the_time_constants_and_detector_noise_does_not(scene_with):
    """The variance of filtered white noise is its filter's: the sum of its squared impulse response."""
    tau = np.full(N_DET, 0.2)
    settings = {"scan.duration": "100 s", "scan.scans": 8, "photon.coherence": "none", "photon.psd": "2 mK2/Hz"}
    settings |= {"scan.step": "1 arcmin", "scan.speed": "0.2 arcmin / s", "detector.psd": "0.5 mK2/Hz"}
    ready = prepare(scene_with({"time_constant": tau}, NOISE_ONLY | settings))
    data = draw_observation(ready, 0).data_mk.reshape(N_DET, 8, -1)[..., 50:].astype(float)
    decay, taps = (c[0] for c in pole_coefficients(tau[:1], RATE))
    impulse = lfilter(taps[::-1], [1, -decay], np.eye(1, 500)[0])
    lag = [2.0 * np.sum(impulse[k:] * impulse[: 500 - k]) * RATE / 2 for k in range(2)]
    expected = np.array([lag[0] + 0.5 * RATE / 2, lag[1]])
    found = [np.mean(data * data), np.mean(data[..., 1:] * data[..., :-1])]
    # Correlated over a few samples: the error of a mean square is below twice that of white noise.
    np.testing.assert_allclose(found, expected, atol=4 * 2 * expected[0] * math.sqrt(2 / data.size))


def test_signal_simulations_lose_to_the_time_constants(scene_with):
    """The transfer function has it: scans of both directions leave 1 / (1 + (w tau)^2) of a mode's amplitude."""
    settings = {"atmosphere": None, "excess": None, "sky": None, "cleaning.algorithm": "none"}
    settings |= {"score.mask_separation_f_lambda": None, "photon.coherence": "none", "score.signal_sims.skies": 6}
    # Each place is seen in both directions alike, and the patch resolves the bins.
    settings |= {"scan.scans": 120, "scan.step": "0.4 arcmin", "scan.duration": "12 s", "map.pixel": "20 arcsec"}
    settings |= {"score.size": "36 arcmin", "score.ell_bin": 2000, "observations": 2}
    tau = 0.1
    slow, plain = (
        run(scene_with(columns, settings), engine=SERIAL).scores["actual"].transfer_function
        for columns in ({"time_constant": np.full(N_DET, tau)}, {})
    )
    lost = slow.transmission / plain.transmission
    edges = np.arange(4000, 12001, 2000)
    # The power of the skies in the bins: of a flat spectrum, behind beam and pixels.
    ell = edges[:-1, None] + (np.arange(20) + 0.5) * 100
    weight = beam_window(ell, math.radians(60 / 3600)) * pixel_window(ell, math.radians(20 / 3600)) / ell
    angle = (np.arange(100) + 0.5) * math.pi / 200
    turn = ell[..., None] * math.radians(4 / 60) * np.stack([np.cos(angle), np.sin(angle)])[:, None, None]
    # Half of the observations scan along the other axis.
    left = np.mean(np.mean(1 / (1 + (turn * tau) ** 2), axis=0) ** 2, axis=-1)
    expected = np.sum(left * weight, axis=-1) / np.sum(weight, axis=-1)
    scored = (slow.ell > 4000) & (slow.ell < 12000)
    np.testing.assert_allclose(lost[scored], expected, rtol=0.02)
    assert (expected < 0.8).all()


# ---------------------------------------------------------------- beams

BEAMS = np.where(np.arange(N_DET) % 3, 60.0, 90.0)  # arcsec: 12 of 60 and 7 of 90
ELL = np.array([0.0, 3000.0, 9000.0])
UNMASKED = {"score.mask_separation_f_lambda": None}


def test_equal_beams_change_nothing(scene_with):
    """A table with the beam of the instrument: the same streams and the same signal, bit by bit."""
    one, other = (prepare(scene_with(columns, UNMASKED)) for columns in ({"beam_fwhm": np.full(N_DET, 60.0)}, {}))
    np.testing.assert_array_equal(draw_observation(one, 0).data_mk, draw_observation(other, 0).data_mk)
    np.testing.assert_array_equal(one.analysis.region.signal_psd, other.analysis.region.signal_psd)


def test_each_detector_sees_the_sky_through_its_beam(scene_with):
    """As a camera all of whose detectors have that beam; a point source keeps its flux, not its peak."""
    alone = dict.fromkeys(("atmosphere", "excess", "photon")) | {"cleaning.algorithm": "none"} | UNMASKED
    alone |= {"detector.psd": "1e-12 mK2/Hz"}
    streams = draw_observation(prepare(scene_with({"beam_fwhm": BEAMS}, alone)), 0).data_mk
    for width in (60.0, 90.0):
        peak = 5 * (60 / width) ** 2
        text = SMALL_SCENE.replace('peak = "5 mK"', f'peak = "{peak} mK"')
        same = draw_observation(prepare(scene_with({}, alone | {"instrument.beam_fwhm": f"{width} arcsec"}, text)), 0)
        rows = width == BEAMS
        np.testing.assert_allclose(streams[rows], same.data_mk[rows], atol=1e-5)
        assert np.abs(streams[~rows] - same.data_mk[~rows]).max() > 0.01


def test_the_window_of_the_map_is_that_of_the_mean_beam(scene_with):
    """Skies in the map before cleaning: power of two beams over that of one, with the same skies."""
    settings = dict.fromkeys(("atmosphere", "excess", "sky", "photon")) | {"cleaning.algorithm": "none"} | UNMASKED
    settings |= {"scan.scans": 240, "scan.step": "0.2 arcmin", "scan.duration": "12 s", "map.pixel": "20 arcsec"}
    settings |= {"score.size": "36 arcmin", "observations": 2, "score.ell_max": 10000}
    setups = [prepare(scene_with(columns, settings)) for columns in ({"beam_fwhm": BEAMS}, {})]
    powers = []
    for setup in setups:
        maps = sum(observe(setup, number, True).signal_maps for number in range(2))[:, 0, 0]
        powers.append(np.mean([setup.analysis.region.ring_noise(item, np.ones_like(item)) for item in maps], axis=0))
    ell, selected = setups[0].analysis.region.rings.ell, setups[0].analysis.region.selected
    windows = [np.sqrt(beam_window(ell, math.radians(width / 3600))) for width in (60, 90)]
    expected = (([12 / 19, 7 / 19] @ np.array(windows)) / windows[0]) ** 2
    signal = [setup.analysis.region.signal_psd for setup in setups]
    np.testing.assert_allclose((powers[0] / powers[1])[selected], (signal[0] / signal[1])[selected], rtol=0.02)
    # The window falls within a bin of 2000, where most of the power is below the middle.
    np.testing.assert_allclose((signal[0] / signal[1])[selected], expected[selected], rtol=0.025)
    assert expected[selected].max() < 0.85


def test_beams_weigh_as_their_detectors_respond():
    beams = beams_of(np.array([2e-4, 3e-4, 2e-4]), np.array([1.0, 1.5, 0.5]))
    assert beams.fwhm_rad.tolist() == [2e-4, 3e-4] and beams.of_detector.tolist() == [0, 1, 0]
    expected = (np.sqrt(beam_window(ELL, 2e-4)) + np.sqrt(beam_window(ELL, 3e-4))) ** 2 / 4
    np.testing.assert_allclose(beams.window(ELL), expected, rtol=1e-13)


def test_few_beams(scene_with):
    with pytest.raises(
        SceneError, match="column 'beam_fwhm': found 19 widths, [0-9.]+ to [0-9.]+ arcsec; 8 or fewer are expected"
    ):
        prepare(scene_with({"beam_fwhm": 60 + SPREAD}, UNMASKED))
    with pytest.raises(SceneError, match="column 'beam_fwhm': found together with score.mask_separation_f_lambda"):
        prepare(scene_with({"beam_fwhm": BEAMS}, {}))


# ---------------------------------------------------------------- weights in maps


def test_samples_weigh_as_the_inverse_of_their_noise(scene_with):
    """Sums and exposures of an observation against those of its streams, sample by sample; hits count samples."""
    alone = dict.fromkeys(("atmosphere", "excess", "photon")) | {"cleaning.algorithm": "none", "detector.psd": None}
    ready = prepare(scene_with({"psd": SPREAD}, alone))
    weight = (1 / SPREAD) / np.mean(1 / SPREAD)
    np.testing.assert_allclose(ready.analysis.weight, weight, rtol=1e-12)
    streams, found = draw_observation(ready, 0), observe(ready, 0, False)
    index = pixel_indices(ready.analysis.geometry, streams)
    masked = ready.analysis.masked
    scans = streams.data_mk.reshape(N_DET, 4, -1).astype(float)
    data = (scans - scans.mean(axis=-1, keepdims=True)).reshape(N_DET, -1)
    n_pixel, names = found.hits[0].size, ready.analysis.data_set_names
    for name, rows in (("actual", np.arange(N_DET)), (f"masked_{len(masked)}", masked)):
        place, each = names.index(name), weight[rows] / weight[rows].mean()
        inside = index[rows] >= 0
        at, of = index[rows][inside], np.broadcast_to(each[:, None], inside.shape)[inside]
        expected = [np.bincount(at, v, n_pixel) for v in (of * data[rows][inside], of, np.ones(len(at)))]
        planes = found.sums[place], found.exposure[place], found.hits[place]
        for item, wanted in zip(planes, expected, strict=True):
            np.testing.assert_allclose(item.ravel(), wanted, atol=2e-4)


def test_detectors_that_are_alike_weigh_alike(scene_with):
    for columns in ({"psd": np.full(N_DET, 2.5)}, {"efficiency": np.ones(N_DET)}, {"responsivity": SPREAD}):
        settings = {"detector.psd": None} if "psd" in columns else {"photon.bose_fraction": 0.3}
        ready = prepare(scene_with(columns, settings))
        assert ready.analysis.weight is None or np.allclose(ready.analysis.weight, 1, rtol=1e-12)


@pytest.mark.parametrize("algorithm", ["none", "average", "planar"])
def test_power_of_weighted_streams_against_matrices(algorithm):
    """Trace of W (1 - P) K (1 - P)^T W, for a matrix and for a correlation without one."""
    rng = np.random.default_rng(5)
    plane = FocalPlane(*hexagon(2, 2e-4).T, 3e-4)
    root = rng.standard_normal((N_DET, N_DET))
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    matrix, gain = root @ root.T, rng.uniform(0.5, 2, N_DET)
    array = projected_array(
        plane, 0.3, responsivity=SPREAD, algorithm=algorithm, assumed=SPREAD[::-1], weight=SPREAD / SPREAD.mean()
    )
    projected = array.cleaned(np.eye(N_DET)) * array.weight[:, None]
    full = gain[:, None] * matrix * gain
    expected = np.trace(projected @ full @ projected.T) / N_DET
    correlation = NoiseCorrelation(SimpleNamespace(times=lambda columns: matrix @ columns), gain)
    assert stream_power(array, full) == pytest.approx(expected, rel=1e-12)
    assert stream_power(array, correlation) == pytest.approx(expected, rel=1e-12)
    wave = np.array([1000.0 + 2000j, 300.0 - 500j])
    seen = array.phases(wave) * array.weight[:, None]
    np.testing.assert_allclose(array.response(wave), array.cleaned(np.eye(N_DET)).T @ seen, rtol=1e-9)


# ---------------------------------------------------------------- forecast


def test_correlations_of_the_forecast_are_those_of_the_streams(scene_with):
    """Levels of the observing conditions times the correlations of the noise model: the covariance of the detectors."""
    settings = {"photon.psd": "2 mK2/Hz", "photon.bose_fraction": 0.4, "photon.coherent_fraction": 0.7}
    settings |= {"detector.psd": None, "atmosphere": None, "excess": None, "sky": None, "cleaning.algorithm": "none"}
    ready = prepare(scene_with({"efficiency": SPREAD, "psd": SPREAD[::-1]}, settings))
    given, shapes = population_conditions(ready)[0], white_shapes(ready)
    for pipeline in ready.analysis.pipelines:
        rows = np.arange(N_DET)[pipeline.rows]
        photon = 2.0 * (0.6 / SPREAD[rows] + 0.4)
        overlap = correlation_matrix(ready.camera.positions_f_lambda[rows], "field")
        expected = 0.7 * np.sqrt(np.outer(photon, photon)) * overlap + np.diag(0.3 * photon + SPREAD[::-1][rows])
        (shared,), _ = noise_correlations(ready.camera, pipeline, shapes)
        alone = independent_noise(shapes, pipeline) @ np.eye(len(rows))
        np.testing.assert_allclose(given.shared[0] * shared + given.white[0] * alone, expected, rtol=1e-10, atol=1e-12)


def test_forecast_of_unequal_noise(scene_with):
    """Without cleaning, maps see the harmonic mean of the PSDs, as weights are their inverse; a run agrees."""
    spread = np.where(np.arange(N_DET) % 2, 8.0, 1.0)
    settings = {"detector.psd": None, "photon": None, "atmosphere": None, "excess": None, "sky": None}
    settings |= {"cleaning.algorithm": "none", "score.mask_separation_f_lambda": None}
    unequal = forecast(prepare(scene_with({"psd": spread}, settings))).scores["actual"].noise_psd
    equal = (
        forecast(prepare(scene_with({"psd": np.full(N_DET, 1 / np.mean(1 / spread))}, settings)))
        .scores["actual"]
        .noise_psd
    )
    np.testing.assert_allclose(unequal, equal, rtol=1e-7)  # responses are in single precision
    settings |= {"scan.scans": 19, "scan.step": "2 arcmin", "scan.duration": "12 s", "score.size": "36 arcmin"}
    settings |= {"score.ell_bin": 1000, "score.jackknives": 32, "map.pixel": "20 arcsec", "observations": 8}
    result = run(scene_with({"psd": spread}, settings), engine=SERIAL)
    for name, item in forecast_agreement(result).items():
        assert abs(item.sigma) < max(0.1, 3 * item.sigma_error) and abs(item.psd) < 0.15 + 3 * item.psd_error, name


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("columns", "settings", "words"),
    [
        ({"nep": SPREAD * 1e-17}, {}, "column 'nep': found together with detector.psd; one of the two"),
        ({"psd": SPREAD}, {"detector": None}, "column 'psd': found without the section [detector]"),
        ({}, {"detector.psd": None}, "detector: exactly one of 'psd', 'nep', 'bolometer' and 'kid' is expected, or a"),
        (
            {"nep": SPREAD * 1e-17},
            {"detector.psd": None},
            "instrument.bandwidth: missing; 'instrument.positions' needs",
        ),
        ({"responsivity": SPREAD}, {"instrument.responsivity_scatter": 0.1}, "column 'responsivity': found together"),
        ({"efficiency": SPREAD}, {}, "column 'efficiency': found with photon.psd and without photon.bose_fraction"),
        ({"efficiency": SPREAD}, {"photon": None, "detector": None}, "column 'efficiency': found without [photon]"),
        (
            {"efficiency": SPREAD},
            {"instrument.efficiency": 0.6, "photon.bose_fraction": 0.4},
            "column 'efficiency': found 1.99325, times an instrument.efficiency of 0.6; 1 or less is expected",
        ),
        ({"time_constant": SPREAD}, {}, "column 'time_constant': found 1.9"),
        (
            {"band": ["90"] * 9 + ["150"] * 10},
            {},
            "instrument.band: missing; the table of detectors has several: one of",
        ),
        ({"band": ["90"] * N_DET}, {"instrument.band": "150"}, "instrument.band: found '150'; one of '90' is expected"),
        ({}, {"instrument.band": "150"}, "instrument.band: found '150', and "),
    ],
)
def test_columns_that_a_scene_cannot_use(scene_with, columns, settings, words):
    with pytest.raises(SceneError) as caught:
        prepare(scene_with(columns, settings))
    assert words in str(caught.value) and len(str(caught.value).splitlines()) == 1


def test_pairs_of_polarizations(scene_with):
    """Two detectors of a pixel share wave noise as their polarizations do: orthogonal ones share none."""
    settings = NOISE_ONLY | {"scan.scans": 400, "photon.psd": "2 mK2/Hz", "photon.coherent_fraction": 0.9}
    settings |= {"photon.bose_fraction": 0.8, "detector.psd": "1 mK2/Hz"}
    x, y = hexagon(2, 40.0).T
    pairs = {"x": Column(np.append(x[:-1], x[0]), unit="arcsec"), "y": Column(np.append(y[:-1], y[0]), unit="arcsec")}
    for turn in (30.0, 90.0):
        columns = pairs | {"angle": np.append(np.zeros(N_DET - 1), turn)}
        with pytest.raises(
            SceneError, match="photon.coherence: found 'field' for detectors that differ in polarization"
        ):
            prepare(scene_with(columns, settings))
        with pytest.raises(SceneError, match="instrument.polarizations: found None for detectors that differ"):
            prepare(scene_with(columns, settings | {"photon.coherence": "hbt"}))
        ready = prepare(scene_with(columns, settings | {"photon.coherence": "hbt", "instrument.polarizations": 1}))
        found, n = covariance(ready)
        levels = observation_levels(ready, 0)
        expected = levels.photon_mk2_hz * levels.shared * math.cos(math.radians(turn)) ** 2 * RATE / 2
        assert found[0, -1] == pytest.approx(expected, abs=4.5 * found[0, 0] / math.sqrt(n))
        assert levels.shared > 0.6


def test_a_band_of_a_table(scene_with):
    bands = np.where(np.arange(N_DET) < 7, "90", "150")
    ready = prepare(
        scene_with(
            {"band": bands, "dead": np.arange(N_DET) == 3, "angle": np.arange(N_DET) * 10.0},
            {"instrument.band": "90", "score.mask_separation_f_lambda": None},
        )
    )
    assert ready.camera.n_det == 6 and ready.camera.counts.positions == 7 and ready.camera.counts.dead == 1
    assert ready.camera.counts.bands == (("90", 6), ("150", 12))
    np.testing.assert_allclose(np.degrees(ready.camera.focal_plane.angle_rad), [0, 10, 20, 40, 50, 60])
