"""Reproduction of the paper's tables and figures: the observations that each needs, and its files."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from mapmaker.files import atomic_write
from surveysim.atmosphere.turbulence_fit import HEIGHT_GRID_M, INDEX_GRID, KOLMOGOROV
from surveysim.output.directory import OutputDirectory, claimed, finish
from surveysim.output.expected_files import of_paper
from surveysim.output.writer import undrawn
from surveysim.paper.manifest import earlier_runs, write_record
from surveysim.paper.measured_survey import MeasuredSurvey, measure_survey
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import Engine
from surveysim.runtime.errors import InputError, InsufficientDataError, SceneError
from surveysim.runtime.text_files import one_line
from surveysim.scene.scene import Scene, load_scene

if TYPE_CHECKING:
    from astropy.table import Table

    from surveysim.report.figures.spec import PaperFigure
    from surveysim.results.results import SurveyResult

TABLES = (1, 2, 3)
FIGURES = tuple(range(1, 17))
# Scenes of each band's observations, in GHz, and what is changed in them.
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
_NEEDS = {
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
# What figure 13 compares with average subtraction.
COMPARED = (("planar",), ("quadratic",))
# What Table 3 and figure 16 set beside the survey itself, and an array masked by separation.
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
        Scenes of scored runs, by the names in `_NEEDS`.
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
    for band in (band for band in SCENES if any(band in _NEEDS[name] for name in names)):
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
        if any(need in _NEEDS[name] for name in names)
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
            f"whole ones are measured, and {found} times as much is enough for them"
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


def reproduce(
    asked: Wanted, out: Path, engine: Engine, *, progress: Callable[[], None] = lambda: None, force: bool = False
) -> tuple[list[Path], list[str]]:
    """Make tables and figures, each as soon as its observations are measured.

    The directory also gets summary.json, which names the scenes of each item, and report.html. Items of earlier calls
    are kept.

    Parameters
    ----------
    asked
        Tables, figures and scenes, from `wanted`.
    out
        Output directory.
    engine
        Workers.
    progress
        Called after each observation.
    force
        Replace other files, and items that were made of other scenes.

    Returns
    -------
    Files, and a line with the reason for each item that could not be made.

    Raises
    ------
    OutputError
        For a directory that another job writes to or, unless with `force`, with other content.
    """
    with claimed(out, of_paper([*asked.items, *map(_band_item, asked.scenes)]), force) as place:
        return _reproduce(asked, place, engine, progress=progress, force=force)


def _reproduce(
    asked: Wanted, place: OutputDirectory, engine: Engine, *, progress: Callable[[], None], force: bool
) -> tuple[list[Path], list[str]]:
    out, used = place.path, _scenes_used(asked)
    surveys: dict[str, MeasuredSurvey] = {}
    made: dict[str, list[Path]] = {}
    failed: dict[str, str] = {}
    left, start = asked.items, perf_counter()
    workers = engine.workers_for(asked.observations) if asked.observations else 1  # before anything is removed
    earlier = earlier_runs(place, [*asked.items, *map(_band_item, asked.scenes)], used, force)
    try:
        for band in (None, *asked.scenes):
            makers = []
            if band is not None:
                surveys[band] = measure_survey(asked.scenes[band], engine, progress)
                makers.append((_band_item(band), partial(_write_measurements, out, band, surveys[band])))
            ready = [name for name in left if set(_NEEDS[name]) <= set(surveys)]
            left = [name for name in left if name not in ready]
            makers += [(name, partial(_write, name, out, surveys, asked.model)) for name in ready]
            _make(makers, made, failed)
        for need, scene in asked.runs.items():
            scored = [name for name in left if _NEEDS[name] == (need,)]
            _make(_run_makers(scored, out, scene, engine=engine, progress=progress), made, failed)
    finally:  # what is made by then is kept, whatever ends the rest
        if made or earlier:
            write_record(
                out,
                earlier,
                made=made,
                failed=failed,
                scenes=used,
                engine=engine.kind,
                workers=workers,
                wall_s=perf_counter() - start,
            )
        finish(place)
    written = [path for paths in made.values() for path in paths]
    return written, [f"{name}: {reason}" for name, reason in failed.items()]


def _band_item(band: str) -> str:
    """Name of the item of a band's measurements."""
    return f"{band} GHz"


def _scenes_used(asked: Wanted) -> list[tuple[Scene, list[str]]]:
    """All simulated scenes with the items made of each."""
    used = []
    for band, scenes in asked.scenes.items():
        items = [_band_item(band)] + [name for name in asked.items if band in _NEEDS[name]]
        used += [(scene, items) for scene in scenes]
    if asked.model:
        used.append((asked.model, ["figure 2"]))
    runs = asked.runs.items()
    return used + [(scene, [name for name in asked.items if need in _NEEDS[name]]) for need, scene in runs]


def _run_makers(
    names: list[str], out: Path, scene: Scene, *, engine: Engine, progress: Callable[[], None]
) -> list[tuple[str, Callable[[], list[Path]]]]:
    """Functions that make the items of one run; the first that is called starts the run."""
    from surveysim.api import run

    result = cache(lambda: run(scene, engine=engine, progress=lambda coadds: progress()))
    return [(name, partial(_write_scored, name, out, result)) for name in names]


def _make(
    makers: Sequence[tuple[str, Callable[[], list[Path]]]], made: dict[str, list[Path]], failed: dict[str, str]
) -> None:
    """Make items by name; those with too few observations go to `failed` with the reason."""
    for name, make in makers:
        try:
            made[name] = make()
        except InputError as error:
            failed[name] = one_line(error)


def _write_scored(name: str, out: Path, run: Callable[[], "SurveyResult"]) -> list[Path]:
    from surveysim.paper.figures import maps as map_figures
    from surveysim.paper.figures import scores as score_figures

    result = run()
    if result.unscored:
        raise InsufficientDataError(result.unscored)
    if name == "table 3":
        return [
            _write_table(out / "table3.ecsv", score_figures.sensitivity_table(result)),
            _write_table(out / "table3_gains.ecsv", score_figures.gain_table(result)),
        ]
    make = {"figure 13": map_figures.map_psd_figure, "figure 16": score_figures.data_set_psd_figure}[name]
    return _write_figure(out, make(result))


def _write_measurements(out: Path, band: str, survey: MeasuredSurvey) -> list[Path]:
    from surveysim.paper.recovery import measurement_table, recovery_table

    return [
        _write_table(out / f"measurements_{band}.ecsv", measurement_table(survey)),
        _write_table(out / f"recovered_{band}.ecsv", recovery_table(survey)),
    ]


def _write(name: str, out: Path, surveys: dict[str, MeasuredSurvey], model: Scene | None) -> list[Path]:
    if name == "table 1":
        from surveysim.paper.tables import amplitude_table, site_table

        return [
            _write_table(out / "table1.ecsv", amplitude_table(surveys)),
            _write_table(out / "table1_sites.ecsv", site_table()),
        ]
    if name == "table 2":
        from surveysim.paper.tables import correlated_noise_table, photon_noise_table

        return [
            _write_table(out / "table2.ecsv", correlated_noise_table(surveys["143"])),
            _write_table(out / "table2_photons.ecsv", photon_noise_table()),
        ]
    return _write_figure(out, _figure(int(name.split()[1]), surveys, model))


def _figure(number: int, surveys: dict[str, MeasuredSurvey], model: Scene | None) -> "PaperFigure":
    from surveysim.paper.figures import cleaning as cleaning_figures
    from surveysim.paper.figures import model as model_figures
    from surveysim.paper.figures import noise as noise_figures
    from surveysim.paper.figures import pairs as pair_figures
    from surveysim.paper.figures import turbulence as turbulence_figures
    from surveysim.paper.figures import wind as wind_figures

    bolocam = [surveys[band] for band in ("143", "268") if band in surveys]
    makers: dict[int, Callable[[], PaperFigure]] = {
        1: model_figures.opacity_figure,
        2: lambda: model_figures.screen_figure(prepare(model)),
        3: lambda: wind_figures.wind_examples_figure(surveys["143"]),
        4: lambda: wind_figures.wind_histogram_figure(bolocam),
        5: lambda: turbulence_figures.correlation_figure(surveys["143"]),
        6: lambda: turbulence_figures.index_height_figure(surveys["143"]),
        7: lambda: noise_figures.b2_distribution_figure(bolocam),
        8: lambda: noise_figures.b2_water_figure(bolocam),
        9: lambda: noise_figures.map_variance_figure(surveys["143"]),
        10: lambda: cleaning_figures.timestream_figure(surveys["143"]),
        11: lambda: cleaning_figures.template_figure(surveys["143"]),
        12: lambda: cleaning_figures.pca_figure(surveys["143"]),
        14: lambda: pair_figures.correlation_histogram_figure(surveys["143"]),
        15: lambda: pair_figures.separation_figure(surveys["143"]),
    }
    return makers[number]()


def _write_figure(out: Path, figure: "PaperFigure") -> list[Path]:
    from surveysim.report.figures.layout import draw_figure
    from surveysim.report.figures.points import points_table

    picture = out / f"figure{figure.number:02d}.png"
    table = picture.with_suffix(".ecsv")
    try:
        draw_figure(figure, picture)
    except Exception as error:  # matplotlib raises a wide range: of fonts, formulas, sizes
        undrawn(f"figure {figure.number}", error)
        return [_write_table(table, points_table(figure))]
    return [_write_table(table, points_table(figure)), picture]


def _write_table(path: Path, table: "Table") -> Path:
    with atomic_write(path) as partial:
        table.write(partial, format="ascii.ecsv", overwrite=True)
    return path
