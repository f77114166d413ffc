"""Beams over the stop in a scene: names, the keys that they need, tables and their errors."""

import pytest

from surveysim.output.scene_copy import scene_files
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.illumination_table import read_illumination
from surveysim.scene.scene import load_scene
from surveysim.telescope.focal_plane import illumination, total_efficiency
from surveysim.telescope.illumination import (
    UNIFORM,
    GaussianIllumination,
    He11Illumination,
    TableIllumination,
    gaussian_horn,
)
from tests.scenes import write_scene

HEADER = """# %ECSV 1.0
# ---
# datatype:
# - {name: rho, datatype: float64}
# - {name: NAME, datatype: float64}
rho NAME
"""


def write(folder, rows, name="intensity"):
    path = folder / "beam.ecsv"
    path.write_text(HEADER.replace("NAME", name) + rows)
    return path


@pytest.mark.parametrize(
    "keys, beam",
    [
        ({}, UNIFORM),
        ({"illumination": "uniform"}, UNIFORM),
        ({"edge_taper": "3 dB"}, GaussianIllumination(3.0)),
        ({"illumination": "gaussian", "edge_taper": "3 dB"}, GaussianIllumination(3.0)),
        ({"horn_f_lambda": 0.7}, gaussian_horn(0.7)),
        ({"illumination": "gaussian", "horn_f_lambda": 0.7}, gaussian_horn(0.7)),
        ({"illumination": "he11", "horn_f_lambda": 0.7}, He11Illumination(0.7)),
    ],
)
def test_beams_of_a_scene(tmp_path, keys, beam):
    settings = {f"instrument.{key}": value for key, value in keys.items()} | {"instrument.efficiency": 0.5}
    instrument = load_scene(write_scene(tmp_path), settings).instrument
    assert illumination(instrument) == beam
    assert total_efficiency(instrument) == pytest.approx(0.5 * beam.efficiency, rel=1e-12)


@pytest.mark.parametrize("name, power", [("intensity", 1), ("amplitude", 2)])
def test_a_table_of_the_beam(tmp_path, name, power):
    write(tmp_path, "0 1\n0.5 0.8\n1.0 0.4\n1.6 0.0\n", name)
    scene = load_scene(write_scene(tmp_path), {"instrument.illumination": "beam.ecsv"})
    beam = prepare(scene).camera.illumination
    assert beam == TableIllumination((0.0, 0.5, 1.0, 1.6), (1.0, 0.8, 0.4, 0.0), power)
    assert 0.5 < beam.efficiency < 1
    assert any(file.endswith(".ecsv") for file in scene_files(scene))


@pytest.mark.parametrize(
    "keys, words",
    [
        ({"illumination": "airy"}, "illumination: found 'airy'; the name of an ECSV file, or one of uniform, gaussian"),
        ({"illumination": "gaussian"}, "horn_f_lambda or edge_taper: missing; the illumination 'gaussian' needs it"),
        ({"illumination": "he11"}, "horn_f_lambda: missing; the illumination 'he11' needs it"),
        ({"illumination": "he11", "edge_taper": "3 dB"}, "horn_f_lambda: missing; the illumination 'he11' needs it"),
        ({"illumination": "uniform", "horn_f_lambda": 0.7}, "horn_f_lambda: found together with the illumination"),
        ({"edge_taper": "3 dB", "horn_f_lambda": 0.7}, "edge_taper: found together with 'horn_f_lambda'"),
        ({"illumination": "no.ecsv"}, "no.ecsv: no such file in the folder of the scene; a table of rho and intensity"),
    ],
)
def test_keys_of_a_beam(tmp_path, keys, words):
    with pytest.raises(SceneError, match=words) as error:
        load_scene(write_scene(tmp_path), {f"instrument.{key}": value for key, value in keys.items()})
    assert "\n" not in str(error.value)


def test_a_table_has_no_horn(tmp_path):
    write(tmp_path, "0 1\n1 1\n")
    settings = {"instrument.illumination": "beam.ecsv", "instrument.horn_f_lambda": 0.7}
    with pytest.raises(SceneError, match="horn_f_lambda: found together with the illumination 'beam.ecsv', which has"):
        load_scene(write_scene(tmp_path), settings)


@pytest.mark.parametrize(
    "rows, name, words",
    [
        ("0 1\n", "intensity", "found 1 rows, and two or more are needed"),
        ("0 1\n1 1\n", "power", "found the columns 'rho, power'"),
        ("0.1 1\n1 1\n", "intensity", "row 1, column 'rho': found 0.1, and 0 in the first row, then more than"),
        ("0 1\n1 1\n1 1\n", "intensity", "row 3, column 'rho': found 1, and 0 in the first row, then more than"),
        ("0 1\n0.9 1\n", "intensity", "column 'rho': found values up to 0.9, and the edge of the stop is 1"),
        ("0 1\n1 -1\n", "amplitude", "row 2, column 'amplitude': found -1, and 0 to 1e6 is allowed"),
        ("0 1\nnan 1\n", "intensity", "row 2, column 'rho': found nan, and 0 to 1000 is allowed"),
        ("0 0\n1 1\n", "intensity", "column 'intensity': found 0 in all rows within the stop"),
    ],
)
def test_errors_of_a_table(tmp_path, rows, name, words):
    path = write(tmp_path, rows, name)
    with pytest.raises(ValueError, match=words) as error:
        read_illumination(path)
    assert str(error.value).startswith(f"instrument.illumination: {path}: ") and "\n" not in str(error.value)


def test_a_stop_that_no_beam_reaches(tmp_path):
    settings = {"photon.coherence": "hbt", "photon.bose_fraction": 0.5, "photon.stop_fraction": 0.2}
    with pytest.raises(SceneError, match="photon.stop_fraction: found 0.2 with a beam that does not spill on the stop"):
        prepare(load_scene(write_scene(tmp_path), settings))
    assert prepare(load_scene(write_scene(tmp_path), settings | {"instrument.edge_taper": "3 dB"}))


@pytest.mark.parametrize(
    "keys, words",
    [
        (
            {"coherence": "intensity"},
            "found 'intensity'; photon noise with this correlation is 'hbt' now",
        ),
        ({"coherence": "field", "stop_fraction": 0.1}, "stop_fraction: found without coherence 'hbt'"),
        (
            {"coherence": "hbt", "bose_fraction": 0.5, "stop_fraction": 0.95},
            "stop_fraction: found 0.95 with a coherent_fraction of 0.1; 1 or less is expected of their sum",
        ),
    ],
)
def test_keys_of_photon_noise(tmp_path, keys, words):
    with pytest.raises(SceneError, match=words):
        load_scene(write_scene(tmp_path), {f"photon.{key}": value for key, value in keys.items()})
