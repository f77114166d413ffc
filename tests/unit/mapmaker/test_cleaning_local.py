"""Localized templates: twin, who is a neighbour, planted local signals."""

import numpy as np
import pytest

from mapmaker.cleaning import LocalOptions, TemplateOptions, clean, clean_in_order
from mapmaker.cleaning.local import neighbourhoods
from mapmaker.timestreams import FocalPlane
from tests import naive

PITCH = 2e-4


def _plane(x, y):
    return FocalPlane(x_rad=np.asarray(x, dtype=float), y_rad=np.asarray(y, dtype=float), fwhm_rad=3e-4)


def _hexagons(rings, turn_rad=0.3):
    """A hexagonal array, turned so that positions are rounded."""
    steps = [(i, j) for i in range(-rings, rings + 1) for j in range(-rings, rings + 1) if abs(i + j) <= rings]
    place = PITCH * np.array([i + 0.5 * j + 1j * j * np.sqrt(0.75) for i, j in steps]) * np.exp(1j * turn_rad)
    return _plane(place.real, place.imag)


def _clean(data, plane, reach=1.2):
    return clean("local", data, np.array([[0, data.shape[1]]]), plane, options=LocalOptions(reach))


@pytest.mark.parametrize("reach", [1.2, 1.8, 6.0])
def test_equals_the_loop_over_detectors(reach):
    rng = np.random.default_rng(0)
    plane = _plane(*rng.uniform(-1e-3, 1e-3, (2, 40)))
    data = rng.standard_normal((40, 30)) + 5 * rng.standard_normal(30)
    cleaned = _clean(data, plane, reach)
    np.testing.assert_allclose(cleaned.data_mk, naive.local_cleaning(data, plane.x_rad, plane.y_rad, reach), atol=1e-12)
    np.testing.assert_array_equal(cleaned.responsivity, 1)
    assert cleaned.removed[0] == 1 and cleaned.iterations[0] == 0


def test_hexagons_have_six_neighbours_and_three_at_the_corners():
    index = neighbourhoods(_hexagons(3), 1.2)
    count = np.sum(index < 37, axis=1) - 1
    assert np.array_equal(np.bincount(count), [0, 0, 0, 6, 12, 0, 19])
    assert all(i in index[i] for i in range(37))


def test_no_more_than_the_six_nearest():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-1e-3, 1e-3, (2, 50))
    index = neighbourhoods(_plane(x, y), 1e3)
    assert index.shape == (50, 7)
    for i in range(50):
        assert set(index[i]) == set(np.argsort(np.hypot(x - x[i], y - y[i]))[:7])


def test_detectors_at_one_place_are_neighbours():
    """Pairs at two places: the separation that counts is that of the places."""
    index = neighbourhoods(_plane([0, 0, PITCH, PITCH, 10 * PITCH], [0, 0, 0, 0, 0]), 1.2)
    assert [set(row) - {5} for row in index] == 4 * [{0, 1, 2, 3}] + [{4}]


@pytest.mark.parametrize(("dtype", "level"), [(np.float64, 1e-12), (np.float32, 1e-6)])
def test_planted_local_signals_vanish(dtype, level):
    """Two groups of three, each with a signal of its own and detectors' own gains; a lone detector keeps its own."""
    rng = np.random.default_rng(2)
    corner = PITCH * np.array([0, 1, 0.5 + 1j * np.sqrt(0.75)])
    place = np.concatenate([corner, corner + 10 * PITCH, [30 * PITCH]])
    signal = np.repeat(rng.standard_normal((3, 50)), [3, 3, 1], axis=0)
    data = ((1 + 0.1 * rng.standard_normal((7, 1))) * signal).astype(dtype)
    cleaned = _clean(data, _plane(place.real, place.imag)).data_mk
    assert np.abs(cleaned[:6]).max() < level * np.abs(data).max()
    np.testing.assert_allclose(cleaned[6], data[6] - data[6].mean(), atol=1e-6 if dtype is np.float32 else 1e-14)


def test_template_that_cancels_is_not_fitted():
    data = np.random.default_rng(3).standard_normal(20) * np.array([[1.0], [-1.0]])
    cleaned = _clean(data, _plane([0, PITCH], [0, 0]))
    np.testing.assert_allclose(cleaned.data_mk, data - data.mean(axis=1, keepdims=True), atol=1e-14)
    assert cleaned.kept.all()


def test_nothing_is_left_to_average_after_local_templates():
    """They take the common signal: responsivities do not converge on what is left."""
    rng = np.random.default_rng(4)
    plane, bounds = _hexagons(3), np.array([[0, 150]])
    data = 10 * rng.standard_normal(150) + rng.standard_normal((37, 150))
    steps = [("local", LocalOptions()), ("average", TemplateOptions(1e-8, 100))]
    assert clean_in_order(steps[::-1], data, bounds, plane).kept.all()
    assert not clean_in_order(steps, data, bounds, plane).kept.any()


def test_one_place_has_no_neighbours():
    with pytest.raises(ValueError, match="3 detectors at 1 place have no neighbours, at least 2 are needed"):
        _clean(np.ones((3, 10)), _plane(np.zeros(3), np.zeros(3)))


@pytest.mark.parametrize("reach", [1.0, 0.0, np.nan, np.inf])
def test_options_out_of_range(reach):
    with pytest.raises(ValueError, match="neighbour_radius: found .*; a finite number above 1 is expected"):
        LocalOptions(reach)
