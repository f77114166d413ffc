"""Cases of the atmosphere: extreme layers, winds and elevations."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mapmaker.cleaning import clean
from surveysim.atmosphere.screen_simulation import add_atmosphere
from surveysim.atmosphere.strip_factors import Strip
from surveysim.atmosphere.thin_screen import Screen, structure_function
from surveysim.reduction.setup import Setup, prepare
from surveysim.runtime.rng import normal_deviates
from surveysim.scene.analysis import Cleaning
from surveysim.scene.scene import Scene
from surveysim.studies.stress.case import N_SAMP, RATE_HZ, TEMPLATES, Outcome, agrees
from surveysim.timestreams.atmosphere import add_layers
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_weather
from surveysim.timestreams.simulation import observation_path


def layer(scene: Scene) -> Outcome:
    """Compare the structure function of an observation's strips with the quadrature.

    Parameters
    ----------
    scene
        Base scene with the overrides of the case.

    Returns
    -------
    Outcome with the largest relative deviation.
    """
    setup = prepare(scene)
    streams = draw_observation(setup, 0)
    cleaned = clean("average", streams.data_mk, streams.scan_bounds, streams.focal_plane, options=TEMPLATES)
    if not (np.isfinite(streams.data_mk).all() and np.isfinite(cleaned.data_mk).all()):
        return Outcome("streams that are not finite", 0.0, 0.0, False)
    worst = max(_departure(setup.air.layers[0].strips.screen, strip) for strip in _strips(setup))
    # Omitted modes may add 1e-3 to the differences along and across together.
    return agrees(worst, 0.0, 2e-3, "relative departure of the structure function")


def _strips(setup: Setup) -> Iterator[Strip]:
    """All strips that a setup has made."""
    for cache in setup.air.layers[0].strips.caches.values():
        yield from cache.strips.values()


def _departure(screen: Screen, strip: Strip) -> float:
    """Largest relative deviation of a strip's structure function along x from `structure_function`."""
    power = np.add.reduceat(np.square(strip.lane_columns, dtype=float).mean(axis=1), strip.start[:-1])
    across = np.square(strip.amplitude, dtype=float)
    power = np.append(power, 2.0 * across.sum(axis=1) - across[:, :1].sum(axis=1))
    k = np.arange(len(power))
    weight = np.where(k == strip.n_x // 2, 1.0, 4.0) / strip.n_x**2
    lag = np.unique(np.geomspace(1, strip.length_rad / strip.step_rad, 24).astype(int))
    theta = lag * strip.step_rad
    waves = 4.0 * np.sin(np.pi * np.outer(lag, k) / strip.n_x) ** 2 @ (weight * power)
    expected = structure_function(screen, theta)
    return float(np.abs((waves + (strip.ramp_std * theta) ** 2) / expected - 1).max())


def _moved(setup: Setup, scan_rad_s: np.ndarray, layer_rad_s: np.ndarray) -> np.ndarray:
    """Streams (n_det, N_SAMP) float32 of one scan through the layer alone; all velocities share one draw."""
    plane = setup.camera.focal_plane
    data = np.zeros((setup.camera.n_det, N_SAMP), np.float32)
    offsets = np.stack([plane.x_rad, plane.y_rad], axis=-1)[None]
    add_atmosphere(
        data,
        np.array([(0, N_SAMP)]),
        sample_rate_hz=RATE_HZ,
        offsets_rad=offsets,
        velocity_rad_s=np.array([scan_rad_s]),
        layer_velocity_rad_s=np.array([layer_rad_s]),
        amplitude_mk=np.array([17.0]),
        strips=setup.air.layers[0].strips.at(1.0),
        deviates=normal_deviates(3, "stress"),
    )
    return data


def still(scene: Scene) -> Outcome:
    """Check that a layer moving with the scan gives constant streams in any direction."""
    setup, angle = prepare(scene), np.arange(16) * math.pi / 8
    velocities = scene.scan.speed_rad_s * np.column_stack([np.cos(angle), np.sin(angle)])
    streams = [_moved(setup, velocity, velocity) for velocity in velocities]
    return agrees(max(np.ptp(data, axis=1).max() for data in streams), 0.0, 0.0, "change of a stream over a scan [mK]")


def opposite(scene: Scene) -> Outcome:
    """Check that a layer moving against the scan equals a layer at rest under a scan twice as fast."""
    setup, velocity = prepare(scene), np.array([0.6, 0.8]) * scene.scan.speed_rad_s
    found = _moved(setup, velocity, -velocity) - _moved(setup, 2 * velocity, np.zeros(2))
    return agrees(np.abs(found).max(), 0.0, 0.0, "difference of streams [mK]")


def one_layer(setup: Setup, b2: float = 0.0) -> np.ndarray:
    """Draw the layer alone for the first observation, at the scene's B2 or another."""
    path, pointing = observation_path(setup.observing, 0)
    weather = observation_weather(setup, 0)
    data = np.zeros((setup.camera.n_det, len(path.time_s)), np.float32)
    add_layers(setup, 0, pointing, weather=replace(weather, b2=b2 or weather.b2), data=data)
    return data


def elevation(scene: Scene) -> Outcome:
    """Check that streams equal those of a layer at the zenith at the slant distance, times sin(el)^((1 - b) / 2)."""
    sine, air = math.sin(scene.fixed_pointing.elevation_rad), scene.atmosphere
    overhead = scene.fixed_pointing.model_copy(update={"elevation_rad": math.pi / 2})
    higher = air.model_copy(update={"layer_height_m": air.layer_height_m / sine})
    here = one_layer(prepare(scene))
    there = one_layer(prepare(scene.model_copy(update={"fixed_pointing": overhead, "atmosphere": higher})))
    expected = sine ** ((1 - air.spectral_index) / 2)
    departure = np.abs(here / expected - there).max() / np.abs(there).max()
    return agrees(departure, 0.0, 2.0**-21, f"streams over those at the zenith: {expected:.5g}; departure from it")


def amplitude(scene: Scene) -> Outcome:
    """Check that streams scale as the square root of B2."""
    setup, b2 = prepare(scene), scene.atmosphere.b2[0]
    here, one = one_layer(setup), one_layer(setup, 1.0)
    departure = np.abs(here / math.sqrt(b2) - one).max() / np.abs(one).max()
    return agrees(departure, 0.0, 2.0**-21, "departure from sqrt(B2) over the largest value")


def no_air(scene: Scene) -> Outcome:
    """Check that B2 = 0 equals no atmosphere."""
    without = scene.model_copy(update={"atmosphere": None, "cleaning": _none_of(scene)})
    found = draw_observation(prepare(scene), 0).data_mk - draw_observation(prepare(without), 0).data_mk
    return agrees(np.abs(found).max(), 0.0, 0.0, "difference of streams [mK]")


def _none_of(scene: Scene) -> Cleaning:
    return scene.cleaning.model_copy(update={"algorithm": ("none",)})


def drawn(scene: Scene) -> Outcome:
    """Draw an observation of a scene that must be refused."""
    setup = prepare(scene)
    values = [np.abs(draw_observation(setup, k).data_mk).max() for k in range(scene.observations)]
    return agrees(float(np.isfinite(values).all()), 1.0, 0.0, "finite")
