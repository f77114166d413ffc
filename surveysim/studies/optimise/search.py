"""Search for the best design: samples over all knobs, then descents from the best of them."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from surveysim.studies.optimise.evaluation import Evaluation
from surveysim.studies.optimise.problem import Places, Problem
from surveysim.studies.optimise.store import EvaluationStore

MOST_SAMPLES = 64  # of each combination of choices
MOST_DESCENTS = 3  # from the samples of a combination of choices
FAR = 0.1  # ln of the metric over that of the best sample, from which one descent is enough
FIRST_RADIUS = 0.1  # of a descent, as a fraction of the knobs' ranges
LAST_RADIUS = 1e-2
MOST_TURNS = 4  # between continuous knobs and integers
SEED = 0  # of the samples
APART = 0.01  # ln of the metric between two optima over the higher one, from which both are local optima
WORSE = 1.0  # added to ln of the worst metric for a design without a forecast

Objective = Callable[[Evaluation], float]  # to make small; only called for designs with a forecast


@dataclass(frozen=True)
class Optimum:
    """An allowed design that no descent improves: its places, and its objective."""

    places: Places
    value: float


class Search:
    """Objective of one search over stored evaluations, at places of the knobs."""

    def __init__(self, store: EvaluationStore, objective: Objective) -> None:
        self.store, self.problem, self.objective = store, store.problem, objective

    def value(self, places: Sequence[float]) -> float:
        """Return the objective; above all known ones for a design without a forecast."""
        found = self.store.at(tuple(places))
        if found.metrics:
            return self.objective(found)
        known = [self.objective(item) for item in self.store.evaluations if item.metrics]
        return max(known, default=0.0) + WORSE - min((0.0, *found.margins))

    def allowed_value(self, places: Sequence[float]) -> float:
        """Return the objective; infinite for a design that is not allowed."""
        found = self.store.at(tuple(places))
        return self.objective(found) if found.allowed else math.inf

    def settled(self, places: Places) -> Places:
        """Return the places of the values that a scene file has for these."""
        return self.problem.places_of(self.problem.settings(places))

    def margin(self, places: Sequence[float]) -> float:
        """Return the smallest margin to the limits."""
        return min(self.store.at(tuple(places)).margins, default=-1.0)


def local_optima(store: EvaluationStore, objective: Objective, starts: Sequence[Places] = ()) -> list[Optimum]:
    """Find local optima of all combinations of choices, best first.

    Sobol' points of the continuous knobs and integers are evaluated, several at a time. Descents start from the lowest
    of those that are lower than their neighbours, and from `starts`: by COBYQA (Ragonneau and Zhang 2024; quadratic
    models in a trust region) in the continuous knobs, in turn with steps of the integers.

    Raises
    ------
    SpentError
        When the problem's number of evaluations is spent.
    """
    search, problem = Search(store, objective), store.problem
    sampled = [(fixed, list(_samples(problem, fixed))) for fixed in _combinations(problem)]
    store.all_at([item for _, places in sampled for item in places])
    values = [np.array([search.allowed_value(item) for item in places]) for _, places in sampled]
    far = min(float(item.min()) for item in values) + FAR
    found: list[Optimum] = []
    for (fixed, places), of in zip(sampled, values, strict=True):
        most = MOST_DESCENTS if of.min() < far else 1
        chosen = [places[number] for number in _lowest(problem, places, of)[:most]]
        chosen += [item for item in starts if all(item[number] == place for number, place in fixed.items())]
        for start in chosen:
            if not any(_close(problem, start, item.places) for item in found):
                found += _descend(search, start)
    return _distinct(search, found)


def descend_from(store: EvaluationStore, objective: Objective) -> Optimum | None:
    """Descend from the allowed design with the lowest objective so far; None without one."""
    search, problem = Search(store, objective), store.problem
    known = [item for item in store.evaluations if item.allowed and item.settings]
    if not known:
        return None
    best = min(known, key=objective)
    return next(iter(_descend(search, problem.places_of(best.settings))), None)


def _combinations(problem: Problem) -> Iterator[dict[int, float]]:
    """Places of the knobs with choices, by number of the knob, for all combinations."""
    numbers = [number for number, knob in enumerate(problem.knobs) if knob.choices]
    for places in product(*(problem.knobs[number].steps() for number in numbers)):
        yield dict(zip(numbers, places, strict=True))


def _samples(problem: Problem, fixed: dict[int, float]) -> Iterator[Places]:
    """Sobol' points in the knobs that are not fixed; all values of integers alone, where these are few."""
    from scipy.stats import qmc

    free = [number for number in range(len(problem.knobs)) if number not in fixed]
    steps = [problem.knobs[number].steps() for number in free]
    if all(steps) and math.prod(map(len, steps)) <= MOST_SAMPLES:  # all there are
        rows: Sequence[Sequence[float]] = list(product(*steps))
    else:
        power = min(3 + len(free), int(math.log2(MOST_SAMPLES)))
        rows = qmc.Sobol(len(free), rng=np.random.default_rng(SEED)).random_base2(power).tolist()
    for row in rows:
        places = dict(zip(free, row, strict=True)) | fixed
        yield tuple(_settled(problem, number, places[number]) for number in range(len(problem.knobs)))


def _settled(problem: Problem, number: int, place: float) -> float:
    """Move a place to the middle of its integer or choice."""
    knob = problem.knobs[number]
    return float(place) if knob.continuous else knob.place(knob.number(place))


def _lowest(problem: Problem, places: Sequence[Places], values: np.ndarray) -> list[int]:
    """Numbers of the samples to descend from: lower than their nearest neighbours, the lowest ones first."""
    points = np.array(places)
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    near = 2 * sum(not knob.choices for knob in problem.knobs)
    neighbours = np.argsort(apart, axis=1, kind="stable")[:, 1 : near + 1]
    low = np.isfinite(values) & (values <= values[neighbours].min(axis=1, initial=np.inf))
    order = np.argsort(values, kind="stable")
    return [int(number) for number in order if low[number]]


def _descend(search: Search, start: Places) -> list[Optimum]:
    """Descend from a design; none where it is not allowed."""
    best = Optimum(start, search.allowed_value(start))
    if not math.isfinite(best.value):
        return []
    radius = FIRST_RADIUS
    for _ in range(MOST_TURNS):
        before = best.value
        best = _along_integers(search, _in_continuous(search, best, radius))
        if not best.value < before or not _is_mixed(search.problem):
            break
        radius /= 3
    return [best]


def _is_mixed(problem: Problem) -> bool:
    return {knob.continuous for knob in problem.knobs if not knob.choices} == {True, False}


def _in_continuous(search: Search, start: Optimum, radius: float) -> Optimum:
    """Descend in the continuous knobs by COBYQA; the answer is the best allowed design on its way."""
    from scipy.optimize import Bounds, NonlinearConstraint, minimize

    free = [number for number, knob in enumerate(search.problem.knobs) if knob.continuous]
    best = start
    if not free:
        return best

    def whole(part: np.ndarray) -> Places:
        places = list(start.places)
        for number, place in zip(free, part.tolist(), strict=True):
            places[number] = min(max(place, 0.0), 1.0)
        return tuple(places)

    def value(part: np.ndarray) -> float:
        nonlocal best
        places = whole(part)
        found = search.allowed_value(places)
        if found < best.value:
            best = Optimum(places, found)
        return search.value(places)

    limits = [NonlinearConstraint(lambda part: search.margin(whole(part)), 0.0, np.inf)]
    minimize(
        value,
        np.array([start.places[number] for number in free]),
        method="COBYQA",
        bounds=Bounds(np.zeros(len(free)), np.ones(len(free))),
        constraints=limits if search.problem.limits else (),
        options={"initial_tr_radius": radius, "final_tr_radius": min(LAST_RADIUS, radius)},
    )
    return best


def _along_integers(search: Search, start: Optimum) -> Optimum:
    """Step along each integer, as long as that is better."""
    best = start
    numbers = [number for number, knob in enumerate(search.problem.knobs) if knob.integer]
    for number in numbers:
        knob = search.problem.knobs[number]
        for step in (1, -1):
            while (after := _stepped(search, best, number, step)).value < best.value:
                best = after
            if knob.number(best.places[number]) != knob.number(start.places[number]):
                break
    return best


def _stepped(search: Search, start: Optimum, number: int, step: int) -> Optimum:
    knob = search.problem.knobs[number]
    value = knob.number(start.places[number]) + step
    if not knob.low <= value <= knob.high:
        return replace(start, value=math.inf)
    places = (*start.places[:number], knob.place(value), *start.places[number + 1 :])
    return Optimum(places, search.allowed_value(places))


def _distinct(search: Search, found: list[Optimum]) -> list[Optimum]:
    """Sort optima, and leave out those of one basin with a better one."""
    kept: list[Optimum] = []
    for item in sorted(found, key=lambda item: item.value):
        if all(_apart(search, item, other) for other in kept):
            kept.append(item)
    return kept


def _apart(search: Search, item: Optimum, other: Optimum) -> bool:
    """Return whether two optima differ in integers or choices, or the design half way between them is worse."""
    pairs = list(zip(search.problem.knobs, item.places, other.places, strict=True))
    if any(not knob.continuous and knob.number(a) != knob.number(b) for knob, a, b in pairs):
        return True
    between = search.allowed_value([(a + b) / 2 for _, a, b in pairs])
    return between > max(item.value, other.value) + APART


def _close(problem: Problem, places: Places, others: Places) -> bool:
    return all(
        abs(place - other) < FIRST_RADIUS if knob.continuous else knob.number(place) == knob.number(other)
        for knob, place, other in zip(problem.knobs, places, others, strict=True)
    )
