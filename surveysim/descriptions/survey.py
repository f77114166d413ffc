"""A first survey for a camera that has none, scaled with its beam and its field of view."""

import math
from dataclasses import dataclass

from surveysim.descriptions.scene_text import Row, Table, measured

_ASSUMED = "assumed"
_LAYER_M = 1000.0  # height of turbulence above a site, for the width of a beam in it
_WIDEST_RAD = math.radians(10)  # maps are flat


@dataclass(frozen=True)
class View:
    """Widths of a camera on the sky [rad], of its beam and of its field of view, and its aperture [m]."""

    beam_rad: float
    field_rad: float
    aperture_m: float


def survey_tables(view: View) -> list[Table]:
    """Tables [scan], [cleaning], [map] and [score]: a square field that the array covers in 20 scans or more."""
    beam = view.beam_rad
    side = min(max(40 * beam, 1.2 * view.field_rad), _WIDEST_RAD)
    step = max(min(side / 20, view.field_rad / 2), beam / 2)
    seconds, size = 3.0, 0.65 * side
    speed = side / seconds
    return [
        Table(
            "[scan]",
            (
                Row("speed", _angle(speed, " / s"), f"{_ASSUMED}: the field in {seconds:g} s"),
                Row("scans", math.ceil(side / step), f"{_ASSUMED}: a square field"),
                Row("duration", f"{seconds:g} s", _ASSUMED),
                Row("turnaround", "2 s", _ASSUMED),
                Row("step", _angle(step), _ASSUMED),
                Row("dither", _angle(step), f"{_ASSUMED}: one step, full range"),
                Row("sample_rate", measured(3 * speed / beam, "Hz"), f"{_ASSUMED}: three samples a beam"),
            ),
        ),
        Table(
            "[cleaning]",
            (
                Row("algorithm", "planar", _ASSUMED),
                Row("responsivities", "observation", f"{_ASSUMED}: one fit to the scans of an observation"),
                Row("tolerance", 1e-8, _ASSUMED),
                Row("max_iterations", 100, _ASSUMED),
            ),
        ),
        Table("[map]", (Row("pixel", _angle(beam / 3), f"{_ASSUMED}: a third of the beam"),)),
        Table(
            "[score]",
            (
                Row("size", _angle(size), f"{_ASSUMED}: within the field"),
                Row("taper_fraction", 0.5, _ASSUMED),
                Row("ell_bin", _two_digits(8 / size), _ASSUMED),
                Row("ell_min", _two_digits(25 / size), _ASSUMED),
                Row("ell_max", _two_digits(3.5 / beam), f"{_ASSUMED}: where the beam leaves a few per cent"),
                Row("jackknives", 64, "sign-flipped co-adds that measure the noise"),
                Row("white_noise_above", measured(speed / beam, "Hz"), f"{_ASSUMED}: above the beam"),
                Row("noise_only_sets", ["uncorrelated"], "what the survey would be worth without correlations"),
            ),
        ),
        Table(
            "[score.signal_sims]",
            (Row("skies", 4, _ASSUMED), Row("observations", 2, _ASSUMED), Row("band_power", "1000 uK2", _ASSUMED)),
        ),
    ]


def layer_aperture_m(view: View) -> float:
    """Width of a pixel's beam in the turbulent layer [m]: the aperture, or the beam's spread where it is wider."""
    return max(view.aperture_m, view.beam_rad * _LAYER_M)


def _angle(radians: float, per: str = "") -> str:
    for unit, size in (("deg", 1.0), ("arcmin", 60.0)):
        value = math.degrees(radians) * size
        if value >= 1:
            return measured(value, f"{unit}{per}")
    return measured(math.degrees(radians) * 3600, f"arcsec{per}")


def _two_digits(value: float) -> int:
    return max(1, int(float(f"{value:.2g}")))
