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
class Explained:
    """Surveys of an explanation.

    Attributes
    ----------
    ingredients
        One layer, each ingredient alone, the best combination.
    scenes
        Scene of each.
    layers
        Scenes of winds with a second layer, by its angle [deg] and share of B2.
    """

    ingredients: tuple[Ingredient, ...]
    scenes: tuple[Scene, ...]
    layers: Mapping[tuple[float, float], Scene]

    @property
    def observations(self) -> int:
        """Number of observations to simulate."""
        return sum(scene.observations for scene in (*self.scenes, *self.layers.values()))


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
    combination = Ingredient(last["name"], last["title"], last["origin"], together | last["settings"])
    first = Ingredient(ONE_LAYER, "one layer", "the scene as it is", {})
    return (first, *alone.values(), combination)


def _without_empty(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with None in place of empty texts, which remove a key."""
    return {key: None if value == "" else value for key, value in settings.items()}


def explained(
    scenarios: Path, *, observations: int | None = None, overrides: Mapping[str, Any] | None = None
) -> Explained:
    """Load and check the scenes of an explanation.

    Parameters
    ----------
    scenarios
        Folder of the scene files.
    observations
        Observations of each survey; None for the number of `ingredients.toml`.
    overrides
        Values by dotted key, for all scenes.

    Raises
    ------
    SceneError
        For a scene that can't be run.
    """
    items, path, changes = ingredients(), scenarios / SCENE, dict(overrides or {})
    changes |= {"observations": observations or _content()["observations"]}
    scenes = tuple(_scene(path, item.title, SETTINGS | changes | dict(item.settings)) for item in items)
    second = _content()["second_layer"]
    layers = {
        (turn, share): _scene(
            path, f"a second layer of {share:g}", SETTINGS | changes | _second_layer(second, turn, share)
        )
        for turn in second["turns_deg"]
        for share in second["shares"]
    }
    return Explained(items, scenes, layers)


def _second_layer(second: Mapping[str, Any], turn_deg: float, share: float) -> dict[str, Any]:
    """Settings of a second layer with a share of B2, and the first layer with the rest."""
    first = {"name": "first", "share": 1 - share} | second["first"]
    other = {"name": "second", "share": share, "wind_turn": f"{turn_deg:g} deg"} | second["second"]
    return {"atmosphere.layers": [first, other]}


def _scene(path: Path, title: str, settings: Mapping[str, Any]) -> Scene:
    scene = load_scene(path, settings)
    try:
        prepare(scene)
    except SceneError as error:
        raise SceneError(f"{path} with {title}: {error}") from None
    return scene
