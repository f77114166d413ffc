"""The search for the best design, on functions with known optima: no scene is forecast."""

import json
import math

import numpy as np
import pytest

from surveysim import SceneError
from surveysim.runtime.errors import InputError
from surveysim.scene.scene import load_scene, scene_hash
from surveysim.studies.optimise.evaluation import Evaluation
from surveysim.studies.optimise.expressions import parse, value_of
from surveysim.studies.optimise.front import front
from surveysim.studies.optimise.importance import importance
from surveysim.studies.optimise.optimum import objective_of, search_optimum
from surveysim.studies.optimise.problem import load_problem
from surveysim.studies.optimise.store import EvaluationStore
from surveysim.survey.checkpoint import CheckpointError
from tests.scenes import SMALL_SCENE

SIGMA, OTHER = "flat_band_power.sigma", "largest_scale.ell"
SPEED = '[[optimise.knobs]]\nkey = "scan.speed"\nlow = "1 arcmin / s"\nhigh = "100 arcmin / s"\nscale = "log"\n'
PITCH = '[[optimise.knobs]]\nkey = "instrument.layout.pitch_f_lambda"\nlow = 0.5\nhigh = 2.5\n'
RINGS = '[[optimise.knobs]]\nkey = "instrument.layout.rings"\nlow = 1\nhigh = 40\n'
ALGORITHM = '[[optimise.knobs]]\nkey = "cleaning.algorithm"\nchoices = ["average", "planar", ["average", "planar"]]\n'
METRIC = '\n[[score.metrics]]\nkind = "largest_scale"\n'


def search_of(write, function, *parts, most=2000, head="", path=None):
    """Store of a search whose metrics are a function of the numbers of the knobs."""
    text = SMALL_SCENE + METRIC + f"\n[optimise]\nevaluations = {most}\n{head}" + "".join(parts)
    problem = load_problem(write(text))

    def job(settings):
        if not settings:
            return Evaluation({}, reason="not forecast")
        found = function(*(knob.number_of(settings[knob.key]) for knob in problem.knobs))
        found = found if isinstance(found, Evaluation) else {SIGMA: found} if np.isscalar(found) else found
        if isinstance(found, Evaluation):
            return Evaluation(settings, **{key: value for key, value in vars(found).items() if key != "settings"})
        return Evaluation(settings, metrics=found, lower={SIGMA: True, OTHER: False}, units={SIGMA: "uK2", OTHER: ""})

    return EvaluationStore(problem, job, path=path)


def numbers(store, found):
    """Numbers of the knobs of the best design."""
    settings = found.evaluations[found.best].settings
    return [knob.number_of(settings[knob.key]) for knob in store.problem.knobs]


# ---------------------------------------------------------------- optima


def test_a_parabola_in_the_logarithm(write):
    """ln f = c ln^2(x / 7): 1 % is ln x within sqrt(ln 1.01 / c) of the optimum."""
    store = search_of(write, lambda x: math.exp(0.5 * math.log(x / 7) ** 2), SPEED)
    found = search_optimum(store)
    assert numbers(store, found) == [pytest.approx(7, rel=0.01)]
    width = math.sqrt(math.log(1.01) / 0.5)
    ends = [math.log(store.problem.knobs[0].number(end) / 7) for end in (found.ranges[0].low, found.ranges[0].high)]
    np.testing.assert_allclose(ends, [-width, width], atol=0.02 * width)
    assert found.ranges[0].ends == ("1 %", "1 %") and len(found.evaluations) < 60


def test_noise_of_the_forecast_is_averaged(write):
    """Noise of 1 % hides the lowest 1 % of a parabola; the surface finds its centre, and tells of the noise."""

    def noisy(x):
        return math.exp(0.5 * math.log(x / 7) ** 2 + np.random.default_rng(int(1e6 * x)).normal(0, 0.01))

    store = search_of(write, noisy, SPEED)
    found = search_optimum(store)
    # About 25 designs within 0.44 of the optimum, whose slope is known to 0.01 / (0.25 sqrt(25)).
    assert numbers(store, found)[0] == pytest.approx(7, rel=0.05)
    assert found.scatter == pytest.approx(0.01, rel=0.5)


def test_rosenbrock_valley(write):
    def valley(x, y):
        x, y = math.log(x / 10), y - 1.5
        return math.exp((0.5 - x) ** 2 + 5 * (y - x**2) ** 2)

    store = search_of(write, valley, SPEED, PITCH)
    found = search_optimum(store)
    assert numbers(store, found) == [pytest.approx(10 * math.exp(0.5), rel=0.03), pytest.approx(1.75, abs=0.03)]
    assert len(found.evaluations) < 250


def test_integers_and_choices(write):
    """Each choice has its own best integer; the other choices are rivals."""

    def steps(rings, x, choice):
        return math.exp(0.02 * (rings - 13 - 5 * choice) ** 2 + (x - 1) ** 2 + [0.1, 0.0, 0.3][int(choice)])

    store = search_of(write, steps, RINGS, PITCH, ALGORITHM)
    found = search_optimum(store)
    assert numbers(store, found) == [18, pytest.approx(1, abs=0.02), 1]
    names = [item.name for item in found.designs]
    assert names[:2] == ["as it is", "best"]
    assert "instrument.layout.rings = 13, cleaning.algorithm = average" in names
    assert "instrument.layout.rings = 23, cleaning.algorithm = average+planar" in names


def test_few_integers_are_all_evaluated(write):
    rings = RINGS.replace("40", "6")
    store = search_of(write, lambda n: [9, 3, 8, 2, 7, 1][int(n) - 1], rings)
    found = search_optimum(store)
    assert numbers(store, found) == [6] and len(found.evaluations) == 7
    assert found.ranges[0].ends == ("1 %", "range")


def test_a_limit_bounds_the_optimum(write):
    """x of at most 3 where 7 is best."""

    def bounded(x):
        margin = math.log(3 / x)
        return Evaluation({}, metrics={SIGMA: math.exp(math.log(x / 7) ** 2)}, lower={SIGMA: True}, margins=(margin,))

    limit = '[[optimise.limits]]\nquantity = "scan.speed"\nat_most = "3 arcmin / s"\n'
    store = search_of(write, bounded, SPEED, limit)
    found = search_optimum(store)
    assert numbers(store, found)[0] == pytest.approx(3, rel=0.02) and numbers(store, found)[0] <= 3
    assert found.ranges[0].ends[1] == "limit"


def test_two_optima_with_a_wall_between_them(write):
    """Designs without a forecast part two basins; the lesser one is a rival."""

    def basins(x):
        if 8 < x < 12:
            return Evaluation({}, reason="refused")
        return math.exp(min(math.log(x / 3) ** 2, 0.05 + math.log(x / 30) ** 2))

    store = search_of(write, basins, SPEED)
    found = search_optimum(store)
    assert numbers(store, found) == [pytest.approx(3, rel=0.02)]
    rival = next(item for item in found.designs if item.name == "local optimum")
    speed = store.problem.knobs[0].number_of(found.evaluations[rival.number].settings["scan.speed"])
    assert speed == pytest.approx(30, rel=0.02)


def test_higher_is_better(write):
    def scale(x):
        return {SIGMA: 1.0, OTHER: math.exp(-(math.log(x / 20) ** 2))}

    store = search_of(write, scale, SPEED, head=f'metrics = ["{OTHER}"]\n')
    assert numbers(store, search_optimum(store)) == [pytest.approx(20, rel=0.02)]


def test_nothing_is_allowed(write):
    with pytest.raises(SceneError, match="none of 18 designs is allowed; 17 of them: too hot"):
        search_optimum(search_of(write, lambda x: Evaluation({}, reason="too hot"), SPEED))


def test_a_search_that_is_spent_says_so(write):
    store = search_of(write, lambda x: math.exp(math.log(x / 7) ** 2), SPEED, most=20)
    found = search_optimum(store)
    assert found.spent and len(found.evaluations) == 20 and not found.ranges
    assert numbers(store, found) == [pytest.approx(7, rel=0.2)]


# ---------------------------------------------------------------- front, importance


def test_the_front_of_two_parabolas(write):
    """ln f = (x - 1)^2 and -ln g = (x - 2)^2 + (y - 1)^2: the front is 1 <= x <= 2 at y = 1."""

    def pair(x, y):
        return {SIGMA: math.exp((y - 1) ** 2 + (x - 1) ** 2), OTHER: math.exp(-((y - 2) ** 2) - (x - 1) ** 2)}

    store = search_of(
        write, lambda y, x: pair(x, y), PITCH, RINGS.replace("40", "3"), head=f'metrics = ["{SIGMA}", "{OTHER}"]\n'
    )
    found = search_optimum(store)
    points = np.array(
        [[knob.number_of(found.evaluations[n].settings[knob.key]) for knob in store.problem.knobs] for n in found.front]
    )
    assert (points[:, 1] == 1).all() and len(points) >= 8
    assert points[:, 0].min() == pytest.approx(1, abs=0.02) and points[:, 0].max() == pytest.approx(2, abs=0.02)
    assert (np.diff(points[:, 0]) > 0).all()  # sorted by the first metric
    assert numbers(store, found)[0] == pytest.approx(1.5, abs=0.05)  # as far from the best of both


def test_the_front_of_some_designs():
    values = [(1, 5), (2, 2), (3, 3), (2, 1), (5, 1), (4, 0)]
    items = [Evaluation({"n": number}, metrics={"x": 1.0}) for number in range(len(values))]
    assert front(items, lambda item: values[item.settings["n"]]) == [0, 3, 5]


def test_importance_of_a_sum(write):
    """ln f = 3 a + b over unit intervals: the knobs make 0.9 and 0.1 of the variance, alone and in all."""
    store = search_of(write, lambda x, y: math.exp(3 * math.log(x) / math.log(100) + (y - 0.5) / 2), SPEED, PITCH)
    found = importance(store, objective_of(SIGMA), 64)
    for index, error in ((found.first, found.first_error), (found.total, found.total_error)):
        assert (np.abs(index - [0.9, 0.1]) < 4 * error + 0.02).all() and (error < 0.15).all()
    assert found.samples == 64 * 4 and found.refused == 0


# ---------------------------------------------------------------- kept evaluations


def test_a_resumed_search_takes_the_same_path(write, tmp_path):
    path, calls = tmp_path / "evaluations.jsonl", []

    def parabola(x):
        calls.append(x)
        return math.exp(math.log(x / 7) ** 2)

    whole = search_optimum(search_of(write, parabola, SPEED))
    n_calls = len(calls)

    store = search_of(write, parabola, SPEED, path=path)
    store.begin()
    store.progress = lambda so_far: (_ for _ in ()).throw(KeyboardInterrupt) if len(so_far.evaluations) == 20 else None
    with pytest.raises(KeyboardInterrupt):
        search_optimum(store)
    with open(path, "a") as file:
        file.write('{"key": "half a li')  # of a killed process
    calls.clear()
    store = search_of(write, parabola, SPEED, path=path)
    store.resume()
    again = search_optimum(store)
    assert [item.settings for item in again.evaluations] == [item.settings for item in whole.evaluations]
    assert again.best == whole.best and len(calls) == n_calls - 19
    assert len(path.read_text().splitlines()) == 1 + len(again.evaluations)


def test_evaluations_of_another_search(write, tmp_path):
    store = search_of(write, lambda x: x, SPEED, path=tmp_path / "evaluations.jsonl")
    store.begin()
    other = search_of(write, lambda x: x, SPEED.replace("100", "50"), path=store.path)
    with pytest.raises(CheckpointError, match="from another search"):
        other.resume()
    store.path.write_text("nothing")
    with pytest.raises(CheckpointError, match="damaged"):
        store.resume()


@pytest.mark.parametrize(
    "line",
    [
        "3",
        "{}",
        '{"key": "{}"}',
        '"metrics": {"x": "y"}',
        '"margins": ["a"]',
        '"metrics": {}',
        '"flags": 3',
        '"key": 3',
    ],
)
def test_damaged_evaluations(write, tmp_path, line):
    store = search_of(write, lambda x: x, SPEED, path=tmp_path / "evaluations.jsonl")
    store.begin()
    store.at((0.5,))
    whole = store.path.read_text()
    if not line.startswith(("{", "3")):  # a field of an evaluation
        line = json.dumps(json.loads(whole.splitlines()[1]) | json.loads(f"{{{line}}}"))
    for text in (f"{whole}{line}\n", f"{whole}half a line\n{line}"):
        store.path.write_text(text)
        with pytest.raises(CheckpointError, match="damaged"):
            store.resume()


# ---------------------------------------------------------------- the section


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("60 * arcmin / scan.speed", "15 s"),
        ("round(2.4 * n)", 7),
        ("floor(7 / 2)", 3),
        ("max(1, ceil(2.1)) ** 2", 9),
        ("sqrt(scan.speed**2)", "4 arcmin / s"),
        ("log(exp(2)) + -1", 1),
    ],
)
def test_expressions(text, value):
    import astropy.units as u

    known = {"scan.speed": u.Quantity("4 arcmin / s"), "n": 3}
    assert u.isclose(value_of(parse(text), known.get), u.Quantity(value))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("open('x')", "found \"open('x')\""),
        ("(lambda: 1)()", "found '(lambda: 1)()'"),
        ("a if b else c", "found 'a if b else c'"),
        ("1 +", "an expression is expected"),
        ("__import__", "found '__import__'; a key of the scene that has a value, or a unit, is expected"),
        ("arcmin + s", "which has no value"),
        ("1 / 0", "which has no value"),
        ("9 ** 9 ** 9 ** 9", "which has no value"),
    ],
)
def test_wrong_expressions(text, said):
    with pytest.raises(InputError) as error:
        value_of(parse(text), {}.get)
    assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("part", "said"),
    [
        (SPEED.replace("scan.speed", "scan.sped"), "did you mean scan.speed?"),
        (SPEED.replace('"1 arcmin', '"200 arcmin'), "optimise.knobs.0.high: found '100 arcmin / s'; more than 'low'"),
        (SPEED.replace("arcmin / s", "s"), "optimise.knobs.0.low: scan.speed: found '1 s'; a quantity in "),
        (RINGS.replace("rings", "dead"), "optimise.knobs.0.low: instrument.layout.dead: found 1; a list is expected"),
        (ALGORITHM.replace('"average"', '"averag"'), "optimise.knobs.0.choices: cleaning.algorithm: found 'averag'"),
        (SPEED + SPEED, "found 'scan.speed' more than once"),
        (RINGS.replace("40", "4.5"), "optimise.knobs.0.high: found 4.5; an integer is expected"),
        (SPEED.replace("scan.speed", "seed"), "found 'seed', which all designs have in common; another key"),
        (SPEED.replace("high", "hihg"), "optimise.knobs.0.hihg: unknown key; did you mean"),
        (ALGORITHM + "low = 1\n", "low: found together with 'choices'"),
        (SPEED + '[[optimise.limits]]\nquantity = "detectors"\n', "'at_least' or 'at_most' is expected"),
        (
            SPEED + '[[optimise.derived]]\nkey = "scan.scans"\nvalue = "open(1)"\n',
            "optimise.derived.0.value: found 'open(1)'",
        ),
        (
            SPEED + '[[optimise.limits]]\nquantity = "detectrs"\nat_most = 2\n',
            "found 'detectrs'; did you mean detectors",
        ),
        (
            SPEED + '[[optimise.derived]]\nkey = "scan.scans"\nvalue = "2 * scan.stp"\n',
            "optimise.derived.0.value: found 'scan.stp'; did you mean scan.step",
        ),
        (
            SPEED + '[[optimise.derived]]\nkey = "scan.scans"\nvalue = "2 * nothing"\n',
            "found 'nothing'; a key of the scene that has a value, or a unit, is expected",
        ),
        ('metrics = ["flat_band_power.sigmaa"]\n' + SPEED, "did you mean flat_band_power.sigma?"),
    ],
)
def test_wrong_sections(write, part, said):
    with pytest.raises(SceneError) as error:
        load_problem(write(SMALL_SCENE + "\n[optimise]\n" + part)).scene_at({"scan.speed": "1 s"})
    assert said in str(error.value)


def test_the_section_changes_no_result(write):
    """Runs of the scene as it is are the same with and without it."""
    with_it = load_scene(write(SMALL_SCENE + "\n[optimise]\n" + SPEED))
    assert with_it.optimise is not None and hash(with_it)
    assert scene_hash(with_it) == scene_hash(load_scene(write(SMALL_SCENE)))


def test_other_files_are_refused(write):
    with pytest.raises(SceneError, match="optimise: missing"):
        load_problem(write(SMALL_SCENE))
    sweep = SMALL_SCENE + "\n[optimise]\n" + SPEED + "\n[sweep]\nobservations = [1, 2]\n"
    with pytest.raises(SceneError, match="sweep: found a sweep"):
        load_problem(write(sweep))
