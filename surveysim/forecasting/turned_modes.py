"""Amplitude and noise of map modes as means over scans along many directions."""

from collections.abc import Iterator

import numpy as np

from surveysim.forecasting.mode_response import Modes


def turned_power(modes: Modes, amplitude: np.ndarray, directions: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Power of map modes whose amplitude is a mean over the scans of a place, averaged over places.

    The azimuths of `modes` are densest along and across a scan. The mean over azimuth takes those about each direction
    in turn, by its weight, so narrow features count as much as they are resolved.

    Parameters
    ----------
    modes
    amplitude : (n_speed, n_bin, n_angle)
        Amplitude of `modes` in scans along the x axis; that of the opposite mode is its conjugate.
    directions : (n_place, n_speed, n_direction)
        Weight of the scans of a place; their directions divide half a turn evenly. It sums to 1.
    share : (n_place,)
        Weight of each place; they sum to 1.

    Returns
    -------
    (n_bin,) array
    """
    power = np.zeros(amplitude.shape[1:])
    for weight, mean in turned_means(modes, amplitude, directions, share):
        power += np.tensordot(weight, mean.real**2 + mean.imag**2, 1)
    return modes.mean(power.ravel())


def turned_means(
    modes: Modes, values: np.ndarray, directions: np.ndarray, share: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Average values of map modes over the scans of each place, at the azimuths about each direction in turn.

    Parameters and shapes are those of `turned_power`, with `values` as its amplitude.

    Yields
    ------
    weight : (n_place,)
        Weight of the direction in each place, times that of the place.
    mean : (n_place, n_bin, n_angle)
    """
    _, _, n = directions.shape
    along = np.einsum("psd,p->pd", directions, share)
    used = np.flatnonzero(along.any(axis=0))
    steps = (used[:, None] - used) % n  # to each direction, from beyond the first one where it is before
    turned = dict(zip(found := np.unique(steps), _turned(modes, values, np.pi / n * found), strict=True))
    for number, row in zip(used, steps, strict=True):
        seen = [turned[step].conj() if other > number else turned[step] for other, step in zip(used, row, strict=True)]
        yield along[:, number], np.tensordot(directions[:, :, used].transpose(0, 2, 1), np.array(seen), 2)


def _turned(modes: Modes, amplitude: np.ndarray, turn_rad: np.ndarray) -> np.ndarray:
    """Interpolate the amplitude of modes that are turned further in azimuth by less than half a turn, (n_turn, ...)."""
    angle = np.angle(modes.wave[-1])
    grid = np.concatenate([angle - np.pi, angle, angle + np.pi])
    values = np.concatenate([amplitude.conj(), amplitude, amplitude.conj()], axis=-1)
    place = (angle + turn_rad[:, None])[..., None]
    near = np.searchsorted(grid, place, side="right") + np.arange(-2, 2)  # of a cubic through four nodes
    weight = [
        np.prod(
            [(place[..., 0] - grid[near[..., j]]) / (grid[near[..., i]] - grid[near[..., j]]) for j in others], axis=0
        )
        for i, others in enumerate([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)])
    ]
    return np.moveaxis(sum(values[..., near[..., i]] * weight[i] for i in range(4)), -2, 0)
