"""Names of output directories: telling, safe on every file system, and one for each set of overrides."""

import re

import pytest

from surveysim.cli.options import setting
from surveysim.output.names import MOST_LETTERS, default_directory


def name(*settings):
    return default_directory("lynx", dict(map(setting, settings))).name


@pytest.mark.parametrize(
    "settings, expected",
    [
        ((), "lynx"),
        (("scan.speed=8 arcmin / s",), "lynx+scan.speed=8arcmin-s"),
        (("scan.speed=8arcmin/s",), "lynx+scan.speed=8arcmin-s"),
        (("seed=3", "observations=4"), "lynx+observations=4+seed=3"),
        (("observations=4", "seed=3"), "lynx+observations=4+seed=3"),
        (("name=other", "seed=3"), "lynx+seed=3"),
        (("map.pixel=1e-3 deg",), "lynx+map.pixel=1e-3deg"),
        (("field.dec=-5 deg",), "lynx+field.dec=-5deg"),
        (("atmosphere.site=mauna_kea",), "lynx+atmosphere.site=mauna_kea"),
        (("instrument.layout.dead=[1, 8]",), "lynx+instrument.layout.dead=1,8"),
        (("excess=", "seed=3"), "lynx+excess=+seed=3"),
    ],
)
def test_names(settings, expected):
    assert name(*settings) == expected


VALUES = [
    *("4", '"4"', "4.0", "[4]", '["4"]', "-4", "4 4", "44", '"true"', "true", "11/3", "11-3", "1/13", "113"),
    *('"8 arcmin-s"', '"8 arcmin / s"', '"8 arcmin / s / s"', '["a", "b"]', '"a,b"', '["a,b"]', '[["a", "b"]]', "[]"),
    *('""', '"a b"', '"ab"', '"a+b"', '"a=b"', '"a/b"', '"a\\\\b"', '"ä"', '"ö"', '"."', '".."', '"a."', '"~"'),
    *('"\\u0000"', '"\\u202e"', '"../../etc"', "{a = 1}", "{a = 2}", "2003-11-20", '"2003-11-20"', "inf", '"inf"'),
    *('"' + "x" * 300 + '"', '"' + "x" * 301 + '"', '"CON"', '"*?"', '"a:b"', "[1, [2]]", "[[1], 2]", "1e400", "-0.0"),
]


def test_no_two_values_share_a_name():
    """All are safe, and those that mean the same alone are the same."""
    found = {value: name(f"a.b={value}") for value in VALUES}
    for value, text in found.items():
        assert re.fullmatch(r"lynx\+a\.b=[A-Za-z0-9_.,~-]+", text) and not text.endswith("."), value
        assert len(text) <= MOST_LETTERS
    same = {"inf", "1e400"}  # one number
    assert len(set(found.values())) == len(VALUES) - len(same) + 1


@pytest.mark.parametrize("number", [3, 10, 100])
def test_many_overrides(number):
    one = {f"section.key_{k}": "a long value of no sense" for k in range(number)}
    found = [default_directory("n" * 100, one | {"z": z}).name for z in range(3)]
    assert len(set(found)) == 3 and max(map(len, found)) <= MOST_LETTERS


@pytest.mark.parametrize("key", ["a b.c", "ä", "a/b", "..", "a=b", "x" * 300])
def test_odd_keys(key):
    found = default_directory("lynx", {key: 1}).name
    assert re.fullmatch(r"lynx\+[A-Za-z0-9_.=~-]+", found) and len(found) <= MOST_LETTERS
