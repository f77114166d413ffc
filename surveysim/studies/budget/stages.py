"""Stages of a scene that a budget removes: components of the streams, steps of the response, cleaning, and settings.

A stage needs others: without turbulence there is nothing to fit responsivities on, and noise that does not exist has no
correlation. Stages that need a removed one are removed with it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from surveysim.scene.noise_and_sky import Photon
from surveysim.scene.response import ResponseSections
from surveysim.scene.scene import Scene
from surveysim.timestreams.component import COMPONENTS, present_components
from surveysim.timestreams.response import RESPONSE_STEPS

CLEANING, ATMOSPHERE = "cleaning", "atmosphere"
NOISES = tuple(item.name for item in COMPONENTS if item.add is not None and item.name != "sky")
FLOORS = ("detector", "photon")  # noise of the least scene: the first that the scene has


@dataclass(frozen=True)
class Stage:
    """A stage of a scene.

    Attributes
    ----------
    name
        Section, or key of the setting that is idealised.
    title
        Name in reports.
    removal
        Values by key that remove it, None for a key or section that is removed.
    needs
        Stages without which it makes no sense.
    """

    name: str
    title: str
    removal: Mapping[str, Any]
    needs: tuple[str, ...] = ()


@dataclass(frozen=True)
class StageList:
    """Stages of a scene by name, and the one that is the floor: noise of the least scene, which no scene is without."""

    stages: Mapping[str, Stage]
    floor: str

    def required(self, name: str) -> frozenset[str]:
        """Stages that a stage needs, directly or not."""
        direct = self.stages[name].needs
        return frozenset(direct).union(*(self.required(other) for other in direct))

    def dependent(self, name: str) -> frozenset[str]:
        """Stages that need a stage, directly or not."""
        return frozenset(other for other in self.stages if name in self.required(other))

    def has_noise_without(self, names: Iterable[str]) -> bool:
        """Tell whether a component of the noise is left without some stages."""
        return not {name for name in NOISES if name in self.stages} <= set(names)

    def removal(self, names: Iterable[str]) -> dict[str, Any]:
        """Values by key that remove some stages, without keys in removed sections; the first stages count most."""
        removed, merged = set(names), dict[str, Any]()
        for name in self.stages:
            if name in removed:
                merged |= {key: value for key, value in self.stages[name].removal.items() if key not in merged}
        gone = tuple(f"{key}." for key, value in merged.items() if value is None)
        return {key: value for key, value in merged.items() if not key.startswith(gone)}


def stages_of(scene: Scene) -> StageList:
    """List the stages of a scene: cleaning, sections of its streams and its response, settings that can be ideal."""
    listed = _in_order(*_cleaning(scene), *_components(scene), *_response(scene), *_settings(scene))
    found = {stage.name: stage for stage in listed}
    floor = next((name for name in (*FLOORS, *reversed(NOISES)) if name in found), "")
    common, stages = (CLEANING,) if CLEANING in found else (), {}
    for name, stage in found.items():
        needs = () if name in (floor, CLEANING) else (*common, *(other for other in stage.needs if other in found))
        stages[name] = Stage(name, stage.title, stage.removal, needs)
    return StageList(stages, floor)


def _in_order(*stages: Stage) -> list[Stage]:
    """Move each stage behind the last one that it needs."""
    ordered: list[Stage] = []
    for stage in stages:
        places = [place for place, other in enumerate(ordered, start=1) if other.name in stage.needs]
        ordered.insert(max(places, default=len(ordered)), stage)
    return ordered


def _cleaning(scene: Scene) -> Iterator[Stage]:
    if scene.cleaning.algorithm != ("none",):
        removal = {"cleaning.algorithm": "none", "cleaning.responsivities": "scan"}
        yield Stage(CLEANING, f"Cleaning ({'+'.join(scene.cleaning.algorithm)})", removal)


def _components(scene: Scene) -> Iterator[Stage]:
    for item in present_components(scene):
        off = {f"{item.name}.{item.switch}": "none"} if item.switch else {item.name: None}
        yield Stage(item.name, item.title, _no_photon_noise(scene.photon) if item.name == "photon" else off)


def _no_photon_noise(photon: Photon) -> dict[str, Any]:
    """Settings of photon noise of level 0: with them the one draw of photon and detector noise stays the same."""
    off: dict[str, Any] = {"photon.psd": "0 mK2 / Hz"}
    if photon.psd_mk2_hz is None:
        off |= {"photon.coherent_fraction": 0.0, "photon.load": None}
    if photon.stop_fraction is not None:
        off["photon.stop_fraction"] = None
    return off if photon.coherence == "none" else off | {"photon.coherence": "none"}


def _response(scene: Scene) -> Iterator[Stage]:
    """Yield the sections of the response, each once: its first step names it."""
    titles = {step.section: step.title for step in reversed(RESPONSE_STEPS)}
    for section in ResponseSections.model_fields:
        if getattr(scene, section) is not None:
            off = {section: None}
            yield Stage(section, titles[section], _no_filter(scene) if section == "time_constants" else off)


def _no_filter(scene: Scene) -> dict[str, Any]:
    """Settings of time constants of 0, with which photon and detector noise keep their draws; else those of a table."""
    if scene.time_constants.value_s is None:
        return {"time_constants": None}
    off = {"time_constants.value": "0 s", "time_constants.scatter": 0.0}
    return off | {"time_constants.deconvolution_error": None}


def _settings(scene: Scene) -> Iterator[Stage]:
    """Yield the settings that are less than ideal."""
    for name, title in (("photon", "Correlation of photon noise"), ("excess", "Correlation of excess noise")):
        section = getattr(scene, name)
        if section is not None and section.coherence != "none":
            ideal = {f"{name}.coherence": "none"}
            if getattr(section, "stop_fraction", None) is not None:
                ideal[f"{name}.stop_fraction"] = None
            yield Stage(f"{name}.coherence", title, ideal, (name,))
    table = scene.instrument.table
    of_table = table is not None and "responsivity" in table.columns
    if scene.instrument.responsivity_scatter > 0 and not of_table:
        key = "instrument.responsivity_scatter"
        yield Stage(key, "Spread of responsivities", {key: 0.0})
    yield from _responsivity_fit(scene)


def _responsivity_fit(scene: Scene) -> Iterator[Stage]:
    from mapmaker.cleaning import TEMPLATE_CLEANINGS

    key, given = "cleaning.responsivities", scene.cleaning.responsivities
    if given == "known" or set(TEMPLATE_CLEANINGS).isdisjoint(scene.cleaning.algorithm):
        return
    if given == "survey":
        yield Stage(key, "Calibration error", {key: "known"})
    else:
        yield Stage(key, f"Fit of responsivities (each {given})", {key: "known"}, (ATMOSPHERE,))
