"""Maps that are solved for, and iterative ones: the right equations, the same bits, nothing lost."""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker.binning import weighted_mean
from mapmaker.geometry import boresight_pixels
from mapmaker.normal_equations import add_normal, add_right_side
from surveysim import load_scene, run
from surveysim.reduction.cleaned_block import reduce_block
from surveysim.reduction.noise_weights import normal_blocks, weights_file
from surveysim.reduction.setup import prepare
from surveysim.results.control_variate import expected_variation, quoted_scores
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.runtime.errors import InputError, SceneError
from surveysim.survey.checkpoint import CheckpointError
from surveysim.survey.run import finished_sums, run_observations
from surveysim.survey.scores import score_survey
from surveysim.timestreams.observation import Stopwatch
from surveysim.timestreams.simulation import observation_path
from tests.scenes import write_scene

SOLVED = {
    "destriped": {"map.maker": "destriped", "map.destriped.baseline": "2 s"},
    "maximum_likelihood": {"map.maker": "maximum_likelihood", "map.maximum_likelihood.band_edges": "[0.5, 1.5] Hz"},
}
ITERATIVE = {"map.maker": "iterative", "sky.point_sources": [{"ra": "08h49m12s", "dec": "+44d50m24s", "peak": "1 K"}]}
BARE = {"score.mask_separation_f_lambda": None, "score.noise_only_sets": [], "score.jackknives": 2}
ARRAYS = ("sums", "weight", "flipped", "signal_maps", "signal_weight")


def scene(folder, settings, **more):
    return load_scene(write_scene(folder), {**BARE, **settings, **more})


def same(one, other):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.convergence == other.convergence
    return True


@pytest.fixture(scope="module", params=SOLVED)
def solved(request, tmp_path_factory):
    """A run by one map-maker: its setup, its checkpoint, and its co-adds."""
    folder = tmp_path_factory.mktemp(request.param)
    setup = prepare(scene(folder, SOLVED[request.param]))
    checkpoint = folder / "checkpoint.h5"
    return setup, checkpoint, run_observations(setup, checkpoint)


def dense(setup, directory):
    """Normal matrix and right-hand side from the streams of all observations, by matrices of one column each."""
    n_pixel = setup.analysis.geometry.n_y * setup.analysis.geometry.n_x
    matrix, right = np.zeros((n_pixel, n_pixel)), np.zeros(n_pixel)
    noise = np.concatenate([node.noise_mk2() for node in finished_sums(setup, directory / "checkpoint.h5")])
    weigh = setup.scene.map.maker == "destriped"
    for number in range(setup.scene.observations):
        weight = 1 / noise[number, 0] if weigh else 1.0
        _, pointing = observation_path(setup.observing, number)
        [block] = setup.observing.blocks
        part = reduce_block(setup, number, pointing, block, delays_s_rad=None, watch=Stopwatch())
        [normal] = normal_blocks(setup, number, weights_file(directory / "noise_weights", number))
        np.testing.assert_array_equal(normal.index, part.index[0])
        pixels = np.unique(normal.index[normal.index >= 0])
        projected = (normal.index == pixels[:, None, None]).astype(float)
        for data, column in ((part.cleaned[0].data_mk[None].astype(float), None), (projected, pixels)):
            weighed = normal.noise.apply(data, normal.index, normal.scan_bounds)
            inside = np.zeros(normal.index.shape, bool)
            for start, stop in normal.scan_bounds:
                inside[:, start:stop] = True
            inside &= normal.index >= 0
            back = np.array([np.bincount(normal.index[inside], row[inside], n_pixel) for row in weighed])
            if column is None:
                right += weight * back[0]
            else:
                matrix[:, column] += weight * back.T
    return matrix, right


def test_maps_solve_the_normal_equations_of_the_streams(solved):
    setup, checkpoint, coadds = solved
    matrix, right = dense(setup, checkpoint.parent)
    sky = weighted_mean(coadds.sums, coadds.weight)[0].ravel()
    assert all(item.converged for item in coadds.convergence) and len(coadds.convergence) == 2
    assert np.linalg.norm(matrix @ sky - right) < 2e-4 * np.linalg.norm(right)
    assert np.ptp(sky[coadds.weight[0].ravel() > 0]) > 0


def test_maximum_likelihood_maps_are_scored_less_a_plane(solved):
    """A gradient of the noise, or of what cleaning leaves of the sky, changes the scores of destriped maps alone."""
    setup, _, coadds = solved
    rows, columns = np.indices(setup.analysis.region.taper.shape)
    plane = 3.0 + 0.2 * rows - 0.1 * columns
    signal_maps = coadds.signal_maps.copy()
    signal_maps[:, :, 1] += 1e-3 * plane * coadds.signal_weight
    patch = setup.analysis.region.patch
    flipped = coadds.flipped + plane * coadds.weight[:, patch, patch]
    assert (coadds.weight[0, patch, patch] > 0).all() and (coadds.signal_weight > 0).all()
    tilted = score_survey(setup, replace(coadds, flipped=flipped, signal_maps=signal_maps))["actual"]
    plain = score_survey(setup, coadds)["actual"]
    same_noise = np.isclose(tilted.noise_psd, plain.noise_psd, rtol=1e-6)
    same_signal = np.isclose(tilted.transfer_function.transmission, plain.transfer_function.transmission, rtol=1e-6)
    expected = setup.scene.map.maker == "maximum_likelihood"
    assert same_noise.all() == same_signal.all() == expected


def test_few_observations_have_the_error_of_the_weather_that_a_forecast_expects(solved):
    setup, _, coadds = solved
    plain, quoted = score_survey(setup, coadds)["actual"], quoted_scores(setup, coadds)["actual"]
    assert coadds.done == 4 and np.isnan(plain.band.error_ukcmb2)
    assert quoted.budget.weather == pytest.approx(expected_variation(setup) / 2)
    assert 0.05 < quoted.budget.weather < 0.5
    assert quoted.band.error_ukcmb2 == pytest.approx(quoted.budget.total * plain.band.sigma_ukcmb2)
    assert quoted.band.sigma_ukcmb2 == plain.band.sigma_ukcmb2


@pytest.mark.slow
def test_bits_do_not_depend_on_workers_or_resumption(solved, tmp_path):
    setup, checkpoint, coadds = solved
    assert same(run_observations(setup, checkpoint, nodes=finished_sums(setup, checkpoint)), coadds)
    path = tmp_path / "checkpoint.h5"
    run_observations(setup, path, stops=lambda sums: sums.done == 2)
    assert len(list((tmp_path / "noise_weights").iterdir())) == 2
    found = run_observations(setup, path, Engine("processes", 2), nodes=finished_sums(setup, path))
    assert same(found, coadds)


@pytest.mark.slow
def test_bits_do_not_depend_on_a_cluster(solved):
    pytest.importorskip("distributed")
    setup, _, coadds = solved
    assert same(run_observations(setup, None, Engine("dask", 2)), coadds)


def test_a_solution_that_is_interrupted_goes_on_from_the_observations(tmp_path):
    made = scene(tmp_path, SOLVED["destriped"])

    def interrupt(name, iteration):
        if iteration == 2:
            raise KeyboardInterrupt

    setup, path = prepare(made), tmp_path / "checkpoint.h5"
    with pytest.raises(KeyboardInterrupt):
        run_observations(setup, path, solving=interrupt)
    nodes = finished_sums(setup, path)
    assert sum(node.done for node in nodes) == 4
    observed = []
    found = run_observations(setup, path, nodes=nodes, progress=observed.append)
    assert not observed and same(found, run_observations(setup, None))
    assert not list((tmp_path / "noise_weights").glob("skies*"))


def test_lost_or_foreign_noise_weights_are_refused(tmp_path):
    setup, path = prepare(scene(tmp_path, SOLVED["destriped"])), tmp_path / "checkpoint.h5"
    run_observations(setup, path)
    weights_file(tmp_path / "noise_weights", 1).write_bytes(b"no archive")
    with pytest.raises(CheckpointError, match="0001.npz: missing, or not the noise weights of observation 1"):
        finished_sums(setup, path)


def test_noise_only_sets_are_solved_with_the_same_weights(tmp_path):
    settings = {**SOLVED["destriped"], "observations": 2}
    alone = run_observations(prepare(scene(tmp_path, settings)), None)
    beside = scene(tmp_path, settings, **{"score.noise_only_sets": ["uncorrelated", "white"]})
    both = run_observations(prepare(beside), None)
    np.testing.assert_array_equal(both.sums[0], alone.sums[0])
    np.testing.assert_array_equal(both.hits[1:], alone.hits[[0, 0]])
    assert [item.name for item in both.convergence] == ["actual", "uncorrelated", "white", "signal simulations"]


@pytest.mark.parametrize("maker", [pytest.param("destriped", marks=pytest.mark.slow), "maximum_likelihood"])
def test_a_masked_array_has_a_map_of_its_own(maker, tmp_path):
    """Its equations have its detectors' streams and weights; those of the actual data are the same as without it."""
    settings = {**SOLVED[maker], "observations": 2, "score.signal_sims.observations": 2}
    masked = prepare(scene(tmp_path, settings, **{"score.mask_separation_f_lambda": 1.3}))
    _, data_set = masked.analysis.data_set_names
    found = run_observations(masked, tmp_path / "checkpoint.h5")
    alone = run_observations(prepare(scene(tmp_path, settings)), None)
    np.testing.assert_array_equal(found.sums[0], alone.sums[0])
    np.testing.assert_array_equal(found.signal_maps[:, 0], alone.signal_maps[:, 0])
    expected = ["actual", data_set, "signal simulations", f"signal simulations of {data_set}"]
    assert [item.name for item in found.convergence] == expected
    sky, noise = weighted_mean(found.sums, found.weight)[1].reshape(1, -1), found.noise_mk2()[:, 1]
    right, seen = np.zeros(sky.shape), np.zeros(sky.shape)
    for number, weight in enumerate(1 / noise if maker == "destriped" else (1.0, 1.0)):
        _, pointing = observation_path(masked.observing, number)
        [block] = masked.observing.blocks
        part = reduce_block(masked, number, pointing, block, delays_s_rad=None, watch=Stopwatch())
        [normal] = normal_blocks(masked, number, weights_file(tmp_path / "noise_weights", number), data_set)
        np.testing.assert_array_equal(normal.index, part.index[1])
        add_right_side(normal, weight * part.cleaned[1].data_mk.astype(float), right)
        add_normal(normal, weight * sky, seen)
    assert 1 < len(normal.index) < masked.camera.n_det
    assert np.linalg.norm(seen - right) < 2e-4 * np.linalg.norm(right)
    scores = score_survey(masked, found)
    assert scores[data_set].noise_psd[-1] > scores["actual"].noise_psd[-1]
    assert scores[data_set].transfer_function.transmission[-1] > 0.7


def test_unconverged_maps_are_flagged(tmp_path):
    settings = {**SOLVED["destriped"], "map.destriped.max_iterations": 1, "observations": 2}
    result = run(scene(tmp_path, settings), engine=SERIAL)
    assert any("actual: the destriped map has not converged after 1 iterations" in line for line in result.warnings)


def test_iterative_maps_restore_bright_sources(tmp_path):
    """Cleaning takes a part of a source that is far brighter than the atmosphere; passes bring it back."""
    binned = prepare(scene(tmp_path, {**ITERATIVE, "map.maker": "binned"}))
    setup, path = prepare(scene(tmp_path, ITERATIVE)), tmp_path / "checkpoint.h5"
    plain, found = run_observations(binned, None), run_observations(setup, path)
    peaks = [weighted_mean(item.sums, item.weight)[0].max() for item in (plain, found)]
    assert found.convergence[0].iterations > 1 and peaks[1] > 1.05 * peaks[0]
    again = run_observations(setup, path, nodes=finished_sums(setup, path), resume=True)
    assert same(again, found)


def test_passes_that_are_interrupted_go_on(tmp_path):
    setup, path = prepare(scene(tmp_path, ITERATIVE)), tmp_path / "checkpoint.h5"
    whole, seen = run_observations(setup, None), []

    def stop(sums):
        seen.append(sums.done)
        if len(seen) == 6:  # the second observation of the second pass
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_observations(setup, path, progress=stop)
    nodes, later = finished_sums(setup, path), []
    assert sum(node.done for node in nodes) == 2
    found = run_observations(setup, path, nodes=nodes, resume=True, progress=lambda sums: later.append(sums.done))
    assert later[0] == 3 and same(found, whole)


def test_streams_less_the_bright_sky(tmp_path):
    """What is cleaned differs from the streams by the sky at the pixel of each sample."""
    setup = prepare(scene(tmp_path, ITERATIVE))
    geometry, rng = setup.analysis.geometry, np.random.default_rng(1)
    sky = rng.normal(size=(geometry.n_y, geometry.n_x))
    _, pointing = observation_path(setup.observing, 0)
    [block] = setup.observing.blocks
    plain, less = (
        reduce_block(item, 0, pointing, block, delays_s_rad=None, watch=Stopwatch())
        for item in (setup, replace(setup, bright_sky_mk=sky))
    )
    index = boresight_pixels(
        geometry, pointing.xi_rad, pointing.eta_rad, pointing.array_angle_rad, plane=setup.camera.focal_plane
    )
    np.testing.assert_allclose(plain.data_mk - less.data_mk, sky.ravel()[index], atol=1e-2)


@pytest.mark.parametrize(
    "settings, line",
    [
        ({"map.maker": "stacked"}, "map.maker"),
        ({"map.maker": "destriped"}, "map.destriped: missing"),
        ({**SOLVED["destriped"], "map.destriped.baseline": "1 ms"}, "map.destriped.baseline: found 0.001 s"),
        ({"map.maker": "maximum_likelihood", "map.maximum_likelihood.band_edges": "[2, 1] Hz"}, "band_edges: found"),
        ({"map.maker": "maximum_likelihood", "map.maximum_likelihood.band_edges": "[0.01] Hz"}, "fewer than 2 modes"),
        ({**SOLVED["destriped"], "cleaning.compare": ["planar"]}, "cleaning.compare: found pipelines with map.maker"),
        ({"map.maker": "iterative", "score.mask_separation_f_lambda": 1.3}, "score.mask_separation_f_lambda: found"),
    ],
)
def test_refusals(tmp_path, settings, line):
    with pytest.raises(SceneError, match=line):
        prepare(scene(tmp_path, settings))


def test_limits_of_unfinished_maps_are_refused(tmp_path):
    with pytest.raises(SceneError, match="map.maker: found 'destriped' with a target error"):
        run(scene(tmp_path, SOLVED["destriped"]), engine=SERIAL, target_error=0.1)
    with pytest.raises(InputError, match="map.maker: found 'iterative' with a limit"):
        run(scene(tmp_path, ITERATIVE), engine=SERIAL, time_budget_s=60.0)


def test_convergence_studies_note_makers_without_a_score_on_the_way(tmp_path):
    from surveysim.studies.convergence.runs import Task, run_task

    found = run_task(Task(scene(tmp_path, SOLVED["destriped"]), (4,)))
    assert "map.maker: found 'destriped'" in found.note
