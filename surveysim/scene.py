"""A scene: its sections together, how its file is read, and what its errors say.

A scene is TOML; quantities are strings with units. A stage is a section, and an absent section
leaves its stage out. Every record here is frozen and holds floats in internal units.
"""

import hashlib
import json
import re
import tomllib
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator
from pydantic.json_schema import SkipJsonSchema

from surveysim.quantities import shown
from surveysim.scan import MIN_SAMPLES
from surveysim.sections import (
    Atmosphere,
    Cleaning,
    Detector,
    Excess,
    FieldSection,
    FixedPointing,
    Instrument,
    MapSection,
    Numerics,
    Photon,
    Scan,
    Schedule,
    Score,
    Section,
    Sky,
)
from surveysim.sites import sites_text
from surveysim.strict_json import strict_json


class SceneError(ValueError):
    """A scene that can't be run; the text has one line for each error: file, key, found, allowed."""


class Scene(Section):
    """A whole scene; an absent section leaves its stage out.

    `assumed` is not a key of the file: it lists the file's own values whose comment says that they are
    assumed or calibrated.
    """

    name: str = Field(
        pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$", max_length=100, json_schema_extra={"otherwise": "that of the file"}
    )
    """Name of the run and, unless said otherwise, of its folder: letters, digits, `_`, `.` and `-`."""
    title: str
    """What it is, in a line that heads tables and figures."""
    seed: int = Field(ge=0, lt=2**63)
    """Seed of all random numbers: one seed, one result."""
    observations: int = Field(ge=1, le=1_000_000)
    """Observations of the survey."""
    field: FieldSection
    schedule: Schedule | None = None
    """Or `fixed_pointing`."""
    fixed_pointing: FixedPointing | None = None
    """Or `schedule`."""
    instrument: Instrument
    scan: Scan
    atmosphere: Atmosphere | None = None
    """Left out: no layer, no weather."""
    excess: Excess | None = None
    photon: Photon | None = None
    detector: Detector | None = None
    sky: Sky | None = None
    """Left out: noise alone."""
    cleaning: Cleaning
    map: MapSection
    score: Score | None = None
    """Left out: maps, but no score."""
    numerics: Numerics = Numerics()
    assumed: SkipJsonSchema[tuple[str, ...]] = ()

    @model_validator(mode="after")
    def _sections_fit(self) -> Self:
        if (self.schedule is None) == (self.fixed_pointing is None):
            raise ValueError("exactly one of the sections 'schedule' and 'fixed_pointing' is expected")
        if self.excess and len(self.excess.b2) > 1 and self.atmosphere is None:
            raise ValueError("excess.b2: found several values; without [atmosphere] one value is expected")
        if self.atmosphere and self.atmosphere.site and self.instrument.bandwidth is None:
            raise ValueError("instrument.bandwidth: missing; the opacity of a site needs the width of the band")
        named = {name for steps in (self.cleaning.algorithm, *self.cleaning.compare) for name in steps}
        if "spectral" in named and not self.instrument.colours:
            raise ValueError("instrument.colours: missing; 'spectral' cleaning needs other bands of the pixels")
        if self.instrument.colours and not (self.atmosphere and self.atmosphere.site):
            raise ValueError("atmosphere.site: missing; how colours scale with each other is the opacity of a site")
        self._power_is_known()
        if not any((self.atmosphere, self.excess, self.photon, self.detector, self.sky)):
            raise ValueError("at least one of atmosphere, excess, photon, detector and sky is expected")
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
    """Read and check a scene file; `overrides` maps dotted keys to values.

    A table [sweep] is set aside: the scene is the one that its points start from (`surveysim.sweep`).
    Raises SceneError with one line for each error: file, key, what was found, what is allowed.
    """
    path = Path(path)
    return scene_of(path, *read_scene(path), overrides or {})


def read_scene(path: Path) -> tuple[str, dict]:
    """Text and unchecked content of a scene file; raises SceneError when it can't be read."""
    try:
        text = path.read_text(encoding="utf-8")
        return text, tomllib.loads(text)
    except OSError as error:
        raise SceneError(f"{path}: can't be read ({error.strerror}); a scene file (TOML) is expected") from None
    except RecursionError:
        raise SceneError(f"{path}: nested too deeply; a scene file (TOML) is expected") from None
    except ValueError as error:  # of TOML, of its dates and of its encoding
        raise SceneError(f"{path}: not a whole TOML file ({error})") from None


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
    data.setdefault("name", path.stem)
    positions = data.get("instrument", {}).get("positions") if isinstance(data.get("instrument"), dict) else None
    if isinstance(positions, str) and positions and "\0" not in positions:
        data["instrument"]["positions"] = str((path.parent / positions).resolve())
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        raise SceneError("\n".join(_error_line(path, item) for item in error.errors())) from None


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
        elif match := re.match(r"\s*(\w+)\s*=\s*(.*?)\s*#\s*((?:assumed|calibrated).*)$", line):
            found.append(f"{section}{match[1]} = {match[2]}: {match[3]}")
    return found


def _assumed_of_site(section: Mapping[str, Any]) -> list[str]:
    """What the site of an [atmosphere] assumes, of the keys that the scene leaves to it."""
    lines = (line.partition(".")[::2] for line in assumed_values(sites_text()))
    return [
        f"atmosphere.{rest}" for site, rest in lines if site == section.get("site") and rest.split()[0] not in section
    ]


def _override(path: Path, data: dict, key: str, value: Any) -> None:
    *sections, last = key.split(".")
    for name in sections:
        data = data.setdefault(name, {})
        if not isinstance(data, dict):
            raise SceneError(f"{path}: {key}: {name!r} is not a section")
    data[last] = value


def _error_line(path: Path, item: Any) -> str:
    key = ".".join(str(part) for part in item["loc"])
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "value_error" and (match := re.match(r"([a-z_0-9]+): ", message)) and key:
        # A check of a whole section names the key that it is about.
        key, message = f"{key}.{match[1]}", message[match.end() :]
    if item["type"] == "extra_forbidden":
        message = f"unknown key; allowed are {', '.join(allowed_keys(item['loc'][:-1]))}"
    elif item["type"] == "missing":
        message = "missing; this key is expected"
    elif item["type"] != "value_error":
        allowed = _EXPECTED.get(item["type"], f"{message[0].lower()}{message[1:]}")
        message = f"found {shown(item['input'])}; {allowed}"
    return f"{path}: {key}: {message}" if key else f"{path}: {message}"


_EXPECTED = {
    "model_type": "a section is expected",
    "tuple_type": "a list is expected",
    "string_type": "a text in quotes is expected",
    "int_type": "an integer is expected",
    "int_parsing": "an integer is expected",
    "int_from_float": "an integer is expected",
    "float_type": "a number is expected",
    "float_parsing": "a number is expected",
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
