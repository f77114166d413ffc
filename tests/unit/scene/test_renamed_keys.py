"""Former names of keys are refused with one line that gives the present name."""

import tomllib

import pytest

from surveysim.runtime.errors import SceneError
from surveysim.scene.error_lines import allowed_keys
from surveysim.scene.renamed_keys import RENAMED, renamed_line
from surveysim.scene.scene import Scene
from surveysim.studies.sweep.axes import load_sweep
from tests.refusals import scene_refusal
from tests.scenes import SMALL_SCENE, write_scene

KEYS = pytest.mark.parametrize("old, new", RENAMED.items())


@KEYS
def test_present_names_are_keys_of_a_scene(old, new):
    for key, there in ((new, not new.startswith("bands.")), (old, False)):
        section, name = key.split(".")
        assert (name in allowed_keys([section], Scene)) is there


@KEYS
def test_a_former_key_in_the_file_or_an_override(tmp_path, old, new):
    path = write_scene(tmp_path)
    expected = f"{old} is now {new}"
    assert scene_refusal(path, {old: 3}) == expected
    section, name = old.split(".")
    header = f"[{section}]\n"
    text = SMALL_SCENE if header in SMALL_SCENE else f"{SMALL_SCENE}\n{header}"
    path.write_text(text.replace(header, f"{header}{name} = 3\n", 1))
    assert tomllib.loads(path.read_text())[section][name] == 3
    assert scene_refusal(path) == expected


@KEYS
def test_a_former_key_on_the_command_line(tmp_path, call, old, new):
    path = write_scene(tmp_path)
    assert call("check", path, "--set", f"{old}=3") == (2, "", f"{path}: {old} is now {new}\n")


@KEYS
def test_a_former_key_on_an_axis_of_a_sweep(tmp_path, old, new):
    path = tmp_path / "small.toml"
    path.write_text(f'{SMALL_SCENE}\n[sweep]\n"{old}" = [1, 2]\n')
    with pytest.raises(SceneError) as caught:
        load_sweep(path)
    assert str(caught.value) == f"{path}: {old} is now {new}"


def test_keys_within_a_renamed_section(tmp_path):
    path = write_scene(tmp_path)
    assert scene_refusal(path, {"score.window.skies": 3}) == "score.window is now score.signal_sims"
    path.write_text(f'{SMALL_SCENE}\n[sweep]\n"score.window.skies" = [2, 3]\n')
    with pytest.raises(SceneError, match=r"small.toml: score.window is now score.signal_sims$"):
        load_sweep(path)
    assert renamed_line("score.signal_sims.skies") == ""
