"""Pipelines of a scene: their data sets, their transfer functions, what they need, and how wrong ones are refused."""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker.binning import read_fits
from surveysim import run
from surveysim.reduction import consistency as checks
from surveysim.reduction import setup as ready
from surveysim.reduction.cleaning_pipelines import needed_detectors
from surveysim.reduction.figure_of_merit import best_places
from surveysim.reduction.resource_limits import needed_memory
from surveysim.reduction.setup import prepare
from surveysim.results.summary import best_pipeline
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.survey.rows import row_names
from tests.scenes import write_scene

FILTERS = {
    "cleaning.highpass_frequency": "0.3 Hz",
    "cleaning.highpass_order": 2,
    "cleaning.notch_frequencies": "[2.1] Hz",
    "cleaning.notch_widths": "[0] Hz",
    "cleaning.time_order": 2,
}
COMPARE = {"cleaning.compare": ["planar", ["average", "local"], "wind"], "cleaning.neighbour_radius": 1.2}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def compared(path, tmp_path_factory, blank_figures):
    out = tmp_path_factory.mktemp("compared")
    return run(load_scene(path, COMPARE), out, engine=SERIAL, figures=True), out


def test_data_sets_and_transfer_functions(path):
    setup = prepare(load_scene(path, COMPARE))
    assert [pipeline.label for pipeline in setup.analysis.pipelines] == [
        "average",
        "planar",
        "average+local",
        "wind",
        "average",
    ]
    masked = f"masked_{len(setup.analysis.masked)}"
    sets = ("actual", "uncorrelated", "white", "planar", "average+local", "wind", "optimal", masked)
    assert setup.analysis.data_set_names == sets
    kinds = ["actual", "noise-only", "noise-only", "alternative", "alternative", "alternative", "optimal", "masked"]
    assert [item.kind for item in setup.analysis.data_sets] == kinds
    n_det = setup.camera.n_det
    assert [item.n_det for item in setup.analysis.data_sets] == [n_det] * 7 + [len(setup.analysis.masked)]
    assert setup.analysis.transfer_function_names == ("actual", "planar", "average+local", "wind", "optimal", masked)
    assert [setup.analysis.transfer_function_index(name) for name in sets] == [0, 0, 0, 1, 2, 3, 4, 5]


def test_one_pipeline_is_no_choice(path):
    setup = prepare(load_scene(path))
    assert not setup.analysis.chooses and "optimal" not in setup.analysis.data_set_names
    # The scene's own sky is the third, and there is no sky of point sources.
    assert len(setup.analysis.signal_skies_mk) == 3 and setup.analysis.own_sky == 2


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"cleaning.algorithm": "pca"}, "cleaning.sigma_cut: missing; 'pca' needs it"),
        ({"cleaning.algorithm": ["average", "local"]}, "cleaning.neighbour_radius: missing; 'local' needs it"),
        ({"cleaning.compare": ["polynomial"], "cleaning.order": 2}, "cleaning.regions: missing; 'polynomial' needs it"),
        (
            {"cleaning.algorithm": "pca", "cleaning.pca_criterion": "modes"},
            "cleaning.pca_modes: missing; pca_criterion 'modes' needs it",
        ),
        (
            {"cleaning.algorithm": "pca", "cleaning.pca_criterion": "variance"},
            "cleaning.pca_variance: missing; pca_criterion 'variance' needs it",
        ),
        ({"cleaning.pca_criterion": "marchenko_pastur"}, "found 'marchenko_pastur' without 'pca'; that algorithm is"),
        ({"cleaning.compare": ["highpass"]}, "cleaning.highpass_frequency: missing; 'highpass' needs it"),
        ({"cleaning.algorithm": ["average", "notch"]}, "cleaning.notch_frequencies: missing; 'notch' needs it"),
        ({"cleaning.compare": ["time_polynomial"]}, "cleaning.time_order: missing; 'time_polynomial' needs it"),
        (
            {
                "cleaning.compare": ["notch"],
                "cleaning.notch_frequencies": "[1, 2] Hz",
                "cleaning.notch_widths": "[0] Hz",
            },
            "cleaning.notch_widths: found 1 values; 2, one for each of notch_frequencies, are expected",
        ),
        (
            {
                "cleaning.compare": ["notch"],
                "cleaning.notch_frequencies": "[4.9] Hz",
                "cleaning.notch_widths": "[1] Hz",
            },
            "cleaning.notch_frequencies: found a band from 4.4 to 5.4 Hz; one from 0 to 5 Hz, half of",
        ),
        (
            {"cleaning.compare": ["notch"], "cleaning.notch_frequencies": "[2] Hz", "cleaning.notch_widths": "[3] Hz"},
            "cleaning.notch_widths: found 3 Hz in 1 bands; 2.17 Hz or less in all is expected for scans of 60 samples",
        ),
        (
            {"cleaning.compare": ["highpass"], "cleaning.highpass_frequency": "0.08 Hz"},
            "found 0.08 Hz; from 0.0833333 Hz, half a cycle in scan.duration, to less than 5 Hz, half of",
        ),
        (
            {"cleaning.compare": ["time_polynomial"], "cleaning.time_order": 20, "scan.duration": "1.5 s"},
            "cleaning.time_order: found 20 with scans of 15 samples; 13 or less is expected",
        ),
        ({"cleaning.compare": ["average"]}, "cleaning.compare: found 'average' more than once"),
        ({"cleaning.compare": ["median"]}, "cleaning.compare.0: found 'median'; one of 'none', 'average'"),
        ({"cleaning.compare": [[]]}, "cleaning.compare.0: found []; one of"),
        ({"cleaning.algorithm": 3}, "cleaning.algorithm: found 3; one of"),
        ({"cleaning.algorithm": ["average", 3]}, "cleaning.algorithm: found 3; one of"),
        (
            {"cleaning.compare": ["polynomial"], "cleaning.order": 5, "cleaning.regions": 1},
            "cleaning.compare: found 18 detectors; 'polynomial' needs 22 or more",
        ),
    ],
)
def test_refused(path, changes, words):
    with pytest.raises(SceneError) as caught:
        prepare(load_scene(path, changes))
    assert words in str(caught.value)


def test_a_pipeline_that_discards_everything_never_wins(path):
    """Local templates leave nothing to calibrate on: the average after them keeps no scan, and no transfer function."""
    scene = load_scene(path, {"cleaning.compare": [["local", "average"]], "cleaning.neighbour_radius": 1.2})
    result = run(scene, engine=SERIAL)
    columns = dict(zip(row_names(result.setup.analysis), np.array(result.coadds.rows).T, strict=True))
    assert columns["discarded_local+average"].sum() == 16
    assert (best_pipeline(result.setup, columns, "cmb") == 0).all()
    np.testing.assert_array_equal(columns["noise_mk2_optimal"], columns["noise_mk2_actual"])


def test_wind_needs_scans_that_tell_it(path):
    with pytest.raises(SceneError, match="cleaning.compare: found 'wind' with scans of 2 s at 10 Hz; 4 s or more"):
        prepare(load_scene(path, {"cleaning.compare": ["wind"], "scan.duration": "2 s"}))


def test_pca_of_too_many_is_refused(path, monkeypatch):
    pca = {"cleaning.algorithm": "pca", "cleaning.sigma_cut": 3.0, "score.mask_separation_f_lambda": None}
    pca |= {"instrument.layout.rings": 4}
    monkeypatch.setattr(checks, "MAX_MODES", 59)
    with pytest.raises(SceneError, match="found 'pca' with 60 detectors and scans of 60 samples; 59 or fewer of one"):
        prepare(load_scene(path, pca))
    # Few samples of many detectors are few eigenvalues too.
    prepare(load_scene(path, pca | {"scan.duration": "5.9 s"}))


@pytest.mark.parametrize(("compared", "most"), [([], 0), (["pca"], 32.0 * 5000**2)])
def test_pca_needs_memory_for_its_matrices(path, compared, most):
    setup = prepare(load_scene(path, {"cleaning.compare": compared, "cleaning.sigma_cut": 3.0}))
    sizes = replace(ready._sizes(setup, 0), n_det=5000, n_samp=6000)
    assert needed_memory(setup.scene, sizes)["cleaning.algorithm"] == most


def test_detectors_that_steps_need(path):
    section = load_scene(path, {"cleaning.order": 3, "cleaning.regions": 2, "cleaning.sigma_cut": 3.0}).cleaning
    needed = [needed_detectors(section, name) for name in ("none", "average", "quadratic", "polynomial", "pca")]
    assert needed == [1, 2, 7, 22, 11]
    filters = load_scene(path, FILTERS).cleaning
    assert [needed_detectors(filters, name) for name in ("highpass", "notch", "time_polynomial")] == [1, 1, 1]


def test_filters_are_compared_and_their_signal_passes(path):
    """Each pipeline has its scores and transfer function; a scan's fit begins with what filtered streams gave."""
    steps = [["highpass", "average"], ["average", "notch"], ["time_polynomial", "notch", "average"]]
    result = run(load_scene(path, FILTERS | {"cleaning.compare": steps}), engine=SERIAL)
    assert {"highpass+average", "average+notch", "time_polynomial+notch+average"} <= set(result.scores)
    columns = dict(zip(row_names(result.setup.analysis), np.array(result.coadds.rows).T, strict=True))
    # Cosines of 6 s below 0.3 Hz, one line, two powers, and one template.
    found = [columns[f"removed_{'+'.join(names)}"].max() for names in steps]
    assert found == [3 + 1, 1 + 2, 2 + 2 + 1]
    selected = result.setup.analysis.region.selected
    passed = [result.scores[name].transfer_function.transmission[selected] for name in ("actual", "highpass+average")]
    assert (passed[1] < passed[0]).all() and (passed[1] > 0.1).all()


def test_filters_leave_the_actual_data_alone(path):
    """Bits of a data set do not depend on the pipelines that it is compared with."""
    alone = run(load_scene(path, {"observations": 2}), engine=SERIAL)
    beside = run(load_scene(path, FILTERS | {"observations": 2, "cleaning.compare": ["highpass"]}), engine=SERIAL)
    np.testing.assert_array_equal(alone.coadds.sums[0], beside.coadds.sums[0])


def test_comparing_changes_nothing_of_the_actual_data(path, compared, tmp_path):
    run(load_scene(path), tmp_path, engine=SERIAL, figures=False)
    for name in ("actual", "white"):
        alone, auxiliary = (read_fits(folder / "maps" / f"{name}.fits") for folder in (tmp_path, compared[1]))
        np.testing.assert_array_equal(alone.weighted_sum, auxiliary.weighted_sum)
        np.testing.assert_array_equal(alone.weight, auxiliary.weight)


def test_what_a_comparison_leaves_behind(compared):
    result, out = compared
    sets = result.setup.analysis.data_set_names
    skies = {f"sky_{name}" for name in result.setup.analysis.transfer_function_names}
    assert {path.stem for path in (out / "maps").iterdir()} == {*sets, *skies}
    assert set(sets) == set(result.scores)
    assert (out / "figures" / "transfer_function.png").exists()
    columns = dict(zip(row_names(result.setup.analysis), np.array(result.coadds.rows).T, strict=True))
    # Templates a scan: of the pipelines' own kind.
    assert [columns[f"removed_{name}"].mean() for name in ("actual", "planar", "average+local")] == [1, 3, 2]
    best = best_pipeline(result.setup, columns, "cmb")
    assert best.shape == (4,) and set(best) <= {0, 1, 2, 3}


def test_the_optimal_map_is_each_observation_s_best(compared):
    """Rebuilt from the co-adds' own rows: its noise is that of the best pipeline in every observation."""
    result, _ = compared
    columns = dict(zip(row_names(result.setup.analysis), np.array(result.coadds.rows).T, strict=True))
    best = best_pipeline(result.setup, columns, "cmb")
    noise = np.array([columns[f"noise_mk2_{pipeline.data_set}"] for pipeline in result.setup.analysis.whole_pipelines])
    np.testing.assert_array_equal(columns["noise_mk2_optimal"], noise[best, np.arange(4)])


def test_flux_at_the_peak_of_a_source(compared):
    """A template of n detectors takes the beam that they see at once, 2.94 / n at 0.7 (f/#)lambda; a scan its mean.

    Both of peaks that are averaged down to 0.8, to 0.9; sources near the edges of an array are seen by fewer.
    """
    removed = compared[0].flux_removed
    assert removed["actual"] < removed["planar"] and removed["actual"] == pytest.approx(removed["wind"], abs=0.05)
    mean_of_scan = 1.06 / 24  # a beam of 1 arcmin in a scan of 24
    assert removed["actual"] == pytest.approx((2.94 / 18 + mean_of_scan) / 0.9, rel=0.35)


def test_the_best_of_merits():
    figures_of_merit = np.array([[1.0, np.nan, 0.0, np.nan], [2.0, 1.0, 0.0, np.nan], [np.nan, 3.0, 0.0, np.nan]])
    assert best_places(figures_of_merit).tolist() == [1, 2, -1, -1]
