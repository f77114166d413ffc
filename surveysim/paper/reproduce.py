"""Reproduction of the paper's tables and figures: observations, items and their files."""

from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from mapmaker.files import atomic_write
from surveysim.output.directory import OutputDirectory, claimed, finish
from surveysim.output.drawings import undrawn
from surveysim.output.expected_study_files import of_paper
from surveysim.paper.manifest import earlier_runs, write_record
from surveysim.paper.measured_survey import MeasuredSurvey, measure_survey
from surveysim.paper.scenes import NEEDS, Wanted
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import Engine
from surveysim.runtime.errors import InputError, InsufficientDataError
from surveysim.runtime.text_files import one_line
from surveysim.scene.scene import Scene
from surveysim.survey.coadd_tree import CoAddTree

if TYPE_CHECKING:
    from astropy.table import Table

    from surveysim.report.figures.spec import PaperFigure
    from surveysim.results.results import SurveyResult


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
            ready = [name for name in left if set(NEEDS[name]) <= set(surveys)]
            left = [name for name in left if name not in ready]
            makers += [(name, partial(_write, name, out, surveys, asked.model)) for name in ready]
            _make(makers, made, failed)
        for need, scene in asked.runs.items():
            scored = [name for name in left if NEEDS[name] == (need,)]
            _make(_run_makers(scored, out, scene, engine=engine, progress=progress), made, failed)
    finally:  # finished items are kept after any error
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
        items = [_band_item(band)] + [name for name in asked.items if band in NEEDS[name]]
        used += [(scene, items) for scene in scenes]
    if asked.model:
        used.append((asked.model, ["figure 2"]))
    runs = asked.runs.items()
    return used + [(scene, [name for name in asked.items if need in NEEDS[name]]) for need, scene in runs]


def _run_makers(
    names: list[str], out: Path, scene: Scene, *, engine: Engine, progress: Callable[[], None]
) -> list[tuple[str, Callable[[], list[Path]]]]:
    """Functions that make the items of one run; the first that is called starts the run."""
    from surveysim.api.surveys import run_survey

    counted = 0

    def count(sums: CoAddTree) -> None:
        nonlocal counted
        for _ in range(counted, sums.done):
            progress()
        counted = sums.done

    result = cache(lambda: run_survey(scene, engine=engine, progress=count))
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
