"""A scene: its sections together, how its file is read, and what its errors say.

A scene is TOML; quantities are strings with units. A stage is a section, and an absent section
leaves its stage out. Every record here is frozen and holds floats in internal units.
"""

import hashlib
import json
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, PrivateAttr, ValidationError, model_validator
from pydantic.json_schema import SkipJsonSchema

from surveysim.runtime.errors import InputError, SceneError
from surveysim.runtime.strict_json import strict_json
from surveysim.runtime.text_files import key_text, nested_deeper, one_line, read_text
from surveysim.scene.analysis import Cleaning, MapSection, Score
from surveysim.scene.fields import Line, whole
from surveysim.scene.instrument import Instrument
from surveysim.scene.noise_and_sky import StreamSections
from surveysim.scene.numerics import Numerics
from surveysim.scene.observing import MIN_SAMPLES, FieldSection, FixedPointing, Scan, Schedule
from surveysim.scene.section import Section
from surveysim.scene.shipped import MAX_NAME, NAME, find_scene
from surveysim.scene.sites import sites_text
from surveysim.scene.units import file_value, shown

MAX_BYTES = 300_000  # of a scene file; with comments they have some 5 kB
MAX_DEPTH = 20  # tables and lists within each other; scenes have 3
MAX_ERRORS = 30  # lines of an error
# Keys of scenes before version 0.4, and their names since then.
RENAMED = {
    "instrument.colours": "instrument.bands",
    "instrument.camera_rotation": "instrument.camera_rotation_range",
    "atmosphere.index": "atmosphere.spectral_index",
    "atmosphere.fluctuation": "atmosphere.water_fluctuation",
    "atmosphere.fluctuation_probabilities": "atmosphere.water_fluctuation_probabilities",
    "cleaning.reach": "cleaning.neighbour_radius",
    "score.white_above": "score.white_noise_above",
    "score.simulated": "score.noise_only_sets",
    "score.window": "score.signal_sims",
    "numerics.stream_memory": "numerics.max_block_memory",
}
# A key of so many parts: the parser's time goes as their square.
_PART = r"""(?:"[^"\n]*+"|'[^'\n]*+'|[\w-]++)"""
_LONG_KEY = re.compile(rf"(?<![\w\-.]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MAX_DEPTH - 1}}}")


@dataclass(frozen=True)
class Origin:
    """The file that a scene was read from, and overrides by key; scenes are the same wherever they come from."""

    path: Path = field(compare=False)
    text: str = field(compare=False)
    overrides: dict[str, Any] = field(compare=False)


class ObservationSections(Section):
    """Keys of the run, and sections of the field, the observations and the instrument."""

    name: str = Field(pattern=f"^{NAME}$", max_length=MAX_NAME, json_schema_extra={"otherwise": "that of the file"})
    """Name of the run and, unless said otherwise, of its folder: letters, digits, `_`, `.` and `-`."""
    title: Line
    """What it is, in a line that heads tables and figures."""
    seed: Annotated[int, *whole(0, 2**63 - 1)]
    """Seed of all random numbers: one seed, one result."""
    observations: Annotated[int, *whole(1, 1_000_000)]
    """Observations of the survey."""
    field: FieldSection
    schedule: Schedule | None = None
    """Or `fixed_pointing`."""
    fixed_pointing: FixedPointing | None = None
    """Or `schedule`."""
    instrument: Instrument
    scan: Scan


class Scene(StreamSections, ObservationSections):
    """A whole scene; an absent section leaves its stage out.

    `assumed` is not a key of the file: it lists the file's own values whose comment says that they are
    assumed or calibrated.
    """

    cleaning: Cleaning
    map: MapSection
    score: Score | None = None
    """Left out: maps, but no score."""
    numerics: Numerics = Numerics()
    assumed: SkipJsonSchema[tuple[str, ...]] = ()
    _origin: Origin | None = PrivateAttr(None)

    @property
    def origin(self) -> Origin | None:
        """The file that it was read from, if it was."""
        return self._origin

    @model_validator(mode="after")
    def _sections_fit(self) -> Self:
        if (self.schedule is None) == (self.fixed_pointing is None):
            raise ValueError("exactly one of the sections 'schedule' and 'fixed_pointing' is expected")
        if self.excess and len(self.excess.b2) > 1 and self.atmosphere is None:
            raise ValueError("excess.b2: found several values; without [atmosphere] one value is expected")
        if self.atmosphere and self.atmosphere.site and self.instrument.bandwidth is None:
            raise ValueError("instrument.bandwidth: missing; the opacity of a site needs the width of the band")
        named = {name for steps in (self.cleaning.algorithm, *self.cleaning.compare) for name in steps}
        if "spectral" in named and not self.instrument.bands:
            raise ValueError("instrument.bands: missing; 'spectral' cleaning needs other bands of the pixels")
        if self.instrument.bands and not (self.atmosphere and self.atmosphere.site):
            raise ValueError("atmosphere.site: missing; the bands scale with each other by the opacity of a site")
        self._power_is_known()
        if not any(getattr(self, name) for name in StreamSections.model_fields):
            *names, last = StreamSections.model_fields
            raise ValueError(f"at least one of {', '.join(names)} and {last} is expected")
        if (found := self.scan.duration_s * self.scan.sample_rate_hz) < MIN_SAMPLES:
            raise ValueError(f"scan.duration: found {found:.3g} samples a scan; {MIN_SAMPLES} or more are expected")
        return self

    def _power_is_known(self) -> None:
        """Raise ValueError where noise is given by optical power and something to tell its temperature is missing."""
        load = self.photon.load if self.photon else None
        if load is None and not (self.detector and self.detector.nep_w_rthz is not None):
            return
        name = "photon.load" if load else "detector.nep"
        for key in ("bandwidth", "efficiency", "polarizations"):
            if getattr(self.instrument, key) is None:
                raise ValueError(f"instrument.{key}: missing; {name!r} needs it")
        if load and load.sky_k is None and not (self.atmosphere and self.atmosphere.site):
            raise ValueError("photon.load.sky: missing; a temperature, or a site that it follows from, is expected")


def load_scene(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Read and check a scene.

    Parameters
    ----------
    path
        Path of a scene file, or the name of a scene (`surveysim.scene.shipped.find_scene`). A table [sweep] is ignored.
    overrides
        Values by dotted key, as in the file; astropy quantities are allowed.

    Raises
    ------
    SceneError
        With one line for each error: file, key, value found, values allowed.
    """
    path = find_scene(path)
    return scene_of(path, *read_scene(path), {key: file_value(value) for key, value in (overrides or {}).items()})


def read_scene(path: Path) -> tuple[str, dict]:
    """Text and unchecked content of a scene file; raises SceneError when it can't be read."""
    try:
        text = read_text(path, MAX_BYTES)
    except InputError as error:
        raise SceneError(f"{path}: {error}; a scene file (TOML) is expected") from None
    if match := _LONG_KEY.search(text):
        raise SceneError(f"{path}: found a key of {MAX_DEPTH} parts or more, {shown(match[0])}; fewer are expected")
    try:
        content = tomllib.loads(text)
    except RecursionError:
        raise SceneError(f"{path}: nested too deeply; a scene file (TOML) is expected") from None
    except ValueError as error:  # of TOML and of its dates
        raise SceneError(f"{path}: not a valid TOML file ({one_line(error)})") from None
    if nested_deeper(content, MAX_DEPTH):
        raise SceneError(f"{path}: nested too deeply; a scene file (TOML) is expected")
    return text, content


def scene_of(path: Path, text: str, content: Mapping[str, Any], overrides: Mapping[str, Any]) -> Scene:
    """The scene of a file that `read_scene` has read; `content` stays as it is. Errors as `load_scene`."""
    data = deepcopy({key: value for key, value in content.items() if key != "sweep"})
    if "assumed" in data or "assumed" in overrides:
        raise SceneError(f"{path}: assumed: unknown key; allowed are {', '.join(allowed_keys(()))}")
    assumed = {line: line.partition(" = ")[0] for line in assumed_values(text)}
    data["assumed"] = [line for line, key in assumed.items() if key not in overrides and not key.startswith("sweep.")]
    for key, value in overrides.items():
        _override(path, data, key, value)
    if isinstance(data.get("atmosphere"), dict):
        data["assumed"] += _assumed_of_site(data["atmosphere"])
    if renamed := [f"{old} is now {new}" for old, new in RENAMED.items() if _holds(data, old)]:
        raise SceneError(error_lines(path, renamed))
    if "name" not in data:
        data["name"] = _name_of(path)
    positions = data.get("instrument", {}).get("positions") if isinstance(data.get("instrument"), dict) else None
    if isinstance(positions, str) and positions and "\0" not in positions:
        data["instrument"]["positions"] = os.path.realpath(path.parent / positions)
    try:
        scene = Scene.model_validate(data)
        scene._origin = Origin(path.absolute(), text, dict(overrides))
        return scene
    except ValidationError as error:
        found = error.errors(include_url=False, include_context=False)
        lines = [_error_line(item) for item in found[:MAX_ERRORS]]
        raise SceneError(error_lines(path, lines, len(found) - len(lines))) from None


def _holds(data: Mapping[str, Any], key: str) -> bool:
    """Whether a scene's content has a key `section.name`."""
    section, name = key.split(".")
    return isinstance(data.get(section), Mapping) and name in data[section]


def _name_of(path: Path) -> str:
    """The name that a file gives its scene; raises SceneError, which says how to name it, where it can't."""
    if not re.fullmatch(NAME, path.stem) or len(path.stem) > MAX_NAME:
        raise SceneError(
            f"{path}: name: missing, and the file's name {shown(path.stem)} can't take its place; a line like"
            ' name = "my_scene" at the top of the file, before any [section], or --set name=my_scene is expected:'
            f" up to {MAX_NAME} ASCII letters, digits, '_', '.' and '-', neither of the last two first"
        )
    return path.stem


def scene_hash(scene: Scene) -> str:
    """SHA-256 of all that a run's results depend on: equal for equal runs, whatever the comments say."""
    content = scene.model_dump(mode="json", exclude={"title", "assumed"})
    if scene.instrument.positions is not None:
        table = scene.instrument.positions.read_bytes()
        content["instrument"]["positions"] = hashlib.sha256(table).hexdigest()
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def resolved(scene: Scene) -> str:
    """The scene in internal units as JSON, with units in the names."""
    return strict_json(scene.model_dump(mode="json"), indent=1, sort_keys=True)


def assumed_values(text: str) -> list[str]:
    """Lines ``section.key = value: comment`` of a scene's text whose comment begins with assumed or calibrated."""
    section, found = "", []
    for line in text.splitlines():
        if match := re.match(r"\s*\[\[?([\w.]+)\]", line):
            section = match[1] + "."
        elif comment := re.search(r"#\s*((?:assumed|calibrated).*)$", line):
            key, equals, value = line[: comment.start()].partition("=")
            if equals and re.fullmatch(r"\w+", key.strip()):
                found.append(f"{section}{key.strip()} = {value.strip()}: {comment[1]}")
    return found


def _assumed_of_site(section: Mapping[str, Any]) -> list[str]:
    """What the site of an [atmosphere] assumes, of the keys that the scene leaves to it."""
    lines = (line.partition(".")[::2] for line in assumed_values(sites_text()))
    return [
        f"atmosphere.{rest}" for site, rest in lines if site == section.get("site") and rest.split()[0] not in section
    ]


def _override(path: Path, data: dict, key: str, value: Any) -> None:
    *sections, last = key.split(".")
    if len(sections) >= MAX_DEPTH or nested_deeper(value, MAX_DEPTH):
        raise SceneError(f"{path}: {shown(key)}: nested too deeply; a key of a scene is expected")
    for name in sections:
        data = data.setdefault(name, {})
        if not isinstance(data, dict):
            raise SceneError(f"{path}: {key}: {name!r} is not a section")
    data[last] = value


def error_lines(path: Path, errors: Sequence[str], left_off: int = 0) -> str:
    """A line for each error of a file, the first few where there are many; `left_off` are left off already."""
    left_off += len(errors[MAX_ERRORS:])
    more = [f"{left_off} more errors"] if left_off else []
    return "\n".join(f"{path}: {line}" for line in [*errors[:MAX_ERRORS], *more])


def _error_line(item: Any) -> str:
    key = key_text(".".join(str(part) for part in item["loc"]))
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "value_error" and (match := re.match(r"([a-z_0-9]+): ", message)) and key:
        # A check of a whole section names the key that it is about.
        key, message = f"{key}.{match[1]}", message[match.end() :]
    if item["type"] == "extra_forbidden":
        message = f"unknown key; allowed are {', '.join(allowed_keys(item['loc'][:-1]))}"
    elif item["type"] == "missing":
        message = "missing; this key is expected"
    elif item["type"] != "value_error":
        message = re.sub(r"^Input should be (greater|less)(.*)$", r"a number \1\2 is expected", message)
        allowed = _EXPECTED.get(item["type"], f"{message[0].lower()}{message[1:]}")
        message = f"found {shown(item['input'])}; {allowed}"
    return f"{key}: {message}" if key else message


_EXPECTED = {
    "model_type": "a section is expected",
    "tuple_type": "a list is expected",
    "string_type": "a text in quotes is expected",
    "int_type": "an integer is expected",
    "int_parsing": "an integer is expected",
    "int_from_float": "an integer is expected",
    "float_type": "a number is expected",
    "float_parsing": "a number is expected",
    "finite_number": "a finite number is expected",
    "string_pattern_mismatch": "ASCII letters, digits, '_', '.' and '-' are expected, neither of the last two first",
}


def allowed_keys(location: tuple) -> list[str]:
    """Keys that a section of the file may have, by the names that lead to it; none where there is no section."""
    model: Any = Scene
    for name in location:
        if isinstance(name, int):
            continue
        annotation = next((f.annotation for k, f in model.model_fields.items() if (f.alias or k) == name), None)
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        model = next((c for c in candidates if isinstance(c, type) and issubclass(c, Section)), None)
        if model is None:
            return []
    return sorted(f.alias or k for k, f in model.model_fields.items() if k != "assumed")
