"""Steps of the detectors' response: their list, the absence of each, and each against its closed form."""

import numpy as np
import pytest
from astropy.table import Column, Table

from surveysim.atmosphere.opacity import band_opacity, optical_depth
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.response import ResponseSections
from surveysim.scene.scene import load_scene
from surveysim.telescope.layouts import hexagon
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.component import present_components
from surveysim.timestreams.observation import Stopwatch, draw_block, draw_observation
from surveysim.timestreams.observed_block import observed_block
from surveysim.timestreams.response import RESPONSE_STEPS, block_response, present_steps, write_sky_signal
from surveysim.timestreams.response_kernels import add_derivative, low_pass
from surveysim.timestreams.simulation import observation_path
from surveysim.timestreams.sky import add_true_sky
from surveysim.timestreams.time_constants import derivative_response, pole_coefficients, pole_response
from tests import naive
from tests.scenes import SMALL_SCENE, write_scene

RATE, N_DET = 10.0, 18
CROSSTALK = {"crosstalk.neighbour_fraction": 0.03, "crosstalk.group_fraction": -0.002, "crosstalk.group_size": 7}


@pytest.fixture
def ready(tmp_path):
    """Function that prepares the small scene with some settings."""
    return lambda settings=None, text=SMALL_SCENE: prepare(load_scene(write_scene(tmp_path, text), settings))


def block_of(setup, observation=0):
    """The first block of an observation."""
    _, pointing = observation_path(setup.observing, observation)
    return observed_block(setup, observation, setup.observing.blocks[0], pointing)


def gains(setup, observation=0):
    """Output of detectors that see 1 mK, over their responsivities (n_det, n_samp)."""
    of = block_of(setup, observation)
    seen = np.ones((setup.camera.n_det, len(of.pointing.time_s)))
    block_response(of, np.zeros_like(seen)).apply(seen)
    return seen / setup.camera.responsivity[:, None]


# ---------------------------------------------------------------- the list


def test_steps_that_act_on_fewer_parts_come_first():
    kinds = ["sky", "signals", "light", "streams"]
    order = [kinds.index(step.acts_on) for step in RESPONSE_STEPS]
    assert order == sorted(order)
    assert {step.section for step in RESPONSE_STEPS} - {"instrument"} == set(ResponseSections.model_fields)


def test_without_sections_there_is_the_responsivity_alone(ready):
    """Nothing is drawn, copied or looked up again for a section that is absent."""
    setup = ready()
    assert [step.name for step in present_steps(setup)] == ["responsivity"]
    of = block_of(setup)
    assert of.true_pointing is of.pointing and setup.camera.true_plane is setup.camera.focal_plane
    drawn = draw_block(setup, 0, of.whole, of.block, Stopwatch())
    signal = np.ones_like(drawn.data_mk)
    assert drawn.response.output(setup.analysis.signal_skies_mk[0], signal) is signal
    assert not present_steps(ready({"instrument.responsivity_scatter": 0.0}))


def test_without_sections_no_bit_changes(ready):
    """Streams are those of the components and the responsivities, in the order of version 0.6.0."""
    setup = ready()
    of = block_of(setup)
    expected = np.zeros((N_DET, len(of.pointing.time_s)), np.float32)
    for item in present_components(setup.scene):
        if item.name == "photon":
            expected *= setup.camera.responsivity[:, None].astype(np.float32)
        item.add(expected, of)
    np.testing.assert_array_equal(draw_observation(setup, 0).data_mk, expected)


@pytest.mark.parametrize(
    "settings",
    [
        {"responsivity_drift.rms": 0.05, "responsivity_drift.time_scale": "8 s"},
        {"responsivity_drift.load_coefficient": "0.2 / K"},
        {"time_constants.value": "0.1 s", "time_constants.scatter": 0.3, "time_constants.deconvolution_error": 0.1},
        CROSSTALK,
        {"pointing_errors.jitter": "5 arcsec", "pointing_errors.positions": "3 arcsec"},
    ],
)
def test_simulated_signals_pass_the_response_of_the_streams(ready, settings):
    """A sky alone in the streams, and the same sky as a simulated signal in a survey with an atmosphere."""
    noiseless = {"excess": None, "photon": None, "detector.psd": "0 mK2/Hz"}
    setup = ready(settings | noiseless)
    of = block_of(setup)
    drawn = draw_block(setup, 0, of.whole, of.block, Stopwatch())
    sky, signal = setup.sky.map_mk, np.empty_like(drawn.data_mk)
    write_sky_signal(setup, of.pointing, sky, signal)
    without = draw_block(ready(settings | noiseless | {"sky": None}), 0, of.whole, of.block, Stopwatch())
    difference = drawn.data_mk.astype(float) - without.data_mk
    found = drawn.response.output(sky, signal)
    np.testing.assert_allclose(found, difference, atol=2e-6 * np.abs(drawn.data_mk).max() + 1e-4 * np.abs(found).max())
    assert np.abs(found - signal).max() > 1e-4 * np.abs(signal).max()


# ---------------------------------------------------------------- responsivity drift


def test_drift_of_the_responsivity(ready):
    """Log-normal with a mean of 1, the stated rms and correlation, its own in each detector and observation."""
    settings = {"responsivity_drift.rms": 0.1, "responsivity_drift.time_scale": "6 s", "scan.scans": 400}
    setup = ready(settings | {"scan.step": "1 arcsec"})
    first, second = np.log(gains(setup, 0)) + 0.1**2 / 2, np.log(gains(setup, 1)) + 0.1**2 / 2
    seconds = block_of(setup).pointing.time_s
    # About duration / (sqrt(pi) T) independent values of each detector.
    n = N_DET * seconds[-1] / (np.sqrt(np.pi) * 6)
    assert abs(first.mean()) < 4 * 0.1 / np.sqrt(n)
    lag = seconds[: len(first[0]) // 2 + 1][30] - seconds[0]  # within a scan: 3 s
    scans = first.reshape(N_DET, 400, -1)
    found = [np.mean(scans**2), np.mean(scans[..., :-30] * scans[..., 30:])]
    expected = 0.01 * np.array([1.0, np.exp(-(lag**2) / (2 * 6.0**2))])
    np.testing.assert_allclose(found, expected, atol=0.01 * (4 * np.sqrt(2 / n) + 0.003))
    for other in (second, np.roll(first, 1, axis=0)):
        assert abs(np.mean(first * other)) < 4 * 0.01 / np.sqrt(n)


def test_drift_goes_on_over_blocks(ready):
    settings = {"responsivity_drift.rms": 0.1, "responsivity_drift.time_scale": "20 s"}
    whole, cut = ready(settings), ready(settings | {"numerics.max_block_memory": "6000 byte"})
    _, pointing = observation_path(cut.observing, 0)
    parts = []
    for block in cut.observing.blocks:
        of = observed_block(cut, 0, block, pointing)
        parts.append(np.ones((N_DET, len(of.pointing.time_s))))
        block_response(of, np.zeros_like(parts[-1])).apply(parts[-1])
    assert len(parts) > 1
    np.testing.assert_allclose(np.concatenate(parts, axis=1) / whole.camera.responsivity[:, None], gains(whole))


def test_the_load_of_the_layer_lowers_responsivities(ready):
    """By the coefficient of each detector, all of one sign, times the mean of what the array sees."""
    alone = dict.fromkeys(("excess", "photon", "sky")) | {"detector.psd": "0 mK2/Hz"}
    setup = ready(alone | {"responsivity_drift.load_coefficient": "0.05 / K", "responsivity_drift.load_scatter": 0.3})
    plain = draw_observation(ready(alone), 0).data_mk.astype(float)
    streams = draw_observation(setup, 0).data_mk
    load_k = 1e-3 * (plain / setup.camera.responsivity[:, None]).mean(axis=0)
    loss = (1 - streams / plain) / load_k
    each = np.median(loss, axis=1)
    np.testing.assert_allclose(streams, plain * (1 - np.outer(each, load_k)), atol=1e-5 * np.abs(plain).max())
    assert (each > 0).all() and 0.15 < np.log(each).std(ddof=1) < 0.5


def test_the_load_of_the_airmass(ready):
    """1 - k times the difference of the site's loads at the elevations of observation and calibration."""
    text = SMALL_SCENE.replace(
        'spectral_index = "11/3"',
        'site = "mauna_kea"\npwv_probabilities = [0.5]\npwv = "[2] mm"\nspectral_index = "11/3"',
    )
    settings = {"instrument.bandwidth": 0.15, "responsivity_drift.load_coefficient": "0.01 / K"}
    setup = ready(settings | {"responsivity_drift.calibration_elevation": "90 deg"}, text)
    opacity = band_opacity(setup.scene.place, setup.scene.instrument.band)
    depth = [float(optical_depth(opacity, 2.0, airmass=airmass)) for airmass in (1 / np.sin(np.radians(55)), 1.0)]
    load_k = opacity.temperature_k * (np.exp(-depth[1]) - np.exp(-depth[0]))
    np.testing.assert_allclose(gains(setup), 1 - 0.01 * load_k, rtol=1e-10)
    assert load_k > 2
    np.testing.assert_allclose(gains(ready(settings, text)), 1, rtol=1e-12)  # calibrated where it observes
    with pytest.raises(SceneError, match=r"load_coefficient: found a load in observation 0 that differs by .* K"):
        gains(
            ready(
                settings
                | {"responsivity_drift.load_coefficient": "0.2 / K"}
                | {"responsivity_drift.calibration_elevation": "20 deg"},
                text,
            )
        )


# ---------------------------------------------------------------- crosstalk


def test_streams_are_the_matrix_times_streams(ready):
    setup = ready(CROSSTALK)
    groups = [list(range(0, 7)), list(range(7, 14)), list(range(14, 18))]
    matrix = naive.crosstalk_matrix(N_DET, groups, 0.03, -0.002)
    plain = draw_observation(ready(), 0).data_mk.astype(float)
    np.testing.assert_allclose(draw_observation(setup, 0).data_mk, matrix @ plain, atol=1e-6 * np.abs(plain).max())
    _, operator = block_response(block_of(setup), plain).steps[-1]
    np.testing.assert_allclose(operator.times(np.eye(N_DET)), matrix, rtol=1e-14)


@pytest.mark.parametrize("column", [True, False])
def test_readout_groups_of_a_table(tmp_path, column):
    """Neighbours are those of the rows of a group; without the column all detectors are one group."""
    x, y = hexagon(1, 40.0).T
    table = Table({"x": Column(x, unit="arcsec"), "y": Column(y, unit="arcsec")})
    if column:
        table["readout_group"] = list("abbabaa")
    table.write(tmp_path / "camera.ecsv")
    settings = {"instrument.positions": "camera.ecsv", "instrument.layout": None, "score": None}
    scene = load_scene(write_scene(tmp_path), settings | {"crosstalk.neighbour_fraction": 0.01})
    groups = [[0, 3, 5, 6], [1, 2, 4]] if column else [list(range(7))]
    setup = prepare(scene)
    assert [group.tolist() for group in setup.camera.readout_groups] == groups
    ones = np.eye(7)
    block_response(block_of(setup), ones).acting_on("streams").apply(ones)
    np.testing.assert_allclose(ones, naive.crosstalk_matrix(7, groups, 0.01, 0.0), rtol=1e-14)


# ---------------------------------------------------------------- time constants


def test_one_value_is_that_of_a_table(tmp_path, ready):
    """The same streams, bit by bit."""
    x, y = hexagon(2, 40.0).T
    columns = {"x": Column(x, unit="arcsec"), "y": Column(y, unit="arcsec")}
    Table(columns).write(tmp_path / "one.ecsv")
    Table(columns | {"time_constant": Column(np.full(19, 0.2), unit="s")}).write(tmp_path / "other.ecsv")
    of_table = {"instrument.layout": None, "instrument.positions": "one.ecsv"}
    one = ready(of_table | {"time_constants.value": "0.2 s"})
    other = ready(of_table | {"instrument.positions": "other.ecsv"})
    np.testing.assert_array_equal(draw_observation(one, 0).data_mk, draw_observation(other, 0).data_mk)
    with pytest.raises(SceneError, match="time_constants.value: found together with the column 'time_constant'"):
        ready(of_table | {"instrument.positions": "other.ecsv", "time_constants.value": "0.2 s"})
    same = ready(of_table | {"instrument.positions": "other.ecsv", "time_constants.deconvolution_error": 0.0})
    np.testing.assert_array_equal(same.camera.deconvolved_s, np.full(19, 0.2))


def test_a_time_constant_of_0_filters_nothing(ready):
    """But photon and detector noise are drawn apart, as with any other."""
    signal = {"photon": None, "detector.psd": "1e-12 mK2/Hz"}
    none, plain = (draw_observation(ready(signal | of), 0).data_mk for of in ({"time_constants.value": "0 s"}, {}))
    np.testing.assert_array_equal(none, plain)


def test_scatter_and_errors_of_time_constants(ready):
    settings = {"time_constants.value": "0.1 s", "time_constants.scatter": 0.2, "instrument.layout.rings": 8}
    camera = ready(settings | {"time_constants.deconvolution_error": 0.05}).camera
    n = camera.n_det
    for found, scatter in ((camera.time_constant_s / 0.1, 0.2), (camera.deconvolved_s / camera.time_constant_s, 0.05)):
        assert abs(np.log(found).mean()) < 4 * scatter / np.sqrt(n)
        assert abs(np.log(found).std() / scatter - 1) < 4 / np.sqrt(2 * n)


def test_derivative_against_the_slow_twin():
    data = np.random.default_rng(2).standard_normal((3, 40))
    expected = naive.add_derivative(data, 20, [0.0, 0.4, 3.0])
    add_derivative(data, 20, np.array([0.0, 0.4, 3.0]))
    np.testing.assert_allclose(data, expected, rtol=1e-12)


@pytest.mark.parametrize("error", [0.0, 0.1, -0.3])
@pytest.mark.parametrize("share", [0.02, 0.05, 0.1])
def test_deconvolution_of_a_wave(share, error):
    """It leaves (1 + i w tau (1 + e)) / (1 + i w tau) of a wave, to 0.5 % at a tenth of the sample rate."""
    tau, time, omega = 0.3, np.arange(600) / RATE, 2 * np.pi * share * RATE
    wave = np.sin(omega * time)[None].copy()
    low_pass(wave, 600, *pole_coefficients(np.array([tau]), RATE))
    add_derivative(wave, 600, np.array([tau * (1 + error) * RATE]))
    residual = (1 + 1j * omega * tau * (1 + error)) / (1 + 1j * omega * tau)
    passed = pole_response(np.array([tau]), np.array([share * RATE]), RATE)[0]
    exact = (1 + 1j * tau * (1 + error) * derivative_response(share * RATE, RATE)) * passed
    middle = slice(100, -4)
    np.testing.assert_allclose(wave[0, middle], np.imag(residual * np.exp(1j * omega * time))[middle], atol=8e-3)
    np.testing.assert_allclose(wave[0, middle], np.imag(exact * np.exp(1j * omega * time))[middle], atol=1e-8)


def test_noise_rises_with_the_deconvolution(ready):
    """White detector noise has the PSD 1 + (tau D)^2, with the derivative D of five samples."""
    settings = dict.fromkeys(("atmosphere", "excess", "photon", "sky", "score")) | {"cleaning.algorithm": "none"}
    settings |= {"scan.scans": 100, "scan.step": "1 arcsec", "scan.duration": "20 s", "detector.psd": "2 mK2/Hz"}
    settings |= {"time_constants.value": "0.3 s", "time_constants.deconvolution_error": 0.0}
    setup = ready(settings)
    data = draw_observation(setup, 0).data_mk
    n = samples_per_scan(setup.observing.scans)
    scans = data.reshape(-1, n)[:, 2:-2].astype(float) * np.hanning(n - 4)
    power = np.mean(np.abs(np.fft.rfft(scans)) ** 2, axis=0)[2:-2]
    power *= 2 / (RATE * np.sum(np.hanning(n - 4) ** 2))
    expected = 2 * (1 + (0.3 * derivative_response(np.fft.rfftfreq(n - 4, 1 / RATE)[2:-2], RATE)) ** 2)
    np.testing.assert_allclose(power, expected, rtol=4.5 / np.sqrt(len(scans)) + 0.01)
    assert expected.max() > 8 * 2


# ---------------------------------------------------------------- pointing errors


def _seen_wave(setup, wavelength_arcmin):
    """Streams of a wave on the sky at the assumed and at the true pointing."""
    of, grid = block_of(setup), setup.sky.geometry
    turn = 2 * np.pi * np.degrees(grid.pixel_rad) * 60 / wavelength_arcmin
    sky = np.sin(turn * (np.arange(grid.n_x) + np.arange(grid.n_y)[:, None]) / np.sqrt(2)).astype(np.float32)
    assumed, true = (np.zeros((setup.camera.n_det, len(of.pointing.time_s)), np.float32) for _ in range(2))
    write_sky_signal(setup, of.pointing, sky, assumed)
    add_true_sky(of, sky, true, setup.camera.responsivity)
    return assumed.astype(float), true.astype(float)


@pytest.mark.parametrize("bandwidth", [None, "0.6 Hz"])
def test_jitter_is_a_beam(ready, bandwidth):
    """The mean stream is the sky behind a Gaussian: exp(-k^2 s^2 / 2) of a wave is left."""
    settings = {"scan.scans": 600, "scan.step": "1 arcsec", "pointing_errors.jitter": "20 arcsec"}
    setup = ready(settings | ({"pointing_errors.jitter_bandwidth": bandwidth} if bandwidth else {}))
    assumed, true = _seen_wave(setup, 2.5)
    k_s = 2 * np.pi / 2.5 * 20 / 60
    left = np.sum(assumed * true) / np.sum(assumed**2)
    # Detectors have the jitter in common; samples within 1 / 2 sqrt(pi) B are correlated.
    n = assumed.shape[1] * (1 if bandwidth is None else min(1, 2 * np.sqrt(np.pi) * 0.6 / RATE))
    np.testing.assert_allclose(left, np.exp(-(k_s**2) / 2), atol=4 * np.sqrt((1 - np.exp(-(k_s**2))) / n))
    of = block_of(setup)
    error = np.degrees(of.true_pointing.xi_rad - of.pointing.xi_rad) * 3600
    assert abs(error.std() / 20 - 1) < 4 / np.sqrt(2 * n) + 0.002
    scans = error.reshape(600, -1)
    found = np.mean(scans[:, 1:] * scans[:, :-1]) / 20**2
    expected = 0.0 if bandwidth is None else np.exp(-((2 * np.pi * 0.6 / RATE) ** 2) / 2)
    assert abs(found - expected) < 4 / np.sqrt(n) + 0.004


def test_positions_are_wrong_in_all_observations(ready):
    """The errors of the detectors have the stated rms, and the mean over detectors is the sky behind a Gaussian."""
    setup = ready({"instrument.layout.rings": 12, "pointing_errors.positions": "15 arcsec"})
    camera = setup.camera
    error = [camera.true_plane.x_rad - camera.focal_plane.x_rad, camera.true_plane.y_rad - camera.focal_plane.y_rad]
    error = np.degrees(error) * 3600
    n = camera.n_det
    assert np.abs(error.std(axis=1) / 15 - 1).max() < 4 / np.sqrt(2 * n)
    assert abs(np.mean(error[0] * error[1])) < 4 * 15**2 / np.sqrt(n)
    of = block_of(setup)
    assert of.true_pointing is of.pointing
    assumed, true = _seen_wave(setup, 2.5)
    k_s = 2 * np.pi / 2.5 * 15 / 60
    left = np.sum(assumed * true) / np.sum(assumed**2)
    np.testing.assert_allclose(left, np.exp(-(k_s**2) / 2), atol=4 * np.sqrt((1 - np.exp(-(k_s**2))) / n))


def test_pointing_drifts_slowly_and_otherwise_in_each_observation(ready):
    settings = {"pointing_errors.drift": "10 arcsec", "pointing_errors.drift_time_scale": "30 s", "observations": 300}
    setup = ready(settings)
    drawn = [block_of(setup, number) for number in range(300)]
    error = [
        np.array([of.true_pointing.xi_rad - of.pointing.xi_rad, of.true_pointing.eta_rad - of.pointing.eta_rad])
        for of in drawn
    ]
    error = np.degrees(error) * 3600
    samples = np.array([0, 59])
    lag = np.diff(drawn[0].pointing.time_s[samples])[0]
    found = np.mean(error[..., 0] * error[..., 59]) / 100, np.mean(error[..., 0] ** 2) / 100
    np.testing.assert_allclose(found, [np.exp(-(lag**2) / (2 * 30**2)), 1], atol=4 * np.sqrt(2 / 600) + 0.003)
    assert np.abs(np.diff(error, axis=-1)).max() < 10
    assert setup.camera.true_plane is setup.camera.focal_plane


@pytest.mark.parametrize(
    "settings",
    [
        {"responsivity_drift.rms": 0.0},
        {"crosstalk.neighbour_fraction": 0.0},
        {"pointing_errors.jitter": "0 arcsec", "pointing_errors.drift": "0 arcsec"},
    ],
)
def test_an_effect_of_0_changes_no_bit(ready, settings):
    """As the first point of a sweep."""
    plain, none = ready(), ready(settings)
    np.testing.assert_array_equal(draw_observation(none, 0).data_mk, draw_observation(plain, 0).data_mk)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"responsivity_drift.rms": 0.1}, "time_scale: missing; 'rms' needs it"),
        ({"responsivity_drift.load_scatter": 0.1}, "rms: missing; it or 'load_coefficient' is expected"),
        (
            {"responsivity_drift.rms": 0.1, "responsivity_drift.time_scale": "1 s"},
            "responsivity_drift.time_scale: found 1 s; 6 s or more is expected",
        ),
        (
            {"responsivity_drift.load_coefficient": "0.1 / K", "responsivity_drift.calibration_elevation": "60 deg"},
            "responsivity_drift.calibration_elevation: found without atmosphere.site",
        ),
        ({"crosstalk.group_size": 8}, "neighbour_fraction: missing; it or 'group_fraction' is expected"),
        ({"time_constants.deconvolution_error": 0.1}, "time_constants.value: missing; one of 'value' and a column"),
        ({"time_constants.value": "1 s"}, r"time_constants.value: found a detector of 1 s; 0.6 s or less is expected"),
        ({"pointing_errors.drift": "1 arcsec"}, "drift_time_scale: missing; 'drift' needs it"),
        (
            {"pointing_errors.jitter": "1 arcsec", "pointing_errors.jitter_bandwidth": "2 Hz"},
            "pointing_errors.jitter_bandwidth: found 2 Hz; 1.25 Hz or less is expected",
        ),
        ({"pointing_errors.positions": "61 arcsec"}, "pointing_errors.positions: found 61 arcsec; 60 arcsec or less"),
    ],
)
def test_refused(ready, settings, words):
    with pytest.raises(SceneError, match=words):
        ready(settings)


def test_lost_samples_widen_by_the_reach_of_the_deconvolution(ready):
    """Two samples on both sides, within a scan: a glitch of any size then leaves nothing."""
    settings = {"glitches.rate": "600 / h", "glitches.amplitude": "1000 mK", "glitches.found": 1.0}
    settings |= {"glitches.decay_time": "0 s", "time_constants.value": "0.2 s"}
    alone, quiet = {"detector.psd": "0 mK2/Hz"}, dict.fromkeys(("atmosphere", "excess", "photon", "sky", "score"))
    quiet |= {"cleaning.algorithm": "none"}
    of = block_of(ready(settings | alone | quiet | {"time_constants.deconvolution_error": 0.0}))
    narrow = draw_block(ready(settings | alone | quiet), 0, of.whole, of.block, Stopwatch()).flags
    drawn = draw_block(of.setup, 0, of.whole, of.block, Stopwatch())
    expected = np.zeros_like(narrow)
    for d, n in np.argwhere(narrow):
        scan = n // 60 * 60
        expected[d, max(scan, n - 2) : min(scan + 60, n + 3)] = True
    np.testing.assert_array_equal(drawn.flags, expected)
    assert narrow.any() and not np.abs(drawn.data_mk[~drawn.flags]).max() > 0 and np.abs(drawn.data_mk).max() > 900
