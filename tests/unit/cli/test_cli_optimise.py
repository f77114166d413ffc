"""The command line of searches for the best design."""

import shutil

import pytest

from surveysim.studies.optimise.store import EvaluationStore
from tests.unit.studies.test_optimise_run import WHITE

RINGS = """
[optimise]
rivals = 1

[[optimise.knobs]]
key = "instrument.layout.rings"
low = 1
high = 3
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "rings.toml"
    path.write_text(WHITE.replace("dead = [5]\n", "") + RINGS)
    return path


def test_a_search_that_is_interrupted_and_resumed(call, scene, monkeypatch):
    out = scene.parent / "out"
    arguments = ("optimise", scene, "--out", out, "--workers", 1, "--no-figures", "--forecast")

    def interrupted(store, key):
        keep(store, key)
        if len(store.evaluations) == 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        keep = EvaluationStore._keep
        patch.setattr(EvaluationStore, "_keep", interrupted)
        code, _, error = call(*arguments)
    assert code == 130 and error.splitlines()[-1].startswith("interrupted; go on with: surveysim optimise ")
    assert len((out / "evaluations.jsonl").read_text().splitlines()) == 1 + 3
    code, _, error = call(*arguments)
    assert code == 2 and error.startswith(f"{out / 'evaluations.jsonl'}: from a run that has not finished; --resume")
    code, text, error = call(*arguments, "--resume")
    assert (code, error) == (0, "") and "│ instrument.layout.rings │ 1 to 3   │ 2" in text
    assert "4 designs were forecast; 0 are not allowed" in text and "page in" in text
    code, text, error = call(*arguments[:-1], "--resume", "--verbose")  # and now the simulations
    assert code == 0 and "The best design and its rivals, simulated" in text
    assert [line.partition(",")[0] for line in error.splitlines()] == ["rings: 1/2 points", "rings: 2/2 points"]
    assert call(*arguments[:-1], "--resume") == (0, "", f"{out}: the run is finished; there is nothing to resume\n")
    page = (out / "report.html").read_text()
    assert call("report", out)[0] == 0 and (out / "report.html").read_text() == page
    shutil.rmtree(out)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--importance", 3), "--importance: found 3; a power of two from 2 to 4096 is expected"),
        (
            ("--set", "optimise.metrics=['no.metric']"),
            "optimise.metrics: found 'no.metric'; one of flat_band_power.sigma",
        ),
        (("--set", "score="), "score: missing; a search compares scores"),
    ],
)
def test_wrong_options(call, scene, options, said):
    code, out, error = call("optimise", scene, *options)
    assert (code, out) == (2, "") and said in error and len(error.splitlines()) == 1
    assert list(scene.parent.iterdir()) == [scene]
