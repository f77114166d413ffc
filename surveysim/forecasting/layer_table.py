"""Noise of the layer against its motion: tabulated at a few motions, and interpolated."""

import math
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from surveysim.forecasting.mode_response import LayerWaves
from surveysim.forecasting.observing_conditions import ObservingConditions

_SPEEDS, _DIRECTIONS = 5, 4  # nodes of the layer's motion against the scan
_SINES = 3  # nodes in elevation
_SLOWEST = 0.02  # least relative speed of the table, in scan speeds

# Maps motions (n_draw, n_direction), complex [rad/s], and sines of elevations (n_draw,) to noise (n_draw, n_bin).
LayerNoise = Callable[[np.ndarray, np.ndarray], np.ndarray]


def sine_nodes(conditions: ObservingConditions) -> np.ndarray:
    """Choose sines of elevations that bracket those of all observations."""
    first, last = conditions.sine.min(), conditions.sine.max()
    return np.linspace(first, last * (1 + 1e-6), _SINES if last > 1.01 * first else 2)


def stream_frequencies(layer: LayerWaves, motion: complex) -> np.ndarray:
    """Frequency [Hz] of each wavevector of the layer in the streams."""
    return (layer.alpha * np.conj(motion)).real


def interpolate_motions(
    motion: np.ndarray, sines: np.ndarray, *, speed_rad_s: float, noise: Callable[[complex], list[np.ndarray]]
) -> LayerNoise:
    """Tabulate `noise` at a few speeds, directions and elevations, and interpolate its mean over the motions of a draw.

    Parameters
    ----------
    motion : (n_draw, n_direction)
        Motions that the table brackets. Mirrored directions are taken as one, because the array has many angles to
        them. Others take the nearest value.
    sines
        Elevations of the table, of `sine_nodes`.
    speed_rad_s
        Speed of the scan.
    noise
        Function of a motion: noise (n_bin,) at each of these elevations.
    """
    slowest = _SLOWEST * speed_rad_s

    def place(motion: np.ndarray, sine: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        logs = np.broadcast_to(np.log(sine)[:, None], motion.shape)
        return np.log(np.maximum(np.abs(motion), slowest)), np.abs(np.angle(motion)), logs

    speed, turn, _ = place(motion, np.ones(len(motion)))
    speeds = np.linspace(speed.min(), speed.max() + 1e-6, _SPEEDS if np.ptp(speed) > 1e-3 else 2)
    turns = np.linspace(turn.min(), turn.max() + 1e-6, _DIRECTIONS if np.ptp(turn) > 1e-3 else 2)
    table = np.array([[noise(np.exp(s + 1j * t)) for t in turns] for s in speeds])
    nodes = speeds, turns, np.log(sines)
    logs = np.log(np.maximum(table, 1e-300))

    def between(motion: np.ndarray, sine: np.ndarray) -> np.ndarray:
        return np.exp(_linear(nodes, logs, place(motion, sine))).mean(axis=1)

    return between


def _linear(nodes: Sequence[np.ndarray], table: np.ndarray, places: Sequence[np.ndarray]) -> np.ndarray:
    """Interpolate between the nodes of each axis of a table (..., n_bin), at places of one shape; nearest beyond."""
    below, share = [], []
    for node, place in zip(nodes, places, strict=True):
        inside = np.clip(place, node[0], node[-1])
        below.append(np.clip(np.searchsorted(node, inside, side="right") - 1, 0, len(node) - 2))
        share.append((inside - node[below[-1]]) / (node[below[-1] + 1] - node[below[-1]]))
    found = np.zeros((*places[0].shape, table.shape[-1]))
    for corner in product((0, 1), repeat=len(nodes)):
        weight = math.prod(part if up else 1 - part for part, up in zip(share, corner, strict=True))
        found += table[tuple(start + up for start, up in zip(below, corner, strict=True))] * weight[..., np.newaxis]
    return found
