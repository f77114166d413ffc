"""Scene files as they come: encodings, pipes, sizes and depths; each is read, or refused in short lines at once."""

import os
from time import perf_counter

import pytest

from surveysim.runtime.errors import SceneError
from surveysim.scene.assumed_values import assumed_values
from surveysim.scene.scene import MAX_BYTES, load_scene
from tests.refusals import SECONDS, scene_refusal
from tests.scenes import SMALL_SCENE, write_scene


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


@pytest.mark.parametrize(
    "content", [b"\xef\xbb\xbf" + SMALL_SCENE.encode(), SMALL_SCENE.replace("\n", "\r\n").encode()], ids=["bom", "crlf"]
)
def test_what_editors_leave_is_read(path, content):
    as_it_was = load_scene(path)
    path.write_bytes(content)
    assert load_scene(path) == as_it_was


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (SMALL_SCENE.replace("small", "kleine für").encode("latin-1"), "line 1 is not UTF-8: found the byte 0xfc; a"),
        (SMALL_SCENE.encode("utf-16"), "line 1 is not UTF-8: found the byte 0xff"),
        (bytes(100), "not a valid TOML file (Invalid statement (at line 1, column 1))"),
        (SMALL_SCENE.encode() + b"#" * MAX_BYTES, "found more than 0.3 MB; a scene file (TOML) is expected"),
        (b"x = " + b"[" * 3000 + b"]" * 3000, "nested too deeply; a scene file (TOML) is expected"),
        (b"x = " + b"[" * 30 + b"]" * 30, "nested too deeply"),
        (b"x = " + b"{a = " * 2000 + b"1" + b"}" * 2000, "nested too deeply"),
        (b"a." * 100_000 + b"b = 1", "found a key of 20 parts or more, 'a.a.a."),
        (b"[" + b"a." * 100_000 + b"b]", "found a key of 20 parts or more"),
        (b'x = {"a" . ' * 1 + b'"a" . ' * 30_000 + b"b = 1}", "found a key of 20 parts or more"),
        (SMALL_SCENE.encode() + b"[map]\npixel = 1", "not a valid TOML file (Cannot declare ('map',) twice"),
        (SMALL_SCENE.encode() + b"\n".join(b"[x%d]" % i for i in range(3000)), "x0: unknown key; allowed are"),
        (b"x = " + b"9" * 5000, "not a valid TOML file (Exceeds the limit (4300 digits)"),
        (b'"\x1b[31mx" = 1', "not a valid TOML file"),
        (b'"\\u001b[31mx" = 1\n' + SMALL_SCENE.encode(), "\\x1b[31mx: unknown key"),
        (b"title = 1979-05-27\n", "title: found 1979-05-27; a text in quotes is expected"),
        (b"field = 1\nscan = 'a'\natmosphere = [1, 2]\ninstrument = 1979-05-27\n", "title: missing"),
    ],
    ids=range(17),
)  # fmt: skip
def test_files_that_are_refused(path, content, words):
    path.write_bytes(content)
    assert scene_refusal(path).startswith(words)


def test_files_that_are_no_files(tmp_path):
    """None of them is waited for."""
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "loop.toml").symlink_to(tmp_path / "loop.toml")
    for name, words in (
        ("", "can't be read (Is a directory); a scene file (TOML) is expected"),
        ("pipe.toml", "found a pipe or a device, not a file; a scene file"),
        ("loop.toml", "can't be read (Too many levels of symbolic links)"),
        ("nowhere.toml", "can't be read (No such file or directory)"),
        ("a.toml/b", "can't be read (No such file or directory)"),
    ):
        assert scene_refusal(tmp_path / name).startswith(words)
    with pytest.raises(SceneError, match="/dev/zero: found a pipe or a device"):
        load_scene("/dev/zero")


@pytest.mark.parametrize("stem", ["my scene", "fürth", "-x", "y" * 150, "a;b", "🔭"])
def test_files_whose_name_is_none_for_results_say_how_to_name_the_scene(path, stem):
    other = path.rename(path.with_name(f"{stem}.toml"))
    text = scene_refusal(other)
    assert text.startswith("name: missing, and the file's name ") and 'a line like name = "my_scene"' in text
    assert "--set name=my_scene" in text
    assert load_scene(other, {"name": "my_scene"}).name == "my_scene"
    other.write_text('name = "my_scene"\n' + SMALL_SCENE)
    assert load_scene(other).name == "my_scene"


@pytest.mark.parametrize(
    ("key", "found", "words"),
    [
        ("title", "a\x1b[31m", "one line of text without control characters is expected"),
        ("title", "a\nb", "one line of text without control characters is expected"),
        ("title", "a" * 301, "found 301 characters, 'aaa"),
        ("name", "a\n", "ASCII letters, digits, "),
        ("scan.scans", "18", "an integer is expected"),
        ("scan.scans", True, "no key of a scene is true or false"),
        ("scan.scans", 1e300, "less than or equal to 100000"),
        ("scan.scans", 10**5000, "less than or equal to 100000"),
        ("instrument.layout.dead", [True], "an integer is expected"),
        ("instrument.layout.dead", ["3"], "an integer is expected"),
        ("atmosphere.b2_probabilities", [0.25, True, 0.75], "a number is expected"),
        ("atmosphere.b2_probabilities", [0.25, "0.5", 0.75], "a number is expected"),
        ("atmosphere.b2_probabilities", [0.25, math_nan := float("nan"), 0.75], "a finite number is expected"),
        ("excess.b2", [46, math_nan], "finite values of 1e+24 or less are expected"),
        ("excess.b2", [46, "580"], "a number is expected"),
        ("atmosphere.spectral_index", "1_1/3", "a number or a fraction like '11/3' is expected"),
        ("atmosphere.spectral_index", "١١/3", "a number or a fraction like '11/3' is expected"),
        ("atmosphere.spectral_index", True, "no key of a scene is true or false"),
        ("atmosphere.wind_log_scatter", "0.4", "a number is expected"),
        ("photon.coherent_fraction", "0.1", "a number is expected"),
        ("photon.psd", "1e300 mK2 / Hz", "1e+12 mK2 / Hz or less is expected"),
        ("fixed_pointing.elevation", "1e-9 deg", "5 deg or more is expected"),
        ("atmosphere.layer_height", "1e30 m", "100000 km or less is expected"),
        ("atmosphere.wind_median", "1e7 arcmin / s", "360 deg / s or less is expected"),
        ("scan.duration", "1e308 s", "10 day or less is expected"),
        ("scan.duration", "4 4 s", "one number and one unit like 's' are expected"),
        ("map.healpix_nside", "1024", "a power of two"),
        ("a." * 30 + "b", 1, "nested too deeply"),
    ],
    ids=range(28),
)  # fmt: skip
def test_values_that_are_refused(path, key, found, words):
    text = scene_refusal(path, {key: found})
    assert words in text and (key in text or len(key) > 50)


def test_a_whole_number_may_have_a_point(path):
    assert load_scene(path, {"observations": 4.0}).observations == 4


def test_comments_are_read_in_no_time():
    """Long lines of spaces, for which a pattern went back and forth."""
    start = perf_counter()
    assert assumed_values("x = " + " " * 100_000 + "#" + " " * 100_000 + "\n" + "y = 1 # assumed: so") == [
        "y = 1: assumed: so"
    ]
    assert perf_counter() - start < SECONDS
    text = "[a]\n x = '#' # assumed\n y = 2 # said # calibrated: with\n# z = 3 # assumed\n w # assumed\n"
    assert assumed_values(text) == ["a.x = '#': assumed", "a.y = 2 # said: calibrated: with"]
