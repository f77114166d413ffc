"""Every wrong input gives a SceneError that says which file, which key, what was found, what is allowed."""

import math
from datetime import date

import pytest

from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from tests.refusals import scene_refusal
from tests.scenes import SCHEDULE, SMALL_SCENE, without_sections, write_scene


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


def check(path, overrides, key, found, allowed):
    """Assert the words of a refusal; keys of checks across a section may be written `section: key` too."""
    text = scene_refusal(path, overrides)
    section, _, last = key.rpartition(".")
    assert f"{key}:" in text or (section and f"{section}: {last}:" in text), text
    assert found in text and allowed in text, text


@pytest.mark.parametrize(
    "key, allowed",
    [
        ("typo", "atmosphere, cleaning"),
        ("scan.typo", "dither, duration"),
        ("instrument.layout.typo", "dead, field_of_view, pitch_f_lambda, rings"),
        ("score.signal_sims.typo", "band_power, observations, skies"),
        ("scan.speed_rad_s", "speed"),  # names of the records are no keys of the file
    ],
)
def test_unknown_keys(path, key, allowed):
    check(path, {key: 1}, key, "unknown key", allowed)


def test_a_mistyped_key_is_one_error_with_a_suggestion(path):
    """The missing key is not listed too, unless another is missing."""
    path.write_text(SMALL_SCENE.replace("speed =", "spead ="))
    with pytest.raises(SceneError) as error:
        load_scene(path)
    assert str(error.value) == f"{path}: scan.spead: unknown key; did you mean scan.speed?"
    path.write_text(SMALL_SCENE.replace("speed =", "quux ="))
    with pytest.raises(SceneError) as error:
        load_scene(path)
    assert len(str(error.value).splitlines()) == 2 and "scan.speed: missing" in str(error.value)


def test_a_mistyped_section_is_one_error_with_a_suggestion(path):
    path.write_text(SMALL_SCENE.replace("[scan]", "[scna]"))
    with pytest.raises(SceneError) as error:
        load_scene(path)
    assert str(error.value) == f"{path}: scna: unknown key; did you mean scan?"


def test_unknown_key_in_a_list(path):
    path.write_text(SMALL_SCENE.replace('peak = "5 mK"', 'peak = "5 mK"\nfluxx = "1 Jy"'))
    check(path, {}, "sky.point_sources.0.fluxx", "unknown key", "flux")


@pytest.mark.parametrize("section", ["field", "instrument", "scan", "cleaning", "map"])
def test_missing_sections(path, section):
    start = SMALL_SCENE.index(f"[{section}]")
    ends = [
        SMALL_SCENE.find(f"\n[{other}]", start) for other in ("fixed_pointing", "scan", "atmosphere", "map", "score")
    ]
    end = min(end for end in ends if end > start)
    path.write_text(SMALL_SCENE[:start] + SMALL_SCENE[end:])
    check(path, {}, section, "missing", "this section is expected")


@pytest.mark.parametrize(
    "line", ['title = "A small camera over a small field"', "seed = 11", 'ra = "08h49m12s"', "scans = 4"]
)
def test_missing_keys(path, line):
    path.write_text(SMALL_SCENE.replace(line + "\n", "", 1))
    text = scene_refusal(path)
    assert f"{line.split()[0]}: missing; this key is expected" in text


@pytest.mark.parametrize(
    "key, found, unit",
    [
        ("scan.speed", "4 arcmin", "'arcmin / s'"),
        ("scan.duration", "6 arcmin", "'s'"),
        ("scan.duration", "6 parsnips", "'s'"),
        ("instrument.beam_fwhm", "60 Hz", "'arcsec'"),
        ("instrument.frequency", "60 arcsec", "'GHz'"),
        ("scan.sample_rate", "1 m", "'Hz'"),
        ("field.ra", "08h49m", "'deg'"),
        ("field.dec", "12 m", "'deg'"),
        ("photon.psd", "2.5 mK / Hz", "mK2 / Hz"),
        ("sky.cmb_band_power", "1000 uK", "uK2"),
        ("excess.variance", "[2.05, 4.52] mK", "mK2"),
        ("atmosphere.b2", "[100, 280, 980] mK2", "mK2 rad(-5/3)"),
        ("atmosphere.b2", "[100, 280, 980] mK2 rad(-2)", "mK2 rad(-5/3)"),
        ("atmosphere.layer_height", "1000 s", "'m'"),
    ],
)
def test_wrong_units(path, key, found, unit):
    check(path, {key: found}, key, found.split("]")[-1].strip(), unit)


def test_unit_of_b2_follows_the_index(path):
    """B2 is in mK^2 rad^(2 - b)."""
    overrides = {"atmosphere.spectral_index": "8/3", "atmosphere.b2": "[100, 280, 980] mK2 deg(-2/3)"}
    scene = load_scene(path, overrides)
    assert scene.atmosphere.b2 == pytest.approx([b * (180 / math.pi) ** (2 / 3) for b in (100, 280, 980)])
    check(path, {"atmosphere.spectral_index": "8/3"}, "atmosphere.b2", "mK2 rad(-5/3)", "mK2 rad(-2/3)")
    assert load_scene(path, {"atmosphere.spectral_index": 2, "atmosphere.b2": "[1, 2, 3] mK2"}).atmosphere.b2 == (
        1,
        2,
        3,
    )


@pytest.mark.parametrize(
    "key, found",
    [
        ("scan.speed", 4),
        ("scan.sample_rate", 10.0),
        ("field.ra", 132.3),
        ("detector.psd", 2.5),
        ("map.pixel", 30),
    ],
)
def test_bare_numbers(path, key, found):
    check(path, {key: found}, key, f"found the bare number {found}", "a string with a unit like")


@pytest.mark.parametrize("found", [[100, 280, 980], "100, 280, 980"])
def test_bare_lists(path, found):
    check(path, {"atmosphere.b2": found}, "atmosphere.b2", "found", "mK2 rad(-5/3)")
    check(path, {"excess.variance": [2.05, 4.52]}, "excess.variance", "found the bare number 2.05", "mK2")


@pytest.mark.parametrize(
    "key, found, allowed",
    [
        ("scan.speed", "-4 arcmin / s", "0.001 arcsec / s or more"),
        ("scan.speed", "0 arcmin / s", "0.001 arcsec / s or more"),
        ("scan.turnaround", "-1 s", "0 or more"),
        ("instrument.beam_fwhm", "-60 arcsec", "0.001 arcsec or more"),
        ("instrument.layout.rings", -1, "greater than or equal to 0"),
        ("instrument.layout.pitch_f_lambda", -0.7, "greater than or equal to 0.1"),
        ("instrument.responsivity_scatter", -0.1, "greater than or equal to 0"),
        ("photon.psd", "-1 mK2 / Hz", "0 or more"),
        ("photon.coherent_fraction", 1.1, "less than or equal to 1"),
        ("atmosphere.outer_scale", "0 m", "1 mm or more"),
        ("atmosphere.wind_median", "-1 arcmin / s", "0 or more"),
        ("excess.band_limit", "0 Hz", "1e-6 Hz or more"),
        ("seed", -1, "greater than or equal to 0"),
        ("observations", 0, "greater than or equal to 1"),
        ("scan.scans", 1.5, "integer"),
        ("scan.scans", "four", "integer"),
        ("cleaning.tolerance", 0, "greater than or equal to 0.000000000001"),
        ("cleaning.algorithm", "cubic", "'none', 'average', 'planar', 'quadratic'"),
        ("excess.coherence", "partial", "'field', 'intensity' or 'none'"),
        ("name", "a b", "ASCII letters, digits, "),
        ("title", 3, "expected"),
        ("instrument.layout.dead", ["five"], "integer"),
    ],
)
def test_values_out_of_range(path, key, found, allowed):
    text = scene_refusal(path, {key: found})
    assert f"{key}" in text and allowed in text
    assert str(found[0] if isinstance(found, list) else found) in text


@pytest.mark.parametrize(
    "key, found, allowed",
    [
        ("fixed_pointing.elevation", "0.0015 deg", "5 deg or more"),
        ("fixed_pointing.parallactic_angle", "400 deg", "360 deg or less"),
        ("instrument.beam_fwhm", "31 deg", "30 deg or less"),
        ("instrument.beam_fwhm", "1e-300 rad", "0.001 arcsec or more"),
        ("instrument.f_lambda", "200 deg", "180 deg or less"),
        ("instrument.frequency", "1 Hz", "1 GHz or more"),
        ("instrument.bandwidth", 1e-300, "greater than or equal to 0.000001"),
        ("scan.speed", "361 deg / s", "360 deg / s or less"),
        ("scan.duration", "11 day", "10 day or less"),
        ("scan.turnaround", "1e300 s", "10 day or less"),
        ("scan.step", "361 deg", "360 deg or less"),
        ("scan.sample_rate", "2 GHz", "1 GHz or less"),
        ("atmosphere.wind_median", "361 deg / s", "360 deg / s or less"),
        ("atmosphere.layer_height", "0.1 mm", "1 mm or more"),
        ("atmosphere.layer_height", "1e300 m", "100000 km or less"),
        ("atmosphere.outer_scale", "1e300 m", "100000 km or less"),
        ("excess.variance", "[1, 1e13] mK2", "1e12 mK2 or less"),
        ("excess.b2", [1, 1e25], "values of 1e+24 or less"),
        ("photon.psd", "1e80 mK2 / Hz", "1e+12 mK2 / Hz or less"),
        ("photon.psd", "1e-300 mK2 / Hz", "0, or 1e-12 mK2 / Hz or more,"),
        ("excess.variance", "[1e-300, 1] mK2", "0, or 1e-12 mK2 or more, is expected of each"),
        ("detector.psd", "1e80 mK2 / Hz", "1e+12 mK2 / Hz or less"),
        ("sky.cmb_band_power", "1e80 uK2", "1e15 uK2 or less"),
        ("score.signal_sims.band_power", "1e-30 uK2", "1e-6 uK2 or more"),
        ("score.mask_separation_f_lambda", 1e-30, "greater than or equal to 0.000001"),
        ("map.pixel", "181 deg", "180 deg or less"),
    ],
)
def test_values_beyond_any_use(path, key, found, allowed):
    """Beyond any telescope, and what streams of 32 bits hold; 12,900 K of layer and noise of 1e80 ran before."""
    check(path, {key: found}, key, f"found {found!r}" if isinstance(found, str) else "found", allowed)


@pytest.mark.parametrize(
    "key, found, allowed",
    [
        ("photon.load.sky", "1e5 K", "10000 K or less"),
        ("photon.load.optics", "1e80 K", "10000 K or less"),
        ("photon.load.sky", "1e-30 K", "0, or 1e-9 K or more,"),
        ("detector.nep", "1e-50 W / Hz(1/2)", "0, or 1e-30 W / Hz(1/2) or more,"),
        ("detector.nep", "1 W / Hz(1/2)", "1e-6 W / Hz(1/2) or less"),
    ],
)
def test_powers_beyond_any_use(path, key, found, allowed):
    check(path, {"photon.load.optics": "1 K", key: found}, key, f"found {found!r}", allowed)


def test_layers_beyond_any_use(path):
    for keys, key, found, allowed in (
        ({"b2": "[1, 2, 1e25] mK2 rad(-5/3)"}, "b2", "found (1.0, 2.0, 1e+25)", "0 or values from 1e-24 to 1e+24"),
        ({"b2": "[1e-300, 2, 3] mK2 rad(-5/3)"}, "b2", "found (1e-300, 2.0, 3.0)", "0 or values from 1e-24"),
        (
            {"spectral_index": 21, "b2": "[1, 2, 3] mK2 rad(-19)"},
            "spectral_index",
            "found 21",
            "less than or equal to 20",
        ),
        ({"layer_height": "5 m"}, "layer_height", "found 5 m with an aperture of 8 m", "no less than the aperture"),
        ({"outer_scale": "5 m"}, "outer_scale", "found 5 m with an aperture of 8 m", "no less than the aperture"),
    ):
        overrides = {f"atmosphere.{name}": value for name, value in keys.items()}
        check(path, overrides, f"atmosphere.{key}", found, allowed)


def test_peaks_beyond_any_use(path):
    for peak, allowed in (("1e80 K", "1e6 K or less"), ("-1e80 K", "-1e6 K or more")):
        source = {"ra": "08h49m20s", "dec": "+44d51m00s", "peak": peak}
        check(path, {"sky.point_sources": [source]}, "sky.point_sources.0.peak", f"found {peak!r}", allowed)


def test_lowest_elevation_of_a_schedule(path):
    path.write_text(without_sections(SMALL_SCENE, "fixed_pointing") + SCHEDULE)
    check(path, {"schedule.min_elevation": "4.99 deg"}, "schedule.min_elevation", "found '4.99 deg'", "5 deg or more")
    assert load_scene(path, {"schedule.min_elevation": "5 deg"}).schedule.min_elevation_rad == math.radians(5)


@pytest.mark.parametrize("word", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(
    "key, unit",
    [("scan.speed", "arcmin / s"), ("fixed_pointing.parallactic_angle", "deg"), ("field.ra", "deg")],
)
def test_quantities_that_are_not_finite(path, word, key, unit):
    check(path, {key: f"{word} {unit}"}, key, f"{word} {unit}", "a finite number is expected")


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize(
    "key",
    [
        "instrument.responsivity_scatter",
        "instrument.layout.pitch_f_lambda",
        "atmosphere.spectral_index",
        "atmosphere.wind_log_scatter",
        "photon.coherent_fraction",
        "cleaning.tolerance",
        "score.taper_fraction",
        "excess.spectral_index",
    ],
)
def test_numbers_that_are_not_finite(path, key, value):
    text = scene_refusal(path, {key: value})
    assert f"{key}: found {value}" in text


@pytest.mark.parametrize("text", ["[46, nan] mK2", "[inf, 2] mK2"])
def test_lists_that_are_not_finite(path, text):
    check(path, {"excess.variance": text}, "excess.variance", "found", "finite number")


@pytest.mark.parametrize("b2", [[math.nan, 580], [46, math.inf], [-5, 580], [0, 580]])
def test_excess_is_given_at_finite_positive_b2(path, b2):
    """Excess is interpolated in the logarithm of B2."""
    check(path, {"excess.b2": b2}, "excess.b2", "found", "expected")


def test_excess_of_no_variance_is_refused_where_logarithms_are_taken(path):
    check(path, {"excess.variance": "[0, 4.52] mK2"}, "excess.variance", "found", "expected")


@pytest.mark.parametrize("text", ["1/0", "eleven thirds", "11/3/2"])
def test_broken_index(path, text):
    check(path, {"atmosphere.spectral_index": text}, "atmosphere.spectral_index", text, "")


@pytest.mark.parametrize("share", [0.1, 0.35, 0.6, 0.9])
def test_truncated_file(path, share):
    """Cut in a line it is no TOML; cut between lines it lacks keys. Either way it says so."""
    cut = SMALL_SCENE.index("=", int(share * len(SMALL_SCENE))) + 1
    path.write_text(SMALL_SCENE[:cut])
    assert "not a valid TOML file" in scene_refusal(path)
    path.write_text(SMALL_SCENE[: SMALL_SCENE.rindex("\n", 0, cut) + 1])
    assert "missing" in scene_refusal(path)


@pytest.mark.parametrize("raw", [b'title = "a" b', b"[scan\n", b"seed = 1\nseed = 2\n", b"\x00"])
def test_bad_toml(path, raw):
    path.write_bytes(raw)
    assert "not a valid TOML file" in scene_refusal(path)


def test_missing_file(tmp_path):
    text = scene_refusal(tmp_path / "nowhere.toml")
    assert "can't be read" in text and "expected" in text
    assert "can't be read" in scene_refusal(tmp_path)  # a folder


@pytest.mark.parametrize("index, power", [(4, "-2"), ("13/3", "-7/3")])
def test_steep_screens_need_an_outer_scale(path, index, power):
    steep = {"atmosphere.spectral_index": index, "atmosphere.b2": f"[100, 280, 980] mK2 rad({power})"}
    check(path, steep, "atmosphere.outer_scale", "missing", "needs an outer scale")
    assert load_scene(path, steep | {"atmosphere.outer_scale": "5 km"}).atmosphere.outer_scale_m == 5000


@pytest.mark.parametrize(
    "key, found, shown",
    [
        ("atmosphere.b2_probabilities", [0.25, 0.25, 0.75], "(0.25, 0.25, 0.75); increasing"),
        ("atmosphere.b2_probabilities", [0.5, 0.25, 0.75], "(0.5, 0.25, 0.75); increasing"),
        ("atmosphere.b2_probabilities", [0.0, 0.25, 0.75], "(0.0, 0.25, 0.75); values between 0 and 1"),
        ("atmosphere.b2_probabilities", [0.25, 0.75, 1.0], "(0.25, 0.75, 1.0); values between 0 and 1"),
        (
            "atmosphere.b2",
            "[280, 100, 980] mK2 rad(-5/3)",
            "(280.0, 100.0, 980.0); values of 0 or more that do not decrease",
        ),
        ("atmosphere.b2", "[-1, 100, 980] mK2 rad(-5/3)", "(-1.0, 100.0, 980.0); values of 0 or more"),
        ("excess.b2", [580, 46], "(580.0, 46.0); increasing"),
        ("excess.variance", "[4.52, 2.05] mK2", "(4.52, 2.05); values of 0 or more that do not decrease"),
    ],
)
def test_knots(path, key, found, shown):
    check(path, {key: found}, key, "found " + shown, "expected")


@pytest.mark.parametrize(
    "key, found, shown",
    [
        ("atmosphere.b2", "[100, 280] mK2 rad(-5/3)", "found 2 values for 3 b2_probabilities"),
        ("excess.variance", "[2, 3, 4] mK2", "found 3 values for 2 b2"),
    ],
)
def test_knots_come_in_pairs(path, key, found, shown):
    check(path, {key: found}, key, shown, "as many as these are expected")


def test_two_focal_planes_or_none(path):
    for overrides in ({"instrument.positions": "table.ecsv"}, {"instrument.layout": None}):
        text = scene_refusal(path, overrides)
        assert (
            "instrument: exactly one of 'layout' (a section), 'wafers' (a list of sections) and 'positions' (a" in text
        )


def test_two_ways_of_pointing_or_none(path):
    text = scene_refusal(path, {"fixed_pointing": None})
    assert "exactly one of the sections 'schedule' and 'fixed_pointing' is expected" in text
    path.write_text(SMALL_SCENE + SCHEDULE)
    assert "exactly one of the sections 'schedule' and 'fixed_pointing' is expected" in scene_refusal(path)
    assert load_scene(path, {"fixed_pointing": None}).schedule.height_m == 4070


@pytest.mark.parametrize("duration, samples", [("0.7 s", "7"), ("0.25 s", "2.5"), ("1 ms", "0.01")])
def test_too_few_samples_a_scan(path, duration, samples):
    check(
        path,
        {"scan.duration": duration},
        "scan.duration",
        f"found {samples} samples a scan",
        "8 or more are expected",
    )
    assert load_scene(path, {"scan.duration": "0.8 s"}).scan.duration_s == pytest.approx(0.8)


def test_some_stage_is_needed(path):
    sections = ("atmosphere", "excess", "photon", "detector", "sky")
    text = scene_refusal(path, dict.fromkeys(sections))
    assert "at least one of atmosphere, excess, photon, detector and sky is expected" in text
    for only in ("atmosphere", "photon", "detector", "sky"):
        scene = load_scene(path, {name: None for name in sections if name != only})
        assert [name for name in sections if getattr(scene, name)] == [only]


def test_excess_of_several_weathers_needs_a_weather(path):
    check(path, {"atmosphere": None}, "excess.b2", "found several values", "one value is expected")


def test_scored_range_holds_a_bin(path):
    check(path, {"score.ell_max": 5999}, "score.ell_max", "found 5999", "or more, ell_min + ell_bin, is expected")


def test_each_error_has_its_line(path):
    text = scene_refusal(path, {"scan.speed": 4, "scan.typo": 1, "cleaning.algorithm": "cubic"})
    assert len(text.splitlines()) == 3


def test_overrides_of_what_is_no_section(path):
    check(path, {"title.text": "a"}, "title.text", "'title' is not a section", "")
    layers = {"atmosphere.layers": [{"name": "a", "height": "1 km", "share": 1}]}
    key = "atmosphere.layers.0.height"
    check(path, layers | {key: "2 km"}, key, "'layers' is a list", "a new list in place of all of it is expected")


def test_one_brightness_of_a_source(path):
    place = {"ra": "08h49m20s", "dec": "+44d51m00s"}
    flux = {"flux": "5 mJy", "flux_frequency": "150 GHz", "spectral_index": 3.5}
    for keys, words in (
        ({}, ("exactly one of 'peak' and 'flux' is expected",)),
        (flux | {"peak": "1 mK"}, ("exactly one of 'peak' and 'flux' is expected",)),
        (flux | {"spectral_index": None}, ("spectral_index: missing", "'flux' needs it")),
        (flux | {"flux_frequency": None}, ("flux_frequency: missing", "'flux' needs it")),
        ({"peak": "1 mK", "spectral_index": 3}, ("spectral_index: found without 'flux'",)),
    ):
        source = place | {key: value for key, value in keys.items() if value is not None}
        text = scene_refusal(path, {"sky.point_sources": [source]})
        assert "sky.point_sources.0" in text and all(word in text for word in words) and "\n" not in text


@pytest.mark.parametrize(
    "key, found, line",
    [
        ("score.metrics", [{"kind": []}], "score.metrics.0.kind: found []; one of 'band_powers', "),
        (
            "score.metrics",
            [{"kind": "band_powers", "edges": [4000, math.nan], "spectrum": "flat", "band_power": "1 uK2"}],
            "score.metrics.0.edges.1: found nan; an integer is expected",
        ),
        (
            "score.metrics",
            [{"kind": "band_powers", "edges": [4000], "spectrum": "flat", "band_power": "1 uK2"}],
            "score.metrics.0.edges: found [4000]; 2 or more items are expected, not 1",
        ),
        ("optimise", {"knobs": []}, "optimise.knobs: found []; 1 or more items are expected, not 0"),
        ("optimise", {"knobs": [3]}, "optimise.knobs.0: found 3; a section is expected"),
        (
            "optimise",
            {"knobs": [{"key": "scan.scans", "low": 2, "high": math.inf}]},
            "optimise.knobs.0.high: found inf; a finite number is expected",
        ),
        (
            "optimise",
            {"knobs": [{"key": "scan.scans", "choices": [2, date(2026, 1, 1)]}]},
            "optimise.knobs.0.choices: found 2026-01-01; a number, a text or a list of these",
        ),
        (
            "optimise",
            {"metrics": ["detectors"] * 2, "knobs": [{"key": "scan.scans", "low": 2, "high": 3}]},
            "optimise.metrics: found 'detectors' more than once; every key once is expected",
        ),
        (
            "optimise",
            {"metrics": list("abc"), "knobs": [{"key": "scan.scans", "low": 2, "high": 3}]},
            "optimise.metrics: found ['a', 'b', 'c']; 2 or fewer items are expected, not 3",
        ),
    ],
)
def test_items_of_lists_have_one_line(path, key, found, line):
    (said,) = scene_refusal(path, {key: found}).splitlines()
    assert said.startswith(line)
