"""Sweeps of a camera of several bands: one sweep for each band that a key of the table [sweep] concerns."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.bands import TABLE, band_key, bands_of, has_key, of_each_band
from surveysim.scene.scene import Origin, Scene, read_scene
from surveysim.scene.shipped import find_scene
from surveysim.scene.units import file_value
from surveysim.studies.sweep.axes import Axis, Point, Sweep, sweep_along, sweep_axes, sweep_hash


@dataclass(frozen=True)
class MultiBandSweep:
    """A scene file with [sweep] and [bands.NAME]: the sweep of each band by name.

    A sweep has the axes that concern its band. Bands that no axis concerns have none.
    """

    name: str
    title: str
    origin: Origin
    bands: Mapping[str, Sweep]

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.origin.path


def load_band_sweep(
    path: str | Path, overrides: Mapping[str, Any] | None = None, reference: int | str | None = None
) -> MultiBandSweep:
    """Read a scene file with tables [sweep] and [bands.NAME]; parameters and errors are those of `load_sweep`."""
    path = find_scene(path)
    overrides = {key: file_value(value) for key, value in (overrides or {}).items()}
    text, content = read_scene(path)
    axes, origin = sweep_axes(path, content, overrides), Origin(path.absolute(), text, overrides)
    base = bands_of(path, text, content, overrides)
    found = {}
    for name, scene in base.bands.items():
        if own := tuple(axis for axis in axes if _concerns(axis, scene, base.content[TABLE][name])):
            found[name] = sweep_along(own, origin, partial(_scene_at, name, origin, content), reference)
    if not found:
        keys = ", ".join(key for axis in axes for key in axis.keys)
        raise SceneError(f"{path}: sweep: found {keys}, which all bands replace; keys that change a band are expected")
    return MultiBandSweep(base.name, base.title, origin, found)


def sweeps_of(sweep: Sweep | MultiBandSweep) -> Mapping[str, Sweep]:
    """Sweeps by band; of a camera of one band, its only sweep without a name."""
    return {"": sweep} if isinstance(sweep, Sweep) else sweep.bands


def sweep_points(sweep: Sweep | MultiBandSweep) -> tuple[Point, ...]:
    """All points of a sweep, of all bands."""
    return tuple(point for item in sweeps_of(sweep).values() for point in item.points)


def band_sweep_hash(sweep: MultiBandSweep) -> str:
    """Return the SHA-256 of everything that the results of all bands depend on."""
    return sha256(" ".join(map(sweep_hash, sweep.bands.values())).encode()).hexdigest()


def _concerns(axis: Axis, scene: Scene, table: Mapping[str, Any]) -> bool:
    """Return whether an axis changes more of a band than the layer that it shares with others."""
    for key in axis.keys:
        band, own = band_key(key)
        if band == scene.band_name or (not band and not has_key(table, own)):
            return True
        if band and "spectral" in scene.cleaning.named:  # which subtracts the streams of that band
            return True
    return False


def _scene_at(name: str, origin: Origin, content: Mapping[str, Any], settings: Mapping[str, Any]) -> Scene:
    """The scene of one band at the settings of a point, made ready once: errors name the band."""
    scenes = bands_of(origin.path, origin.text, content, {**origin.overrides, **settings})
    of_each_band(scenes.path, scenes.content, lambda band: prepare(scenes.bands[band]) if band == name else None)
    return scenes.bands[name]
