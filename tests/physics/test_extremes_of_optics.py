"""Cameras far from the paper's: dense and sparse pixels, one detector, thousands, loads that are all or none shared."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest

from surveysim import run, simulate_observation
from surveysim.forecasting.forecast import forecast
from surveysim.forecasting.mode_response import matrix_power, projected_array
from surveysim.reduction.setup import prepare
from surveysim.results.agreement import forecast_agreement
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.telescope.focal_plane import camera
from surveysim.telescope.layouts import hexagon
from surveysim.telescope.pixel_coherence import lattice_sum
from surveysim.timestreams.observed_block import observation_levels
from tests.pixels import correlation_matrix
from tests.scenes import SMALL_SCENE, without_sections

# A patch wide enough for few observations, in weather that keeps all scans.
WIDE = {
    "observations": 24,
    "scan.scans": 19,
    "scan.step": "2 arcmin",
    "scan.duration": "12 s",
    "map.pixel": "20 arcsec",
    "score.size": "36 arcmin",
    "score.ell_bin": 2000,
    "score.jackknives": 32,
    "score.signal_sims.observations": 8,
}
BRIGHT = {"atmosphere.b2": "[400, 900, 2000] mK2 rad(-5/3)"}
NO_AIR = (
    without_sections(SMALL_SCENE, "atmosphere", "sky")
    .replace('b2 = [46, 580]\nvariance = "[2.05, 4.52] mK2"', 'b2 = [100]\nvariance = "[3] mK2"')
    .replace('"average"', '"none"')
    .replace("mask_separation_f_lambda = 1.3\n", "")
    .replace("dead = [5]\n", "")
)
LOAD = """
[photon]
coherence = "field"
[photon.load]
sky = "40 K"
optics = "0 K"
"""
EFFICIENT = {"instrument.bandwidth": 0.15, "instrument.efficiency": 0.8, "instrument.polarizations": 1}


@pytest.fixture
def scene_of(tmp_path):
    def load(text: str, overrides=None):
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return load_scene(path, overrides or {})

    return load


def check_survey(scene, names=("actual", "uncorrelated", "white")):
    """Finite, and as forecast: within three errors of 24 observations, and 10 % of them for their own weights."""
    result = run(scene, engine=SERIAL)
    found = forecast_agreement(result)
    for name in names:
        score = result.scores[name]
        assert np.isfinite(score.noise_psds).all() and np.isfinite(score.band.sigma_ukcmb2)
        assert abs(found[name].sigma) < 0.1 + 3 * found[name].sigma_error, (name, found[name])
        assert found[name].sigma_error < 0.12


@pytest.mark.parametrize("pitch", [0.1, 10.0])
@pytest.mark.parametrize("coherence", ["field", "hbt"])
def test_pitch(scene_of, pitch, coherence):
    keys = WIDE | {"instrument.layout.pitch_f_lambda": pitch, "instrument.layout.rings": 1, "photon.bose_fraction": 0.7}
    keys |= {"photon.coherence": coherence, "excess.coherence": coherence.replace("hbt", "intensity")}
    check_survey(scene_of(NO_AIR, keys))


@pytest.mark.slow
def test_dense_pixels_under_the_atmosphere(scene_of):
    """37 pixels within half a beam: their average takes most of the sky as well."""
    keys = WIDE | BRIGHT | {"instrument.layout.pitch_f_lambda": 0.3, "instrument.layout.rings": 3}
    keys |= {"score.mask_separation_f_lambda": 0.6, "instrument.layout.dead": []}
    check_survey(scene_of(without_sections(SMALL_SCENE, "sky"), keys))


def test_one_detector(scene_of):
    keys = WIDE | {"instrument.layout.rings": 0}
    scene = scene_of(NO_AIR, keys)
    assert prepare(scene).camera.n_det == 1
    check_survey(scene)


def test_one_detector_has_no_average(scene_of):
    with pytest.raises(SceneError, match="cleaning.algorithm: found 1 detector; 'average' needs 2 or more"):
        forecast(
            prepare(
                scene_of(without_sections(SMALL_SCENE, "sky"), {"instrument.layout": {"rings": 0, "pitch_f_lambda": 1}})
            )
        )


@pytest.mark.parametrize("fraction", [0.0, 1.0])
@pytest.mark.parametrize("coherence", ["field", "hbt"])
def test_all_or_nothing_coherent(scene_of, fraction, coherence):
    keys = WIDE | {"photon.coherent_fraction": fraction, "photon.coherence": coherence, "photon.psd": "9 mK2/Hz"}
    keys |= {"photon.bose_fraction": 1.0}
    check_survey(scene_of(without_sections(NO_AIR, "excess"), keys))


def test_nothing_coherent_is_no_coherence(scene_of):
    """Two ways to say the same, in forecasts to the last digits."""
    none = forecast(prepare(scene_of(NO_AIR, {"photon.coherent_fraction": 0.0}))).scores["actual"].noise_psd
    other = forecast(prepare(scene_of(NO_AIR, {"photon.coherence": "none", "photon.coherent_fraction": 1.0})))
    np.testing.assert_allclose(other.scores["actual"].noise_psd, none, rtol=1e-9)


def test_nearly_singular_correlations(scene_of):
    """127 pixels within 1.2 (f/#)lambda share a few modes: most eigenvalues are rounding."""
    keys = {"instrument.layout.pitch_f_lambda": 0.1, "instrument.layout.rings": 6, "photon.coherent_fraction": 1.0}
    scene = scene_of(NO_AIR, WIDE | keys)
    values = np.linalg.eigvalsh(correlation_matrix(prepare(scene).camera.positions_f_lambda, "field"))
    assert np.sum(values > 1e-6 * values[-1]) < 60
    check_survey(scene)


# ---------------------------------------------------------------- ideal arrays


@pytest.mark.parametrize("pitch", [0.7, 1.0, 1.4])
def test_mean_of_an_ideal_array_has_the_lattice_s_noise(pitch):
    """All photon noise coherent as an intensity: 1 + lattice sum, less the neighbours that detectors at the edge lack.

    Of 1951 detectors a share of 6 r / n, r rings, lie at the edge and lack up to half of their neighbours; of the sum's
    longer tail, gamma^2 ~ s^-3, those beyond reach of the array lack: some 3 % of the sum in all.
    """
    place = hexagon(25, pitch)
    common = correlation_matrix(place, "intensity").sum() / len(place)
    expected = 1 + lattice_sum(pitch, "intensity")
    assert common < expected + 1e-9
    assert common == pytest.approx(expected, rel=0.05)


def test_forecast_of_the_common_mode_is_the_lattice_s(scene_of):
    """The same from the array response at a wave so long that the array sees no phase."""
    cam = camera(scene_of(NO_AIR, {"instrument.layout.rings": 12}).instrument, 0)
    array = projected_array(cam.focal_plane, 0.3, responsivity=np.ones(len(cam.focal_plane.x_rad)), algorithm="none")
    correlation = correlation_matrix(cam.positions_f_lambda, "intensity")
    response = array.response(np.array([1.0 + 0.5j]))
    ratio = matrix_power(response, correlation) / matrix_power(response, None)
    assert ratio[0] == pytest.approx(correlation.sum() / len(correlation), rel=1e-4)
    assert ratio[0] == pytest.approx(1 + lattice_sum(0.7, "intensity"), rel=0.08)  # of 469 detectors, 72 at the edge


def test_streams_of_an_ideal_load_have_the_lattice_s_common_mode(scene_of):
    """Variance of the array's mean over that of as many independent ones: 4 sqrt(2 / 20 000) of it is 4 %.

    Of the lattice sum, 217 detectors with 48 at the edge lack some 8 % more.
    """
    text = without_sections(NO_AIR, "excess", "photon", "detector", "score") + LOAD.replace("field", "hbt")
    keys = EFFICIENT | {
        "instrument.layout.rings": 8,
        "scan.scans": 50,
        "scan.duration": "40 s",
        "scan.speed": "0.1 arcmin/s",
    }
    scene = scene_of(text, keys | {"instrument.responsivity_scatter": 0, "scan.step": "0.1 arcmin"})
    data = simulate_observation(scene, 0).data_mk
    n_det = len(data)
    ratio = n_det * data.mean(axis=0).var() / data.var(axis=1).mean()
    correlation = prepare(scene).camera.photon_correlation.parts[0]
    shared = observation_levels(prepare(scene), 0).shared
    exact = 1 + shared * (correlation.sum() / n_det - 1)
    assert ratio == pytest.approx(exact, rel=0.04)
    assert ratio == pytest.approx(1 + shared * lattice_sum(0.7, "intensity"), rel=0.12)


# ---------------------------------------------------------------- layouts


@pytest.mark.parametrize("pitch", [0.5, 0.7, 1.0, 1.15, 1.4, 1.7, 2.0, 2.5])
def test_field_of_view_holds_its_area(scene_of, pitch):
    """8 arcmin has the area of 131 cells at 0.7 (f/#)lambda; pixels are the nearest to the centre, within a pitch."""
    keys = {"instrument.layout": {"field_of_view": "8 arcmin", "pitch_f_lambda": pitch}}
    plane = camera(scene_of(NO_AIR, keys).instrument, 0).focal_plane
    step, radius = pitch * 57.142857 / 60, 4.0
    assert len(plane.x_rad) == round(np.pi * radius**2 / (np.sqrt(0.75) * step**2))
    everything = np.sort(np.hypot(*hexagon(20, step).T))[: len(plane.x_rad)]
    found = np.sort(np.degrees(np.hypot(plane.x_rad, plane.y_rad)) * 60)
    np.testing.assert_allclose(found, everything, atol=1e-6)
    assert found.max() <= radius + step


def test_field_of_view_smaller_than_a_cell_is_one_detector(scene_of):
    keys = {"instrument.layout": {"field_of_view": "0.5 arcmin", "pitch_f_lambda": 0.7}}
    assert len(camera(scene_of(NO_AIR, keys).instrument, 0).focal_plane.x_rad) == 1


@pytest.mark.parametrize(
    "layout, message",
    [
        (
            {"rings": 2, "field_of_view": "8 arcmin", "pitch_f_lambda": 0.7},
            "exactly one of 'rings' and 'field_of_view'",
        ),
        ({"pitch_f_lambda": 0.7}, "exactly one of 'rings' and 'field_of_view'"),
        ({"field_of_view": "10 deg", "pitch_f_lambda": 0.7}, "instrument.layout.field_of_view: found .* rings"),
    ],
)
def test_layouts_that_are_refused(scene_of, layout, message):
    with pytest.raises(SceneError, match=message):
        prepare(scene_of(NO_AIR, {"instrument.layout": layout}))


def test_horns_fit_between_their_neighbours(scene_of):
    horns = {"instrument.layout.pitch_f_lambda": 2.0}
    assert prepare(scene_of(NO_AIR, horns | {"instrument.horn_f_lambda": 2.0})).camera.illumination.edge_taper_db > 8
    with pytest.raises(SceneError, match="instrument.horn_f_lambda: found 2.01; 2, the closest pair's distance"):
        prepare(scene_of(NO_AIR, horns | {"instrument.horn_f_lambda": 2.01}))
    with pytest.raises(SceneError, match="edge_taper: found together with 'horn_f_lambda'"):
        scene_of(NO_AIR, horns | {"instrument.horn_f_lambda": 1.0, "instrument.edge_taper": "3 dB"})


# ---------------------------------------------------------------- size

_BIG = """
    import resource
    from surveysim import simulate_observation
    from surveysim.forecasting.forecast import forecast
    from surveysim.reduction.setup import prepare
    from surveysim.scene.scene import load_scene
    scene = load_scene({path!r}, {keys!r})
    print(simulate_observation(scene, 0).data_mk.shape[0])
    print(forecast(prepare(scene)).scores["actual"].band.sigma_ukcmb2)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2)
"""


@pytest.mark.slow
def test_2000_detectors_fit_into_4_gigabytes(tmp_path):
    """25 rings, one observation simulated and the survey forecast: the peak of a fresh process."""
    path = tmp_path / "scene.toml"
    path.write_text(SMALL_SCENE)
    keys = {"instrument.layout.rings": 25, "scan.scans": 18, "scan.duration": "15 s", "score.size": "30 arcmin"}
    code = textwrap.dedent(_BIG.format(path=str(path), keys=keys))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    n_det, sigma, gigabytes = (float(line) for line in done.stdout.split())
    assert n_det == 1950
    assert 0 < sigma < np.inf
    assert gigabytes < 4
