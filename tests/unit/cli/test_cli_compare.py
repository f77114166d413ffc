"""The command compare."""

from pathlib import Path

from tests.scenes import write_scene
from tests.unit.studies.test_sweep_run import WHITE

QUICK = ("--engine", "serial", "--no-figures", "-q")


def test_compare(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write_scene(tmp_path, WHITE)
    for name, settings in (("a", ()), ("b", ("--set", "scan.scans=5")), ("c", ("--set", "seed=3"))):
        assert call("run", path, *QUICK, *settings, "--out", name) == (0, "", "")
    code, out, error = call("compare", "a", "b", "c")
    assert (code, error) == (0, "") and sorted(item.name for item in Path().iterdir()) == ["a", "b", "c", "small.toml"]
    assert "Ratios are to a." in out and "Errors of ratios of b are paired" in out
    assert "The errors of c are for independent runs: seeds 11 and 3." in out and "scan.scans" in out
    assert call("compare", "a", "b", "--out", "both", "--no-figures", "-q") == (0, "", "")
    assert (Path("both") / "report.html").is_file() and call("report", "both")[0] == 0
    code, out, error = call("compare", "a", "both")
    assert (code, out) == (2, "") and error.startswith("both: found a comparison; the directory of a run")
