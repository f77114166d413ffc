"""Evaluations of a search, kept in a file as they come: an interrupted search repeats its path from them."""

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import model_validator

from surveysim import __version__
from surveysim.runtime.engine import SERIAL, Engine, ordered_map
from surveysim.runtime.errors import InputError
from surveysim.studies.optimise.evaluation import Evaluation
from surveysim.studies.optimise.problem import Places, Problem
from surveysim.studies.sweep.point_metrics import Numbers
from surveysim.survey.checkpoint import CheckpointError

FILE = "evaluations.jsonl"
Job = Callable[[dict[str, Any]], Evaluation]  # of the values of the knobs
Progress = Callable[["EvaluationStore"], None]


class SpentError(InputError):
    """The search has had all its evaluations."""


class _Kept(Numbers):
    """A line of the file."""

    key: str
    settings: dict[str, Any]
    metrics: dict[str, float]
    units: dict[str, str]
    lower: dict[str, bool]
    margins: list[float]
    discarded: float | None
    flags: list[str]
    reason: str

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if bool(self.metrics) == bool(self.reason):
            raise ValueError("metrics, or a reason for none, are expected")
        return self

    @property
    def evaluation(self) -> Evaluation:
        """The forecast of the design."""
        content = {name: value for name, value in self if name not in ("key", "discarded", "margins", "flags")}
        return Evaluation(
            **content,
            margins=tuple(self.margins),
            discarded=math.nan if self.discarded is None else self.discarded,
            flags=tuple(self.flags),
        )


class EvaluationStore:
    """Forecasts of designs by the values of their knobs, in memory and in a file.

    The only mutable record of a search: it grows by one evaluation at a time.

    Parameters
    ----------
    problem
    job
        Forecast of a design.
    engine
        Where designs that are asked for together are evaluated.
    path
        File of the evaluations; None keeps them in memory alone.
    progress
        Called after each new evaluation.
    """

    def __init__(
        self,
        problem: Problem,
        job: Job,
        engine: Engine = SERIAL,
        *,
        path: Path | None = None,
        progress: Progress = lambda store: None,
    ) -> None:
        self.problem, self.job, self.engine, self.path, self.progress = problem, job, engine, path, progress
        self.most = problem.options.evaluations
        self._found: dict[str, Evaluation] = {}
        self._kept: dict[str, Evaluation] = {}

    @property
    def evaluations(self) -> tuple[Evaluation, ...]:
        """All designs that the search has asked for, in order."""
        return tuple(self._found.values())

    def resume(self) -> None:
        """Load kept evaluations, or begin a new file; CheckpointError for a file of another search."""
        if self.path.exists():
            self._kept = _read(self.path, self.problem.identity)
        self._write_all()

    def begin(self) -> None:
        """Begin a new file, if evaluations are kept."""
        if self.path is not None:
            self._write_all()

    def _write_all(self) -> None:
        from mapmaker.files import atomic_write

        head = {"search": self.problem.identity, "surveysim": __version__}
        with atomic_write(self.path) as partial:
            lines = [json.dumps(head), *map(_line, self._kept.items())]
            partial.write_text("\n".join(lines) + "\n", encoding="utf-8")

    def at(self, places: Places) -> Evaluation:
        """Evaluate the design at some places of the knobs."""
        return self.of(self.problem.settings(places))

    def of(self, settings: Mapping[str, Any]) -> Evaluation:
        """Evaluate the design of some values of the knobs."""
        return self._all([dict(settings)], SERIAL)[0]

    def all_at(self, places: Iterable[Places]) -> list[Evaluation]:
        """Evaluate designs, several at a time."""
        return self._all([self.problem.settings(item) for item in places], self.engine)

    def _all(self, settings: list[dict[str, Any]], engine: Engine) -> list[Evaluation]:
        keys = [_key(item) for item in settings]
        for key in keys:
            if key in self._kept and key not in self._found:
                self._found[key] = self._kept[key]
        missing = {key: item for key, item in zip(keys, settings, strict=True) if key not in self._found}
        room = self.most - len(self._found)
        asked = dict(list(missing.items())[: max(0, room)])
        results = ordered_map(self.job, list(asked.values()), engine)
        try:
            for key in asked:
                self._found[key] = next(results)
                self._keep(key)
                self.progress(self)
        finally:
            results.close()
        if len(asked) < len(missing):
            raise SpentError(f"the search has had its {self.most} evaluations")
        return [self._found[key] for key in keys]

    def _keep(self, key: str) -> None:
        if self.path is not None:
            with open(self.path, "a", encoding="utf-8") as file:
                file.write(_line((key, self._found[key])) + "\n")


def _key(settings: Mapping[str, Any]) -> str:
    return json.dumps(settings, sort_keys=True)


def _line(item: tuple[str, Evaluation]) -> str:
    key, found = item
    content = {"key": key, **vars(found)}
    return json.dumps(content | {"discarded": None if math.isnan(found.discarded) else found.discarded})


def _read(path: Path, identity: str) -> dict[str, Evaluation]:
    """Read kept evaluations; the last line of a killed process may be in part."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    try:
        head = json.loads(lines[0])
        other = head["search"] != identity or head["surveysim"] != __version__
        kept = [] if other else [_Kept.model_validate(item) for item in _whole_lines(lines[1:])]
    except (IndexError, ValueError, KeyError, TypeError):
        raise CheckpointError(f"{path}: damaged; start anew with --force, or write elsewhere with --out") from None
    if other:
        raise CheckpointError(f"{path}: from another search; start anew with --force, or write elsewhere with --out")
    return {item.key: item.evaluation for item in kept}


def _whole_lines(lines: list[str]) -> list[Any]:
    """Contents of lines, without a last one that is in part; ValueError for any other."""
    try:
        last = [json.loads(line) for line in lines[-1:]]
    except ValueError:
        last = []
    return [json.loads(line) for line in lines[:-1]] + last
