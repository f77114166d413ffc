"""Scenes: the schema of the whole file, and its reading with overrides.

A scene is a TOML file; quantities are strings with units. Each section switches on a stage of the simulation. All
records are frozen and hold floats in internal units.
"""

import hashlib
import json
import os
import re
import tomllib
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, PrivateAttr, ValidationError, model_validator
from pydantic.json_schema import SkipJsonSchema

from surveysim.runtime.errors import InputError, SceneError
from surveysim.runtime.strict_json import strict_json
from surveysim.runtime.text_files import nested_deeper, one_line, read_text
from surveysim.scene.analysis import Cleaning, Score
from surveysim.scene.assumed_values import assumed_of_site, assumed_values
from surveysim.scene.error_lines import HIDDEN_KEYS, allowed_keys, error_lines, unknown_key, validation_lines
from surveysim.scene.fields import Line, whole
from surveysim.scene.instrument import Instrument
from surveysim.scene.map_section import MapSection
from surveysim.scene.noise_and_sky import ONE_NOISE, StreamSections
from surveysim.scene.numerics import Numerics
from surveysim.scene.observing import FieldSection, FixedPointing, Schedule
from surveysim.scene.optics import Optics
from surveysim.scene.optimise import Optimise
from surveysim.scene.place import Place, SiteSection, own_place, shipped_place, with_place
from surveysim.scene.readout import ReadoutSections
from surveysim.scene.renamed_keys import renamed_lines
from surveysim.scene.response import ResponseSections
from surveysim.scene.scan_patterns import AnyScan
from surveysim.scene.section import Section
from surveysim.scene.shipped import MAX_NAME, NAME, find_scene, is_name, no_such_scene
from surveysim.scene.sites import OWN
from surveysim.scene.spectra import Spectra
from surveysim.scene.telescope import TelescopeSection
from surveysim.scene.units import file_value, shown

MAX_BYTES = 300_000  # largest scene file; typical ones have 5 kB with comments
MAX_DEPTH = 20  # tables and lists within each other; scenes have 3
# A key of so many parts: the parser's time goes as their square.
_PART = r"""(?:"[^"\n]*+"|'[^'\n]*+'|[\w-]++)"""
_LONG_KEY = re.compile(rf"(?<![\w\-.]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MAX_DEPTH - 1}}}")


@dataclass(frozen=True)
class Origin:
    """File that a scene was read from, and overrides by key; not part of a scene's identity."""

    path: Path = field(compare=False)
    text: str = field(compare=False)
    overrides: dict[str, Any] = field(compare=False)


class CameraBand(Section):
    """Band of a camera of several: its name, and the scenes of the other bands, which have no others themselves."""

    name: str
    others: tuple["Scene", ...] = ()


class ObservationSections(Section):
    """Keys of the run, and sections of the field, the observations and the instrument."""

    name: str = Field(pattern=f"^{NAME}$", max_length=MAX_NAME, json_schema_extra={"otherwise": "that of the file"})
    """Name of the run and of its output directory: letters, digits, `_`, `.` and `-`."""
    title: Line
    """Title of tables and figures, on one line."""
    seed: Annotated[int, *whole(0, 2**63 - 1)]
    """Seed of all random numbers."""
    observations: Annotated[int, *whole(1, 1_000_000)]
    """Number of observations of the survey."""
    field: FieldSection
    site: SiteSection | None = None
    """Alternative: `atmosphere.site`, the name of a site that ships."""
    schedule: Schedule | None = None
    """Alternative: `fixed_pointing`."""
    fixed_pointing: FixedPointing | None = None
    """Alternative: `schedule`."""
    instrument: Instrument
    optics: Optics | None = None
    """Photon noise, beam and flux calibration follow from it where they are left out."""
    scan: AnyScan
    telescope: TelescopeSection | None = None
    """Without it no track is refused as too fast."""


class Scene(ResponseSections, ReadoutSections, StreamSections, ObservationSections):
    """A whole scene; a section that is left out leaves out its stage of the simulation.

    Two attributes are no keys of the file. `assumed` lists the values whose comments call them assumed or calibrated.
    `band` is set where the scene is that of one band of a camera (`surveysim.scene.bands`).
    """

    cleaning: Cleaning
    map: MapSection
    score: Score | None = None
    """Without it there are maps, but no uncertainties."""
    spectra: Spectra | None = None
    numerics: Numerics = Numerics()
    optimise: Optimise | None = None
    assumed: SkipJsonSchema[tuple[str, ...]] = ()
    band: SkipJsonSchema[CameraBand | None] = None
    _origin: Origin | None = PrivateAttr(None)

    @property
    def origin(self) -> Origin | None:
        """File that the scene was read from; None for a scene made otherwise."""
        return self._origin

    @property
    def band_name(self) -> str:
        """Name of the band; empty for a camera of one."""
        return self.band.name if self.band else ""

    @property
    def others(self) -> tuple["Scene", ...]:
        """Scenes of the other bands of the camera."""
        return self.band.others if self.band else ()

    @property
    def place(self) -> Place | None:
        """Place whose air the telescope looks through; None without water vapour."""
        if self.atmosphere is None or self.atmosphere.site is None:
            return None
        return own_place(self.site) if self.site else shipped_place(self.atmosphere.site)

    @property
    def turbulent(self) -> bool:
        """True if the time-streams have a turbulent layer."""
        return self.atmosphere is not None and self.atmosphere.turbulence != "none"

    @model_validator(mode="before")
    @classmethod
    def _site_supplies_the_place(cls, data: Any) -> Any:
        return with_place(data) if isinstance(data, dict) else data

    @model_validator(mode="after")
    def _sections_fit(self) -> Self:
        if (self.schedule is None) == (self.fixed_pointing is None):
            raise ValueError("exactly one of the sections 'schedule' and 'fixed_pointing' is expected")
        if self.excess and len(self.excess.b2) > 1 and self.atmosphere is None:
            raise ValueError("excess.b2: found several values; without [atmosphere] one value is expected")
        if self.atmosphere and self.atmosphere.site and not self.instrument.band.width_hz:
            raise ValueError("instrument.bandwidth: missing; the opacity of a site needs the width of the band")
        if self.fixed_pointing and self.atmosphere and (key := self.atmosphere.dated_key):
            raise ValueError(f"atmosphere.{key}: found with [fixed_pointing]; [schedule] is expected, which has dates")
        self._beam_is_known()
        self._load_is_given()
        self._power_is_known()
        self._readout_fits()
        if not any(getattr(self, name) for name in StreamSections.model_fields):
            *names, last = StreamSections.model_fields
            raise ValueError(f"at least one of {', '.join(names)} and {last} is expected")
        self.scan.check_observations(self.observations, self.schedule is not None)
        if self.spectra:
            self.spectra.check(self.score, self.scan, self.map.maker)
        return self

    def _readout_fits(self) -> None:
        """Raise ValueError for frequencies and times that scans do not resolve, and levels relative to absent noise."""
        for number, line in enumerate(self.lines):
            if line.frequency_hz > self.scan.sample_rate_hz / 2:
                raise ValueError(
                    f"lines.{number}.frequency: found {line.frequency_hz:g} Hz; half of scan.sample_rate,"
                    f" {self.scan.sample_rate_hz / 2:g} Hz, or less is expected"
                )
        if self.glitches and self.glitches.decay_time_s > self.scan.duration_s:
            raise ValueError(
                f"glitches.decay_time: found {self.glitches.decay_time_s:g} s; {self.scan.duration_s:g} s or less is"
                f" expected, {self.scan.duration_key}"
            )
        if self.photon or self.detector:
            return
        for name, part in self.readout_noise.parts.items() if self.readout_noise else ():
            if part.psd_mk2_hz is None:
                raise ValueError(f"readout_noise.{name}.psd: missing; without [photon] and [detector] it is expected")
        if self.glitches and self.glitches.threshold is not None:
            raise ValueError("glitches.threshold: found without [photon] and [detector], whose noise it is relative to")

    def _beam_is_known(self) -> None:
        """Raise ValueError for a beam or (f/#)lambda that is left out without an aperture that it follows from."""
        aperture_m = self.optics.aperture_m if self.optics else None
        for key, value in (("beam_fwhm", self.instrument.beam_fwhm_rad), ("f_lambda", self.instrument.f_lambda_rad)):
            if value is None and aperture_m is None:
                raise ValueError(
                    f"instrument.{key}: missing; an angle, or 'optics.aperture' that it follows from, is expected"
                )

    def _load_is_given(self) -> None:
        """Raise ValueError unless photon noise, and noise that depends on the load, have exactly one source."""
        photon, kid = self.photon, self.detector.kid if self.detector else None
        if photon and photon.psd_mk2_hz is None and photon.load is None and self.optics is None:
            raise ValueError("photon: exactly one of 'psd', 'load' (a section) and a section [optics] is expected")
        if self.detector and self.detector.stated is None and self.instrument.table_noise is None:
            raise ValueError(f"detector: {ONE_NOISE}, or a column 'psd' or 'nep' of the table instrument.positions")
        if photon and photon.load and self.optics:
            raise ValueError("photon.load: found together with [optics], which sets it; one of the two is expected")
        if kid and not (photon and photon.psd_mk2_hz is None):
            raise ValueError("detector.kid: its noise depends on the load; 'photon.load' or [optics] is expected")

    def _power_is_known(self) -> None:
        """Raise ValueError for noise given by optical power without the keys that convert it to temperature."""
        if (name := self.given_by_power) is None:
            return
        for key in ("bandwidth", "efficiency", "polarizations"):
            if getattr(self.instrument, key) is None and not (key == "bandwidth" and self.instrument.passband):
                raise ValueError(f"instrument.{key}: missing; {name!r} needs it")
        if name not in ("photon.load", "optics"):
            return
        load, key = (self.photon.load, "photon.load.sky") if name == "photon.load" else (self.optics, "optics.sky")
        if load.sky_k is None and not (self.atmosphere and self.atmosphere.site):
            raise ValueError(f"{key}: missing; a temperature, or a site that it follows from, is expected")

    @property
    def given_by_power(self) -> str | None:
        """Section or key that gives noise by power; None if none does."""
        photon, detector = self.photon, self.detector
        if photon and photon.psd_mk2_hz is None:
            return "photon.load" if photon.load else "optics"
        if detector and detector.stated is None:
            return "instrument.positions" if self.instrument.table_noise[0] == "nep" else None
        return f"detector.{detector.stated}" if detector and detector.stated != "psd" else None


def load_scene(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Read and check a scene.

    Parameters
    ----------
    path
        Path of a scene file, or name of a scene (`find_scene`).
    overrides
        Values by dotted key, such as ``{"scan.speed": "4 arcmin / s"}``; astropy quantities are allowed. None removes a
        key or a section.

    Returns
    -------
    The scene; of a file with a table [sweep] the scene that all points start from.

    Raises
    ------
    SceneError
        With one line for each error: file, key, value found, values expected.
    """
    path = find_scene(path)
    return scene_of(path, *read_scene(path), {key: file_value(value) for key, value in (overrides or {}).items()})


def read_scene(path: Path) -> tuple[str, dict]:
    """Read a scene file without checking its keys: text and content. Raises SceneError if it can't be read."""
    if is_name(str(path)) and not os.path.lexists(path):
        raise SceneError(no_such_scene(str(path)))
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
    except ValueError as error:  # invalid TOML or dates
        raise SceneError(f"{path}: not a valid TOML file ({one_line(error)})") from None
    if nested_deeper(content, MAX_DEPTH):
        raise SceneError(f"{path}: nested too deeply; a scene file (TOML) is expected")
    return text, content


def scene_of(path: Path, text: str, content: Mapping[str, Any], overrides: Mapping[str, Any]) -> Scene:
    """Make the scene of a file that `read_scene` has read; errors as for `load_scene`."""
    data = scene_data(path, text, content, overrides)
    if "bands" in data:
        raise SceneError(f"{path}: bands: found a camera of several bands; a scene without [bands] is expected here")
    scene, wrong = validated(data, path.parent)
    if scene is None:
        raise SceneError(error_lines(path, wrong))
    scene._origin = Origin(path.absolute(), text, dict(overrides))
    return scene


def scene_data(path: Path, text: str, content: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a file by key, as `validated` takes them: with overrides, name and assumed values."""
    data = deepcopy({key: value for key, value in content.items() if key != "sweep"})
    given = {key.partition(".")[0] for key in (*data, *overrides)}
    for hidden in HIDDEN_KEYS:
        if hidden in given:
            raise SceneError(f"{path}: {hidden}: {unknown_key(hidden, Scene)}")
    assumed = {line: line.partition(" = ")[0] for line in assumed_values(text)}
    replaced = tuple(f"{key}." for key in overrides)
    data["assumed"] = [line for line, key in assumed.items() if not f"{key}.".startswith((*replaced, "sweep."))]
    for key, value in overrides.items():
        _override(path, data, key, value)
    if "name" not in data:
        data["name"] = _name_of(path)
    return data


def validated(data: Mapping[str, Any], folder: Path) -> tuple[Scene | None, list[str]]:
    """Check the values of a scene whose file is in `folder`; return the scene, or None and a line for each error."""
    if renamed := renamed_lines(data):
        return None, renamed
    if isinstance(air := data.get("atmosphere"), dict):
        of_site = assumed_of_site(air if "site" not in data else {"site": OWN} | air)
        data = {**data, "assumed": [*data["assumed"], *of_site]}
    try:
        return Scene.model_validate(data, context={"folder": folder}), []
    except ValidationError as error:
        return None, validation_lines(error, Scene)


def _name_of(path: Path) -> str:
    """Name a scene after its file; raises SceneError for a file whose name is no name of a scene."""
    if not re.fullmatch(NAME, path.stem) or len(path.stem) > MAX_NAME:
        raise SceneError(
            f"{path}: name: missing, and the file's name {shown(path.stem)} can't take its place; a line like"
            ' name = "my_scene" at the top of the file, before any [section], or --set name=my_scene is expected:'
            f" up to {MAX_NAME} ASCII letters, digits, '_', '.' and '-', neither of the last two first"
        )
    return path.stem


def scene_hash(scene: Scene) -> str:
    """SHA-256 hash of everything that the results of a run depend on; title and comments do not count."""
    return _hash(_content(scene, {"title": True, "assumed": True}))


def survey_hash(scene: Scene) -> str:
    """SHA-256 hash of everything that one observation depends on, but for its start.

    Surveys of more observations, or nights, have the same; those of a single one compare pipelines otherwise.
    """
    excluded: dict[str, Any] = {"title": True, "assumed": True, "observations": True, "schedule": {"nights"}}
    return _hash(_content(scene, excluded) | {"single": scene.observations == 1})


def _content(scene: Scene, excluded: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a scene without some keys; of other bands all that the results depend on."""
    content = scene.model_dump(exclude={**excluded, "band": True, "optimise": True, "telescope": True})
    if scene.band is None:
        return content
    return content | {"band": scene.band.name, "others": [_of_other(scene, other, excluded) for other in scene.others]}


def _of_other(scene: Scene, other: Scene, excluded: Mapping[str, Any]) -> dict[str, Any]:
    """Values of another band: all where cleaning subtracts its streams, else those that size the common layer."""
    if "spectral" in scene.cleaning.named:
        return _content(other, excluded)
    content = other.model_dump(include={"instrument", "optics"})
    return content | {"spectral": "spectral" in other.cleaning.named}


def _hash(content: dict[str, Any]) -> str:
    """Hash the values of a scene; files count by their content, whatever their names."""
    text = json.dumps(content, sort_keys=True, default=lambda path: hashlib.sha256(path.read_bytes()).hexdigest())
    return hashlib.sha256(text.encode()).hexdigest()


def resolved(scene: Scene) -> str:
    """JSON text of a scene in internal units, with units in the names."""
    bands = {"band": scene.band_name, "other_bands": [item.band_name for item in scene.others]} if scene.band else {}
    return strict_json(scene.model_dump(mode="json", exclude={"band", "optimise"}) | bands, indent=1, sort_keys=True)


def _override(path: Path, data: dict, key: str, value: Any) -> None:
    *sections, last = key.split(".")
    if len(sections) >= MAX_DEPTH or nested_deeper(value, MAX_DEPTH):
        raise SceneError(f"{path}: {shown(key)}: nested too deeply; a key of a scene is expected")
    if value is None and sections[:1] != ["bands"]:  # a band may be without what others have
        _remove(path, data, key)
        return
    for name in sections:
        data = data.setdefault(name, {})
        if isinstance(data, list):
            raise SceneError(f"{path}: {key}: {name!r} is a list; a new list in place of all of it is expected")
        if not isinstance(data, dict):
            raise SceneError(f"{path}: {key}: {name!r} is not a section")
    data[last] = value


def _remove(path: Path, data: dict, key: str) -> None:
    """Remove a key or a section; one that is not there stays away, an unknown one is an error."""
    *sections, last = key.split(".")
    if last not in allowed_keys(sections, Scene):
        raise SceneError(f"{path}: {shown(key)}: {unknown_key(key, Scene, HIDDEN_KEYS)}")
    for name in sections:
        data = data.get(name, {})
        if not isinstance(data, dict):
            return
    data.pop(last, None)
