"""Ten thousand detectors at 200 Hz from the command line: what observations of two blocks take."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCENE = Path(__file__).parents[2] / "scenarios" / "large_camera.toml"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "wait4"), reason="what a process held is asked of a Unix system")
def test_memory_of_observations_in_blocks(tmp_path):
    """8e7 detector-samples, all data sets and window skies, scored; more scans make more blocks, not larger ones."""
    settings = ("observations=2", "scan.scans=2", "scan.step=90 arcmin", "numerics.stream_memory=100 MB")
    command = [sys.executable, "-c", "from surveysim.cli import main; main()", "run", str(SCENE), "--workers", "1"]
    command += [word for setting in settings for word in ("--set", setting)]
    process = subprocess.Popen([*command, "--no-figures", "--quiet", "--out", str(tmp_path)])
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    held = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    assert held < 3e9
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["detector_samples"] > 8e7
    scores = {name: item["sigma_ukcmb2"] for name, item in summary["scores"].items()}
    assert scores["white"] < scores["actual"] < scores["masked_2611"]
    # Nothing but the scans and their noise are in both: a few per cent of forecast and chance, with room.
    for name in ("white", "actual", "masked_2611"):
        assert scores[name] == pytest.approx(summary["scores"][name]["forecast_ukcmb2"], rel=0.3)
