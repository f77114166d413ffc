"""Closed form of maps that are solved for: (P^T W P) m = P^T W F d, for cleaning F and noise weights W.

In the mode k of the map, seen by the detectors at r with s = exp(i k.r) at the frequency f, the normal matrix of one
observation is z = s^H W s / n_det, noise of cross-spectra C adds Q = s^H W F C F^H W s / n_det, and a signal seen with
responsivities r adds y = s^H W F (r s) / n_det. All scans of a place add up before the division,

    N = sum t Q / (sum t z)^2,    T = |sum t y|^2 / (sum t z)^2,

over observations, speeds and directions, so modes along one direction of scans are those of the scans across it. With
W = C^-1 and no cleaning N^-1 = sum t s^H C^-1 s / n_det, the noise of a maximum-likelihood map. Modes are taken as
independent: a normal matrix that couples them, by pieces of scans or uneven hits, is that of their mean.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from surveysim.forecasting.mode_response import Modes
from surveysim.forecasting.track_motions import TrackMotions
from surveysim.forecasting.turned_modes import turned_means


@dataclass(frozen=True, eq=False)
class SolvedSums:
    """Sums over the observations of a survey, for scans along the x axis at each speed of the track.

    Attributes
    ----------
    normal : (n_speed, n_bin, n_angle)
        Normal matrix, z.
    noise : (n_speed, n_bin, n_angle)
        Noise Q [mK^2 a sample].
    signal : (n_speed, n_bin, n_angle)
        Amplitude y of the signal.
    """

    normal: np.ndarray
    noise: np.ndarray
    signal: np.ndarray


@dataclass(frozen=True, eq=False)
class ObservationNoise:
    """Noise of the single observations of a survey, averaged over azimuth and speeds.

    Attributes
    ----------
    noise, layer : (n_obs, n_bin)
        Noise variance a sample, and the layers' part of it [mK^2].
    taken : (n_bin,)
        Fraction of the weight of the modes that baselines, or the modes of a measured noise model, take.
    """

    noise: np.ndarray
    layer: np.ndarray
    taken: np.ndarray


def solved_bins(modes: Modes, sums: SolvedSums, tracks: TrackMotions) -> tuple[np.ndarray, np.ndarray]:
    """Noise variance a sample [mK^2] and transfer function of the map, (n_bin,) each."""
    noise, signal = np.zeros(modes.wave.shape), np.zeros(modes.wave.shape)
    of_track = tracks.directions, tracks.place_share
    for weight, normal, added, seen in _together(modes, sums, *of_track):
        square = normal.real**2
        noise += np.tensordot(weight, np.divide(added.real, square, out=np.zeros(square.shape), where=square > 0), 1)
        power = seen.real**2 + seen.imag**2
        signal += np.tensordot(weight, np.divide(power, square, out=np.zeros(square.shape), where=square > 0), 1)
    return modes.mean(noise.ravel()), modes.mean(signal.ravel())


def _together(
    modes: Modes, sums: SolvedSums, directions: np.ndarray, share: np.ndarray
) -> Iterator[tuple[np.ndarray, ...]]:
    """Weight of each direction, and means of normal matrix, noise and signal over the scans of each place."""
    values = (sums.normal, sums.noise, sums.signal)
    found = [turned_means(modes, np.asarray(item, complex), directions, share) for item in values]
    for (weight, normal), (_, noise), (_, signal) in zip(*found, strict=True):
        yield weight, normal, noise, signal
