"""Cases of cleaning: residuals of extreme time-streams and arrays."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from mapmaker.cleaning import (
    LocalOptions,
    PcaOptions,
    PolynomialOptions,
    SpectralOptions,
    WindOptions,
    clean,
)
from mapmaker.cleaning.local import neighbourhoods
from mapmaker.timestreams import FocalPlane
from surveysim.atmosphere.screen_simulation import StripCache
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import InsufficientDataError
from surveysim.runtime.rng import normal_deviates
from surveysim.scene.scene import Scene
from surveysim.studies.stress.atmosphere import one_layer
from surveysim.studies.stress.case import N_SAMP, QUANTUM, RATE_HZ, STIFF, TEMPLATES, Outcome, agrees
from surveysim.timestreams.atmosphere import add_layers
from surveysim.timestreams.noise import add_white
from surveysim.timestreams.observed_block import observation_weather
from surveysim.timestreams.simulation import observation_path

ALGORITHMS: dict[str, Any] = {
    "average": TEMPLATES,
    "planar": TEMPLATES,
    "quadratic": TEMPLATES,
    "polynomial": PolynomialOptions(3, 1, 1e-8, 100),
    "pca": PcaOptions(3.0),
    "wind": WindOptions(np.zeros((1, 2)), RATE_HZ, 1e-8, 100),
}
_REMOVED = {"average": 1, "planar": 3, "quadratic": 6, "polynomial": 10, "wind": 1, "pca": 1}


def stiff(scene: Scene, algorithm: str) -> Outcome:
    """Compare residuals of float32 and float64 time-streams of the same draws, in units of the white noise.

    A float32 sample is rounded four times (layer made, moved, observed, white noise added), and the lattice once, at
    values of up to about three standard deviations.

    Parameters
    ----------
    scene
        Base scene with the overrides of the case.
    algorithm
        Cleaning algorithm, a key of `ALGORITHMS`.
    """
    setup = prepare(scene)
    _, pointing = observation_path(setup.observing, 0)
    weather = observation_weather(setup, 0)
    scale = STIFF / np.std(_mean_removed(one_layer(setup, 1.0), setup.observing.scans.n_scans))
    strong = replace(weather, b2=scale**2)
    layer = setup.air.layers[0]
    caches = {number: _in_float64(cache) for number, cache in layer.strips.caches.items()}
    finer = replace(layer, strips=replace(layer.strips, caches=caches))
    fine = replace(setup, air=replace(setup.air, layers=(finer,)))
    left = []
    for one, dtype in ((setup, np.float32), (fine, np.float64)):
        data = np.zeros((setup.camera.n_det, len(pointing.scan)), dtype)
        add_layers(one, 0, pointing, weather=strong, data=data)
        data *= setup.camera.responsivity[:, None].astype(np.float32)
        add_white(data, 2 / RATE_HZ, RATE_HZ, normal_deviates(1, "stress"))
        left.append(_cleaned(algorithm, data, setup.camera.focal_plane).astype(float))
    lost = float(np.std(left[0] - left[1]))
    note = f"of {STIFF:g} before and {np.std(left[1]):.3g} after cleaning; {-math.log10(lost / STIFF):.1f} digits"
    return agrees(lost, 0.0, 4 * QUANTUM * STIFF, note)


def _in_float64(cache: StripCache) -> StripCache:
    strips = {n: replace(strip, columns=strip.columns.astype(float)) for n, strip in cache.strips.items()}
    return replace(cache, strips=strips)


def _mean_removed(data: np.ndarray, n_scans: int) -> np.ndarray:
    scans = data.reshape(len(data), n_scans, -1).astype(float)
    return scans - scans.mean(axis=-1, keepdims=True)


def planted(n_det: int, ratio: float, n_samp: int = N_SAMP, n_scans: int = 1) -> np.ndarray:
    """Draw white noise and a common mode of `ratio` with gains that scatter by 5 % about 1, (n_det, n) float64."""
    rng = np.random.default_rng(n_det)
    noise, common = rng.standard_normal((n_det, n_scans * n_samp)), rng.standard_normal(n_scans * n_samp)
    return noise + ratio * (1 + 0.05 * rng.standard_normal((n_det, 1))) * common


def _cleaned(algorithm: str, data: np.ndarray, plane: FocalPlane, n_samp: int = N_SAMP) -> np.ndarray:
    bounds = np.arange(0, data.shape[1], n_samp)[:, None] + [0, n_samp]
    options = ALGORITHMS[algorithm]
    if algorithm == "wind":
        options = replace(options, slowness_s_rad=np.zeros((len(bounds), 2)))
    cleaned = clean(algorithm, data, bounds, plane, options=options)
    if not cleaned.kept.all():
        raise InsufficientDataError(f"{np.sum(~cleaned.kept)} of {len(bounds)} scans discarded")
    return cleaned.data_mk


def common_mode(scene: Scene, algorithm: str, dtype: type) -> Outcome:
    """Compare the residuals of a common mode and of one a thousand times stronger.

    Parameters
    ----------
    scene
        Base scene with the overrides of the case.
    algorithm
        Cleaning algorithm, a key of `ALGORITHMS`.
    dtype
        Type of the samples of the stronger mode.
    """
    plane = prepare(scene).camera.focal_plane
    weak, strong = (planted(len(plane.x_rad), ratio) for ratio in (1e3, STIFF))
    change = _cleaned(algorithm, strong.astype(dtype), plane) - _cleaned(algorithm, weak, plane)
    # c is fitted to 1e-3 of the noise with the weaker: what it takes of the noise differs by no more.
    tolerance = 1e-3 if dtype is np.float64 else 4 * QUANTUM * STIFF
    return agrees(np.std(change), 0.0, tolerance, "change of the residual [white noise]")


def white_left(scene: Scene, algorithm: str, places: str = "", n_samp: int = N_SAMP, n_scans: int = 1) -> Outcome:
    """Check the white noise after cleaning against the degrees of freedom of the templates."""
    plane = plane_of(_places(places)) if places else prepare(scene).camera.focal_plane
    n_det = len(plane.x_rad)
    data = _cleaned(algorithm, planted(n_det, 100.0, n_samp, n_scans), plane, n_samp)
    # Mean and template amplitude each take a degree of freedom in every template, c one more in the scan.
    expected = (1 - _REMOVED[algorithm] / n_det) * (1 - 2 / n_samp)
    return agrees(data.var(), expected, 4 * math.sqrt(2 / data.size), "variance left of white noise")


def scaled(scene: Scene, algorithm: str) -> Outcome:
    """Check that the residual does not change if all responsivities are multiplied by a power of two."""
    plane = prepare(scene).camera.focal_plane
    data = planted(len(plane.x_rad), 100.0)
    left = _cleaned(algorithm, data, plane)
    changes = [np.abs(_cleaned(algorithm, s * data, plane) / s - left).max() for s in (2.0**-20, 2.0**20)]
    return agrees(max(changes), 0.0, 0.0, "change of the residual over the scale")


def decades(scene: Scene) -> Outcome:
    """Check that cleaning calibrates responsivities over six decades."""
    plane = prepare(scene).camera.focal_plane
    data = planted(len(plane.x_rad), 100.0)
    gain = np.geomspace(1e-3, 1e3, len(data))[:, None]
    change = _cleaned("average", gain * data, plane) / gain - _cleaned("average", data, plane)
    return agrees(np.abs(change).max(), 0.0, 1e-9, "change of the residual over the responsivity [white noise]")


def one_detector(scene: Scene) -> Outcome:
    """Check that a single detector loses only its mean."""
    plane = prepare(scene).camera.focal_plane
    data = planted(1, 100.0)
    left = clean("none", data, np.array([[0, N_SAMP]]), plane, options=None).data_mk
    return agrees(np.abs(left - (data - data.mean())).max(), 0.0, 0.0, "difference from the data less their mean")


def spectral(scene: Scene) -> Outcome:
    """Check the white noise of one band after subtraction of a common mode, and the noise added from the other band."""
    plane = prepare(scene).camera.focal_plane
    rng = np.random.default_rng(4)
    layer = STIFF * rng.standard_normal((len(plane.x_rad), N_SAMP))
    noise, other = rng.standard_normal((2, *layer.shape))
    options = SpectralOptions((3.0 * layer + other)[None])
    left = clean("spectral", layer + noise, np.array([[0, N_SAMP]]), plane, options=options).data_mk
    # A mean and a coefficient each take a degree of freedom; a third of the other band's noise is added.
    expected = (1 - 2 / N_SAMP) * (1 + 1 / 9)
    return agrees(left.var(), expected, 4 * expected * math.sqrt(2 / left.size), "variance left")


def equal_modes(scene: Scene, singular: np.ndarray, expected: int) -> Outcome:
    """Count the planted modes that PCA removes.

    Parameters
    ----------
    scene
        Base scene with the overrides of the case.
    singular
        Singular values (n_det,) of the planted modes.
    expected
        Number of modes to remove.
    """
    plane = prepare(scene).camera.focal_plane
    rng, n_det = np.random.default_rng(6), len(singular)
    left = np.linalg.qr(rng.standard_normal((n_det, n_det)))[0]
    amplitude = rng.standard_normal((N_SAMP, n_det))
    right = np.linalg.qr(amplitude - amplitude.mean(axis=0))[0]
    cleaned = clean("pca", left * singular @ right.T, np.array([[0, N_SAMP]]), plane, options=PcaOptions(3.0))
    return agrees(float(cleaned.removed[0]), expected, 0.0, "modes removed")


def plane_of(places: np.ndarray) -> FocalPlane:
    """Make a focal plane of detectors at positions (n_det, 2) [rad], with a beam of one arcminute."""
    return FocalPlane(places[:, 0], places[:, 1], 3e-4)


def _places(kind: str) -> np.ndarray:
    """37 positions (n_det, 2) [rad]: on a line, nearly on one, on a circle, or in two clusters."""
    t, rng = np.linspace(-1, 1, 37), np.random.default_rng(8)
    places = {
        "a line": np.column_stack([t, 0.3 * t]),
        "nearly a line": np.column_stack([t, 0.3 * t + 1e-8 * rng.standard_normal(37)]),
        "a circle": np.column_stack([np.cos(3 * t), np.sin(3 * t)]),
        "two clusters": np.column_stack([np.sign(t), 0 * t]) + 0.03 * rng.standard_normal((37, 2)),
    }
    return 1e-3 * places[kind]


def local(scene: Scene, places: str) -> Outcome:
    """Measure the white noise after local average subtraction.

    Parameters
    ----------
    scene
        Base scene; unused.
    places
        Arrangement of the detectors, a name of `_places`.
    """
    plane, options = plane_of(_places(places)), LocalOptions(1.2)
    data = planted(37, 0.0)
    left = clean("local", data, np.array([[0, N_SAMP]]), plane, options=options).data_mk
    members = np.sum(neighbourhoods(plane, options.neighbour_radius) < 37, axis=1)
    # A detector alone loses its mean; others lose their share of the template and the coefficient too.
    share = np.where(members > 1, (1 - 1 / members) * (1 - 2 / N_SAMP), 1 - 1 / N_SAMP)
    return agrees(left.var(), share.mean(), 4 * math.sqrt(2 / data.size), "variance left of white noise")
