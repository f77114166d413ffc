"""Ten thousand detectors at 200 Hz for ten minutes, from the command line: what one observation takes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCENE = Path(__file__).parents[2] / "scenarios" / "large_camera.toml"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "wait4"), reason="what a process held is asked of a Unix system")
def test_one_observation_in_eight_gigabytes(tmp_path):
    """1.2e9 detector-samples, all data sets and window skies, scored."""
    command = [sys.executable, "-c", "from surveysim.cli import main; main()", "run", str(SCENE), "--workers", "1"]
    process = subprocess.Popen([*command, "--set", "observations=1", "--no-figures", "--quiet", "--out", str(tmp_path)])
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    held = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    assert held < 8e9
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["detector_samples"] > 1.2e9
    scores = {name: item["sigma_ukcmb2"] for name, item in summary["scores"].items()}
    assert scores["white"] < scores["actual"] < scores["masked_2611"]
    # Nothing but the scans and their noise are in both: a few per cent of forecast and chance, with room.
    for name in ("white", "actual", "masked_2611"):
        assert scores[name] == pytest.approx(summary["scores"][name]["forecast_ukcmb2"], rel=0.3)
