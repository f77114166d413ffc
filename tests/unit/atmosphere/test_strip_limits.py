"""Checks that strips can be built: strips that are trusted to be built unseen."""

from math import inf

import pytest

from surveysim.atmosphere import strip_limits
from surveysim.atmosphere.screen_simulation import StripCache
from surveysim.atmosphere.strip_factors import N_X_MAX, build_strip, factorize_dense, longest_track
from surveysim.atmosphere.thin_screen import Screen
from surveysim.atmosphere.wide_strips import factorize_wide
from surveysim.runtime.errors import OutOfRangeError


@pytest.mark.parametrize("outer_scale", [1.0, 9.0, 300.0, inf])
@pytest.mark.parametrize("index", [0.01, 1.0, 8 / 3, 11 / 3, 3.9])
@pytest.mark.parametrize("n_x, n_lane", [(128, 2), (256, 25), (2048, 11)])
def test_long_strips_need_no_doubling(n_x, n_lane, index, outer_scale):
    """At the limits above which strips are not tried."""
    step = strip_limits._LONG_BEAMS / n_x
    strip = build_strip(
        Screen(index, 1.0, outer_scale),
        length_rad=longest_track(n_x, step),
        half_width_rad=0.5 * (n_lane - 1) * step,
        step_rad=step,
    )
    assert strip.n_x == n_x


@pytest.mark.slow
@pytest.mark.parametrize("outer_scale", [64.0, 300.0, inf])
@pytest.mark.parametrize("index", [0.01, 3.7])
@pytest.mark.parametrize("n_x, n_lane", [(1024, 49), (1024, 256), (2048, 150)])
def test_wide_strips_of_64_beams_need_no_doubling(n_x, n_lane, index, outer_scale):
    """At the limits above which they are not tried."""
    step = strip_limits._LONG_BEAMS / n_x
    assert step >= strip_limits._WIDE_STEP and index <= strip_limits._WIDE_INDEX
    strip = build_strip(
        Screen(index, 1.0, outer_scale),
        length_rad=longest_track(n_x, step),
        half_width_rad=0.5 * (n_lane - 1) * step,
        step_rad=step,
        factorize=factorize_wide,
    )
    assert (strip.n_x, strip.n_lane) == (n_x, n_lane)


def _strips(index, *, lanes=10, step=0.1):
    return StripCache(Screen(index, 1.0), half_width_rad=0.5 * (lanes - 1) * step, step_rad=step)


def test_ordinary_strips_are_not_tried(monkeypatch):
    monkeypatch.setattr(strip_limits, "build_strip", None)
    assert strip_limits.check_strip(_strips(11 / 3), 8.0) == (256 // 2 + 1) * 10**2


@pytest.mark.parametrize("index, lanes, step", [(3.95, 10, 0.1), (11 / 3, 10, 60 / N_X_MAX), (11 / 3, 700, 0.1)])
def test_others_are_tried(monkeypatch, index, lanes, step):
    """A steep spectrum, a fine lattice, and a wide strip."""
    tried = []
    monkeypatch.setattr(strip_limits, "_try", lambda *arguments, n_x, **others: tried.append(n_x))
    monkeypatch.setattr(strip_limits, "_used", lambda *arguments: 10)
    strip_limits.check_strip(_strips(index, lanes=lanes, step=step), 8.0 * step / 0.1)
    assert tried == [256]


def _wide(index, *, lanes, step=1 / 20):
    return StripCache(Screen(index, 1.0), half_width_rad=0.5 * (lanes - 1) * step, step_rad=step, wide=True)


def test_long_wide_strips_are_trusted_and_others_built():
    """The number is that of points, which need as much memory as elements of matrices."""
    trusted, steep, short = _wide(11 / 3, lanes=300), _wide(3.9, lanes=60), _wide(11 / 3, lanes=60)
    assert strip_limits.check_strip(trusted, 40.0) == 4096 * 300
    assert not trusted.strips
    strip_limits.check_strip(steep, 40.0)
    strip_limits.check_strip(short, 4.0)
    assert steep.strips and short.strips


@pytest.mark.parametrize("lanes, length", [(2049, 40.0), (1100, 400.0)])
def test_wide_strips_that_are_too_large_are_refused(lanes, length):
    with pytest.raises(OutOfRangeError, match="found a rectangle of the layer with .* 2048 across"):
        strip_limits.check_strip(_wide(11 / 3, lanes=lanes), length)


def test_narrow_rectangles_are_those_of_straight_scans():
    assert _wide(11 / 3, lanes=48).factorize is StripCache(Screen(11 / 3, 1.0), 30.0, 0.05).factorize is factorize_dense
