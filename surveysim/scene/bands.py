"""Cameras of several bands: the tables [bands.NAME] of a scene file, and the scene of each band.

A table has keys of the scene that differ in that band, by section. The scene of a band is that of the file with these
keys replaced. All bands see the same layer, weather, pointing and sky, so the keys of these are common to all.
"""

import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

from surveysim.runtime.errors import InputError, SceneError
from surveysim.runtime.text_files import key_text
from surveysim.scene.detector_table import detector_table
from surveysim.scene.error_lines import error_lines
from surveysim.scene.scene import CameraBand, Origin, Scene, read_scene, scene_data, scene_hash, validated
from surveysim.scene.shipped import MAX_NAME, find_scene
from surveysim.scene.units import file_value, shown

TABLE = "bands"
BAND_NAME, MAX_BAND_NAME = r"[A-Za-z0-9_]+", 20
MAX_BANDS = 20
# Sections and keys that are the same in all bands, and keys of a common section that bands may have.
COMMON = (
    *("seed", "observations", "name", "title", "field", "scan", "schedule", "fixed_pointing", "sweep", "numerics"),
    *("map", "site", "atmosphere", "instrument.camera_rotation_range", "optimise"),
)
OWN = ("atmosphere.b2", "atmosphere.b2_probabilities")

T = TypeVar("T")


class OtherBandError(SceneError):
    """An error of another band than the one that is made ready."""

    def __init__(self, band: str, text: str) -> None:
        super().__init__(f"{TABLE}.{band}: {text}")
        self.band, self.text = band, text


@contextmanager
def errors_of(band: Scene, among: Scene) -> Iterator[None]:
    """Turn errors about a band into `OtherBandError` where the scene `among` is made ready, and not that band's own."""
    try:
        yield
    except InputError as error:
        if band.band_name == among.band_name:
            raise
        raise OtherBandError(band.band_name, str(error)) from None


@dataclass(frozen=True)
class MultiBandScene:
    """A scene file of a camera of several bands.

    Attributes
    ----------
    bands
        Scene of each band by name, in the order of the file.
    content
        Values by key, with the tables of the bands.
    """

    name: str
    title: str
    origin: Origin
    bands: Mapping[str, Scene]
    content: Mapping[str, Any] = field(repr=False)

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.origin.path


def load_bands(path: str | Path, overrides: Mapping[str, Any] | None = None) -> MultiBandScene:
    """Read and check a scene of a camera of several bands.

    Parameters
    ----------
    path
        Path of a scene file with tables [bands.NAME], or name of a scene.
    overrides
        Values by dotted key, as for `load_scene`; a key such as "bands.150.detector.psd" is that of one band.

    Raises
    ------
    SceneError
        With one line for each error: file, key, value found, values expected.
    """
    path = find_scene(path)
    return bands_of(path, *read_scene(path), {key: file_value(value) for key, value in (overrides or {}).items()})


def bands_of(path: Path, text: str, content: Mapping[str, Any], overrides: Mapping[str, Any]) -> MultiBandScene:
    """Make the scenes of the bands of a file that `read_scene` has read; errors as for `load_bands`."""
    data = scene_data(path, text, content, overrides)
    tables = _tables(path, data.get(TABLE), str(data["name"]))
    _check_bands_of(path, content.get(TABLE), overrides)
    common = {key: value for key, value in data.items() if key not in (TABLE, "assumed")}

    def scene_of_band(name: str) -> Scene:
        own = {"name": f"{data['name']}_{name}", "title": f"{data.get('title')}: {name}", "band": {"name": name}}
        if not isinstance(data.get("title"), str):
            own.pop("title")
        own["assumed"] = _assumed(data["assumed"], name, tables[name])
        merged = _merged(_merged(common, tables[name]), own)
        scene, wrong = validated(_with_rows_of(name, merged, path.parent), path.parent)
        if scene is None:
            raise SceneError("\n".join(wrong))
        _check_common_weather(scene, tables[name], len(tables))
        return scene

    scenes = of_each_band(path, data, scene_of_band)
    origin = Origin(path.absolute(), text, dict(overrides))
    return MultiBandScene(str(data["name"]), str(data["title"]), origin, _with_others(scenes), data)


def bands_hash(scenes: MultiBandScene) -> str:
    """SHA-256 hash of everything that the results of all bands depend on."""
    return sha256(" ".join(map(scene_hash, scenes.bands.values())).encode()).hexdigest()


def band_key(key: str) -> tuple[str, str]:
    """Split a dotted key of one band into the band's name and the key of its scene; an empty name for other keys."""
    table, _, rest = key.partition(".")
    name, _, own = rest.partition(".")
    return (name, own) if table == TABLE else ("", key)


def common_key(key: str) -> str:
    """Return the key or section that makes a dotted key common to all bands; empty for keys of single bands."""
    found = next((item for item in COMMON if f"{key}.".startswith(f"{item}.")), "")
    return "" if any(f"{key}.".startswith(f"{item}.") for item in OWN) else found


def of_each_band(path: Path, content: Mapping[str, Any], job: Callable[[str], T]) -> dict[str, T]:
    """Compute `job(name)` for each band of the values of a file; raises SceneError with each error once.

    A line names a key as the file gives it: in the table of the band, or for all bands, with the name of the band if
    others that have it can be run.
    """
    done: dict[str, T] = {}
    wrong: dict[str, dict[str, None]] = {}  # bands with the error, in order
    for name in content[TABLE]:
        try:
            done[name] = job(name)
        except SceneError as error:
            band, text = (error.band, error.text) if isinstance(error, OtherBandError) else (name, str(error))
            for line in text.splitlines():
                wrong.setdefault(line.removeprefix(f"{path}: "), {})[band] = None
    if wrong:
        raise SceneError(error_lines(path, list(dict.fromkeys(_lines(wrong, content)))))
    return done


def _lines(wrong: Mapping[str, Collection[str]], content: Mapping[str, Any]) -> Iterable[str]:
    tables = content[TABLE]
    for line, names in wrong.items():
        found = re.match(r"[a-z_0-9]+(\.[a-z_0-9]+)*(?=: )", line)
        key = found[0] if found else ""
        common = {name for name in tables if not has_key(tables[name], key)}
        of_all = common <= set(names) and (has_key(content, key) or len(names) == len(tables) > 1)
        for name in names:
            if of_all and name in common:
                yield line
            elif not key or (name in common and has_key(content, key)):
                yield f"{TABLE}.{name}: {line}"
            else:
                yield f"{TABLE}.{name}.{line}"


def has_key(table: Any, key: str) -> bool:
    """Return whether a table has a value at a dotted key, or at the list that the key is part of."""
    for part in key.split("."):
        if not isinstance(table, dict):
            return True
        if part not in table:
            return False
        table = table[part]
    return not isinstance(table, dict)


def _tables(path: Path, table: Any, scene: str) -> dict[str, dict[str, Any]]:
    """Check the names of bands and their keys; raises SceneError with a line for each error."""
    if not isinstance(table, dict) or not table:
        raise SceneError(f"{path}: {TABLE}: found {shown(table)}; tables [{TABLE}.NAME] are expected")
    if len(table) > MAX_BANDS:
        raise SceneError(f"{path}: {TABLE}: found {len(table)} bands; {MAX_BANDS} or fewer are expected")
    wrong = [line for name, keys in table.items() for line in _wrong(name, keys, scene)]
    if wrong:
        raise SceneError(error_lines(path, wrong))
    return table


def _check_bands_of(path: Path, table: Any, overrides: Mapping[str, Any]) -> None:
    """Raise SceneError for overrides of bands that the file does not have."""
    known = list(table) if isinstance(table, dict) else []
    for name in dict.fromkeys(filter(None, (band_key(key)[0] for key in overrides))):
        if name not in known:
            raise SceneError(f"{path}: {TABLE}.{name}: unknown band; allowed are {', '.join(known)}")


def _wrong(name: str, keys: Any, scene: str) -> Iterable[str]:
    where = f"{TABLE}.{key_text(name)}"
    if not re.fullmatch(BAND_NAME, name) or len(name) > MAX_BAND_NAME:
        yield f"{where}: a name of up to {MAX_BAND_NAME} ASCII letters, digits and '_' is expected"
    elif len(scene) + 1 + len(name) > MAX_NAME:
        yield f"{where}: found {len(scene) + len(name)} letters with the scene's; {MAX_NAME - 1} or fewer are expected"
    elif not isinstance(keys, dict):
        yield f"{where}: found {shown(keys)}; a table of sections is expected"
    else:
        given = dict.fromkeys(common_key(key) for key in _keys(keys))
        for common in filter(None, given):
            yield f"{where}.{common}: the same in all bands; outside [{where}] it is expected"


def _keys(table: Mapping[str, Any], before: str = "") -> Iterable[str]:
    for name, value in table.items():
        if isinstance(value, dict) and value:
            yield from _keys(value, f"{before}{name}.")
        else:
            yield f"{before}{name}"


def _merged(data: Mapping[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """Replace the values of a table in some data, section by section."""
    found = dict(data)
    for key, value in table.items():
        both = isinstance(value, dict) and isinstance(found.get(key), dict)
        found[key] = _merged(found[key], value) if both else value
    return found


def _with_rows_of(name: str, data: Mapping[str, Any], folder: Path) -> Mapping[str, Any]:
    """Choose the rows of the band in a table of detectors with a column `band`, unless the scene chooses some."""
    camera = data.get("instrument")
    if not isinstance(camera, dict) or "band" in camera or not isinstance(camera.get("positions"), str):
        return data
    try:
        table = detector_table(Path(os.path.realpath(folder / camera["positions"])))
    except (InputError, ValueError):  # which the check of the key explains
        return data
    return {**data, "instrument": camera | {"band": name}} if "band" in table.columns else data


def _assumed(lines: Iterable[str], name: str, table: Mapping[str, Any]) -> list[str]:
    """Select the assumed values of one band from those of the file."""
    own, found = f"{TABLE}.{name}.", []
    for line in lines:
        if line.startswith(own):
            found.append(line.removeprefix(own))
        elif not line.startswith(f"{TABLE}.") and not has_key(table, line.partition(" = ")[0]):
            found.append(line)
    return found


def _check_common_weather(scene: Scene, table: Mapping[str, Any], n_bands: int) -> None:
    """Raise SceneError for weather that differs between bands."""
    air = scene.atmosphere
    if air is None or n_bands == 1:
        return
    if air.b2 and "b2" not in table.get("atmosphere", {}):
        raise SceneError(
            "atmosphere.b2: found for all bands; it is expected in each [bands.NAME.atmosphere], as B2 differs between"
            " bands, or left out with a site that it follows from"
        )
    if air.table is not None and "b2" in air.table.columns:
        raise SceneError(
            "atmosphere.weather_table: found a column b2 with [bands]; water_fluctuation is expected, as B2"
            " differs between bands"
        )
    if air.wind_b2_exponent:
        raise SceneError(
            f"atmosphere.wind_b2_exponent: found {air.wind_b2_exponent:g} with [bands]; 0 is expected, as B2 differs"
            " between bands that see one wind"
        )


def _with_others(scenes: Mapping[str, Scene]) -> dict[str, Scene]:
    """Give the scene of each band those of the others."""

    def whole(name: str, scene: Scene) -> Scene:
        others = tuple(other for key, other in scenes.items() if key != name)
        return scene.model_copy(update={"band": CameraBand(name=name, others=others)})

    return {name: whole(name, scene) for name, scene in scenes.items()}
