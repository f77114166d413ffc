"""Table of the layer's noise against scipy's interpolation."""

from types import SimpleNamespace

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from surveysim.forecasting.layer_table import interpolate_motions, sine_nodes


def test_interpolation_is_linear_in_logarithms_and_angles():
    """At motions of the table and outside it, between two and three elevations."""
    rng = np.random.default_rng(5)
    for sine in (rng.uniform(0.4, 0.9, 12), np.full(12, 0.7)):
        motion = rng.normal(size=(12, 6)) + 1j * rng.normal(size=(12, 6))
        asked, of_table = [], sine_nodes(SimpleNamespace(sine=sine))

        def noise(one, asked=asked, heights=of_table):
            asked.append(one)
            return [np.array([abs(one) ** -2 * (2 + np.angle(one)), abs(one)]) / height for height in heights]

        found = interpolate_motions(motion, of_table, speed_rad_s=0.1, noise=noise)
        speeds = np.unique(np.round(np.log(np.abs(asked)), 12))
        turns = np.unique(np.round(np.abs(np.angle(asked)), 12))
        nodes = speeds, turns, np.log(of_table)
        assert [len(node) for node in nodes] == [5, 4, 3 if np.ptp(sine) else 2]
        table = np.log([[noise(np.exp(s + 1j * t)) for t in turns] for s in speeds])
        scipys = RegularGridInterpolator(nodes, table)
        others = 3 * rng.normal(size=(20, 6)) + 2j * rng.normal(size=(20, 6))
        heights = rng.uniform(0.3, 1, 20)
        places = np.log(np.abs(others)), np.abs(np.angle(others)), np.log(heights)[:, None] + np.zeros(others.shape)
        inside = [np.clip(item, node[0], node[-1]) for item, node in zip(places, nodes, strict=True)]
        expected = np.exp(scipys(np.stack(inside, axis=-1))).mean(axis=1)
        np.testing.assert_allclose(found(others, heights), expected, rtol=1e-9)
