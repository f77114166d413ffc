"""The whole search: importance of the knobs, best design or Pareto front, flatness, and the designs to simulate."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from surveysim.runtime.errors import SceneError
from surveysim.studies.optimise.evaluation import Evaluation
from surveysim.studies.optimise.front import front, knee, search_front
from surveysim.studies.optimise.importance import Importance, importance
from surveysim.studies.optimise.problem import Problem
from surveysim.studies.optimise.ranges import Flatness, KnobRange, flatness, places_of_ends
from surveysim.studies.optimise.search import Objective, Optimum, Search, descend_from, local_optima
from surveysim.studies.optimise.store import EvaluationStore, SpentError
from surveysim.studies.optimise.surface import Surface
from surveysim.studies.sweep.axes import value_text

AS_IT_IS = "as it is"
BEST = "best"


@dataclass(frozen=True)
class Design:
    """A design to simulate: its name, and its number among the evaluations."""

    name: str
    number: int


@dataclass(frozen=True)
class Found:
    """Outcome of a search by forecast.

    Attributes
    ----------
    evaluations
        All designs that were forecast, in order; the first is the scene as it is.
    best
        Number of the best design; with two metrics, the one of the front that is closest to the ideal point.
    ranges
        Of each knob about the best design; none with two metrics, or where the evaluations were spent.
    scatter
        Standard deviation of ln of the metric about a smooth surface near the optimum, by the noise of the forecast.
    smoothed
        Metric of designs on that surface, by number: the forecast without its noise.
    front
        Numbers of the designs of the Pareto front; none with one metric.
    designs
        The scene as it is, the best design and its rivals.
    spent
        Whether the search ended because it had no more evaluations.
    """

    evaluations: tuple[Evaluation, ...]
    best: int
    ranges: tuple[KnobRange, ...]
    scatter: float
    smoothed: dict[int, float]
    front: tuple[int, ...]
    importance: Importance | None
    designs: tuple[Design, ...]
    spent: bool


def search_optimum(store: EvaluationStore, importance_samples: int = 0) -> Found:
    """Search for the best design of a problem, or the front of two metrics.

    Parameters
    ----------
    store
    importance_samples
        Samples of Sobol' indices, a power of two; 0 leaves them out.

    Raises
    ------
    SceneError
        Where no design is allowed.
    """
    problem = store.problem
    store.of({})
    objectives = [objective_of(key) for key in problem.options.metrics]
    told = None
    if importance_samples:
        store.most += importance_samples * (len(problem.knobs) + 2)
        told = importance(store, objectives[0], importance_samples)
    spent, optima, flat = False, [], None
    try:
        if len(objectives) == 1:
            optima = _optima(store, objectives[0])
            flat = flatness(Search(store, objectives[0]), _best_places(store, objectives[0]))
        else:
            search_front(store, _pair(objectives))
    except SpentError:
        spent = True
    return _found(store, objectives, told, optima=optima, flat=flat, spent=spent)


def objective_of(key: str) -> Objective:
    """Return the objective of a metric: its logarithm, so that less is better."""
    return lambda item: math.log(item.metrics[key]) * (1 if item.lower[key] else -1)


def _pair(objectives: list[Objective]) -> Callable[[Evaluation], tuple[float, float]]:
    first, second = objectives
    return lambda item: (first(item), second(item))


def _optima(store: EvaluationStore, objective: Objective) -> list[Optimum]:
    """Local optima, best first; the scene as it is, and the best design so far, are starts."""
    problem = store.problem
    starts = [item for item in (problem.present_places(),) if item is not None]
    optima = local_optima(store, objective, starts)
    descend_from(store, objective)  # designs of the importance may lie elsewhere
    return optima


def _best_places(store: EvaluationStore, objective: Objective) -> tuple[float, ...]:
    best = _best(store, objective)
    if best is None:
        raise SceneError(_nothing_allowed(store))
    return store.problem.places_of(best.settings)


def _best(store: EvaluationStore, objective: Objective) -> Evaluation | None:
    allowed = [item for item in store.evaluations if item.allowed and item.settings]
    return min(allowed, key=objective, default=None)


def _nothing_allowed(store: EvaluationStore) -> str:
    reasons = Counter(item.reason or "beyond a limit" for item in store.evaluations if not item.allowed)
    reason, count = reasons.most_common(1)[0]
    found = f"none of {len(store.evaluations)} designs is allowed; {count} of them: {reason}"
    return f"{store.problem.path}: optimise: {found}"


def _found(
    store: EvaluationStore,
    objectives: list[Objective],
    told: Importance | None,
    *,
    optima: list[Optimum],
    flat: Flatness | None,
    spent: bool,
) -> Found:
    evaluations, problem = store.evaluations, store.problem
    numbers = {id(item): number for number, item in enumerate(evaluations)}
    on_front: list[int] = []
    if len(objectives) == 2:
        on_front = front(evaluations, _pair(objectives))
        best = evaluations[knee(evaluations, on_front, _pair(objectives))] if on_front else None
    else:
        best = _best(store, objectives[0]) if flat is None else store.at(flat.best)
    if best is None:
        raise SceneError(_nothing_allowed(store))
    number = numbers[id(best)]
    rivals = _front_rivals(problem, on_front, number) if on_front else _rivals(store, best, optima, flat)
    designs = [Design(AS_IT_IS, 0), Design(BEST, number), *rivals]
    designs = _once(designs, store.evaluations)
    return Found(
        evaluations=store.evaluations,
        best=number,
        ranges=flat.ranges if flat else (),
        scatter=flat.surface.scatter if flat and flat.surface else math.nan,
        smoothed=_smoothed(store, flat.surface, designs) if flat and flat.surface else {},
        front=tuple(on_front),
        importance=told,
        designs=tuple(designs),
        spent=spent,
    )


def _smoothed(store: EvaluationStore, surface: Surface, designs: list[Design]) -> dict[int, float]:
    """Metric of designs on a surface, by number; of the scene as it is where that has the derived keys of a design."""
    problem, found = store.problem, {}
    key = problem.options.metrics[0]
    for item in designs:
        own = store.evaluations[item.number]
        places = problem.places_of(own.settings) if own.settings else problem.present_places()
        if places is not None and surface.holds(places) and store.at(places).metrics.get(key) == own.metrics.get(key):
            value = float(surface.at(np.array([[places[number] for number in surface.free]]))[0])
            found[item.number] = math.exp(value if own.lower[key] else -value)
    return found


def _once(designs: list[Design], evaluations: tuple[Evaluation, ...]) -> list[Design]:
    """Leave out designs with the settings of an earlier one, and number equal names."""
    kept: list[Design] = []
    for item in designs:
        if all(evaluations[item.number].settings != evaluations[other.number].settings for other in kept):
            same = sum(other.name.partition(" #")[0] == item.name for other in kept)
            kept.append(Design(f"{item.name} #{same + 1}", item.number) if same else item)
    return kept


def _front_rivals(problem: Problem, on_front: list[int], best: int) -> list[Design]:
    """Ends of the front, and designs evenly along it."""
    names = [f"best {key}" for key in problem.options.metrics]
    found = [Design(names[0], on_front[0]), Design(names[1], on_front[-1])][: problem.options.rivals]
    room = problem.options.rivals - len(found)
    between = [on_front[(step + 1) * (len(on_front) - 1) // (room + 1)] for step in range(max(0, room))]
    return found + [Design(f"front {number}", number) for number in between]


def _rivals(store: EvaluationStore, best: Evaluation, optima: list[Optimum], flat: Flatness | None) -> list[Design]:
    """Other local optima, named by their choices, then the ends of the ranges within 1 %."""
    problem = store.problem
    if flat and flat.surface:  # within it, optima are noise of the forecast
        optima = [item for item in optima if not flat.surface.holds(item.places)]
    named = [(_name_of(problem, best, store.at(item.places)), item.places) for item in optima]
    if flat is not None:
        ends = places_of_ends(flat.best, flat.ranges)
        named += [(f"{problem.knobs[number].key.rpartition('.')[2]} {side}", places) for number, side, places in ends]
    rivals = [(name, store.at(places)) for name, places in named]
    numbers = {id(item): number for number, item in enumerate(store.evaluations)}
    found = [Design(name, numbers[id(item)]) for name, item in rivals if item is not best and item.allowed]
    return _once(found, store.evaluations)[: problem.options.rivals]


def _name_of(problem: Problem, best: Evaluation, rival: Evaluation) -> str:
    """Name a local optimum by the choices and integers that differ from the best design's."""
    keys = [knob.key for knob in problem.knobs if not knob.continuous]
    differ = [key for key in keys if rival.settings[key] != best.settings[key]]
    return ", ".join(f"{key} = {value_text(rival.settings[key])}" for key in differ) or "local optimum"
