"""Scenes that the paper's tables and figures need, loaded and checked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surveysim.atmosphere.turbulence_fit import HEIGHT_GRID_M, INDEX_GRID, KOLMOGOROV
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Scene, load_scene

TABLES = (1, 2, 3)
FIGURES = tuple(range(1, 17))
# Scene files by band in GHz, and the keys that are changed in them.
SCENES: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "143": (("lynx", "sds1"), {}),
    "268": (("cosmos",), {}),
    "151": (("acbar_south_pole",), {}),
    "282": (
        ("acbar_south_pole",),
        {
            "name": "acbar_south_pole_282",
            "seed": 20020602,
            "instrument.frequency": "282 GHz",
            "instrument.bandwidth": 0.18,
        },
    ),
}
# Bands, or a run of its own, that each item needs.
NEEDS: dict[str, tuple[str, ...]] = {
    "table 1": ("143", "268", "151", "282"),
    "table 2": ("143",),
    "figure 1": (),
    "figure 2": (),
    "figure 3": ("143",),
    "figure 4": ("143", "268"),
    "figure 5": ("143",),
    "figure 6": ("143",),
    "figure 7": ("143", "268"),
    "figure 8": ("143", "268"),
    "figure 9": ("143",),
    "figure 10": ("143",),
    "figure 11": ("143",),
    "figure 12": ("143",),
    "figure 14": ("143",),
    "figure 15": ("143",),
    # Runs of their own.
    "figure 13": ("compared",),
    "table 3": ("scored",),
    "figure 16": ("scored",),
}
# Cleaning algorithms that figure 13 compares with average subtraction.
COMPARED = (("planar",), ("quadratic",))
# Noise-only sets of Table 3 and figure 16; the other sets are the survey itself and an array masked by separation.
SIMULATED = ("uncorrelated", "white")


@dataclass(frozen=True)
class Wanted:
    """Requested tables and figures, with the scenes that they need.

    Attributes
    ----------
    tables, figures
        Numbers in the paper.
    scenes
        Scenes by band in GHz.
    model
        Scene of figure 2.
    runs
        Scenes of scored runs, by the names in `NEEDS`.
    """

    tables: tuple[int, ...]
    figures: tuple[int, ...]
    scenes: dict[str, list[Scene]]
    model: Scene | None
    runs: dict[str, Scene]

    @property
    def items(self) -> list[str]:
        """Names of all items, such as "figure 5"."""
        return [f"table {number}" for number in self.tables] + [f"figure {number}" for number in self.figures]

    @property
    def observations(self) -> int:
        """Number of observations to simulate."""
        measured = sum(scene.observations for scenes in self.scenes.values() for scene in scenes)
        return measured + sum(scene.observations for scene in self.runs.values())


def wanted(
    tables: Sequence[int],
    figures: Sequence[int],
    scenarios: Path,
    *,
    observations: int | None,
    overrides: Mapping[str, Any] | None = None,
) -> Wanted:
    """Load and check the scenes that tables and figures need.

    Parameters
    ----------
    tables, figures
        Numbers in the paper.
    scenarios
        Folder of the scene files.
    observations
        Largest number of observations of each scene; None for all.
    overrides
        Values by dotted key, for all scenes.

    Raises
    ------
    SceneError
        For a scene that can't be run or measured, and for scenes of one band with different cameras or settings.
    """
    names = [f"table {number}" for number in tables] + [f"figure {number}" for number in figures]
    scenes: dict[str, list[Scene]] = {}
    for band in (band for band in SCENES if any(band in NEEDS[name] for name in names)):
        files, changes = SCENES[band]
        paths = [scenarios / f"{name}.toml" for name in files]
        scenes[band] = [_scene(path, changes | dict(overrides or {}), observations) for path in paths]
        for path, scene in zip(paths, scenes[band], strict=True):
            _check(path, scene, scenes[band][0])
    lynx = scenarios / "lynx.toml"
    model = _scene(lynx, dict(overrides or {}), observations) if 2 in figures else None
    loaders = {"compared": _compared, "scored": _scored}
    runs = {
        need: load(lynx, dict(overrides or {}), observations)
        for need, load in loaders.items()
        if any(need in NEEDS[name] for name in names)
    }
    return Wanted(tuple(tables), tuple(figures), scenes, model, runs)


def _compared(path: Path, overrides: dict[str, Any], observations: int | None) -> Scene:
    """Scene that scores only the cleaning algorithms of figure 13."""
    scene = _scene(path, {"cleaning.compare": [list(steps) for steps in COMPARED]} | overrides, observations)
    if scene.score is None:
        raise SceneError(f"{path}: score: missing; figure 13 scores the maps")
    score = scene.score.model_copy(update={"mask_separation_f_lambda": None, "noise_only_sets": (), "reference": None})
    return _prepared(path, scene.model_copy(update={"score": score}))


def _scored(path: Path, overrides: dict[str, Any], observations: int | None) -> Scene:
    """Scene that scores only the four data sets of Table 3."""
    scene = _scene(path, {"cleaning.compare": []} | overrides, observations)
    if scene.score is None:
        raise SceneError(f"{path}: score: missing; Table 3 and figure 16 score the maps")
    if set(scene.score.noise_only_sets) != set(SIMULATED):
        found = ", ".join(scene.score.noise_only_sets) or "none"
        raise SceneError(
            f"{path}: score.noise_only_sets: found {found}; Table 3 and figure 16 need {' and '.join(SIMULATED)}"
        )
    if scene.score.mask_separation_f_lambda is None:
        raise SceneError(f"{path}: score.mask_separation_f_lambda: missing; Table 3 and figure 16 need a masked array")
    score = scene.score.model_copy(update={"reference": None})
    return _prepared(path, scene.model_copy(update={"score": score}))


def _prepared(path: Path, scene: Scene) -> Scene:
    """Prepare the scene once; raises SceneError with its file if it can't be run."""
    try:
        prepare(scene)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    return scene


def _scene(path: Path, changes: dict[str, Any], observations: int | None) -> Scene:
    scene = load_scene(path, changes)
    if observations is None or observations >= scene.observations:
        return scene
    return scene.model_copy(update={"observations": observations})


def _check(path: Path, scene: Scene, first: Scene) -> None:
    """Raise SceneError unless a scene can be measured together with the first one of its band."""
    unscored = _prepared(path, scene.model_copy(update={"score": None}))
    if scene.atmosphere is None:
        raise SceneError(f"{path}: [atmosphere] is missing; this command measures it")
    if (found := len(prepare(unscored).observing.blocks)) > 1:
        memory = f"{scene.numerics.max_block_bytes / 1e6:.4g} MB"
        raise SceneError(
            f"{path}: numerics.max_block_memory: found {memory}, which cuts observations into {found} blocks; "
            "a limit that an observation fits in is expected, as whole ones are measured"
        )
    index, height = scene.atmosphere.spectral_index, scene.atmosphere.layer_height_m
    if abs(index - INDEX_GRID[KOLMOGOROV]) > 1e-9 or height not in HEIGHT_GRID_M:
        raise SceneError(
            f"{path}: atmosphere: found index {index:.4g} and layer_height {height:g} m; B2 is fitted at"
            f" 11/3 and one of {', '.join(f'{height:g}' for height in HEIGHT_GRID_M)} m"
        )
    for name in ("instrument", "atmosphere", "scan"):
        if getattr(scene, name) != getattr(first, name):
            raise SceneError(f"{path}: {name}: not that of {first.name!r}; scenes of one band are measured together")
