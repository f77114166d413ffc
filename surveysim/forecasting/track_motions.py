"""Speeds and directions along the track of the boresight, weighted by what each sample adds to the noise of the map.

A scan that is straight over a map mode k sees it at the frequency f = k.v / 2 pi of the local velocity v, so the noise
in the mode is a mean over the track. The map at x is the mean of the h(x) samples there. Segments of the track have
independent noise, which adds up to the variance

    sum_t taper(x_t)^2 / h(x_t)^2 N(v_t) = int taper^2 / h <N>_x dx,

so each sample counts by taper^2 / hits^2 of its place. The amplitude of the signal is a mean over the samples of a
place, and its power a mean over places.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.forecasting.coverage import Coverage, samples_in_maps
from surveysim.reduction.setup import Setup
from surveysim.runtime.once import keep_last
from surveysim.telescope.pointing import Pointing
from surveysim.telescope.scans import ScanPath
from surveysim.timestreams.simulation import ObservingSetup, boresight_path, observation_path

AZIMUTHS = 32  # bins of direction in half a turn; two directions at a right angle are centres of bins
_SPEEDS, _DIRECTIONS = 4, 8  # nodes of equal weight along a curved track
_SAME_SPEED = 0.1  # relative range of speeds that one node represents
_TRACKS = 8  # of even, and of odd observations, that represent a survey
_CURVATURES = 50  # quantiles
_SLOWEST_RAD_S = 1e-12  # of a boresight at rest
_MOST_SAMPLES = 4000  # of one of them; longer ones are thinned in time


@dataclass(frozen=True)
class TrackMotions:
    """Velocities along the tracks of observations that represent a survey.

    Attributes
    ----------
    straight
        Whether all scans are straight, of one velocity each.
    speed_rad_s : (n_speed,)
        Nodes of the speed.
    share : (n_track, n_speed)
        Weight of each node in the noise of an observation; they sum to 1.
    turn_rad : (n_track, n_speed, n_direction)
        Directions from xi to eta, of equal weight.
    track_of : (n_obs,)
        Track that represents each observation.
    place_share : (n_place,)
        Share of each place in the power of the signal; they sum to 1.
    directions : (n_place, n_speed, AZIMUTHS)
        Distribution of the samples of a place over speed and direction, modulo half a turn; it sums to 1.
    curvature : (n_curvature,)
        Quantiles of equal weight in the noise of the curvature of the track [1/rad].
    """

    straight: bool
    speed_rad_s: np.ndarray
    share: np.ndarray
    turn_rad: np.ndarray
    track_of: np.ndarray
    place_share: np.ndarray
    directions: np.ndarray
    curvature: np.ndarray


@dataclass(frozen=True)
class _Track:
    """Complex velocity and curvature of samples (n,), their weight in the noise, and in places (n, n_place)."""

    velocity: np.ndarray
    curvature: np.ndarray
    noise: np.ndarray
    places: np.ndarray
    straight: bool


@keep_last(1)
def track_motions(setup: Setup) -> TrackMotions:
    """Sample the velocities along the tracks of a survey, weighted as in the map of the first cleaning pipeline."""
    numbers, track_of = representatives(setup.observing)
    tracks = _tracks(setup, numbers)
    bounds, nodes = _speed_nodes(tracks)
    parts = [np.digitize(np.abs(track.velocity), bounds) for track in tracks]
    share, turns = zip(*(_nodes(*item, len(nodes)) for item in zip(tracks, parts, strict=True)), strict=True)
    counts = np.bincount(track_of, minlength=len(tracks))
    found = [_distribution(*item, len(nodes)) for item in zip(tracks, parts, strict=True)]
    directions = np.tensordot(counts, found, 1)
    total = directions.sum(axis=(1, 2))
    seen = total > 0
    return TrackMotions(
        straight=tracks[0].straight,
        speed_rad_s=nodes,
        share=np.array(share),
        turn_rad=np.array(turns),
        track_of=track_of,
        place_share=total[seen] / total.sum(),
        directions=directions[seen] / total[seen, None, None],
        curvature=_curvatures(tracks),
    )


def representatives(observing: ObservingSetup) -> tuple[np.ndarray, np.ndarray]:
    """Choose observations (n_track,) of all parallactic angles, and for each observation (n_obs,) the one like it.

    Even and odd observations, whose patterns may differ, have their own.
    """
    parallactic = observing.angles.parallactic_rad
    middle = parallactic[:, parallactic.shape[1] // 2]
    numbers: list[int] = []
    track_of = np.empty(len(middle), int)
    for first in range(min(2, len(middle))):
        those = np.arange(first, len(middle), 2)
        order = those[np.argsort(middle[those], kind="stable")]
        for alike in np.array_split(order, min(_TRACKS, len(order))):
            track_of[alike] = len(numbers)
            numbers.append(int(alike[len(alike) // 2]))
    return np.array(numbers), track_of


def _tracks(setup: Setup, numbers: np.ndarray) -> list[_Track]:
    paths = [boresight_path(setup.observing, number) for number in numbers.tolist()]
    if all(path.straight for path in paths):
        return [_straight_track(path) for path in paths]
    coverage = Coverage(setup, setup.analysis.pipelines[0])
    return [_curved_track(*observation_path(setup.observing, number), coverage) for number in numbers.tolist()]


def _straight_track(path: ScanPath) -> _Track:
    """Scans, which all places see alike, in place of samples."""
    ones = np.ones(len(path.velocity_rad_s))
    return _Track(path.velocity_rad_s @ [1, 1j], 0 * ones, ones, ones[:, None], True)


def _curved_track(path: ScanPath, pointing: Pointing, coverage: Coverage) -> _Track:
    place = (path.xi_rad + 1j * path.eta_rad).reshape(len(path.mid_time_s), -1)
    seconds = path.time_s[1] - path.time_s[0]
    velocity = np.asarray(np.gradient(place, seconds, axis=1))
    turning = np.abs(np.gradient(np.unwrap(np.angle(velocity), axis=1), seconds, axis=1)).ravel()
    velocity = velocity.ravel()
    used = samples_in_maps(path, -(-len(velocity) // _MOST_SAMPLES))
    seen = coverage.of_samples(pointing, used)
    curvature = turning[used] / np.maximum(np.abs(velocity[used]), _SLOWEST_RAD_S)
    return _Track(velocity[used], curvature, seen.noise, seen.places, False)


def _speed_nodes(tracks: list[_Track]) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (n_speed - 1,) between speeds of equal weight in the noise, and the mean (n_speed,) of each part."""
    speed = np.abs(np.concatenate([track.velocity for track in tracks]))
    weight = np.concatenate([track.noise for track in tracks])
    speed, weight = speed[weight > 0], weight[weight > 0]
    if np.ptp(speed) <= _SAME_SPEED * speed.max():
        return np.zeros(0), np.array([np.median(speed)])
    order = np.argsort(speed)
    speed, until = speed[order], np.cumsum(weight[order])
    bounds = speed[np.searchsorted(until, until[-1] * np.arange(1, _SPEEDS) / _SPEEDS)]
    part = np.digitize(speed, bounds)
    sums = [np.bincount(part, item, _SPEEDS) for item in (weight[order] * speed, weight[order])]
    return bounds, sums[0] / sums[1]


def _curvatures(tracks: list[_Track]) -> np.ndarray:
    """Quantiles of equal weight in the noise of the curvature along all tracks."""
    curvature = np.concatenate([track.curvature for track in tracks])
    order = np.argsort(curvature)
    until = np.cumsum(np.concatenate([track.noise for track in tracks])[order])
    return curvature[order][np.searchsorted(until, until[-1] * (np.arange(_CURVATURES) + 0.5) / _CURVATURES)]


def _nodes(track: _Track, part: np.ndarray, n_speed: int) -> tuple[np.ndarray, np.ndarray]:
    """Weight (n_speed,) of each part of the speeds in the noise, and directions (n_speed, n_direction) in it."""
    weight = track.noise if track.noise.any() else np.ones(len(track.noise))
    angle = np.mod(np.angle(track.velocity), 2 * np.pi)
    share, n_direction, turns = np.bincount(part, weight, n_speed), 2 if track.straight else _DIRECTIONS, []
    for number in range(n_speed):
        inside = np.where(part == number, weight, 0.0) if share[number] > 0 else weight
        order = np.argsort(angle, kind="stable")
        until = np.cumsum(inside[order])
        level = until[-1] * (np.arange(n_direction) + 0.5) / n_direction
        turns.append(angle[order][np.searchsorted(until, level)])
    return share / share.sum(), np.array(turns)


def _distribution(track: _Track, part: np.ndarray, n_speed: int) -> np.ndarray:
    """Weight in the signal of each place by speed and direction, (n_place, n_speed, AZIMUTHS)."""
    azimuth = np.mod(np.round(np.angle(track.velocity) / np.pi * AZIMUTHS).astype(int), AZIMUTHS)
    length = n_speed * AZIMUTHS
    counts = [np.bincount(part * AZIMUTHS + azimuth, column, length) for column in track.places.T]
    return np.reshape(counts, (-1, n_speed, AZIMUTHS))
