"""Keys of sites that a scene accepts, and refusals of others."""

import re

import pytest

from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.timestreams.observed_block import observation_weather
from tests.scenes import SMALL_SCENE, write_scene

B2_LINE = 'b2 = "[100, 280, 980] mK2 rad(-5/3)"\n'
SITE = {"atmosphere.site": "mauna_kea", "instrument.bandwidth": 0.15}


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"atmosphere.site": "mauna_loa"}, "atmosphere.site: found 'mauna_loa'; did you mean mauna_kea?"),
        ({"atmosphere.site": "moon"}, "atmosphere.site: found 'moon'; one of 'mauna_kea', 'south_pole'"),
        ({"atmosphere.site": 3}, "atmosphere.site: found 3; one of"),
        ({"atmosphere.site": "alma"}, "instrument.bandwidth: missing"),
        ({"atmosphere.pwv": "[1] mm", "atmosphere.pwv_probabilities": [0.5]}, "atmosphere.site: missing"),
        (SITE | {"atmosphere.pwv": "[1, 2] mm"}, "atmosphere.pwv: found 2 values for 5 pwv_probabilities"),
        (SITE | {"atmosphere.pwv": "[1, 2, 3, 4, 5] K"}, "atmosphere.pwv: found '1 K'"),
        (SITE | {"atmosphere.water_fluctuation": "[1, 2, 3] mK2"}, "atmosphere.water_fluctuation: found '1 mK2'"),
        (
            SITE | {"atmosphere.water_fluctuation": "[0, 1, 2] rad(-5/3)"},
            "fluctuation: found (0.0, 1.0, 2.0); values above 0",
        ),
        (
            SITE | {"atmosphere.pwv": "[0, 1, 2, 3, 4] mm"},
            "pwv: found (0.0, 1.0, 2.0, 3.0, 4.0); values above 0",
        ),
        (
            SITE | {"atmosphere.pwv_probabilities": [0, 0.25, 0.5, 0.75, 1.5]},
            "atmosphere.pwv_probabilities.4: found 1.5; a number less than or equal to 1 is",
        ),
        (SITE | {"atmosphere.pwv": "[1, 2, 3, 4, 50] mm"}, "atmosphere.pwv: found 50 mm of water vapour; 0.05 to 6 mm"),
        (SITE | {"atmosphere.pwv": "[1, 2, 3, 4, 2000] mm"}, "1000 mm or less is expected of each"),
        (
            SITE | {"atmosphere.pwv": "[1, 2, 3] mm", "atmosphere.pwv_probabilities": [0.25, 0.5, 0.75]},
            "atmosphere.pwv_probabilities: found (0.25, 0.5, 0.75); 0 first and 1 last are expected, the driest",
        ),
        (SITE | {"instrument.frequency": "1.2 THz"}, "bands within 10 to 1000 GHz are allowed"),
        (SITE | {"atmosphere.wind_b2_exponent": 5}, "atmosphere.wind_b2_exponent: found 5; "),
    ],
)
def test_refused(path, changes, words):
    with pytest.raises(SceneError) as caught:
        prepare(load_scene(path, changes))
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_one_line_for_a_wrong_name(path):
    """Keys that the site would supply are not reported as missing."""
    text = path.read_text()
    for key in ("layer_height", "wind_median", "latitude"):
        text = re.sub(rf"^{key} = .*\n", "", text, flags=re.MULTILINE)
    path.write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene(path, {"atmosphere.site": "atacama"})
    assert str(caught.value).startswith(f"{path}: atmosphere.site: found 'atacama'; ") and "\n" not in str(caught.value)


def test_noise_by_power_under_an_opaque_sky(path):
    """In the middle of a water line nothing is seen, and noise above the atmosphere is without limit."""
    line = {"instrument.frequency": "183.31 GHz", "instrument.bandwidth": 1e-3, "instrument.efficiency": 0.4}
    load = {"photon.psd": None, "photon.coherent_fraction": None, "photon.load.optics": "1 K"}
    low = {"fixed_pointing.elevation": "5 deg", "instrument.polarizations": 2}
    with pytest.raises(SceneError, match=r"^photon.load: found power that is a noise of .* mK2 / Hz above"):
        prepare(load_scene(path, SITE | line | load | low))


def test_fluctuations_beyond_any_air(path):
    """Their key is named, as nobody wrote B2; beside a B2 that is given their order alone counts."""
    changes = SITE | {"atmosphere.water_fluctuation": "[1e22, 1e23, 1e24] rad(-5/3)"}
    prepare(load_scene(path, changes))
    path.write_text(SMALL_SCENE.replace("b2_probabilities = [0.25, 0.5, 0.75]\n", "").replace(B2_LINE, ""))
    with pytest.raises(SceneError, match=r"^atmosphere.water_fluctuation: found \(1e\+22, .* B2 above 1e\+24 mK\^2"):
        prepare(load_scene(path, changes))


def test_another_index_needs_fluctuations_or_b2_of_its_own(path):
    """Amplitudes of a site are those of 11/3; one line says which keys it takes, whoever wrote none."""
    path.write_text(SMALL_SCENE.replace("b2_probabilities = [0.25, 0.5, 0.75]\n", "").replace(B2_LINE, ""))
    steep = SITE | {"atmosphere.spectral_index": "8/3"}
    with pytest.raises(SceneError) as caught:
        load_scene(path, steep)
    assert str(caught.value) == (
        f"{path}: atmosphere.water_fluctuation: missing; those of site 'mauna_kea' are amplitudes at an index of 11/3: "
        "with 8/3, 'water_fluctuation' in rad(-2/3) or 'b2' in mK2 rad(-2/3) is expected"
    )
    prepare(load_scene(path, steep | {"atmosphere.water_fluctuation": "[4e-5, 1e-4, 2e-4] rad(-2/3)"}))


def test_b2_of_another_index_keeps_the_ranks_of_the_site(path):
    """The water and its fluctuations rank the draws; a unit of theirs moves no rank."""
    steep = {"atmosphere.spectral_index": "8/3", "atmosphere.b2": "[100, 280, 980] mK2 rad(-2/3)"}
    one, other = (prepare(load_scene(path, SITE | keys)) for keys in ({}, steep))
    for number in range(4):
        assert observation_weather(one, number) == observation_weather(other, number)


def test_one_value_is_the_same_water_for_all(path):
    scene = load_scene(path, SITE | {"atmosphere.pwv": "[1.3] mm", "atmosphere.pwv_probabilities": [0.5]})
    water = [observation_weather(prepare(scene), number).pwv_mm for number in range(4)]
    assert water == pytest.approx([1.3] * 4)


def test_a_site_gives_what_the_scene_leaves_out(path):
    scene = load_scene(path, SITE | {"atmosphere.pwv": "[0.6, 1, 1.5, 2, 3] mm"})
    assert scene.atmosphere.pwv_mm == (0.6, 1.0, 1.5, 2.0, 3.0) and scene.atmosphere.b2 == (100, 280, 980)
    assert scene.atmosphere.water_fluctuation == (3.7e-6, 7.4e-6, 1.5e-5)


def test_what_the_site_assumes_is_said_unless_the_scene_replaces_it(path):
    said = [line for line in load_scene(path, SITE).assumed if line.startswith("atmosphere.")]
    # The scene has its own wind and height; of the rest the site calibrates its fluctuations.
    assert [line.split()[0] for line in said] == ["atmosphere.water_fluctuation"]
    own = load_scene(path, SITE | {"atmosphere.water_fluctuation": "[3e-6, 9e-6, 2e-5] rad(-5/3)"})
    assert not [line for line in own.assumed if line.startswith("atmosphere.")]
