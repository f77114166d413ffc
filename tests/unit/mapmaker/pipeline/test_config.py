"""Configurations: defaults, units, and one line for each error."""

import math
import string

import numpy as np
import pytest

from mapmaker.cleaning import ALGORITHMS
from mapmaker.errors import InputError
from mapmaker.pipeline.config import Config, load_config


def loaded(tmp_path, text):
    path = tmp_path / "map.toml"
    path.write_text(text)
    return load_config(path)


def test_everything_has_a_default(tmp_path):
    assert loaded(tmp_path, "") == Config()


def test_units(tmp_path):
    found = loaded(
        tmp_path,
        '[map]\npixel = "0.5 arcmin"\ncentre = ["8h49m12s", "-44d30m"]\nsize = ["1 deg", "1800 arcsec"]\n'
        '[flags]\njump_window = "500 ms"\nnoise_ratio = 2\n[[flags.spare]]\ncentre = ["1 rad", "10 deg"]\n'
        'radius = "2 arcmin"\n',
    )
    assert found.map.pixel == pytest.approx(math.radians(1 / 120))
    assert np.degrees(found.map.centre) == pytest.approx([132.3, -44.5])
    assert np.degrees(found.map.size) == pytest.approx([1, 0.5])
    assert (found.flags.jump_window, found.flags.noise_ratio) == (0.5, 2.0)
    assert found.flags.spare[0].centre == pytest.approx((1, math.radians(10)))


@pytest.mark.parametrize(
    "text, line",
    [
        ('[map]\npixel = "20 apples"', "map.pixel: found '20 apples'; a quantity with a unit, as \"20 arcsec\""),
        ("[map]\npixel = 20", "map.pixel: found 20; a quantity with a unit"),
        ('[map]\npixel = "0 deg"', "map.pixel: found '0 deg'; a value above 0 and up to 3.14159 rad is expected"),
        ('[map]\ncentre = ["1 deg", "95 deg"]', "map.centre.1: found '95 deg'; a declination up to 90 deg is expected"),
        ("[map]\nhealpix_nside = 1000", "map.healpix_nside: found 1000; a power of two is expected"),
        ('[map]\nweights = "best"', "map.weights: found 'best'; 'detector', 'file' or 'uniform' is expected"),
        ("[flags]\nglitch_sgma = 4", "flags.glitch_sgma: unknown key; did you mean glitch_sigma?"),
        ("[flags]\nnothing = 4", "flags.nothing: unknown key; allowed are find, glitch_sigma"),
        ("[flags]\nglitch_sigma = 1", "flags.glitch_sigma: found 1; a number greater than or equal to 3 is expected"),
        ("[flags]\nmax_lost = nan", "flags.max_lost: found nan; a "),
        ("[flags]\npasses = 1.5", "flags.passes: found 1.5; an integer is expected"),
        ('[flags]\nfind = ["jumps", "jumps"]', "flags.find: found ['jumps', 'jumps']; different items are expected"),
        ("map = 3", "map: found 3; a section is expected"),
        ("cleaning = []", "cleaning: found []; 1 or more items are expected"),
        ('[[cleaning]]\nalgorithm = "averag"', "cleaning.0.algorithm: found 'averag'; \"none\", \"average\","),
        ("[[cleaning]]\norder = 1", "cleaning.0.algorithm: missing; this key is expected"),
        ('[[cleaning]]\nalgorithm = "polynomial"', "cleaning.0.order: missing; this key is expected"),
        ('[[cleaning]]\nalgorithm = "pca"\nmodes = 2', "cleaning.0.modes: found 2 with criterion = \"sigma_cut\"; no"),
        ("map = ", "not TOML ("),
    ],
)  # fmt: skip
def test_errors_name_file_and_key(text, line, tmp_path):
    with pytest.raises(InputError) as caught:
        loaded(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'map.toml'}: {line}") and "\n" not in str(caught.value)


def test_all_errors_are_told(tmp_path):
    with pytest.raises(InputError) as caught:
        loaded(tmp_path, "a = 1\n[map]\npixel = 1\nb = 2\n[flags]\npasses = 0\n")
    assert len(str(caught.value).splitlines()) == 4


def test_files_that_are_none(tmp_path):
    with pytest.raises(InputError, match="nowhere.toml: no such file"):
        load_config(tmp_path / "nowhere.toml")
    with pytest.raises(InputError, match="no file"):
        load_config(tmp_path)
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="bytes.toml: not TOML"):
        load_config(tmp_path / "bytes.toml")


# Options that an algorithm needs; those without them are cleanings of other data than the file's.
NEEDED = {
    "polynomial": "order = 1",
    "highpass": 'corner = "0.1 Hz"',
    "notch": 'frequencies = ["1 Hz"]\nwidths = ["0.1 Hz"]',
    "time_polynomial": "order = 2",
}


@pytest.mark.parametrize("name", sorted(set(ALGORITHMS) - {"wind", "spectral"}))
def test_every_algorithm_has_its_options(name, tmp_path):
    config = loaded(tmp_path, f'[[cleaning]]\nalgorithm = "{name}"\n{NEEDED.get(name, "")}')
    options = config.cleaning[0].options(20.0)
    assert config.cleaning[0].algorithm == name and isinstance(options, ALGORITHMS[name].options)


def test_mangled_configurations(tmp_path):
    """Each is read, or refused in lines that begin with the file."""
    rng = np.random.default_rng(1)
    whole = (
        '[map]\npixel = "20 arcsec"\ncentre = ["132 deg", "44 deg"]\n[flags]\nfind = ["jumps"]\nmax_lost = 0.5\n'
        '[[cleaning]]\nalgorithm = "pca"\nsigma_cut = 3\n[[cleaning]]\nalgorithm = "average"\n[jackknives]\nfiles = 2\n'
    )
    refused = 0
    for _ in range(40):
        text = list(whole)
        for place in rng.integers(0, len(text), 2):
            text[place] = rng.choice([*string.printable, "\x00", "é", "[[", '"', "1e400", "nan"])
        try:
            loaded(tmp_path, "".join(text))
        except InputError as error:
            refused += 1
            assert all(line.startswith(f"{tmp_path / 'map.toml'}: ") for line in str(error).split("\n"))
    assert refused > 12
