"""Ingredients that are added to one frozen layer, from `ingredients.toml`."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from surveysim.paper.explain.values import SETTINGS
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Scene, load_scene

ONE_LAYER = "one_layer"
SCENE = "lynx.toml"


@dataclass(frozen=True)
class Ingredient:
    """An ingredient: name, title, origin of its values, and the keys that it changes (None removes a key)."""

    name: str
    title: str
    origin: str
    settings: Mapping[str, Any]


@dataclass(frozen=True)
class SecondLayer:
    """A second layer of several shares of B2, at some angles to the wind of the first.

    Attributes
    ----------
    shares
        Fractions of B2.
    turns_deg
        Angles between the winds.
    height_m, wind_factor
        Height of the second layer and its wind speed over that of the first.
    """

    shares: tuple[float, ...]
    turns_deg: tuple[float, ...]
    height_m: float
    wind_factor: float


@lru_cache
def _content() -> dict[str, Any]:
    path = Path(__file__).with_name("ingredients.toml")
    return tomllib.loads(path.read_text(encoding="utf-8"))


def ingredients() -> tuple[Ingredient, ...]:
    """List the surveys of the table: one layer, each ingredient alone, and the best combination."""
    alone = {
        item["name"]: Ingredient(item["name"], item["title"], item["origin"], _without_empty(item["settings"]))
        for item in _content()["ingredient"]
    }
    last = _content()["combination"]
    together: dict[str, Any] = {}
    for name in last["of"]:
        together |= alone[name].settings
    origin = f"the ingredients {', '.join(alone[name].title for name in last['of'])}"
    first = Ingredient(ONE_LAYER, "one layer", "the scene as it is", {})
    return (first, *alone.values(), Ingredient(last["name"], last["title"], origin, together))


def _without_empty(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with None in place of empty texts, which remove a key."""
    return {key: None if value == "" else value for key, value in settings.items()}


def ingredient_scene(
    item: Ingredient, scenarios: Path, *, observations: int, overrides: Mapping[str, Any] | None = None
) -> Scene:
    """Load the scene of an ingredient, with all cleaning algorithms.

    Parameters
    ----------
    item
        The ingredient.
    scenarios
        Folder of the scene files.
    observations
        Number of observations, at most that of the scene.
    overrides
        Values by dotted key, for the scenes of all ingredients.

    Raises
    ------
    SceneError
        For a scene that can't be run.
    """
    path = scenarios / SCENE
    scene = load_scene(path, SETTINGS | dict(overrides or {}) | dict(item.settings) | {"name": f"lynx_{item.name}"})
    scene = scene.model_copy(update={"observations": min(observations, scene.observations)})
    try:
        prepare(scene)
    except SceneError as error:
        raise SceneError(f"{path} with {item.title}: {error}") from None
    return scene
