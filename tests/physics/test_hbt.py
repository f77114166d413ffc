"""Correlated wave noise of photons (Hill and Kusaka 2024): beams over the stop, pairs of detectors, arrays."""

import math
import tracemalloc

import numpy as np
import pytest
from scipy.special import j1
from scipy.stats import chi2

from mapmaker.timestreams import FocalPlane
from surveysim import run
from surveysim.forecasting.forecast import forecast
from surveysim.reduction.setup import prepare
from surveysim.results.agreement import forecast_agreement
from surveysim.runtime.engine import SERIAL
from surveysim.scene.passband import Passband, top_hat
from surveysim.scene.scene import load_scene
from surveysim.telescope.array_noise import array_correlation, array_psd, common_with_others
from surveysim.telescope.focal_plane import Camera
from surveysim.telescope.illumination import (
    UNIFORM,
    GaussianIllumination,
    He11Illumination,
    TableIllumination,
    gaussian_horn,
)
from surveysim.telescope.lattice_noise import LARGEST_ERROR, embed
from surveysim.telescope.layouts import HEXAGONAL, Lattice, hexagon, hexagon_cells
from surveysim.telescope.pixel_coherence import (
    PixelCoherence,
    correlation_matrices,
    lattice_sum,
    part_weights,
    wave_noise_band,
)
from surveysim.telescope.radiative_chain import black_body
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_levels
from tests import camera as camera_scene
from tests.naive import beam_coherence, wave_correlation
from tests.scenes import SMALL_SCENE, WIDE_PATCH, without_sections, write_scene

BEAMS = [UNIFORM, GaussianIllumination(3.0), gaussian_horn(1.3), He11Illumination(0.7), He11Illumination(2.0)]
SPILLING = BEAMS[1:]
SEPARATIONS = [0.0, 0.35, 0.7, 1.3, 2.4, 6.1]


# ---------------------------------------------------------------- beams over the stop


@pytest.mark.parametrize("s", SEPARATIONS)
@pytest.mark.parametrize("beam", BEAMS, ids=str)
def test_aperture_is_the_slow_transform(beam, s):
    # The midpoint rule with 4000 points errs by (6 pi / 4000)^2 / 24 at most.
    assert beam.aperture(np.array([s]))[0] == pytest.approx(beam_coherence(beam.intensity, s, 0, 1), abs=1e-6)


@pytest.mark.parametrize("s", SEPARATIONS)
@pytest.mark.parametrize("beam, outer", [(SPILLING[0], 8.0), (SPILLING[1], 8.0)], ids=str)
def test_light_of_the_stop_is_the_slow_transform(beam, outer, s):
    """Gaussian beams, of which nothing is left at eight radii: 10^-19 and less."""
    found = beam.stop(np.array([s]))[0]
    assert found == pytest.approx(beam_coherence(beam.intensity, s, 1, outer), abs=5e-5)  # steps of 1 / 570


@pytest.mark.parametrize("diameter", [0.7, 2.0])
def test_light_of_the_stop_around_a_corrugated_horn(diameter):
    """The tail of the beam goes as rho^-5: up to 60 radii all but 3 times 10^-7 of the beam's power is counted."""
    beam = He11Illumination(diameter)
    for s in (0.0, 0.9 * diameter, 1.5 * diameter):
        slow = beam_coherence(beam.intensity, s, 1, 60.0, n=20_000)
        assert beam.stop(np.array([s]))[0] == pytest.approx(slow, abs=1e-5)


@pytest.mark.parametrize("beam", BEAMS, ids=str)
def test_small_and_many_separations(beam):
    """Interpolated in separation where that pays, to 1e-11; 1 at none, and even."""
    many = np.linspace(0, 40, 3001)
    some = many[::600]
    for transform in (beam.aperture, beam.whole):
        np.testing.assert_allclose(transform(many)[::600], transform(some), rtol=0, atol=1e-11)
        np.testing.assert_allclose(transform(-some), transform(some), rtol=0, atol=1e-15)
        assert transform(np.zeros(1))[0] == pytest.approx(1, abs=1e-13)


def test_uniform_stop_has_no_factor_of_two():
    """Gamma is 2 J1(pi s) / (pi s) with s in (f/#)lambda, and light of the stop does not reach the pixel."""
    s = np.array([0.3, 0.7, 1.22, 5.0])
    np.testing.assert_allclose(UNIFORM.aperture(s), 2 * j1(np.pi * s) / (np.pi * s), rtol=1e-13)
    assert UNIFORM.efficiency == 1 and not UNIFORM.stop(s).any()


@pytest.mark.parametrize("diameter", [0.7, 1.3, 2.0, 5.0])
def test_efficiency_of_a_corrugated_horn(diameter):
    """Against the power in the far field, counted in rings to 400 radii; beyond is (2 / pi^2 d rho)^3-like, 1e-8."""
    beam = He11Illumination(diameter)
    rho = (np.arange(2_000_000) + 0.5) / 5000
    power = beam.intensity(rho) * rho
    assert beam.efficiency == pytest.approx(power[:5000].sum() / power.sum(), abs=2e-7)


def test_a_gaussian_is_nearly_the_beam_of_a_corrugated_horn():
    """Fields that overlap by 98 % in power (Goldsmith 1998) differ by sqrt(1 - 0.98) in any share of it at most."""
    s = np.linspace(0, 4, 41)
    for diameter in (0.7, 1.3, 2.0):
        horn, gaussian = He11Illumination(diameter), gaussian_horn(diameter)
        assert horn.efficiency == pytest.approx(gaussian.efficiency, abs=0.14)
        # Both numerator and denominator of the coherence are such shares; most of the difference cancels.
        assert np.abs(horn.aperture(s) - gaussian.aperture(s)).max() < 0.05


@pytest.mark.parametrize("diameter", [0.7, 1.3, 2.0])
def test_horns_that_do_not_overlap_share_nothing_in_thermal_equilibrium(diameter):
    """Light of one temperature from the whole plane of the stop: orthogonal modes have independent noise."""
    beam = He11Illumination(diameter)
    s = diameter * np.array([1.0, 1.2, 3.0])
    eta = beam.efficiency
    np.testing.assert_allclose(eta * beam.aperture(s) + (1 - eta) * beam.stop(s), 0, atol=1e-13)
    assert abs(beam.aperture(s[:1])[0]) > 0.01  # each of the two alone is correlated


def test_overlap_of_two_horns():
    """The convolution of the aperture field with itself on a grid, for horns of one (f/#)lambda."""
    from scipy.special import j0

    step = 1 / 400
    x, y = np.meshgrid(np.arange(-1, 1, step) + step / 2, np.arange(-0.5, 0.5, step) + step / 2)

    def field(u):
        r = np.hypot(u, y)
        return np.where(r < 0.5, j0(2.404825557695773 * 2 * r), 0)

    norm = np.sum(field(x) ** 2)
    for s in (0.2, 0.5, 0.8):
        direct = np.sum(field(x + s / 2) * field(x - s / 2)) / norm
        assert He11Illumination(1.0).whole(np.array([s]))[0] == pytest.approx(direct, abs=1e-4)


def test_many_horns_take_little_memory():
    """Half a million separations of a table of 1000 horns, of which none overlap."""
    positions = np.random.default_rng(2).permutation(hexagon(20, 1.5)[:1000]) + 0.1
    positions += np.random.default_rng(3).uniform(-0.2, 0.2, positions.shape)
    tracemalloc.start()
    coherence = PixelCoherence("hbt", He11Illumination(1.0), ((0.95, 0.5), (1.05, 0.5)), with_stop=True)
    matrices = correlation_matrices(positions, coherence)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert matrices.shape == (3, 1000, 1000) and peak < 150e6


def test_beams_by_table():
    """A Gaussian by its values: linear interpolation errs by h^2 / 8 times its curvature. Amplitudes are squared."""
    beam, rho = GaussianIllumination(6.0), np.linspace(0, 5, 2001)
    s = np.array(SEPARATIONS)
    for power in (1, 2):
        table = TableIllumination(tuple(rho.tolist()), tuple((beam.intensity(rho) ** (1 / power)).tolist()), power)
        assert table.efficiency == pytest.approx(beam.efficiency, abs=1e-6)
        for mine, exact in ((table.aperture, beam.aperture), (table.stop, beam.stop)):
            np.testing.assert_allclose(mine(s), exact(s), rtol=0, atol=1e-5)


def test_a_coarse_table_is_piecewise_linear():
    """Three knots, one of them beyond the edge of the stop, against the slow transform of the same lines."""
    table = TableIllumination((0.0, 0.8, 1.5), (1.0, 0.6, 0.0))
    for s in SEPARATIONS:
        at = np.array([s])
        assert table.aperture(at)[0] == pytest.approx(beam_coherence(table.intensity, s, 0, 1), abs=1e-6)
        assert table.stop(at)[0] == pytest.approx(beam_coherence(table.intensity, s, 1, 1.5), abs=1e-6)


def test_flat_table_is_a_uniform_stop():
    table, s = TableIllumination((0.0, 1.0), (0.3, 0.3)), np.linspace(0, 30, 500)
    assert table.efficiency == 1
    np.testing.assert_allclose(table.aperture(s), UNIFORM.aperture(s), rtol=0, atol=1e-12)


# ---------------------------------------------------------------- the band


@pytest.mark.parametrize(
    "band",
    [
        top_hat(150e9, 0.3),
        Passband((120e9, 140e9, 150e9, 175e9), (0.0, 1.0, 0.8, 0.1)),
        Passband(tuple(np.linspace(125e9, 170e9, 90)), tuple(1.1 + np.sin(np.linspace(0, 9, 90)))),
    ],
    ids=["top hat", "coarse", "fine"],
)
@pytest.mark.parametrize("beam", [UNIFORM, gaussian_horn(1.2)], ids=str)
def test_average_over_the_band_is_brute_force(beam, band):
    """Wave noise goes as the square of the transmission; the midpoint rule in 300 frequencies is the brute force."""
    low, high = band.edges_hz
    frequency = low + (high - low) * (np.arange(300) + 0.5) / 300
    transmission = np.interp(frequency, band.frequency_hz, band.transmission)
    pairs = list(zip(frequency / band.centre_hz, transmission, strict=True))
    coherence = PixelCoherence("hbt", beam, wave_noise_band(band), with_stop=beam is not UNIFORM)
    for s in (0.7, 1.2, 1.7, 3.3):
        parts = coherence.parts(np.array([s]))[:, 0]
        stop = 0.3 if beam is not UNIFORM else 0.0
        expected = wave_correlation(beam, s, pairs, 1 - stop, stop)
        assert part_weights(stop, len(parts)) @ parts == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize("diameter", [0.7, 1.3])
def test_average_over_the_band_of_a_chain_of_elements(diameter):
    """Horns before a cold stop spill less at high frequencies: a band of 40 %, frequency by frequency.

    The averages of the weights cost less than 1 % of the correlation. With the noise of a beam that spills alike at all
    frequencies it would be 14 and 40 % too high.
    """
    band, beam, s = top_hat(150e9, 0.4), gaussian_horn(diameter), np.array([diameter])
    frequency, weight = band.nodes
    noise, shared, aperture = [], [], []
    for each in frequency:
        here, ratio = beam.at(each / 150e9), each / 150e9
        eta = here.efficiency
        light = eta * 0.3 * black_body(each, 100.0), (1 - eta) * black_body(each, 4.0)
        amplitude = light[0] * here.aperture(s * ratio)[0] + light[1] * here.stop(s * ratio)[0]
        noise.append((each * sum(light)) ** 2)
        shared.append((each * amplitude) ** 2)
        aperture.append(light[0] / sum(light))
    stop = 1 - np.average(aperture, weights=weight * noise)
    parts = PixelCoherence("hbt", beam, wave_noise_band(band), with_stop=True).parts(s)[:, 0]
    assert part_weights(stop, 3) @ parts == pytest.approx(weight @ shared / (weight @ noise), rel=0.01)


def test_far_pixels_of_a_wide_band():
    """To 1e-6 in a band of 30 %, at 12 to 45 (f/#)lambda, where wave noise is correlated by 1e-4 to 1e-6 at most."""
    band = top_hat(150e9, 0.3)
    ratio = 0.85 + 0.3 * (np.arange(20_000) + 0.5) / 20_000
    s = np.array([12.0, 20.0, 45.0])
    exact = np.mean(UNIFORM.aperture(np.multiply.outer(s, ratio)) ** 2, axis=1)
    assert np.abs(PixelCoherence("hbt", UNIFORM, wave_noise_band(band)).parts(s)[0] - exact).max() < 1e-6


def test_a_band_of_one_frequency_has_no_average():
    assert wave_noise_band(top_hat(150e9, 0)) == ((1.0, 1.0),)


# ---------------------------------------------------------------- matrices


@pytest.mark.parametrize("beam", SPILLING, ids=str)
@pytest.mark.parametrize("pitch", [0.3, 0.7, 1.3])
def test_all_parts_are_positive_semi_definite(beam, pitch):
    """Products of coherences, which are transforms of non-negative light: for any weights, and with angles."""
    coherence = PixelCoherence("hbt", beam, wave_noise_band(top_hat(150e9, 0.25)), with_stop=True)
    angle = np.radians(np.random.default_rng(3).uniform(0, 180, 61))
    for psi in (None, angle):
        parts = correlation_matrices(hexagon(4, pitch), coherence, psi)
        for part in parts:
            assert np.linalg.eigvalsh(part)[0] > -1e-9
        for share in (0.0, 0.2, 0.7, 1.0):
            total = np.tensordot(part_weights(share, 3), parts, axes=1)
            np.testing.assert_allclose(np.diagonal(total), 1, rtol=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.35])
def test_lattice_has_the_parts_of_the_matrix(share):
    cells, positions = hexagon_cells(7, 1.2)
    coherence = PixelCoherence("hbt", gaussian_horn(1.2), wave_noise_band(top_hat(150e9, 0.2)), with_stop=True)
    torus = embed(Lattice(cells, 1.2, HEXAGONAL), 1.0, coherence).at(share)
    n_q, n_r = torus.values.shape
    q, r = (cells[:, None] - cells).transpose(2, 0, 1)
    expected = np.tensordot(part_weights(share, 3), correlation_matrices(positions, coherence), axes=1)
    assert np.abs(torus.correlation[q % n_q, r % n_r] - expected).max() <= LARGEST_ERROR
    assert torus.values.min() >= 0


def fields_of_pair(rng, gamma, delta, n):
    """Unpolarized thermal fields (2 detectors, 2 components, n) with the coherence gamma, turned by the angle delta."""
    z = (rng.standard_normal((3, 2, n)) + 1j * rng.standard_normal((3, 2, n))) / math.sqrt(2)
    root = math.sqrt(gamma)
    fields = root * z[0] + math.sqrt(1 - gamma) * z[1:]
    turn = np.array([[math.cos(delta), math.sin(delta)], [-math.sin(delta), math.cos(delta)]])
    return np.stack([fields[0], turn @ fields[1]])


def test_polarization_angles_against_thermal_fields():
    """Powers of detectors of one polarization: gamma^2 cos^2 delta. Of Q, the difference of two: gamma^2 cos 2 delta.

    A correlation of n exponential powers scatters by at most sqrt(8 / n) (their kurtosis is 9).
    """
    rng, n, gamma = np.random.default_rng(5), 400_000, 0.6
    for delta in np.radians([0.0, 30.0, 45.0, 80.0, 90.0]):
        power = np.abs(fields_of_pair(rng, gamma, delta, n)) ** 2
        one = np.corrcoef(power[0, 0], power[1, 0])[0, 1]
        both = np.corrcoef(power[0].sum(axis=0), power[1].sum(axis=0))[0, 1]
        stokes_q = np.corrcoef(power[0, 0] - power[0, 1], power[1, 0] - power[1, 1])[0, 1]
        spread = 4 * math.sqrt(8 / n)
        assert one == pytest.approx((gamma * math.cos(delta)) ** 2, abs=spread)
        assert both == pytest.approx(gamma**2, abs=spread)
        assert stokes_q == pytest.approx(gamma**2 * math.cos(2 * delta), abs=spread)


def test_matrix_of_polarized_detectors():
    positions, angle = np.array([[0, 0], [0.8, 0], [0.8, 0.0001]]), np.radians([10.0, 40.0, 130.0])
    coherence = PixelCoherence("hbt")
    matrix = correlation_matrices(positions, coherence, angle)[0]
    gamma = UNIFORM.aperture(np.array([0.8]))[0]
    assert matrix[0, 1] == pytest.approx(gamma**2 * 0.75, rel=1e-12)  # cos^2 30 degrees
    assert matrix[1, 2] == pytest.approx(0, abs=1e-12)  # orthogonal detectors at one place
    assert (np.diagonal(matrix) == 1).all()


# ---------------------------------------------------------------- arrays


def lattice_camera(rings, pitch, illumination=UNIFORM, band=None):
    cells, positions = hexagon_cells(rings, pitch)
    return Camera(FocalPlane(*positions.T, 1.0), 1.0, illumination, (Lattice(cells, pitch, HEXAGONAL),), band=band)


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_sums_over_pairs_are_those_of_the_matrix(share):
    cam = lattice_camera(6, 0.9, gaussian_horn(0.9))
    coherence = PixelCoherence("hbt", cam.illumination, wave_noise_band(top_hat(150e9, 0.2)), with_stop=True)
    matrix = np.tensordot(part_weights(share, 3), correlation_matrices(cam.positions_f_lambda, coherence), axes=1)
    expected = matrix.sum() / len(matrix) - 1
    assert common_with_others(cam, coherence, share) == pytest.approx(expected, rel=1e-9)
    free = Camera(cam.focal_plane, 1.0, cam.illumination)
    assert common_with_others(free, coherence, share) == pytest.approx(expected, rel=1e-9)
    found = array_correlation(cam, coherence, aperture_weight=0.5 * (1 - share), stop_weight=0.5 * share)
    assert found == pytest.approx(0.25 * expected, rel=1e-9)


@pytest.mark.parametrize("pitch", [0.7, 1.0, 1.4])
def test_large_arrays_have_the_sum_of_the_lattice(pitch):
    """Less what detectors at the edge lack: with R rings (a + b ln R) / R, for gamma^2 ~ s^-3, and 1 / R^2 beyond."""
    rings = np.array([15, 30, 60])
    found = [common_with_others(lattice_camera(n, pitch), PixelCoherence("hbt"), 0.0) for n in rings]
    whole = np.linalg.solve(np.column_stack([np.ones(3), 1 / rings, np.log(rings) / rings]), found)[0]
    assert whole == pytest.approx(lattice_sum(pitch, "intensity"), abs=0.005)


# ---------------------------------------------------------------- streams


HBT = {
    "instrument.bandwidth": 0.25,
    "instrument.layout.pitch_f_lambda": 1.0,
    "instrument.layout.rings": 3,
    "instrument.layout.dead": [5, 11],
    "instrument.horn_f_lambda": 1.0,
    "instrument.illumination": "he11",
    "instrument.responsivity_scatter": 0.0,
    "photon.psd": "3 mK2/Hz",
    "photon.coherence": "hbt",
    "photon.bose_fraction": 0.8,
    "photon.coherent_fraction": 0.9,
    "photon.stop_fraction": 0.05,
    "detector.psd": "0.5 mK2/Hz",
    "scan.duration": "600 s",
    "scan.speed": "1 arcsec / s",
}
QUIET = without_sections(SMALL_SCENE, "atmosphere", "excess", "sky", "score").replace('"average"', '"none"')


def drawn(tmp_path, overrides):
    setup = prepare(load_scene(write_scene(tmp_path, QUIET), HBT | overrides))
    return setup, draw_observation(setup, 0).data_mk.astype(float)


def formula(setup, angle=None):
    """Covariance of a sample of all detectors by equations 59, 60 and 68, from the keys of the scene."""
    photon, beam = setup.scene.photon, setup.camera.illumination
    place = setup.camera.positions_f_lambda
    band = [(ratio, 1.0) for ratio in 0.875 + 0.25 * (np.arange(60) + 0.5) / 60]
    separation = np.linalg.norm(place[:, None] - place, axis=-1)
    distinct, which = np.unique(separation.round(9), return_inverse=True)
    weights = photon.coherent_fraction, photon.stop_fraction or 0.0
    shared = np.array([wave_correlation(beam, s, band, *weights) for s in distinct])[which].reshape(separation.shape)
    if angle is not None:
        shared = shared * np.cos(angle[:, None] - angle) ** 2
    wave = photon.bose_fraction * photon.psd_mk2_hz
    own = photon.psd_mk2_hz + setup.scene.detector.psd_mk2_hz
    matrix = np.where(np.eye(len(place), dtype=bool), own, wave * shared)
    return matrix * setup.scene.scan.sample_rate_hz / 2


def check_covariance(data, expected):
    """Chi squared of all pairs and variances of n samples: pairs scatter by sqrt((1 + rho^2) / n), nearly independent.

    The sum over pairs of the squared departure has a mean of the number of pairs; its scatter is that of chi squared
    times at most 1 + the mean squared correlation times the number of detectors.
    """
    n_det, n = data.shape
    found = data @ data.T / n
    spread = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / n)
    pairs = np.triu_indices(n_det)
    departure = ((found - expected) / spread)[pairs]
    assert np.abs(departure).max() < 5
    # Quantiles of 1 in 10^5 on both sides.
    low, high = chi2.ppf([1e-5, 1 - 1e-5], len(departure))
    assert low < np.sum(departure**2) < high


@pytest.mark.parametrize(
    "stop", [None, pytest.param(0.05, marks=pytest.mark.slow), pytest.param(0.4, marks=pytest.mark.slow)]
)
def test_every_pair_of_drawn_streams(tmp_path, stop):
    """35 detectors in 24 000 samples, horns of one (f/#)lambda that touch; weights of the stop from none to most."""
    overrides = {"photon.stop_fraction": stop, "photon.coherent_fraction": 0.9 if stop != 0.4 else 0.5}
    setup, data = drawn(tmp_path, overrides)
    check_covariance(data, formula(setup))


@pytest.mark.slow
def test_every_pair_of_a_lattice(tmp_path, monkeypatch):
    """The same with fields on a torus, as for more than 1500 detectors; it is as good as 0.002 of the wave noise."""
    from surveysim.reduction import setup as setup_module
    from surveysim.timestreams import shared_parts

    for module in (setup_module, shared_parts):
        monkeypatch.setattr(module, "MOST_DENSE", 10)
    prepare.cache_clear()
    setup, data = drawn(tmp_path, {})
    prepare.cache_clear()
    exact = formula(setup)
    torus = setup.camera.photon_correlation.at(observation_levels(setup, 0).stop_share)
    n_q, n_r = torus.values.shape
    cells = setup.camera.lattice.cells
    q, r = (cells[:, None] - cells).transpose(2, 0, 1)
    levels = observation_levels(setup, 0)
    shared = levels.photon_mk2_hz * levels.shared * setup.scene.scan.sample_rate_hz / 2
    implied = np.where(np.eye(len(exact), dtype=bool), exact, shared * torus.correlation[q % n_q, r % n_r])
    assert np.abs(implied - exact).max() < LARGEST_ERROR * shared
    check_covariance(data, implied)


@pytest.mark.parametrize("pitch, stop", [(1.0, 0.05), (1.0, None), (1.1, 0.05)])
def test_noise_of_the_mean_is_equation_68(tmp_path, pitch, stop):
    """The variance of the mean of 35 detectors over 24 000 samples is known to sqrt(2 / n), 0.9 %."""
    keys = {"instrument.layout.pitch_f_lambda": pitch, "photon.stop_fraction": stop, "scan.scans": 8}
    setup, data = drawn(tmp_path, keys)
    levels = observation_levels(setup, 0)
    psd = array_psd(setup.camera, setup.camera.photon_coherence, levels)
    n = data.shape[1]
    assert data.mean(axis=0).var() * 2 / setup.scene.scan.sample_rate_hz == pytest.approx(psd, rel=4 * math.sqrt(2 / n))
    gamma2 = array_correlation(
        setup.camera, setup.camera.photon_coherence, aperture_weight=0.9, stop_weight=stop or 0.0
    )
    photon, n_det = setup.scene.photon, setup.camera.n_det
    shot, wave = (1 - photon.bose_fraction) * photon.psd_mk2_hz, photon.bose_fraction * photon.psd_mk2_hz
    assert psd == pytest.approx((shot + (1 + gamma2) * wave + 0.5) / n_det, rel=1e-12)
    assert gamma2 > 10 * math.sqrt(2 / n)  # more than the test could miss


def test_angles_of_detectors_that_absorb_both_polarizations_do_not_matter():
    plane = FocalPlane(np.array([0.0, 0.9]), np.zeros(2), 1.0, np.radians([0.0, 90.0]))
    gamma = UNIFORM.aperture(np.array([0.9]))[0]
    for polarizations, expected in ((None, 0.0), (1, 0.0), (2, gamma**2)):
        cam = Camera(plane, 1.0, polarizations=polarizations)
        assert common_with_others(cam, PixelCoherence("hbt"), 0.0) == pytest.approx(expected, abs=1e-12)


@pytest.mark.slow
def test_two_detectors_of_each_pixel(tmp_path):
    """Orthogonal polarizations at one place share nothing, detectors of other pixels cos^2 of their angle."""
    setup = prepare(load_scene(write_scene(tmp_path, QUIET), HBT))
    plane = setup.camera.focal_plane
    angle = np.radians(np.tile([0.0, 45.0, 90.0, 135.0, 20.0], 7))
    turned = Camera(
        FocalPlane(plane.x_rad, plane.y_rad, plane.fwhm_rad, angle),
        setup.camera.f_lambda_rad,
        setup.camera.illumination,
        polarizations=1,
    )
    coherence = setup.camera.photon_coherence
    from surveysim.timestreams.shared_parts import shared_noise

    levels = observation_levels(setup, 0)
    matrix = shared_noise(turned, coherence, "photon").at(levels.stop_share)
    scale = levels.photon_mk2_hz * setup.scene.scan.sample_rate_hz / 2
    share = levels.shared * levels.photon_mk2_hz / (levels.photon_mk2_hz + 0.5)
    factor = matrix.factor(share) * math.sqrt(scale * (levels.photon_mk2_hz + 0.5) / levels.photon_mk2_hz)
    expected = formula(setup, angle)
    np.testing.assert_allclose(factor @ factor.T, expected, rtol=0, atol=3e-5 * expected.max())
    sums = common_with_others(turned, coherence, levels.stop_share)
    assert sums == pytest.approx((expected.sum() - np.trace(expected)) / 35 / (scale * levels.shared), rel=1e-3)


# ---------------------------------------------------------------- forecast


def test_forecast_of_a_survey_whose_stop_is_shared(tmp_path):
    """Weights of the parts vary by draw; the forecast is linear in them: maps of drawn streams agree."""
    keys = WIDE_PATCH | {name: value for name, value in HBT.items() if name.startswith(("instrument.", "photon."))}
    keys |= {"instrument.layout.dead": [], "photon.coherent_fraction": 0.9, "photon.stop_fraction": 0.1}
    keys |= {"instrument.layout.pitch_f_lambda": 0.7, "instrument.horn_f_lambda": 0.7}
    keys |= {"photon.psd": "20 mK2/Hz", "photon.bose_fraction": 1.0, "observations": 12}
    keys |= {"cleaning.algorithm": "none", "atmosphere": None, "excess": None, "sky": None}
    path = write_scene(tmp_path)
    scene = load_scene(path, keys)
    found = forecast_agreement(run(scene, engine=SERIAL))["actual"]
    assert abs(found.sigma) < 0.03 + 3 * found.sigma_error
    alone = forecast(prepare(load_scene(path, keys | {"photon.coherence": "none", "photon.stop_fraction": None})))
    mine = forecast(prepare(scene))
    assert mine.scores["actual"].band.sigma_ukcmb2 > 1.05 * alone.scores["actual"].band.sigma_ukcmb2


@pytest.mark.slow
def test_weights_follow_the_water_of_each_observation(tmp_path):
    """A chain of elements with a stop: every pair of two observations, under its own water, by its own weights."""
    text = camera_scene.QUIET + camera_scene.PHOTON.replace("field", "hbt") + camera_scene.CAMERA + camera_scene.SITE
    (tmp_path / "scene.toml").write_text(text)
    keys = camera_scene.BAND | camera_scene.HORNS | {"scan.duration": "200 s", "scan.speed": "1 arcsec / s"}
    keys |= {"instrument.responsivity_scatter": 0.0, "atmosphere.b2": "[0, 0] mK2 rad(-5/3)"}
    keys |= {"atmosphere.b2_probabilities": [0.25, 0.75], "instrument.illumination": "he11", "scan.scans": 8}
    setup = prepare(load_scene(tmp_path / "scene.toml", keys))
    place, beam = setup.camera.positions_f_lambda, setup.camera.illumination
    separation = np.linalg.norm(place[:, None] - place, axis=-1)
    width = keys["instrument.bandwidth"]
    band = [(ratio, 1.0) for ratio in 1 + width * ((np.arange(60) + 0.5) / 60 - 0.5)]
    distinct, which = np.unique(separation.round(9), return_inverse=True)
    by_water = sorted(range(4), key=lambda number: observation_levels(setup, number).stop_share)
    shares = []
    for number in (by_water[0], by_water[-1]):
        levels = observation_levels(setup, number)
        weights = levels.aperture_weight, levels.stop_weight
        shared = np.array([wave_correlation(beam, s, band, *weights) for s in distinct])[which]
        own = levels.photon_mk2_hz + levels.detector_mk2_hz
        diagonal = np.eye(len(place), dtype=bool)
        expected = np.where(diagonal, own, levels.wave_mk2_hz * shared.reshape(separation.shape))
        data = draw_observation(setup, number).data_mk.astype(float)
        check_covariance(data, expected * setup.scene.scan.sample_rate_hz / 2)
        shares.append(levels.stop_share)
    assert min(shares) > 0.005 and abs(shares[0] / shares[1] - 1) > 0.05
