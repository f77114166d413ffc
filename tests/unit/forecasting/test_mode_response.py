"""The array response, apodization and ring modes of a forecast against dense algebra and plain loops."""

from itertools import product

import numpy as np
import pytest

from mapmaker.cleaning import TemplateOptions, clean
from mapmaker.geometry import sky_offsets
from mapmaker.spectrum import tukey
from mapmaker.timestreams import FocalPlane
from surveysim.atmosphere.thin_screen import Screen, structure_function
from surveysim.forecasting.mode_kernels import apodized_sums, unit_phases
from surveysim.forecasting.mode_response import (
    LayerWaves,
    evolution_shifts,
    layer_gain,
    layer_stream_gain,
    layer_waves,
    matrix_power,
    projected_array,
    ring_modes,
    stream_power,
)
from surveysim.forecasting.scan_apodization import apodization_of, frequency_nodes, hann_apodization, scan_apodization
from surveysim.telescope.layouts import hexagon
from surveysim.telescope.pointing import sky_vector
from surveysim.timestreams.noise import draw_from_psd
from tests import naive
from tests.deviates import deviates

ARCSEC = np.pi / 648_000
ORDERS = {"none": -1, "average": 0, "planar": 1, "quadratic": 2}
SAMPLES, RATE = 128, 10.0


def camera(rings: int = 2) -> FocalPlane:
    x, y = hexagon(rings, 40 * ARCSEC).T
    return FocalPlane(x.copy(), y.copy(), 60 * ARCSEC)


def responsivities(n_det: int) -> np.ndarray:
    return np.exp(0.1 * np.random.default_rng(5).standard_normal(n_det))


def waves(n: int = 7) -> np.ndarray:
    rng = np.random.default_rng(6)
    return rng.uniform(300, 12_000, n) * np.exp(2j * np.pi * rng.random(n))


# ---------------------------------------------------------------- apodization


@pytest.mark.parametrize(("rows", "filtered"), [(1, False), (5, False), (5, True)])
def test_apodized_sums_are_the_double_loop(rows, filtered):
    rng = np.random.default_rng(1)
    transfer = rng.standard_normal(9)
    frequency, at = rng.uniform(-4, 4, 30), rng.uniform(-3, 3, 5)  # up to 7, beyond the table's 4
    strength, power, (mean, loose) = rng.random((rows, 30)), rng.random((3, 30)), rng.random((2, 30))
    losses = rng.dirichlet(np.ones(4))[:3], rng.standard_normal((5, 3)), rng.standard_normal((3, 30))
    removed = rng.standard_normal((5, 30)) if filtered else np.zeros((0, 0))
    found = apodized_sums(strength, power, frequency, at, transfer, 2.0, mean, loose, *losses, removed)
    expected = naive.apodized_sums(strength, power, frequency, at, transfer, 2.0, mean, loose, *losses, removed)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_transfer_is_the_transform_of_the_taper():
    """Look-up at 16 steps a cycle misses (pi / 16)^2 / 8 of the taper's mean (2 t / T)^2, below 0.2: 1e-3."""
    taper = tukey(400, 1.0, 400.0, 0.5)
    apodization = apodization_of(20.0, taper, 0.05)
    time = (np.arange(400) - 199.5) * 0.05
    frequency = np.array([-0.31, -0.02, 0.0, 0.013, 0.04, 0.117, 0.3, 1.1])
    direct = np.array([np.sum(taper * np.exp(-2j * np.pi * f * time)).real for f in frequency])
    direct *= np.sqrt(0.05 / np.sum(taper**2))
    np.testing.assert_allclose(apodization.at(frequency), direct, atol=1e-3 * apodization.transfer[0])
    assert apodization.at(1e6) == 0


def test_squared_transfer_has_unit_integral():
    """Parseval: white noise goes through whole when no mean is removed."""
    for apodization in (
        scan_apodization(15.0, speed_rad_s=1e-3, size_rad=0.012, taper_fraction=0.5),
        hann_apodization(15.0),
    ):
        frequency = np.linspace(-2, 2, 80_001)
        assert np.sum(apodization.at(frequency) ** 2) * (frequency[1] - frequency[0]) == pytest.approx(1, abs=2e-3)


def test_scan_shorter_than_the_map_cuts_its_taper():
    """A taper over 40 scans is flat along one: its transform is that of a box."""
    apodization = scan_apodization(10.0, speed_rad_s=1e-3, size_rad=0.4, taper_fraction=0.5)
    frequency = np.array([0.0, 0.03, 0.05, 0.15, 0.26])
    np.testing.assert_allclose(apodization.at(frequency), np.sqrt(10.0) * np.sinc(frequency * 10.0), atol=0.02)


def test_nodes_integrate_to_the_band():
    nodes, weight = frequency_nodes(scan_apodization(15.0, speed_rad_s=1e-3, size_rad=0.012, taper_fraction=0.5), 5.0)
    assert weight.sum() == pytest.approx(10.0, rel=1e-2)
    assert (np.diff(nodes) > 0).all()
    np.testing.assert_allclose(nodes, -nodes[::-1])


@pytest.mark.parametrize("index", [0, 1])
def test_noise_of_a_mode_is_what_drawn_scans_leave(index):
    """Scans less their mean, tapered, at a mode's frequency: 20 000 powers, exponential, so 0.7 % (1 % at f = 0)."""
    rng, draws = np.random.default_rng(2), 20_000
    step_hz = RATE / (2 * SAMPLES)
    line_hz = step_hz * np.arange(1, SAMPLES + 1)
    psd = np.concatenate([[0], line_hz**-index])
    scans = draw_from_psd(psd, (draws,), 2 * SAMPLES, RATE, deviates(rng))[:, :SAMPLES].astype(float)
    scans -= scans.mean(axis=1, keepdims=True)
    taper = tukey(SAMPLES, 1.0, SAMPLES, 0.5)
    at_hz = np.array([0.0, 0.03, 0.078, 0.2, 1.3])
    time = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) / RATE
    modes = (scans * taper) @ np.exp(-2j * np.pi * np.outer(time, at_hz))
    found = np.mean(np.abs(modes) ** 2, axis=0) / np.sum(taper**2)
    both = np.concatenate([-line_hz, line_hz])
    apodization = apodization_of(SAMPLES / RATE, taper, 1 / RATE)
    strength = np.tile(psd[1:], 2)[None] * step_hz
    expected = apodization.sums(strength, both, at_hz) * RATE / 2
    np.testing.assert_allclose(found, expected, rtol=4 * np.sqrt(2 / draws) + 0.01)
    if index == 0:
        # The mean takes nearly all of a mode that is constant along the scan, and nothing of a fast one.
        assert expected[0] < 0.35 * expected[-1]


def test_tapers_anywhere_in_a_scan_leave_the_mean_of_all_places():
    """Waves less their mean, seen through a taper of half the scan's length, at evenly spaced places of its middle."""
    duration, places = SAMPLES / RATE, 400
    step = duration / SAMPLES
    apodization = scan_apodization(duration, speed_rad_s=2.0, size_rad=duration, taper_fraction=0.5, centred=False)
    assert apodization.slack_s == pytest.approx(duration / 2)
    time, at_hz = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) * step, np.array([0.0, 0.05, 0.1, 0.3])
    for f in (0.02, 0.05, 0.09, 0.2):
        wave, found = np.exp(2j * np.pi * f * time), np.zeros(len(at_hz))
        for middle in duration / 2 * ((np.arange(places) + 0.5) / places - 0.5):
            fine = middle + (np.arange(SAMPLES) - (SAMPLES - 1) / 2) * step / 2
            taper = tukey(SAMPLES, step, duration, 0.5)
            left = (np.exp(2j * np.pi * f * fine) - wave.mean()) * taper
            modes = np.abs(np.exp(-2j * np.pi * np.outer(at_hz, fine)) @ left) ** 2
            found += modes * step / 2 / np.sum(taper**2) / places
        expected = [apodization.sums(np.ones((1, 1)), np.array([f]), at_hz[[k]])[0] for k in range(len(at_hz))]
        np.testing.assert_allclose(expected, found, rtol=0.02, atol=2e-3 * apodization.transfer[0] ** 2)


def test_passed_is_what_the_mean_leaves_of_a_wave():
    """The share of its own mode that a wave keeps, by samples."""
    taper = tukey(SAMPLES, 1.0, SAMPLES, 0.5)
    apodization = apodization_of(SAMPLES / RATE, taper, 1 / RATE)
    time = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) / RATE
    for f in (0.0, 0.05, 0.11, 0.7):
        wave = np.exp(2j * np.pi * f * time)
        left = np.sum((wave - wave.mean()) * taper * wave.conj()) / taper.sum()
        assert apodization.signal_amplitude(f) == pytest.approx(left.real, abs=3e-3)


# ---------------------------------------------------------------- rings


def test_ring_means_of_smooth_functions_are_exact():
    ell = np.array([900.0, 5000.0])
    modes = ring_modes(ell)
    assert modes.share.sum() == pytest.approx(1, rel=1e-12)
    angle = np.angle(modes.wave)
    np.testing.assert_allclose(np.abs(modes.wave), np.broadcast_to(ell[:, None], angle.shape))
    for power, mean in ((2, 1 / 2), (4, 3 / 8), (6, 5 / 16)):
        np.testing.assert_allclose(modes.mean((np.cos(angle) ** power).ravel()), mean, rtol=1e-9)


# ---------------------------------------------------------------- arrays


def test_places_are_the_sky_offsets():
    plane, angle = camera(), np.radians(23.0)
    array = projected_array(plane, angle, responsivity=np.ones(19), algorithm="none")
    xi, eta = sky_offsets(plane, np.array([angle]))
    np.testing.assert_allclose(array.place, (xi + 1j * eta)[0], atol=1e-12)
    np.testing.assert_allclose(array.place, np.array(sky_vector(angle, plane.x_rad, plane.y_rad)).T @ [1, 1j])


@pytest.mark.parametrize(("largest", "atol"), [(6.0, 2e-15), (1e4, 4e-12)])
def test_unit_phases_are_exponentials(largest, atol):
    """Angles are rounded to 1e-16 of themselves, some three times."""
    angle = np.concatenate([np.arange(-8, 9) * np.pi / 4, np.linspace(-1, 1, 999) * largest, [1e-12, -1e-12]])
    found, unit = np.empty((len(angle), 2), complex), np.array([1.0, 0.5])
    unit_phases(angle, angle, unit, 1 - unit, found)
    np.testing.assert_allclose(found, np.exp(1j * np.array([angle, angle])).T, rtol=0, atol=atol)


@pytest.mark.parametrize("algorithm", ORDERS)
def test_response_is_the_adjoint_of_the_cleaning(algorithm):
    plane, wave = camera(), waves()
    gain = responsivities(19)
    array = projected_array(plane, 0.7, responsivity=gain, algorithm=algorithm)
    left = naive.cleaning_matrix(plane.x_rad, plane.y_rad, gain, ORDERS[algorithm])
    seen = np.array([[np.exp(1j * (k * np.conj(r)).real) for k in wave] for r in array.place])
    np.testing.assert_allclose(array.phases(wave), seen, atol=1e-12)
    np.testing.assert_allclose(array.response(wave), left.conj().T @ seen, atol=1e-9)
    streams = np.random.default_rng(8).standard_normal((19, 30))
    np.testing.assert_allclose(array.cleaned(streams), left @ streams, atol=1e-9)


@pytest.mark.parametrize("algorithm", ["average", "planar", "quadratic"])
def test_cleaned_is_what_the_map_maker_leaves(algorithm):
    """Common signals with the responsivities, and a thousandth of something else that follows none of them in time.

    The fit then finds the responsivities to 1e-3 of that rest, times the number of templates.
    """
    plane, n = camera(), 400
    gain = responsivities(19)
    # The map-maker counts a slope or curvature of the responsivities as one of the templates.
    powers = [(i, j) for i in range(3) for j in range(3 - i) if i + j <= ORDERS[algorithm]]
    shapes = np.array([(plane.x_rad / 1e-4) ** i * (plane.y_rad / 1e-4) ** j for i, j in powers]).T
    gain += 1 - shapes @ np.linalg.lstsq(shapes, gain)[0]
    array = projected_array(plane, 0.0, responsivity=gain, algorithm=algorithm)
    rng = np.random.default_rng(9)
    time = 2 * np.pi * (np.arange(n) + 0.5) / n
    common = np.sin(time)
    rest = 1e-3 * rng.standard_normal((19, 12)) @ np.cos(np.outer(np.arange(5, 17), time))
    data = gain[:, None] * common + rest
    result = clean(algorithm, data, np.array([[0, n]]), plane, options=TemplateOptions(1e-12, 500))
    assert result.kept.all()
    expected = array.cleaned(rest)
    np.testing.assert_allclose(result.data_mk, expected, atol=1e-2 * expected.std())


def test_powers_are_those_of_dense_matrices():
    plane, wave = camera(), waves()
    gain = responsivities(19)
    array = projected_array(plane, 1.1, responsivity=gain, algorithm="planar")
    left = naive.cleaning_matrix(plane.x_rad, plane.y_rad, gain, 1)
    root = np.random.default_rng(10).standard_normal((19, 19))
    matrix = root @ root.T / 19
    response = array.response(wave)
    for given, dense in ((None, np.eye(19)), (matrix, matrix)):
        expected = [(e.conj() @ left @ dense @ left.T @ e).real / 19 for e in array.phases(wave).T]
        np.testing.assert_allclose(matrix_power(response, given), expected, rtol=1e-9)
        assert stream_power(array, given) == pytest.approx(np.trace(left @ dense @ left.T) / 19, rel=1e-12)


@pytest.mark.parametrize("algorithm", ORDERS)
def test_layer_gain_is_the_double_sum(algorithm):
    plane, wave = camera(1), waves(3)
    gain = responsivities(7)
    algorithm = "average" if algorithm == "quadratic" else algorithm  # of seven, six templates leave next to nothing
    array = projected_array(plane, 0.4, responsivity=gain, algorithm=algorithm)
    left = naive.cleaning_matrix(plane.x_rad, plane.y_rad, gain, ORDERS[algorithm])
    layer = LayerWaves(np.append(waves(4), -waves(4)) / 10, np.ones((1, 8)), np.zeros(1), np.ones(1))
    expected = naive.layer_gain(array.place, gain, left, wave, layer.alpha)
    found = layer_gain(array, array.response(wave), layer)
    # Amplitudes in single precision are right to 1e-7, and responses are below 1.
    np.testing.assert_allclose(np.sqrt(found), np.sqrt(expected), rtol=1e-6, atol=1e-7)
    streams = left @ (gain[:, None] * array.phases(2 * np.pi * layer.alpha))
    np.testing.assert_allclose(layer_stream_gain(array, layer), np.mean(np.abs(streams) ** 2, axis=0), atol=1e-12)


@pytest.mark.parametrize("algorithm", ["average", "planar"])
def test_wrong_responsivities_are_those_of_the_projection_alone(algorithm):
    """Detectors see with the true ones; 1 - P, and so the response, holds those that cleaning assumes."""
    plane, wave, gain = camera(1), waves(3), responsivities(7)
    assumed = gain * np.exp(0.2 * np.random.default_rng(12).standard_normal(7))
    array = projected_array(plane, 0.4, responsivity=gain, algorithm=algorithm, assumed=assumed)
    left = naive.cleaning_matrix(plane.x_rad, plane.y_rad, assumed, ORDERS[algorithm])
    np.testing.assert_allclose(array.response(wave), left.conj().T @ array.phases(wave), atol=1e-9)
    layer = LayerWaves(np.append(waves(4), -waves(4)) / 10, np.ones((1, 8)), np.zeros(1), np.ones(1))
    expected = naive.layer_gain(array.place, gain, left, wave, layer.alpha)
    found = layer_gain(array, array.response(wave), layer)
    # Amplitudes in single precision are right to 1e-7, and responses are below 1.
    np.testing.assert_allclose(np.sqrt(found), np.sqrt(expected), rtol=1e-6, atol=1e-7)
    # Of a layer that all detectors see alike, the error times the layer is left.
    flat = LayerWaves(np.array([1e-9 + 0j, -1e-9]), np.ones((1, 2)), np.zeros(1), np.ones(1))
    rms = np.sqrt(np.mean((left @ gain) ** 2))
    assert np.sqrt(layer_stream_gain(array, flat)[0]) == pytest.approx(rms, rel=1e-6)
    assert stream_power(array, None) == pytest.approx(np.trace(left @ left.T) / 7, rel=1e-12)


@pytest.mark.parametrize("outer_rad", [np.inf, 0.2])
def test_layer_waves_hold_the_structure_function(outer_rad):
    """Summed over the wavevectors, 2 (1 - cos) is the structure function, to a few hundredths of the quadrature."""
    screen, sines = Screen(11 / 3, 8e-3, outer_rad), (1.0, 0.5)
    layer = layer_waves(screen, 0.05, sines)
    for sine, power in zip(sines, layer.power, strict=True):
        seen = Screen(11 / 3, 8e-3 * sine, outer_rad * sine)
        for lag, direction in product((2e-4, 1e-3, 4e-3, 1.5e-2), (0.0, 0.3, 1.2)):
            phase = 2 * np.pi * (layer.alpha * np.exp(-1j * direction)).real * lag
            found = np.sum(power * 4 * np.sin(phase / 2) ** 2)
            assert found == pytest.approx(float(structure_function(seen, lag)), rel=0.03)


def test_sums_over_other_frequencies_are_refused():
    apodization = apodization_of(SAMPLES / RATE, tukey(SAMPLES, 1.0, SAMPLES, 0.5), 1 / RATE)
    frequency, at_hz = np.linspace(0.1, 1, 9), np.linspace(0, 1, 4)
    assert apodization.power_sums(np.ones((4, 9)), np.ones((2, 9)), frequency, at_hz).shape == (2, 4)
    for strength, power in (((4, 8), (2, 9)), ((3, 9), (2, 9)), ((1, 9), (2, 8)), ((4, 9), (9,))):
        with pytest.raises(ValueError, match="found gain .* are expected"):
            apodization.power_sums(np.ones(strength), np.ones(power), frequency, at_hz)


@pytest.mark.parametrize("time_s", [2.0, 30.0])
def test_shifts_have_the_correlation_of_an_evolving_layer(time_s):
    """Three shifts of each sign, against the closed form up to the lag 0.8 T; a frozen layer has none."""
    shift, share = evolution_shifts(time_s)
    assert share.sum() == pytest.approx(1) and len(shift) == 6
    lag = np.linspace(0, 0.8, 25)
    expected = (1 - lag / 2) * np.cos(np.pi * lag / 2) + np.sin(np.pi * lag / 2) / np.pi
    np.testing.assert_allclose(np.cos(2 * np.pi * np.outer(lag * time_s, shift)) @ share, expected, atol=0.04)
    assert [item.tolist() for item in evolution_shifts(None)] == [[0], [1]]
