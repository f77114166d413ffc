"""Thin layers beside a slab of three-dimensional turbulence, by quadrature (`docs/layers_study.py`)."""

from math import gamma, pi, sqrt

import numpy as np
import pytest

from docs.layers_study import (
    APERTURE_M,
    FIELD_RAD,
    OUTER_SCALE_M,
    PAGE,
    Slab,
    departures,
    measures,
    slab_layers,
    with_tables,
)
from surveysim.atmosphere.thin_screen import Screen, structure_function


@pytest.fixture(scope="module")
def true():
    return measures(Slab())


def test_two_layers_of_a_slab_are_enough(true):
    """The amplitude B2 = c h^(b - 2) dh has no free constant. One layer is not enough."""
    one, two, three = (departures(slab_layers(Slab(), number, OUTER_SCALE_M), true) for number in (1, 2, 3))
    assert np.abs(two[:4]).max() < 0.013 and np.abs(two[5]) < 0.025
    assert np.allclose(two, three, atol=2e-3)
    assert one[2] < -0.08 and one[3] < -0.13 and one[4] == pytest.approx(-1)


def test_a_sheet_is_a_layer_of_index_8_3():
    """Far thinner than the beam, the slab is two-dimensional: its spectrum is the integral along the line of sight."""
    thickness, height = 0.1, 1000.0
    b2 = thickness**2 * sqrt(pi) * gamma(4 / 3) / gamma(11 / 6) * height ** (8 / 3 - 2)
    slab, screen = Slab(height - thickness / 2, height + thickness / 2), Screen(8 / 3, APERTURE_M / height)
    for apart in FIELD_RAD * np.array([0.1, 1.0]):
        assert slab.structure(apart, 0.0) == pytest.approx(b2 * structure_function(screen, apart), rel=0.01)


@pytest.mark.slow
def test_the_page_has_the_tables_of_today():
    text = PAGE.read_text(encoding="utf-8")
    assert with_tables(text) == text
