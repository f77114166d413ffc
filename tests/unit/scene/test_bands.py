"""Tables [bands.NAME]: merging, and refusals that name the key as the file gives it."""

import pickle
import tomllib

import pytest

from surveysim.api.bands import checked_bands
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.bands import bands_hash, common_key, load_bands
from surveysim.scene.scene import load_scene, scene_hash, survey_hash
from tests.cameras import TWO_BANDS, write_camera
from tests.scenes import SCHEDULE, write_scene


def refusal(path, overrides=None):
    """Lines of a refusal, less the path."""
    with pytest.raises(SceneError) as caught:
        load_bands(path, overrides)
    lines = str(caught.value).splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    return [line.removeprefix(f"{path}: ") for line in lines]


def test_a_band_has_the_keys_of_the_scene_and_its_own(tmp_path):
    scenes = load_bands(write_camera(tmp_path))
    wide, narrow = scenes.bands.values()
    assert list(scenes.bands) == ["150", "220"] and scenes.name == "two"
    assert (wide.name, narrow.name) == ("two_150", "two_220")
    assert wide.title == "A small camera over a small field: 150"
    assert (wide.instrument.frequency_hz, narrow.instrument.frequency_hz) == (150e9, 220e9)
    assert wide.instrument.bandwidth == narrow.instrument.bandwidth == 0.15
    assert (wide.instrument.layout.rings, narrow.instrument.layout.rings) == (2, 1)
    assert (wide.detector.psd_mk2_hz, narrow.detector.psd_mk2_hz) == (2.5, 4)
    assert wide.photon == narrow.photon and wide.field == narrow.field
    assert [item.band_name for item in wide.others] == ["220"] and wide.others[0].others == ()
    assert pickle.loads(pickle.dumps(wide)) == wide


def test_overrides_of_one_band_and_of_all(tmp_path):
    path = write_camera(tmp_path)
    changed = load_bands(path, {"bands.150.detector.psd": "9 mK2 / Hz", "photon.psd": "1 mK2 / Hz"}).bands
    assert [item.detector.psd_mk2_hz for item in changed.values()] == [9, 4]
    assert [item.photon.psd_mk2_hz for item in changed.values()] == [1, 1]


def test_assumed_values_are_those_of_the_band(tmp_path):
    text = TWO_BANDS.replace('psd = "2.5 mK2 / Hz"\n', 'psd = "2.5 mK2 / Hz"  # assumed: as others\n')
    text = text.replace('psd = "4 mK2 / Hz"', 'psd = "4 mK2 / Hz"  # assumed: more')
    wide, narrow = load_bands(write_camera(tmp_path, text)).bands.values()
    site = "atmosphere.water_fluctuation"
    psd = [[line for line in item.assumed if not line.startswith(site)] for item in (wide, narrow)]
    common = 'photon.psd = "2.5 mK2 / Hz": assumed: as others'
    assert psd[0] == [common, 'detector.psd = "2.5 mK2 / Hz": assumed: as others']
    assert psd[1] == [common, 'detector.psd = "4 mK2 / Hz": assumed: more']


@pytest.mark.parametrize(
    "overrides, lines",
    [
        ({"bands.150.seed": 3}, ["bands.150.seed: the same in all bands; outside [bands.150] it is expected"]),
        ({"bands.220.scan.speed": 3}, ["bands.220.scan: the same in all bands; outside [bands.220] it is expected"]),
        (
            {"bands.150.instrument.camera_rotation_range": "3 deg"},
            ["bands.150.instrument.camera_rotation_range: the same in all bands; outside [bands.150] it is expected"],
        ),
        (
            {"bands.150.atmosphere.layer_height": "1 km", "bands.220.map.pixel": "1 arcsec"},
            [
                "bands.150.atmosphere: the same in all bands; outside [bands.150] it is expected",
                "bands.220.map: the same in all bands; outside [bands.220] it is expected",
            ],
        ),
        (
            {"bands.150.instrument.frequency": "3 m"},
            ["bands.150.instrument.frequency: found '3 m'; a quantity in units like 'GHz' is expected"],
        ),
        # Given for all bands, and replaced in one.
        (
            {"instrument.beam_fwhm": "3 GHz"},
            ["instrument.beam_fwhm: found '3 GHz'; a quantity in units like 'arcsec' is expected"],
        ),
        ({"detector.psdd": 3}, ["detector.psdd: unknown key; did you mean detector.psd?"]),
        ({"bands.150.photo.psd": 1}, ["bands.150.photo: unknown key; did you mean photon?"]),
        ({"bands.150.instrument.frequency": None}, None),
        ({"bands.x-y.detector.psd": 3}, ["bands.x-y: a name of up to 20 ASCII letters, digits and '_' is expected"]),
        ({"bands.90.detector.psd": "3 mK2 / Hz"}, ["bands.90: unknown band; allowed are 150, 220"]),
        ({"bands.220": 3}, ["bands.220: found 3; a table of sections is expected"]),
        ({"bands": {}}, ["bands: found {}; tables [bands.NAME] are expected"]),
        ({"instrument.bands": []}, ["instrument.bands is now bands.NAME"]),
        (
            {"atmosphere.b2": "[1, 2] mK2 rad(-5/3)", "atmosphere.b2_probabilities": [0.1, 0.9]},
            [
                "atmosphere.b2: found for all bands; it is expected in each [bands.NAME.atmosphere], as B2 differs"
                " between bands, or left out with a site that it follows from"
            ],
        ),
        (
            {"atmosphere.wind_b2_exponent": 0.3},
            [
                "atmosphere.wind_b2_exponent: found 0.3 with [bands]; 0 is expected, as B2 differs between bands that"
                " see one wind"
            ],
        ),
    ],
)
def test_refused(tmp_path, overrides, lines):
    found = refusal(write_camera(tmp_path), overrides)
    if lines is None:  # a key that one band lacks
        assert len(found) == 1 and found[0].startswith(
            "bands.150.instrument: exactly one of 'frequency' and 'passband'"
        )
    else:
        assert found == lines


def test_a_table_of_weather_has_fluctuations_of_water(tmp_path):
    header = "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: time, datatype: float64}\n"
    (tmp_path / "w.ecsv").write_text(
        f"{header}# - {{name: b2, unit: mK2 rad(-5/3), datatype: float64}}\ntime b2\n53000 1\n54000 1\n"
    )
    dates = {f"schedule.{key}": value for key, value in tomllib.loads(SCHEDULE)["schedule"].items()}
    keys = dates | {"fixed_pointing": None, "atmosphere.weather_table": "w.ecsv"}
    found = refusal(write_camera(tmp_path), keys)
    assert found == [
        "atmosphere.weather_table: found a column b2 with [bands]; water_fluctuation is expected, as B2 differs between"
        " bands"
    ]


def test_values_of_b2_of_each_band(tmp_path):
    text = TWO_BANDS
    for name, b2 in (("150", 100), ("220", 400)):
        text += f'\n[bands.{name}.atmosphere]\nb2 = "[{b2}] mK2 rad(-5/3)"\nb2_probabilities = [0.5]\n'
    scenes = load_bands(write_camera(tmp_path, text)).bands
    assert [item.atmosphere.b2 for item in scenes.values()] == [(100,), (400,)]


def test_common_keys():
    assert common_key("atmosphere.layer_height") == "atmosphere" and common_key("atmosphere.b2") == ""
    assert common_key("seed") == "seed" and common_key("instrument.camera_rotation_range") != ""
    assert common_key("instrument.beam_fwhm") == "" and common_key("maps") == ""


def test_a_scene_of_one_band_is_expected_elsewhere(tmp_path):
    path = write_camera(tmp_path)
    with pytest.raises(
        SceneError, match=r"two.toml: bands: found a camera of several bands; a scene without \[bands\]"
    ):
        load_scene(path)
    for hidden in ("band", "assumed"):
        with pytest.raises(SceneError, match=f"small.toml: {hidden}: unknown key"):
            load_scene(write_scene(tmp_path), {hidden: "150"})


def test_hashes_count_what_the_results_of_a_band_depend_on(tmp_path):
    """The layer depends on where the detectors of all bands are; subtracting bands on all of their noise."""
    path = write_camera(tmp_path)

    def hashes(**overrides):
        return {name: scene_hash(scene) for name, scene in load_bands(path, overrides).bands.items()}

    own = hashes()
    noise = hashes(**{"bands.220.detector.psd": "5 mK2 / Hz"})
    pitch = hashes(**{"bands.220.instrument.layout.pitch_f_lambda": 0.8})
    assert noise["150"] == own["150"] and noise["220"] != own["220"]
    assert pitch["150"] != own["150"] and pitch["220"] != own["220"]
    spectral = {"cleaning.algorithm": ["average", "spectral"]}
    assert hashes(**spectral)["150"] != hashes(**spectral, **{"bands.220.detector.psd": "5 mK2 / Hz"})["150"]
    assert bands_hash(load_bands(path)) != bands_hash(load_bands(path, {"bands.220.detector.psd": "5 mK2 / Hz"}))
    few, many = (load_bands(path, {"observations": n}).bands["150"] for n in (4, 8))
    assert scene_hash(few) != scene_hash(many) and survey_hash(few) == survey_hash(many)


def test_spectral_cleaning_needs_bands_at_the_same_positions(tmp_path):
    path = write_camera(tmp_path)
    spectral = {"cleaning.algorithm": ["average", "spectral"]}
    expected = r"'spectral' with 18 detectors in band 150 and 6 in 220; the same positions in all bands are expected"
    with pytest.raises(SceneError, match=expected):
        prepare(load_bands(path, spectral).bands["150"])
    alike = spectral | {"bands.220.instrument.layout.rings": 2}
    assert len(prepare(load_bands(path, alike).bands["150"]).others) == 1
    moved = alike | {"bands.220.instrument.layout.pitch_f_lambda": 0.7001}
    with pytest.raises(SceneError, match="the same positions in all bands are expected"):
        prepare(load_bands(path, moved).bands["150"])
    with pytest.raises(SceneError, match=r"found 'spectral'; it needs tables \[bands.NAME\] of the same pixels"):
        prepare(load_scene(write_scene(tmp_path), spectral))


TABLE = """# %ECSV 1.0
# ---
# datatype:
# - {name: x, unit: arcmin, datatype: float64}
# - {name: y, unit: arcmin, datatype: float64}
# - {name: band, datatype: string}
x y band
0 0 150
1 0 150
0 1 150
0 0 220
1 1 220
"""


def test_a_band_takes_its_rows_of_a_table(tmp_path):
    """Unless its own key `band` chooses others."""
    (tmp_path / "camera.ecsv").write_text(TABLE)
    text = TWO_BANDS.replace("[instrument.layout]\nrings = 2\npitch_f_lambda = 0.7\ndead = [5]\n", "")
    text = text.replace("[bands.220.instrument.layout]\nrings = 1\n", "").replace(
        'camera_rotation_range = "60 deg"', 'camera_rotation_range = "60 deg"\npositions = "camera.ecsv"'
    )
    path = write_camera(tmp_path, text)
    assert [prepare(scene).camera.n_det for scene in load_bands(path).bands.values()] == [3, 2]
    swapped = load_bands(path, {"bands.220.instrument.band": "150"}).bands
    assert [prepare(scene).camera.n_det for scene in swapped.values()] == [3, 3]
    for setting, line in (
        ({"bands.220.instrument.band": "90"}, "bands.220.instrument.band: found"),
        ({"instrument.positions": "missing.ecsv"}, "instrument.positions: "),
    ):
        with pytest.raises(SceneError) as caught:
            checked_bands(load_bands(path, setting))
        assert str(caught.value).startswith(f"{path}: {line}") and "\n" not in str(caught.value)
