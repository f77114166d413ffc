"""Noise shared on a lattice by fields on a torus, against the matrix of all pairs."""

import math

import numpy as np
import pytest

from mapmaker.stream_psd import hann_psd
from mapmaker.timestreams import FocalPlane
from surveysim.forecasting import coverage
from surveysim.forecasting.forecast import forecast
from surveysim.forecasting.mode_response import matrix_power, projected_array, stream_power
from surveysim.forecasting.noise_model import survey_models
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.noise_and_sky import Excess
from surveysim.scene.scene import load_scene
from surveysim.telescope import lattice_noise as lattice
from surveysim.telescope.illumination import UNIFORM, GaussianIllumination
from surveysim.telescope.lattice_noise import LARGEST_ERROR, CirculantFactor, NoiseCorrelation
from surveysim.telescope.layouts import hexagon, hexagon_cells
from surveysim.timestreams.low_frequency import add_excess, excess_psd
from surveysim.timestreams.noise import add_correlated_white
from surveysim.timestreams.observation import draw_observation
from tests.dense import DENSE
from tests.deviates import deviates
from tests.pixels import correlation_matrix, torus_of
from tests.scenes import write_scene

RATE = 10.0


def array(rings, pitch, dead=()):
    """Places on the lattice and positions of a hexagonal layout less some of its detectors."""
    cells, positions = hexagon_cells(rings, pitch)
    return np.delete(cells, list(dead), axis=0), np.delete(positions, list(dead), axis=0)


def implied(torus, cells):
    """Correlation of all pairs of detectors on a torus."""
    n_q, n_r = torus.values.shape
    q, r = (cells[:, None] - cells).transpose(2, 0, 1)
    return torus.correlation[q % n_q, r % n_r]


@pytest.mark.parametrize("coherence", ["field", "intensity"])
@pytest.mark.parametrize("pitch", [0.5, 0.7, 1.0, 1.3, 2.0])
@pytest.mark.parametrize("taper_db", [0.0, 8.9])
def test_correlation_of_all_pairs(coherence, pitch, taper_db):
    cells, positions = array(9, pitch, dead=(3, 100, 269))
    torus = torus_of(cells, pitch, coherence, GaussianIllumination(taper_db))
    expected = correlation_matrix(positions, coherence, GaussianIllumination(taper_db))
    found = implied(torus, cells)
    assert (torus.values >= 0).all()
    np.testing.assert_allclose(np.diag(found), 1.0, rtol=1e-12)
    assert np.abs(found - expected).max() <= LARGEST_ERROR


def test_an_embedding_without_negative_eigenvalues_is_exact():
    """Squared coherence has no power beyond one cycle in one (f/#)lambda: a torus of twice the array is exact."""
    cells, positions = array(9, 1.3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lattice, "_ROOM", 2.0)
        torus = torus_of(cells, 1.3, "intensity", UNIFORM)
    np.testing.assert_allclose(implied(torus, cells), correlation_matrix(positions, "intensity"), atol=1e-12)


def test_a_torus_has_room_for_a_wide_array():
    """Axes of unlike lengths: the shorter way around is taken in every direction."""
    cells = np.array([(q, r) for q in range(30) for r in range(12)])
    torus = torus_of(cells, 0.9, "field", UNIFORM)
    places = cells @ np.array([[1, 0], [0.5, math.sqrt(0.75)]]) * 0.9
    assert np.abs(implied(torus, cells) - correlation_matrix(places, "field")).max() <= LARGEST_ERROR


def test_coherence_too_sharp_for_any_torus(monkeypatch):
    monkeypatch.setattr(lattice, "_MOST_SPANS", 1.5)
    with pytest.raises(ValueError, match=r"off by 0\.\d+ on a torus of .* a larger pitch, a tapered illumination"):
        torus_of(array(3, 0.2)[0], 0.2, "field", UNIFORM)


def test_places_on_the_lattice():
    cells, positions = array(5, 0.7)
    steps = cells @ np.array([[1, 0], [0.5, math.sqrt(0.75)]])
    np.testing.assert_allclose(steps * 0.7, positions, atol=1e-12)


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_fields_have_the_covariance(share):
    """Of both parts, and none between them: an element from n pairs scatters by sqrt((1 + rho^2) / n)."""
    cells, _ = array(3, 0.7)
    torus, n = torus_of(cells, 0.7, "field", UNIFORM), 5_000
    fields = np.empty((len(cells), n), np.complex64)
    for places, part in torus.factor(share).fields(n, deviates(3)):
        fields[:, places] = part
    expected = share * implied(torus, cells) + (1 - share) * np.eye(len(cells))
    for pair in ((fields.real, fields.real), (fields.imag, fields.imag)):
        found = pair[0].astype(float) @ pair[1].T.astype(float) / n
        assert np.abs((found - expected) / np.sqrt((1 + expected**2) / n)).max() < 5
    across = fields.real.astype(float) @ fields.imag.T.astype(float) / n
    assert np.abs(across).max() < 5 / math.sqrt(n)
    following = fields[:, 1:].real.astype(float) @ fields[:, :-1].real.T.astype(float) / n
    assert np.abs(following).max() < 5 / math.sqrt(n)


@pytest.mark.parametrize("n_samp", [1, 2, 4001])
def test_white_streams_of_any_length(n_samp):
    cells, _ = array(2, 1.0)
    root = torus_of(cells, 1.0, "intensity", UNIFORM).factor()
    data = np.full((len(cells), n_samp), 100, np.float32)
    add_correlated_white(data, 2.5, RATE, root, deviates(4))
    assert (data != 100).all()
    if n_samp > 1000:
        variance = (data - 100).var(axis=1, dtype=float)
        # Detectors share little here: a variance from n samples is known to sqrt(2 / n).
        assert variance == pytest.approx(2.5 * RATE / 2, rel=5 * math.sqrt(2 / n_samp))
        assert np.abs(np.corrcoef(data[:, 1:].ravel(), data[:, :-1].ravel())[0, 1]) < 5 / math.sqrt(data.size / 2)


def test_excess_streams_have_spectrum_and_correlation():
    section = Excess(spectral_index=1.0, band_limit="1 Hz", b2=[100], variance="[3] mK2", coherence="field")
    cells, positions = array(2, 0.7)
    root, n_scans, n = torus_of(cells, 0.7, "field", UNIFORM).factor(), 200, 300
    data = np.zeros((len(cells), n_scans * n), np.float32)
    add_excess(data, section, variance_mk2=3.0, n_scans=n_scans, sample_rate_hz=RATE, factor=root, deviates=deviates(5))
    psd = hann_psd(data, n_scans, np.ones(n_scans, bool), RATE).mean(axis=0)
    k = np.arange(5, 140)
    expected = excess_psd(section, 3.0, n, 2 * n, RATE)[2 * k] * (1 + 1 / (3 * k**2))
    # Detectors share half of the noise: some eight count as independent.
    assert np.abs(psd[k] / expected - 1).max() < 5 / math.sqrt(n_scans * 8)
    # Scans do not know of each other, and pairs share what overlap says.
    scans = data.reshape(len(cells), n_scans, n)
    modes = np.fft.rfft(scans * np.hanning(n), axis=-1)[..., 4:100]
    modes /= np.sqrt(np.mean(np.abs(modes) ** 2, axis=(0, 1)))
    modes = modes.reshape(len(cells), -1)
    cross = (modes @ modes.conj().T).real / modes.shape[1]
    off = np.abs(cross - correlation_matrix(positions, "field")).max()
    assert off < 5 / math.sqrt(modes.shape[1] / 2) + LARGEST_ERROR  # neighbouring bins of the taper count half
    means = scans.mean(axis=-1)
    assert abs(np.mean(means[:, 1:] * means[:, :-1]) / means.var()) < 5 / math.sqrt(8 * n_scans)


@pytest.mark.parametrize("kind", [float, complex])
def test_products_are_those_of_the_matrix(kind):
    cells, _ = array(4, 0.7, dead=(7,))
    torus, rng = torus_of(cells, 0.7, "field", UNIFORM), np.random.default_rng(6)
    columns = rng.standard_normal((len(cells), 5)).astype(kind)
    if kind is complex:
        columns += 1j * rng.standard_normal(columns.shape)
    gain, matrix = rng.uniform(0.8, 1.2, len(cells)), implied(torus, cells)
    np.testing.assert_allclose(torus.times(columns), matrix @ columns, atol=1e-11)
    shared = NoiseCorrelation(torus, gain) @ columns
    np.testing.assert_allclose(shared, gain[:, None] * matrix * gain @ columns, atol=1e-11)
    np.testing.assert_allclose(NoiseCorrelation(None, gain) @ columns, gain[:, None] ** 2 * columns, rtol=1e-12)


@pytest.mark.parametrize("algorithm", ["none", "average", "quadratic"])
def test_powers_of_a_forecast_are_those_of_the_matrix(algorithm):
    cells, positions = array(4, 0.7)
    torus, rng = torus_of(cells, 0.7, "field", UNIFORM), np.random.default_rng(7)
    gain = rng.uniform(0.8, 1.2, len(cells))
    cleaned = projected_array(FocalPlane(*positions.T, 1.0), 0.3, responsivity=gain, algorithm=algorithm)
    matrix, shared = gain[:, None] * implied(torus, cells) * gain, NoiseCorrelation(torus, gain)
    assert stream_power(cleaned, shared) == pytest.approx(stream_power(cleaned, matrix), rel=1e-9)
    waves = cleaned.response(rng.standard_normal(6) + 1j * rng.standard_normal(6))
    np.testing.assert_allclose(matrix_power(waves, shared), matrix_power(waves, matrix), rtol=1e-9)


# ---------------------------------------------------------------- scenes of many detectors, with few told to be many


def test_coverage_of_many_samples_is_that_of_some_of_them(path, monkeypatch):
    """One of four samples in time, counted four times: within the chance of where they fall."""
    ready = prepare(load_scene(path, {"scan.sample_rate": "40 Hz", "map.pixel": "60 arcsec", "score.ell_max": 10000}))
    whole = coverage.mean_hits(ready, ready.analysis.pipelines[0])
    samples = ready.camera.n_det * ready.observing.scans.n_scans * 240
    monkeypatch.setattr(coverage, "_MOST_HIT_SAMPLES", samples / 4)
    some = coverage.mean_hits(ready, ready.analysis.pipelines[0])
    assert some.sum() == pytest.approx(whole.sum(), rel=0.02) and (some % 1 == 0).all()
    covered = whole > 20
    assert covered.sum() > 20
    assert np.abs(some - whole)[covered].mean() < 0.15 * whole[covered].mean()


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


def test_forecasts_are_those_of_matrices(path, few_are_many):
    scene = load_scene(path)
    kept = dict.fromkeys(
        ("actual", "masked_7"), np.ones(scene.observations)
    )  # how many are discarded is tried on draws, which differ
    many = forecast(prepare(scene), kept)
    assert isinstance(prepare(scene).camera.excess_factor, CirculantFactor)
    with pytest.MonkeyPatch.context() as patch:
        for module in DENSE:
            patch.setattr(module, "MOST_DENSE", 1000)
        prepare.cache_clear()
        survey_models.cache_clear()
        few = forecast(prepare(scene), kept)
    for name, item in few.scores.items():
        np.testing.assert_allclose(many.scores[name].noise_psd, item.noise_psd, rtol=0.01)
        assert many.scores[name].band.sigma_ukcmb2 == pytest.approx(item.band.sigma_ukcmb2, rel=3e-3)


def test_streams_share_what_they_do_with_a_matrix(path, few_are_many):
    """Covariance of detectors in streams of photon and excess noise: that of the closed form, within the chance."""
    settings = {"scan.scans": 200, "cleaning.algorithm": "none", "instrument.responsivity_scatter": 0.0}
    settings |= {"excess.b2": [100], "excess.variance": "[3] mK2"}
    scene = load_scene(path, settings | {"atmosphere": None, "sky": None, "score": None})
    ready = prepare(scene)
    data = draw_observation(ready, 0).data_mk.reshape(18, 200, 60).astype(float)
    data -= data.mean(axis=-1, keepdims=True)
    data = np.diff(data, axis=-1).reshape(18, -1)
    found = data @ data.T / data.shape[1]
    overlap = correlation_matrix(ready.camera.positions_f_lambda, "field")
    own = np.trace(found) / 18
    shared = [found[overlap > 0.4][found[overlap > 0.4] < 0.9 * own].mean(), found[np.abs(overlap) < 0.1].mean()]
    psd = excess_psd(scene.excess, 3.0, 60, 120, RATE)
    step = 4 * np.sin(np.pi * np.arange(61) / 120) ** 2
    excess = np.sum(psd * step) * RATE / 120
    white = 2 * 2.5 * RATE / 2
    assert own == pytest.approx(excess + 2 * white, rel=0.05)
    neighbours = overlap[(overlap > 0.4) & (overlap < 1)].mean()
    assert shared[0] == pytest.approx(neighbours * (excess + 0.1 * white), rel=0.1)
    assert abs(shared[1]) < 0.03 * own


@pytest.mark.parametrize("lattice", [False, True])
@pytest.mark.parametrize("missing", [None, "photon", "detector"])
def test_photon_and_detector_noise_add_up(path, request, lattice, missing):
    """Covariance p ((1 - s) I + s C) + d I, in one draw; elements of it scatter as Wishart's."""
    if lattice:
        request.getfixturevalue("few_are_many")
    settings = {
        "scan.scans": 400,
        "photon.psd": "2 mK2/Hz",
        "detector.psd": "3 mK2/Hz",
        "photon.coherent_fraction": 0.8,
    }
    settings = {key: value for key, value in settings.items() if not key.startswith(f"{missing}.")}
    settings |= dict.fromkeys(("atmosphere", "excess", "sky", "score", *([missing] if missing else [])))
    settings |= {"cleaning.algorithm": "none"}
    ready = prepare(load_scene(path, settings))
    data = draw_observation(ready, 0).data_mk.astype(float)
    overlap = correlation_matrix(ready.camera.positions_f_lambda, "field")
    if lattice and missing != "photon":
        overlap = implied(ready.camera.photon_correlation.at(0.0), ready.camera.lattice.cells)
    photon, detector = (0 if missing == name else level for name, level in (("photon", 2), ("detector", 3)))
    expected = (photon * (0.2 * np.eye(18) + 0.8 * overlap) + detector * np.eye(18)) * RATE / 2
    spread = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / data.shape[1])
    assert (np.abs(data @ data.T / data.shape[1] - expected) < 4.5 * spread).all()
    assert abs(np.mean(data[:, 1:] * data[:, :-1])) < 5 * expected.max() / np.sqrt(data.size / 18)


def test_tables_of_many_detectors_share_nothing(path, few_are_many):
    """Positions without a lattice need a matrix; what they do not share needs none."""
    import astropy.units as u
    from astropy.table import QTable

    x, y = hexagon(2, 40.0).T
    QTable({"x": x * u.arcsec, "y": y * u.arcsec}).write(path.parent / "camera.ecsv")
    table = {"instrument.layout": None, "instrument.positions": "camera.ecsv"}
    with pytest.raises(SceneError, match=r"photon.coherence: found 'field' for the 19 detectors of a table; 10 or few"):
        prepare(load_scene(path, table))
    alone = load_scene(path, table | {"photon.coherence": "none", "excess.coherence": "none"})
    assert prepare(alone).camera.excess_factor is None and prepare(alone).camera.photon_correlation is None
    assert set(forecast(prepare(alone)).scores) == {"actual", "uncorrelated", "white", "masked_7"}
