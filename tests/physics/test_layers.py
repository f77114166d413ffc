"""Several layers, layers that evolve and winds that drift, against closed forms.

Monte Carlo tolerances are 4.5 standard deviations.
"""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from mapmaker.geometry import sky_offsets
from surveysim.atmosphere.evolution import Evolution, draw_evolution, evolution_correlation
from surveysim.atmosphere.thin_screen import cross_psd, structure_function
from surveysim.atmosphere.weather import Weather
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.telescope.pointing import sky_vector
from surveysim.timestreams.atmosphere import add_layers, add_realization, straight_scans
from surveysim.timestreams.curved_layer import curved_scans
from surveysim.timestreams.layer_views import LayerNumbers, LayerRealization, layer_wind
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.simulation import observation_path
from tests.scenes import SMALL_SCENE, without_sections

ARCMIN = math.radians(1 / 60)
WEATHER = Weather(b2=300.0, wind_speed_rad_s=20 * ARCMIN, wind_angle_rad=0.4, pwv_mm=math.nan)
LOW = {"name": "low", "height": "700 m", "share": 0.6}
HIGH = {"name": "high", "height": "1500 m", "share": 0.4, "wind_factor": 1.8, "wind_turn": "120 deg"}
SIGMAS = 4.5
# The telescope points at the zenith and hardly moves.
AT_REST = {
    "scan.speed": "0.001 arcsec / s",
    "scan.scans": 1,
    "fixed_pointing.elevation": "90 deg",
    "instrument.layout.rings": 1,
    "instrument.layout.dead": [],
    "instrument.layout.pitch_f_lambda": 8,
    "instrument.camera_rotation_range": "0 deg",
    "numerics.precision": "float64",
}


@pytest.fixture
def air(tmp_path):
    """Make the setup of a scene of the layers alone, with keys of its [atmosphere]."""
    path = tmp_path / "scene.toml"
    path.write_text(without_sections(SMALL_SCENE, "excess", "photon", "detector", "sky", "score"))

    def make(keys, others=AT_REST):
        return prepare(load_scene(path, others | {f"atmosphere.{key}": value for key, value in keys.items()}))

    return make


def streams(setup, observation=0, *, weather=WEATHER, block=None):
    """Streams of the layers alone, and the pointing of the observation."""
    _, pointing = observation_path(setup.observing, 0)
    n_scans = block.n_scans if block else setup.observing.scans.n_scans
    data = np.zeros((setup.camera.n_det, len(pointing.time_s) * n_scans // setup.observing.scans.n_scans))
    add_layers(setup, observation, pointing, weather=weather, data=data, block=block)
    return data


def detector_offsets(setup):
    """Offsets (n_det, 2) of the detectors from the boresight."""
    _, pointing = observation_path(setup.observing, 0)
    return np.stack(sky_offsets(setup.camera.focal_plane, pointing.scan_array_angle_rad), axis=-1)[0]


# ---------------------------------------------------------------- several layers


def test_one_listed_layer_is_the_layer(air):
    """Bits are those of a scene without layers; a second layer has numbers of its own."""
    alone = {"name": "one", "height": "1000 m", "share": 1}
    expected = streams(air({}, {}))
    np.testing.assert_array_equal(streams(air({"layers": [alone]}, {})), expected)
    both = streams(air({"layers": [alone | {"share": 0.5}, alone | {"share": 0.5, "name": "two"}]}, {}))
    other = both - math.sqrt(0.5) * expected
    assert other.std() > 0.1 * expected.std()
    assert not np.allclose(other, math.sqrt(0.5) * expected, atol=0.1 * expected.std())


def test_cross_spectra_of_two_layers(air):
    """Layers 120 degrees apart, at two heights: the sum of the cross-spectra of each in its own wind."""
    setup = air({"layers": [LOW, HIGH]}, AT_REST | {"scan.duration": "32 s", "scan.sample_rate": "8 Hz"})
    n_obs, rate = 200, 8.0
    offsets, pairs = detector_offsets(setup), ((0, 3), (1, 4), (0, 6))
    window = np.hanning(256 + 1)[:-1]
    found = np.zeros((len(pairs) + 1, 129), complex)
    for number in range(n_obs):
        data = streams(setup, number)
        modes = np.fft.rfft((data - data.mean(axis=1, keepdims=True)) * window, axis=1)
        found[0] += np.mean(np.abs(modes) ** 2, axis=0)
        for row, (i, j) in enumerate(pairs, 1):
            found[row] += modes[i].conj() * modes[j]
    found *= 2 / (rate * np.sum(window**2) * n_obs)
    frequency = np.arange(1, 33) * rate / 256
    expected = np.zeros((len(pairs) + 1, 32), complex)
    for layer in setup.air.layers:
        speed, angle = layer.wind(WEATHER)
        wind = np.array(sky_vector(math.radians(20), math.cos(angle), math.sin(angle)))
        for row, (i, j) in enumerate(((0, 0), *pairs)):
            apart = offsets[j] - offsets[i]
            along, across = wind @ apart, wind @ [-apart[1], apart[0]]
            spectrum = cross_psd(layer.strips.screen, frequency, speed, across)
            expected[row] += 300 * layer.b2_factor * spectrum * np.exp(-2j * np.pi * frequency * along / speed)
    # The window joins neighbouring frequencies; groups of four are compared.
    expected, found = (expected[:, :-2] + 4 * expected[:, 1:-1] + expected[:, 2:]) / 6, found[:, 2:32]
    auto = expected[0].real
    found, expected = (np.mean((item / auto)[:, 4:28].reshape(len(item), 6, 4), axis=2) for item in (found, expected))
    error = 1 / math.sqrt(2 * n_obs)  # of four frequencies, which have about half the information of independent ones
    assert np.abs(found - expected).max() < SIGMAS * error
    assert np.ptp(expected[1:].real) > 0.5 and np.ptp(expected[1:].imag) > 0.2


# ---------------------------------------------------------------- evolution


@pytest.mark.parametrize("count", [2, 3])
def test_weights_and_their_correlation(count):
    """Squares of the weights add to one; the mean of products over phases and all signs is the closed form."""
    time, phases = np.linspace(0, 21, 106), (np.arange(40) + 0.5) / 40
    signs = np.array(list(itertools.product([-1.0, 1.0], repeat=5)))
    total = np.zeros_like(time)
    for phase, sign in itertools.product(phases, signs):
        evolution = Evolution(7.0, count, float(phase), sign)
        weights = np.array([evolution.weight(number, time) for number in range(count)])
        np.testing.assert_allclose((weights**2).sum(axis=0), 1, rtol=1e-12)
        total += weights[:, 0] @ weights / (len(phases) * len(signs))
    np.testing.assert_allclose(total, evolution_correlation(time, 7.0), atol=2e-4)
    assert evolution_correlation(np.array([0.0, 7.0, 14.0, 20.0]), 7.0) == pytest.approx(
        [1, 1 / np.pi, 0, 0], abs=1e-15
    )


@pytest.mark.parametrize(("seconds", "count"), [(60.0, 2), (5.0, 2), (2.0, 4), (0.5, 11)])
def test_realizations_are_as_many_as_a_scan_sees(seconds, count):
    """Weights are smooth in time, and signs reach to the end of the observation."""
    evolution = draw_evolution(seconds, scan_s=5.0, end_s=300.0, rng=np.random.default_rng(3))
    assert evolution.count == count and set(evolution.signs) <= {-1.0, 1.0}
    time = np.linspace(0, 300, 60_001)
    for number in range(count):
        weight = evolution.weight(number, time)
        assert np.abs(np.diff(weight)).max() < 0.5 * np.pi * time[1] / seconds * (1 + 1e-6)


@pytest.mark.slow
def test_decorrelation_in_time(air):
    """Differences of two detectors: the frozen layer's covariance in space and time, times the correlation."""
    seconds, rate, n_obs = 10.0, 2.0, 500
    keys = {"decorrelation_time": f"{seconds} s"}
    setup = air(keys, AT_REST | {"scan.duration": "24 s", "scan.sample_rate": f"{rate} Hz"})
    weather = replace(WEATHER, wind_speed_rad_s=0.7 * ARCMIN)
    offsets = detector_offsets(setup)
    apart = offsets[6] - offsets[0]
    drawn = np.array([np.subtract(*streams(setup, number, weather=weather)[[6, 0]]) for number in range(n_obs)])
    lag = np.arange(0, 45, 4)
    moved = lag[:, None] / rate * np.array(sky_vector(math.radians(20), *weather.wind_rad_s))
    structure, screen = structure_function, setup.air.layers[0].strips.screen
    ahead, behind = (structure(screen, np.hypot(*(apart + sign * moved).T)) for sign in (1, -1))
    frozen = 150 * (ahead + behind - 2 * structure(screen, np.hypot(*moved.T)))
    expected = frozen * evolution_correlation(lag / rate, seconds)
    products = [drawn[:, : 48 - n] * drawn[:, n:] for n in lag]
    found = np.array([item.mean() for item in products])
    error = np.array([item.mean(axis=1).std() / math.sqrt(n_obs) for item in products])
    assert np.all(np.abs(found - expected) < SIGMAS * error)
    assert np.all(error < 0.08 * frozen[0]) and expected[5] < 0.5 * frozen[5]


@pytest.mark.slow
def test_trends_of_scans_decorrelate(air):
    """Gradients in neighbouring scans of a layer at rest correlate as those of a frozen one, times the correlation."""
    timing = {"scan.scans": 3, "scan.duration": "6 s", "scan.turnaround": "2 s", "scan.sample_rate": "2 Hz"}
    found, n_obs, at_rest = {}, 500, replace(WEATHER, wind_speed_rad_s=0.0)
    for seconds in (None, 10.0):
        setup = air({"decorrelation_time": f"{seconds} s"} if seconds else {}, AT_REST | timing)
        drawn = np.array([streams(setup, number, weather=at_rest).reshape(7, 3, -1)[[0, 6]] for number in range(n_obs)])
        gradient = np.subtract(*drawn.mean(axis=-1).transpose(1, 0, 2))
        found[seconds] = np.mean(gradient[:, :-1] * gradient[:, 1:]) / np.mean(gradient**2)
    lag = np.subtract.outer(np.arange(12), np.arange(12)) / 2
    within, between = (evolution_correlation(lag + apart, 10.0).mean() for apart in (0.0, 8.0))
    assert found[None] > 0.8  # what scans do not share is smaller than the trends
    assert found[10.0] == pytest.approx(found[None] * between / within, abs=SIGMAS / math.sqrt(2 * n_obs))


DAISY = """\
[scan]
pattern = "daisy"
radius = "6 arcmin"
radial_period = "6 s"
chunk = "6 s"
duration = "24 s"
dither = "0 arcsec"
sample_rate = "10 Hz"
"""


def as_daisy(path):
    """Give a scene four chunks of a daisy in place of its scans."""
    text = path.read_text()
    path.write_text(text[: text.index("[scan]")] + DAISY + "\n" + text[text.index("[atmosphere]") :])


@pytest.mark.parametrize("pattern", ["raster", "daisy"])
def test_a_realization_with_a_weight_of_one_is_the_layer(air, tmp_path, pattern):
    """But for its mean in each scan, which all samples of the scan have in common."""
    if pattern == "daisy":
        as_daisy(tmp_path / "scene.toml")
    setup = air({}, {"numerics.precision": "float64", "fixed_pointing.elevation": "90 deg"})
    _, pointing = observation_path(setup.observing, 0)
    n_scans = setup.observing.scans.n_scans
    block, (layer,) = Block(0, 0, n_scans), setup.air.layers
    numbers = LayerNumbers(setup.scene.seed, 0, 0, "")
    scans_of = straight_scans if pointing.straight else curved_scans
    of = scans_of(layer, setup, pointing, layer_wind(layer, WEATHER, pointing, numbers), b2=WEATHER.b2)
    frozen, mixed = np.zeros((2, setup.camera.n_det, len(pointing.time_s)))
    item = LayerRealization(numbers)
    add_realization(frozen, of, item, block)
    add_realization(mixed, of, replace(item, weight=np.ones((n_scans, len(pointing.time_s) // n_scans))), block)
    difference = (frozen - mixed).reshape(setup.camera.n_det, n_scans, -1)
    assert pointing.straight == (pattern == "raster") and np.ptp(frozen) > 5
    np.testing.assert_allclose(np.ptp(difference, axis=(0, 2)), 0, atol=1e-4)
    assert np.abs(difference).max() > 0.1


@pytest.mark.parametrize("pattern", ["raster", "daisy"])
def test_blocks_of_an_evolving_layer(air, tmp_path, pattern):
    """The first block has the numbers of an observation of one block; later ones have its trends at least."""
    if pattern == "daisy":
        as_daisy(tmp_path / "scene.toml")
    drift = {"direction_rms": "10 deg", "time_scale": "1 min"}
    setup = air({"decorrelation_time": "7 s", "layers": [LOW, HIGH], "wind_drift": drift}, {})
    whole, first = streams(setup), streams(setup, block=Block(0, 0, 2))
    np.testing.assert_array_equal(whole[:, : first.shape[1]], first)
    second, same = streams(setup, block=Block(1, 2, 4)), whole[:, first.shape[1] :]
    assert np.corrcoef(second.ravel(), same.ravel())[0, 1] > 0.7 and not np.allclose(second, same, atol=0.1)


# ---------------------------------------------------------------- drifting wind


def test_wind_drifts(air):
    """Logarithms of speeds and directions have their rms and time scale about the drawn wind."""
    drift = {"speed_rms": 0.2, "direction_rms": "15 deg", "time_scale": "40 s"}
    setup = air({"wind_drift": drift}, {"scan.scans": 16})
    _, pointing = observation_path(setup.observing, 0)
    (layer,) = setup.air.layers
    n = 1500
    wind = np.array([layer_wind(layer, WEATHER, pointing, LayerNumbers(1, number, 0, "")) for number in range(n)])
    change = np.log((wind[:, 0] + 1j * wind[:, 1]) / complex(*WEATHER.wind_rad_s))
    for part, rms in ((change.real, 0.2), (change.imag, math.radians(15))):
        variance = np.mean(part**2, axis=0)
        assert variance == pytest.approx(np.full(16, rms**2), rel=SIGMAS * math.sqrt(2 / n) + 0.003)
        for scans in (2, 5, 9):
            found = np.mean(part[:, 0] * part[:, scans]) / rms**2
            assert found == pytest.approx(math.exp(-((8.0 * scans / 40) ** 2) / 2), abs=SIGMAS * math.sqrt(2 / n))


def test_scans_see_the_drifted_wind(air):
    """One scan in a drifted wind is that of the wind it drifts to."""
    drift = {"speed_rms": 0.2, "direction_rms": "15 deg", "time_scale": "40 s"}
    timing = {"scan.scans": 1}
    drifting, constant = air({"wind_drift": drift}, timing), air({}, timing)
    _, pointing = observation_path(drifting.observing, 0)
    seed = drifting.scene.seed
    (azimuth,), (elevation,) = layer_wind(drifting.air.layers[0], WEATHER, pointing, LayerNumbers(seed, 0, 0, ""))
    moved = replace(
        WEATHER, wind_speed_rad_s=math.hypot(azimuth, elevation), wind_angle_rad=math.atan2(elevation, azimuth)
    )
    np.testing.assert_allclose(streams(drifting), streams(constant, weather=moved), rtol=1e-5, atol=1e-4)
    assert moved.wind_angle_rad != pytest.approx(WEATHER.wind_angle_rad, abs=0.01)
