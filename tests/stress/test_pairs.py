"""Two runs at one moment in one directory: one is done, the other is refused; neither mixes with the other."""

import time

import numpy as np
import pytest

from tests.stress.commands import SCENE, SWEEP, ended, start
from tests.trees import lost, plant, results

pytestmark = pytest.mark.slow

FEW = 2
LONG = SCENE.replace("observations = 16", "observations = 80")
# Scene and arguments of each of the two.
PAIRS = (
    ((LONG, ("--set", "seed=1")), (LONG, ("--set", "seed=2"))),
    ((LONG, ("--engine", "serial")), (LONG, ("--workers", "2", "--set", "seed=2", "--save-timestreams"))),
    ((SWEEP, ("--workers", "2")), (LONG, ("--workers", "1"))),
    ((LONG, ("--resume",)), (LONG, ("--resume", "--set", "seed=2"))),
    ((SWEEP, ("--workers", "1")), (SWEEP, ("--workers", "1", "--resume", "--set", "seed=2"))),
)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """Files of each command run alone."""
    kept = {}

    def of(text, arguments):
        if (text, arguments) not in kept:
            root = tmp_path_factory.mktemp("alone")
            (root / "scene.toml").write_text(text)
            code, error = ended(start(root, "run", "scene.toml", *arguments, "--no-figures", "-q", "--out", "out"))
            assert code == 0, error
            kept[text, arguments] = results(root / "out")
        return kept[text, arguments]

    return of


def test_pairs(request, tmp_path, alone):
    stress = request.config.option.stress
    number = max(1, stress // 3) if stress else FEW
    rng = np.random.default_rng(request.config.option.fuzz_seed)
    failed = []
    for place in range(number):
        root = tmp_path / f"{place:03d}"
        root.mkdir()
        if fault := together(root, PAIRS[place % len(PAIRS)], float(rng.choice([0, 0.05, 0.2, 0.8])), alone):
            failed.append(f"{place}: {fault}")
    assert not failed, "\n".join([f"{len(failed)} of {number} pairs:", *failed])


def together(root, pair, delay, alone):
    """Start both; say what is wrong, or nothing."""
    before = plant(root)
    processes = []
    for number, (text, arguments) in enumerate(pair):
        (root / f"{number}").mkdir()
        scene = root / f"{number}" / "scene.toml"
        scene.write_text(text)
        processes.append(start(root, "run", f"{number}/scene.toml", *arguments, "--no-figures", "-q", "--out", "out"))
        time.sleep(delay if number == 0 else 0)
    ends = [ended(process) for process in processes]
    said = f"{pair[0][1]} and {pair[1][1]}, {delay} s apart, ended with {ends}"
    done = [number for number, (code, _) in enumerate(ends) if code == 0]
    if len(done) != 1:
        return f"{said}: one success is expected"
    code, error = ends[1 - done[0]]
    if code not in (1, 2) or len(error.strip().splitlines()) != 1 or len(error) > 500:
        return f"{said}: a refusal in one line is expected"
    if gone := lost(root, before):
        return f"{said}: lost {gone}"
    expected, found = alone(*pair[done[0]]), results(root / "out")
    odd = sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))
    return f"{said}: other files than of one alone: {odd}" if odd else ""
