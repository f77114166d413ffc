"""List of the stress cases: scenes and inputs at and beyond the limits, with their expected answers."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from surveysim.studies.stress import atmosphere as air
from surveysim.studies.stress import cleaning
from surveysim.studies.stress import noise_and_maps as streams
from surveysim.studies.stress.case import QUANTUM, STIFF, Case
from surveysim.telescope.layouts import hexagon

_LAYER = "the strip has the structure function of the quadrature to 2e-3; streams are finite, before cleaning and after"
_WHITE = "white noise is left less a degree of freedom a template and two a stream, to 4 sigma"
_QUANTA = f"float32 rounds an atmosphere of 1e6 white noises to {QUANTUM * STIFF:.2g} of one: four of these at most"
_OUTER_SCALE = {"atmosphere.outer_scale": "10 km"}
_WINDS = [f"{speed} arcmin / s" for speed in (0, 4, 500)]
_HOUR = {"scan.duration": "1 hour", "scan.speed": "0.02 arcmin / s", "scan.scans": 1}


def _at_index(index: str, height: str) -> dict[str, Any]:
    # B2 in the unit of its index, such that 1000 m give some 17 mK.
    power = {"2/3": "4/3", "5/3": "1/3", "11/3": "-5/3", "14/3": "-8/3", "17/3": "-11/3", "20/3": "-14/3"}[index]
    keys = {
        "atmosphere.spectral_index": index,
        "atmosphere.b2": f"[280] mK2 rad({power})",
        "atmosphere.layer_height": height,
    }
    return keys | (_OUTER_SCALE if index in ("14/3", "17/3", "20/3") else {})


def _layer_cases() -> list[Case]:
    grid = [
        Case(f"layer, b = {b}, h = {h}", _LAYER, air.layer, _at_index(b, h), slow=h == "20 km")
        for b in ("2/3", "5/3", "11/3", "14/3", "20/3")
        for h in ("100 m", "1000 m", "20 km")
        if (b, h) != ("20/3", "100 m")
    ]
    smooth = _at_index("20/3", "100 m") | {"atmosphere.outer_scale": "100 m"}
    steepest = {
        "atmosphere.spectral_index": 10,
        "atmosphere.b2": "[280] mK2 rad(-8)",
        "atmosphere.outer_scale": "100 m",
    }
    still = "wind = scan velocity: streams are constant, exactly, and the mean takes all of them"
    turned = "only the difference counts: bit for bit as twice the speed in calm"
    return grid + [
        *(Case(f"wind of {wind}", _LAYER, air.layer, {"atmosphere.wind_median": wind}) for wind in _WINDS),
        Case("layer, b = 20/3, h = 100 m, outer scale of 100 m", _LAYER, air.layer, smooth),
        Case("layer, b = 10, outer scale of 100 m", _LAYER, air.layer, steepest),
        Case("scan of an hour, outer scale of 10 km", _LAYER, air.layer, _HOUR | _OUTER_SCALE, slow=True),
        Case("layer at rest, 16 directions", still, air.still),
        Case("wind against the scan", turned, air.opposite),
    ]


def _layer_refusals() -> list[Case]:
    fast = {"atmosphere.wind_median": "1000 arcmin / s"}
    return [
        Case(
            "layer, b = 20/3, h = 100 m",
            "an outer scale of 100 rad leaves no power on a strip's scales to draw from: refused",
            air.layer,
            _at_index("20/3", "100 m"),
            refusal="use a smaller outer scale",
        ),
        Case(
            "fast and high layer",
            "1000 arcmin/s at 20 km pass 10^4 beams, beyond the structure function: refused",
            air.layer,
            fast | {"atmosphere.layer_height": "20 km"},
            refusal="a slower wind",
        ),
        Case(
            "scan of an hour",
            "differences over 30 rad are so large that their rounding hides those of neighbours: refused",
            air.layer,
            _HOUR,
            refusal="shorter scans",
        ),
        Case(
            "scan of an hour under a fast layer",
            "no machine holds a strip of 1000 rad: refused",
            air.layer,
            _HOUR | fast,
            refusal="shorter scans",
        ),
    ]


def _weather_cases() -> list[Case]:
    elevation = "sin(el)^(1 - b) and a beam of D sin(el) / h: streams are those of a layer at h / sin(el) overhead"
    amplitude = "streams of one draw go as sqrt(B2), to rounding of float32"
    none = {"atmosphere.b2": "[0] mK2 rad(-5/3)", "instrument.responsivity_scatter": 0}
    tails = {"atmosphere.b2_probabilities": [0.49, 0.51], "atmosphere.b2": "[1e-6, 1e8] mK2 rad(-5/3)"}
    calm = {"atmosphere.b2_probabilities": [0.5, 0.6], "atmosphere.b2": "[0, 1000] mK2 rad(-5/3)"}
    return [
        # A power of two scales a lattice bit for bit.
        Case("elevation of 30 deg", elevation, air.elevation, {"fixed_pointing.elevation": "30 deg"}),
        Case("elevation of 5 deg", _LAYER, air.layer, {"fixed_pointing.elevation": "5 deg"}),
        *(
            Case(f"B2 of {b2}", amplitude, air.amplitude, {"atmosphere.b2": f"[{b2}] mK2 rad(-5/3)"})
            for b2 in ("1e-6", "1e8", "1e18")
        ),
        Case("B2 of 0", "no atmosphere, bit for bit", air.no_air, none),
        Case(
            "tails of B2",
            "quantiles of 1e-6 and 1e8 at 0.49 and 0.51 have tails beyond all numbers: refused",
            air.drawn,
            tails | {"observations": 40},
            refusal="atmosphere.b2",
        ),
        Case(
            "wind of a B2 of 0",
            "wind goes as a power of B2 over its median, which is 0: refused",
            air.drawn,
            calm | {"atmosphere.wind_b2_exponent": -0.3, "observations": 40},
            refusal="median B2 of 0",
        ),
    ]


def _strength_cases() -> list[Case]:
    independent = "the residual does not depend on how strong a common mode is"
    scaled = "scaling by powers of two commutes with every step, bit for bit"
    cases = []
    for name in cleaning.ALGORITHMS:
        fine, coarse = (
            partial(cleaning.common_mode, algorithm=name, dtype=dtype) for dtype in (np.float64, np.float32)
        )
        cases += [
            Case(f"atmosphere of 1e6 white noises, {name}", _QUANTA, partial(cleaning.stiff, algorithm=name)),
            Case(f"common mode of 1e6, {name}", independent, fine),
            Case(f"common mode of 1e6 in float32, {name}", f"{independent}; {_QUANTA}", coarse),
            Case(f"all responsivities times 2^-20 and 2^20, {name}", scaled, partial(cleaning.scaled, algorithm=name)),
        ]
    decades = "average subtraction commutes with each detector's responsivity, to rounding once converged"
    return cases + [
        Case("common mode of 1e6, spectral", f"{_WHITE}, and a ninth of another band's", cleaning.spectral),
        Case("responsivities over six decades", decades, cleaning.decades),
    ]


def _size_cases() -> list[Case]:
    many, alone = {"instrument.layout.rings": 26}, {"instrument.layout.rings": 0}
    short = {"scan.duration": "0.8 s", "excess": None, "cleaning.algorithm": "pca"}
    bare = alone | {"cleaning.algorithm": "none"}
    strong = np.concatenate([np.exp(np.linspace(-0.3, 0.3, 35)), [1e4, 1e4]])
    eight = partial(cleaning.white_left, n_samp=8, n_scans=100)
    return [
        *(
            Case(f"2107 detectors, {name}", _WHITE, partial(cleaning.white_left, algorithm=name), many, slow=True)
            for name in ("average", "quadratic", "pca")
        ),
        *(
            Case(f"scans of 8 samples, {name}", _WHITE, partial(eight, algorithm=name))
            for name in ("average", "planar", "quadratic")
        ),
        Case(
            "scans of 8 samples, pca",
            "7 eigenvalues are too few for one to stand out at 3 sigma: refused",
            air.drawn,
            short,
            refusal="no mode can stand out",
        ),
        Case("scans of an hour, planar", _WHITE, partial(cleaning.white_left, algorithm="planar", n_samp=36_000)),
        Case("one detector", "the stream less its mean, exactly", cleaning.one_detector, bare),
        Case("one detector, average", "its own average: refused", air.drawn, alone, refusal="'average' needs 2"),
        Case("two equal modes, pca", "both stand out", partial(cleaning.equal_modes, singular=strong, expected=2)),
        Case(
            "all modes equal, pca", "none stands out", partial(cleaning.equal_modes, singular=np.ones(37), expected=0)
        ),
    ]


def _geometry_cases() -> list[Case]:
    # Independent terms of each geometry: 1 and x on a line, all but one of second order on a circle.
    most: dict[str, tuple[str, ...]]
    most = {"a line": ("average", "wind", "pca"), "nearly a line": ("average", "wind", "pca")}
    most |= {"a circle": ("average", "planar", "wind", "pca"), "two clusters": tuple(cleaning.ALGORITHMS)}
    cases = []
    for places, held in most.items():
        for name in cleaning.ALGORITHMS:
            check = partial(cleaning.white_left, algorithm=name, places=places)
            if name in held:
                cases.append(Case(f"detectors on {places}, {name}", _WHITE, check))
            else:
                why = "positions, to a millionth, do not tell the terms apart: refused"
                cases.append(Case(f"detectors on {places}, {name}", why, check, refusal="independent templates"))
        why = "a template of n detectors takes 1 / n of white noise, to 4 sigma"
        cases.append(Case(f"detectors on {places}, local", why, partial(cleaning.local, places=places)))
    return cases


def _stream_cases() -> list[Case]:
    pitch, twice = hexagon(15, 2e-4), np.repeat(hexagon(2, 2e-4), 2, axis=0)
    cases = [
        Case(
            f"excess of index {index}",
            "variance below the band limit is as asked for, to 4 sigma",
            streams.excess,
            {"excess.spectral_index": index},
        )
        for index in (0, 1, 4, 10)
    ]
    return cases + [
        Case(
            "excess of index 0 is white", "samples do not correlate", streams.white_excess, {"excess.spectral_index": 0}
        ),
        Case("pixels all in one place", "37 equal pixels: 36 eigenvalues of 0 to rounding", streams.twins),
        *(
            Case(f"eigenvalue of {least:g}", "0 but for rounding", partial(streams.correlation, least=least))
            for least in (0.0, -1e-14)
        ),
        Case(
            "eigenvalue of -1e-3",
            "no correlation matrix: refused",
            partial(streams.correlation, least=-1e-3),
            refusal="none below 0 is allowed",
        ),
        Case("gains over six decades", "the profile of correlation is free of gains", streams.gains),
        Case("profile of 721 detectors", "linear least squares gives it back", partial(streams.pairs, places=pitch)),
        Case(
            "two detectors in one place",
            "their separation sets no scale: refused",
            partial(streams.pairs, places=twice),
            refusal="in one place",
        ),
    ]


def _map_cases() -> list[Case]:
    return [
        Case("map with unhit pixels", "0 where nothing was seen", streams.unhit),
        Case("likelihood map under 1e6", "a common mode weighs nothing, however strong", streams.likelihood_map),
        Case(
            "bins too narrow",
            "no mode in one: refused",
            air.drawn,
            {"score": _score(ell_bin=1)},
            refusal="score.ell_bin",
        ),
        Case(
            "patch too small",
            "no mode in its bins: refused",
            air.drawn,
            {"score": _score(size="1 arcmin")},
            refusal="ell_bin",
        ),
        Case(
            "scored range beyond the beam",
            "no signal passes: refused",
            air.drawn,
            {"score": _score(), "instrument.beam_fwhm": "2 deg"},
            refusal="score.ell_min",
        ),
        Case(
            "scored range beyond the map",
            "its pixels hold no such multipole: refused",
            air.drawn,
            {"score": _score(ell_min=400_000, ell_max=500_000)},
            refusal="score.ell_max",
        ),
    ]


def _bound_cases() -> list[Case]:
    finite = "each key at its bound: streams are finite 32-bit numbers, without a warning"
    beyond = "beyond any telescope or air: refused with the key"
    most: dict[str, Any]
    most = {
        "atmosphere.b2": "[1e24] mK2 rad(-5/3)",
        "fixed_pointing.elevation": "5 deg",
        "excess.variance": "[1e12] mK2",
        "detector.psd": "1e12 mK2 / Hz",
        "sky": {"cmb_band_power": "1e15 uK2", "point_sources": [_SOURCE | {"peak": "1e6 K"}]},
    }
    least = {
        "atmosphere.b2": "[1e-24] mK2 rad(-5/3)",
        "excess.variance": "[1e-12] mK2",
        "detector.psd": "1e-12 mK2 / Hz",
        "sky": {"cmb_band_power": "1e-30 uK2"},
    }
    zenith = {"fixed_pointing": None, "schedule": _MAUNA_KEA, "field.dec": "19.8 deg", "observations": 1}
    behind = {"sky": {"cmb_band_power": "0 uK2", "point_sources": [_SOURCE | {"ra": "20h49m12s", "dec": "-44d50m24s"}]}}
    refused: list[tuple[str, dict[str, Any], str]]
    refused = [
        ("elevation of 0.0015 deg", {"fixed_pointing.elevation": "0.0015 deg"}, "5 deg or more"),
        ("white noise of 1e80", {"detector.psd": "1e80 mK2 / Hz"}, "detector.psd"),
        ("excess of 1e80", {"excess.variance": "[1e80] mK2"}, "excess.variance"),
        ("B2 of 1e30", {"atmosphere.b2": "[1e30] mK2 rad(-5/3)"}, "atmosphere.b2"),
        ("layer below the telescope's width", {"atmosphere.layer_height": "5 m"}, "no less than the aperture"),
        ("beam of 1e-300 rad", {"instrument.beam_fwhm": "1e-300 rad"}, "instrument.beam_fwhm"),
        ("map of 50,000 pixels a side", {"map.pixel": "0.08 arcsec"}, "map.pixel"),
        ("scans through the zenith", zenith, "the sky turns by"),
        ("source behind the tangent plane", behind, "180 deg from the field's centre"),
    ]
    return [
        Case("every level at its largest", finite, air.drawn, most, slow=True),
        Case("every level at its smallest", finite, air.drawn, least),
        *(Case(name, beyond, air.drawn, keys, refusal=words) for name, keys, words in refused),
    ]


_SOURCE = {"ra": "08h49m12s", "dec": "+44d50m24s", "peak": "1 K"}
_MAUNA_KEA = {
    "latitude": "19.8 deg",
    "longitude": "-155.5 deg",
    "height": "4070 m",
    "first_night": "2003-10-28",
    "nights": 1,
    "max_hour_angle": "3 hourangle",
    "min_elevation": "40 deg",
}


def _score(**keys: Any) -> dict[str, Any]:
    score = {"size": "12 arcmin", "taper_fraction": 0.5, "ell_bin": 2000, "ell_min": 4000, "ell_max": 12_000}
    score |= {"jackknives": 4, "white_noise_above": "2.5 Hz", "noise_only_sets": []}
    return score | {"signal_sims": {"skies": 2, "observations": 2, "band_power": "1000 uK2"}} | keys


CASES: tuple[Case, ...] = (
    *_layer_cases(),
    *_layer_refusals(),
    *_weather_cases(),
    *_strength_cases(),
    *_size_cases(),
    *_geometry_cases(),
    *_stream_cases(),
    *_map_cases(),
    *_bound_cases(),
)
