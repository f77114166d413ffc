"""Runs of settings, each in its own process, with their times and memory."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from time import perf_counter, process_time
from typing import Any

import numpy as np

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import Setup, prepare
from surveysim.results.control_variate import known_expectations, quoted_scores
from surveysim.runtime.engine import Engine, ordered_map
from surveysim.runtime.errors import InputError, InsufficientDataError, SceneError
from surveysim.runtime.memory import peak_bytes
from surveysim.scene.scene import Scene, scene_hash
from surveysim.studies.convergence.records import OF_SCREEN, Setting
from surveysim.survey.coadd_tree import CoAddTree
from surveysim.survey.run import run_observations
from surveysim.survey.scores import DataSetScore


@dataclass(frozen=True)
class Task:
    """A scene to run, and the numbers of observations after which to score it."""

    scene: Scene
    counts: tuple[int, ...]


@dataclass(frozen=True)
class Mark:
    """Score after some observations, or the reason for none, and the times of the observations and of the score."""

    score: DataSetScore | None
    wall_s: float
    cpu_s: float
    note: str = ""


@dataclass(frozen=True)
class Run:
    """Marks by number of observations, with time and memory of the process; `note` is the reason for no marks."""

    marks: dict[int, Mark] = field(default_factory=dict)
    start_s: float = np.nan
    peak_mb: float = np.nan
    raised_mb: float = np.nan
    note: str = ""

    def scored(self, count: int) -> bool:
        """Return whether there is a score of this many observations."""
        return count in self.marks and self.marks[count].score is not None


def run_task(task: Task) -> Run:
    """Run a scene in this process; a scene that cannot be run has a note instead of marks."""
    before, start = peak_bytes() / 1e6, perf_counter()
    try:
        setup = prepare(task.scene)
        if (maker := task.scene.map.maker) != "binned":
            raise InputError(f"map.maker: found {maker!r}; 'binned' maps can be scored before the last observation")
        # Compiles, and makes factors and expectations over weather: no part of the time that an observation takes.
        observe(setup, 0, with_signal_sims=True)
        known_expectations(setup)
        start_s = perf_counter() - start
        marks = _marks(setup, task.counts)
    except (InputError, MemoryError) as error:
        return Run(note=f"refused: {first_line(error)}")
    peak = peak_bytes() / 1e6
    return Run(marks, start_s, peak, peak - before)


def _marks(setup: Setup, counts: Sequence[int]) -> dict[int, Mark]:
    marks: dict[int, Mark] = {}
    began, scoring = clocks(), np.zeros(2)

    def mark(sums: CoAddTree) -> None:
        if sums.done not in counts:
            return
        before, found, note = clocks(), None, ""
        try:
            found = quoted_scores(setup, sums.so_far(), (ACTUAL,))[ACTUAL]
        except InsufficientDataError as error:  # too few observations, or none with window skies
            note = f"not scored: {first_line(error)}"
        after = clocks()
        wall, cpu = after - began - scoring
        scoring[:] += after - before
        marks[sums.done] = Mark(found, float(wall), float(cpu), note)

    run_observations(setup, None, progress=mark)
    return marks


def clocks() -> np.ndarray:
    """Wall and CPU seconds of this process."""
    return np.array([perf_counter(), process_time()])


def first_line(error: BaseException) -> str:
    """First line of an error's message, or the name of its type if it has none."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


@dataclass(frozen=True)
class Tasks:
    """Tasks by the hash of their scene, each once; for the place of each setting, its hash or the reason for its
    refusal.
    """

    tasks: dict[str, Task] = field(default_factory=dict)
    hashes: dict[int, str] = field(default_factory=dict)
    refused: dict[int, str] = field(default_factory=dict)


def tasks(scene_of: Callable[[Mapping[str, Any]], Scene], settings: Iterable[Setting]) -> Tasks:
    """Collect the runs that sampling and numerical settings need; equal scenes run once.

    Parameters
    ----------
    scene_of
        Function that makes the scene with overrides; raises SceneError for a setting that is refused.
    settings
        Settings of all ladders.

    Returns
    -------
    Tasks by scene, and the reason for each refused setting.
    """
    found = Tasks()
    for place, setting in enumerate(settings):
        if setting.kind not in ("sampling", "numerical"):
            continue
        try:
            scene = scene_of(setting.overrides)
        except SceneError as error:
            found.refused[place] = f"refused: {first_line(error)}"
            continue
        if setting.parameter in OF_SCREEN and not scene.turbulent:
            found.refused[place] = "refused: without [atmosphere] there is no screen"
            continue
        found.hashes[place] = scene_hash(scene)
        found.tasks.setdefault(found.hashes[place], Task(scene, (scene.observations,)))
    return found


def run_all(tasks: Sequence[Task], engine: Engine, progress: Callable[[int], None]) -> list[Run]:
    """Run tasks, several at a time, each in one process; `progress` receives the number of finished tasks."""
    found: list[Run] = []
    results = ordered_map(run_task, tasks, engine)
    try:
        for run in results:
            found.append(run)
            progress(len(found))
    finally:
        results.close()
    return found


def seeds_wanted(scene: Scene, own: Run, reference_error: float, most: int) -> int:
    """Number of whole surveys whose mean sigma(A) reaches a relative error, at most `most`.

    Parameters
    ----------
    scene
        Scene of one survey.
    own
        Run of this scene.
    reference_error
        Wanted relative error of the mean.
    most
        Largest number of surveys.

    Raises
    ------
    InsufficientDataError
        For a run without a score, or with too few observations for an error of sigma(A).
    """
    if not own.scored(scene.observations):
        raise InsufficientDataError(f"{scene.name}: {own.note or own.marks[scene.observations].note}")
    error = own.marks[scene.observations].score.budget.total
    if np.isnan(error):
        n_obs = scene.observations
        raise InsufficientDataError(
            f"{scene.name}: found {n_obs} observations; as many as tell the error of sigma(A) are expected"
        )
    return min(most, ceil((error / reference_error) ** 2))
