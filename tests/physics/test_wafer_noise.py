"""Noise of many detectors on square lattices and on several wafers, against the matrix of all pairs."""

import numpy as np
import pytest

from surveysim.forecasting.forecast import forecast
from surveysim.forecasting.noise_model import survey_models
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.telescope.array_noise import common_with_others
from surveysim.telescope.illumination import GaussianIllumination
from surveysim.telescope.lattice_noise import LARGEST_ERROR, CirculantFactor, WaferFactor, WaferPixels, embed
from surveysim.telescope.layouts import SQUARE, Lattice
from surveysim.telescope.pixel_coherence import PixelCoherence, correlation_matrices
from surveysim.timestreams.observation import draw_observation
from tests.dense import DENSE
from tests.deviates import deviates
from tests.scenes import write_scene

RATE = 10.0
WAFER = {"rings": 1, "pitch_f_lambda": 0.7}
FAR = [
    WAFER | {"offset_x": "-8 arcmin", "rotation": "20 deg", "dead": [3]},
    {"shape": "square", "side": 3, "pitch_f_lambda": 1.1, "offset_x": "8 arcmin"},
]
NOISE_ONLY = dict.fromkeys(("atmosphere", "sky", "score")) | {"cleaning.algorithm": "none", "instrument.layout": None}
FIELD = {
    "photon.coherence": "field",
    "photon.coherent_fraction": 0.8,
    "photon.psd": "2 mK2/Hz",
    "detector.psd": "1 mK2/Hz",
}
ALONE = {"excess.b2": [100], "excess.variance": "[3] mK2", "instrument.responsivity_scatter": 0.0}


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


@pytest.mark.parametrize("kind", ["field", "intensity"])
@pytest.mark.parametrize("pitch", [0.6, 1.0, 1.5])
def test_correlation_of_all_pairs_on_a_square_lattice(kind, pitch):
    cells = np.array([(q, r) for q in range(14) for r in range(11) if (q, r) != (3, 4)])
    lattice, coherence = Lattice(cells, pitch, SQUARE), PixelCoherence(kind, GaussianIllumination(5.0))
    torus = embed(lattice, 1.0, coherence).at(0.0)
    n_q, n_r = torus.values.shape
    q, r = (cells[:, None] - cells).transpose(2, 0, 1)
    expected = correlation_matrices(lattice.positions_rad, coherence)[0]
    assert np.abs(torus.correlation[q % n_q, r % n_r] - expected).max() <= LARGEST_ERROR


def test_sums_over_pairs_of_a_square_lattice(path):
    layout = {"instrument.layout": {"shape": "square", "side": 5, "pitch_f_lambda": 0.9}}
    cam = prepare(load_scene(path, layout)).camera
    coherence = PixelCoherence("field", cam.illumination)
    matrix = correlation_matrices(cam.positions_f_lambda, coherence)[0]
    assert common_with_others(cam, coherence, 0.0) == pytest.approx((matrix.sum() - 25) / 25, rel=1e-10)


def wafer_pixels():
    """Correlations of three wafers of 4, 3 and 2 detectors."""
    cells = [np.array([(0, 0), (1, 0), (0, 1), (2, 2)]), np.array([(0, 0), (3, 0), (1, 1)]), np.array([(0, 0), (1, 0)])]
    coherence = PixelCoherence("intensity", GaussianIllumination(5.0))
    return WaferPixels(tuple(embed(Lattice(item, 0.8, SQUARE), 1.0, coherence) for item in cells))


def dense(pixels):
    """Matrix of the correlation of wafers."""
    return np.column_stack([pixels.at(0.0).times(column[:, None])[:, 0] for column in np.eye(9)])


def test_wafers_share_nothing_and_the_rest_is_theirs():
    pixels = wafer_pixels()
    matrix = dense(pixels)
    np.testing.assert_allclose(np.diag(matrix), 1, rtol=1e-12)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    assert not matrix[:4, 4:].any() and not matrix[4:7, 7:].any() and matrix[0, 1] > 0.2
    rng = np.random.default_rng(2)
    columns = rng.standard_normal((9, 4)) + 1j * rng.standard_normal((9, 4))
    np.testing.assert_allclose(pixels.at(0.0).times(columns), matrix @ columns, atol=1e-12)
    for rows in (np.array([1, 2, 5, 8]), np.array([4, 6]), slice(None)):
        (some,) = pixels.columns(rows)
        part = matrix[rows][:, rows]
        np.testing.assert_allclose(some.times(np.eye(len(part))), part, atol=1e-12)


def test_fields_of_wafers_have_their_correlation():
    """Over many fields; any part of them is the same alone."""
    pixels, n = wafer_pixels(), 40_000
    root = pixels.at(0.0).factor(0.7)
    found = np.concatenate([fields for _, fields in root.fields(n, deviates(3))], axis=1)
    expected = 0.7 * dense(pixels) + 0.3 * np.eye(9)
    for part in (found.real, found.imag):
        scatter = np.sqrt((1 + expected**2) / n)
        assert (np.abs(part @ part.T / n - expected) < 4.5 * scatter).all()
    assert np.abs(found.real @ found.imag.T / n).max() < 4.5 / np.sqrt(n)
    later = np.concatenate([fields for _, fields in root.fields(n - 1234, deviates(3), first=1234)], axis=1)
    np.testing.assert_allclose(later, found[:, 1234:], atol=1e-6)


def test_one_wafer_is_a_lattice():
    """Its fields have the same bits."""
    one = wafer_pixels().wafers[0].at(0.0).factor()
    assert isinstance(one, CirculantFactor)
    (alone,), (among,) = (list(root.fields(50, deviates(4))) for root in (one, WaferFactor((one,))))
    np.testing.assert_array_equal(alone[1], among[1])


def test_streams_of_wafers(path, few_are_many):
    """Photon noise of a scene with two wafers: covariance of all pairs, within the chance."""
    settings = NOISE_ONLY | FIELD | {"excess": None, "instrument.wafers": FAR, "scan.scans": 400}
    ready = prepare(load_scene(path, settings))
    assert isinstance(ready.camera.photon_correlation, WaferPixels) and ready.camera.n_det == 15
    data = draw_observation(ready, 0).data_mk.astype(float)
    overlap = correlation_matrices(ready.camera.positions_f_lambda, ready.camera.photon_coherence)[0]
    assert np.abs(overlap[:6, 6:]).max() < 0.02
    overlap[:6, 6:], overlap[6:, :6] = 0, 0
    expected = (2.0 * (0.2 * np.eye(15) + 0.8 * overlap) + np.eye(15)) * RATE / 2
    spread = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / data.shape[1])
    slack = 1.6 * RATE / 2 * LARGEST_ERROR
    assert (np.abs(data @ data.T / data.shape[1] - expected) < 4.5 * spread + slack).all()


def test_forecasts_of_wafers_are_those_of_matrices(path, few_are_many):
    settings = {"instrument.layout": None, "instrument.wafers": FAR, "atmosphere": None, "sky": None} | FIELD | ALONE
    settings |= {"cleaning.algorithm": "none", "score.mask_separation_f_lambda": 1.0}
    scene = load_scene(path, settings)
    many = forecast(prepare(scene))
    with pytest.MonkeyPatch.context() as patch:
        for module in DENSE:
            patch.setattr(module, "MOST_DENSE", 1000)
        prepare.cache_clear()
        survey_models.cache_clear()
        few = forecast(prepare(scene))
    assert many.scores.keys() == few.scores.keys()
    for name, item in few.scores.items():
        np.testing.assert_allclose(many.scores[name].noise_psd, item.noise_psd, rtol=0.01)


def test_wafers_close_to_each_other_are_refused(path, few_are_many):
    """Noise that they would share is neglected; it has a limit."""
    near = [WAFER | {"offset_x": f"{offset} arcmin"} for offset in (-1.5, 1.5)]
    settings = NOISE_ONLY | FIELD | {"excess": None, "instrument.wafers": near}
    with pytest.raises(
        SceneError, match=r"photon.coherence: found 'field' for more than 10 .* 0.02 or less is expected"
    ):
        prepare(load_scene(path, settings))
    assert prepare(load_scene(path, settings | {"photon.coherence": "none"})).camera.n_det == 14
