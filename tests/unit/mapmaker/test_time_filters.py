"""Filters in time: response against definitions, linearity, scans apart, modes, memory, bad options."""

import numpy as np
import pytest

from mapmaker.cleaning import HighpassOptions, NotchOptions, TimePolynomialOptions, clean, clean_in_order
from mapmaker.cleaning.time_filters import time_modes
from mapmaker.errors import InsufficientDataError
from mapmaker.timestreams import FocalPlane

RATE, N_SAMP, N_DET = 10.0, 150, 4
BOUNDS = np.array([[0, N_SAMP], [N_SAMP, 2 * N_SAMP]])
PLANE = FocalPlane(*np.random.default_rng(0).uniform(-1e-3, 1e-3, (2, N_DET)), fwhm_rad=1.5e-4)
TIME_S = (np.arange(N_SAMP) - (N_SAMP - 1) / 2) / RATE
FILTERS = {
    "highpass": HighpassOptions(0.2, RATE),
    "notch": NotchOptions((1.4, 3.0), (0.0, 0.3), RATE),
    "time_polynomial": TimePolynomialOptions(3),
}
BUTTERWORTH = HighpassOptions(0.2, RATE, 2)


def _clean(name, data, options=None, bounds=BOUNDS):
    return clean(name, data, bounds, PLANE, options=options or FILTERS[name])


def _streams(seed=1):
    return np.random.default_rng(seed).standard_normal((N_DET, 2 * N_SAMP))


@pytest.mark.parametrize("name", FILTERS)
def test_filters_are_projections(name):
    once = _clean(name, _streams())
    np.testing.assert_allclose(_clean(name, once.data_mk).data_mk, once.data_mk, atol=1e-12)
    means = once.data_mk.reshape(N_DET, 2, N_SAMP).mean(axis=2)
    np.testing.assert_allclose(means, 0, atol=1e-13)
    rank = np.linalg.matrix_rank(_clean(name, np.tile(np.eye(N_SAMP)[:N_DET], (1, 2))).data_mk[:, :N_SAMP])
    assert rank == N_DET


@pytest.mark.parametrize(("name", "options"), [*FILTERS.items(), ("highpass", BUTTERWORTH)])
def test_modes_are_those_of_the_filter(name, options):
    """The columns of the operator, from impulses, against one minus its modes, which omit losses below 0.1 %."""
    found = time_modes(options, N_SAMP)
    np.testing.assert_allclose(found.modes.T @ found.modes, np.eye(len(found.loss)), atol=1e-12)
    np.testing.assert_allclose(found.modes[::-1], found.modes * np.where(found.odd, -1, 1), atol=1e-12)
    plane = FocalPlane(*np.zeros((2, N_SAMP)), fwhm_rad=1e-4)
    operator = clean(name, np.eye(N_SAMP), BOUNDS[:1], plane, options=options).data_mk
    expected = np.eye(N_SAMP) - 1 / N_SAMP - (found.modes * found.loss) @ found.modes.T
    difference = np.linalg.norm(operator - expected, ord=2)
    assert difference < (1e-3 if options is BUTTERWORTH else 1e-12)


@pytest.mark.parametrize(("name", "options"), [*FILTERS.items(), ("highpass", BUTTERWORTH)])
def test_nothing_leaks_between_scans(name, options):
    data = _streams()
    other = data.copy()
    other[:, N_SAMP:] *= 1e6
    first, second = (_clean(name, item, options).data_mk[:, :N_SAMP] for item in (data, other))
    np.testing.assert_array_equal(first, second)


def test_sharp_highpass_removes_the_cosines_below_the_corner_and_no_others():
    """Those of a scan of 15 s are at multiples of 1/30 Hz: five are below 0.2 Hz."""
    cosines = np.cos(np.pi / N_SAMP * np.outer([1, 3, 5, 6], np.arange(N_SAMP) + 0.5))
    cleaned = _clean("highpass", cosines, bounds=BOUNDS[:1])
    np.testing.assert_allclose(cleaned.data_mk[:3], 0, atol=1e-13)
    np.testing.assert_allclose(cleaned.data_mk[3], cosines[3], atol=1e-13)
    np.testing.assert_array_equal(cleaned.removed, 5)


@pytest.mark.parametrize("order", [1, 2, 5])
def test_butterworth_leaves_its_power_of_each_cosine(order):
    """Half at the corner, which is the sixth cosine, and ten (order) decibels less an octave below."""
    cosines = np.cos(np.pi / N_SAMP * np.outer([3, 6, 12, 100], np.arange(N_SAMP) + 0.5))
    cleaned = _clean("highpass", cosines, HighpassOptions(0.2, RATE, order), BOUNDS[:1]).data_mk
    left = np.sum(cleaned**2, axis=1) / np.sum(cosines**2, axis=1)
    np.testing.assert_allclose(left, 1 / (1 + (6 / np.array([3, 6, 12, 100])) ** (2.0 * order)), rtol=1e-10)


def test_highpass_does_not_see_the_step_between_the_ends_of_a_scan():
    """A straight line from -1 to 1: of its power 1 / k^4 is in each odd cosine, 0.23 % beyond the fifth."""
    line = np.tile(np.linspace(-1, 1, N_SAMP), (N_DET, 1))
    left = _clean("highpass", line, HighpassOptions(0.17, RATE), BOUNDS[:1]).data_mk
    odd = np.arange(7, 2001, 2.0)
    assert np.mean(left**2) / np.mean(line**2) == pytest.approx(96 / np.pi**4 * np.sum(odd**-4), rel=0.02)


@pytest.mark.parametrize("phase", [0.0, 0.7, 2.0])
def test_notch_removes_a_line_of_any_phase_and_a_band(phase):
    waves = np.cos(2 * np.pi * np.outer([1.4, 2.86, 3.0, 3.14], TIME_S) + phase)
    left = _clean("notch", waves, bounds=BOUNDS[:1]).data_mk
    share = np.sum(left**2, axis=1) / np.sum(waves**2, axis=1)
    assert share[0] < 1e-24 and share[1:].max() < 0.01


def test_notch_leaves_other_frequencies():
    """A line takes sinc^2 of the distance in cycles a scan, of both signs of the frequency."""
    cycles = np.array([10.5, 20.5])
    waves = np.cos(2 * np.pi * np.outer(1.4 + cycles / (N_SAMP / RATE), TIME_S))
    left = clean(
        "notch", waves, BOUNDS[:1], PLANE.subset(np.arange(2)), options=NotchOptions((1.4,), (0.0,), RATE)
    ).data_mk
    share = 1 - np.sum(left**2, axis=1) / np.sum(waves**2, axis=1)
    assert (share < 3 / (np.pi * cycles) ** 2).all() and (share > 0).all()


@pytest.mark.parametrize("order", [1, 4])
def test_polynomials_vanish_and_the_rest_is_orthogonal(order):
    powers = np.vander(TIME_S / TIME_S[-1], order + 1, increasing=True).T
    data = np.vstack([powers, np.random.default_rng(3).standard_normal((1, N_SAMP))])
    plane = FocalPlane(*np.zeros((2, len(data))), fwhm_rad=1e-4)
    cleaned = clean("time_polynomial", data, BOUNDS[:1], plane, options=TimePolynomialOptions(order)).data_mk
    np.testing.assert_allclose(cleaned[:-1], 0, atol=1e-13)
    np.testing.assert_allclose(powers @ cleaned[-1], 0, atol=1e-12)
    assert np.sum(cleaned[-1] ** 2) == pytest.approx(
        np.linalg.lstsq(powers.T, data[-1], rcond=None)[1].item(), rel=1e-10
    )


def test_filters_combine_with_templates_in_any_order():
    """Filters act on time and templates of given responsivities on detectors: they commute."""
    from mapmaker.cleaning import TemplateOptions

    average = ("average", TemplateOptions(1e-8, 100, np.ones(N_DET)))
    highpass = ("highpass", BUTTERWORTH)
    data = _streams() + 100
    one, other = (clean_in_order(steps, data, BOUNDS, PLANE) for steps in ([average, highpass], [highpass, average]))
    np.testing.assert_allclose(one.data_mk, other.data_mk, atol=1e-11)
    np.testing.assert_array_equal(one.removed, 1 + 5)


@pytest.mark.parametrize("name", FILTERS)
def test_dead_detectors_and_large_arrays(name, monkeypatch):
    """Detectors are independent: a dead one stays 0, and chunks of rows give the same bits."""
    from mapmaker import chunks

    data = _streams()
    data[2] = 40.0
    whole = _clean(name, data)
    assert whole.kept.all() and np.abs(whole.data_mk[2]).max() < 1e-12
    monkeypatch.setattr(chunks, "CHUNK_SAMPLES", 2 * N_SAMP)
    np.testing.assert_allclose(_clean(name, data).data_mk, whole.data_mk, atol=1e-13)
    data[3, 10] = np.nan
    np.testing.assert_array_equal(_clean(name, data).kept, [False, True])
    assert not _clean(name, data).data_mk[:, :N_SAMP].any()


def test_bad_options():
    with pytest.raises(ValueError, match="corner_hz: found 5.0; a finite number above 0 and below 5 is expected"):
        HighpassOptions(5.0, RATE)
    with pytest.raises(ValueError, match="order: found 0; an integer of at least 1 and of at most 20 is expected"):
        HighpassOptions(1.0, RATE, 0)
    with pytest.raises(ValueError, match=r"frequencies_hz: found a band from 4.5 to 5.5 Hz; one from 0 to 5 Hz"):
        NotchOptions((5.0,), (1.0,), RATE)
    with pytest.raises(ValueError, match=r"widths_hz: found the shape \(1,\); \(2,\) is expected"):
        NotchOptions((1.0, 2.0), (1.0,), RATE)
    with pytest.raises(InsufficientDataError, match="10 modes in time need scans of 12 samples or more, got 11"):
        _clean("time_polynomial", _streams()[:, :11], TimePolynomialOptions(10), np.array([[0, 11]]))
