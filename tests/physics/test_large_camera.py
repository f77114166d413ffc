"""Ten thousand detectors at 200 Hz for ten minutes, from the command line: what one observation takes and leaves."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from astropy.io import fits
from astropy.table import Table

from surveysim.observation import observation_levels
from surveysim.scene import load_scene
from surveysim.setup import prepare

SCENE = Path(__file__).parents[2] / "scenarios" / "large_camera.toml"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "wait4"), reason="what a process held is asked of a Unix system")
def test_one_observation_in_eight_gigabytes(tmp_path):
    """1.2e9 detector-samples with all data sets: every sample is in the maps, and white noise as it went in."""
    command = [sys.executable, "-c", "from surveysim.cli import main; main()", "run", str(SCENE), "--workers", "1"]
    process = subprocess.Popen([*command, "--set", "observations=1", "--no-figures", "--quiet", "--out", str(tmp_path)])
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    assert usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024) < 8e9
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["detectors"] == 10267 and summary["detector_samples"] == 60 * 2000 * 10267
    row = Table.read(tmp_path / "tables" / "observations.ecsv")[0]
    with fits.open(tmp_path / "maps" / "white.fits") as file:
        assert file["HITS"].data.sum(dtype=int) == (60 - row["discarded_actual"]) * 2000 * 10267
    levels = observation_levels(prepare(load_scene(SCENE, {"observations": 1})), 0)
    # Of the noise above 20 Hz, the mean over 10267 detectors, six templates take next to nothing.
    assert row["white_mk2_hz"] == pytest.approx(levels.photon_mk2_hz + levels.detector_mk2_hz, rel=0.01)
    # The map's modes are thousands of degrees of freedom.
    assert row["noise_mk2_white"] == pytest.approx(row["white_mk2_hz"] * 100, rel=0.05)
    assert row["noise_mk2_white"] < row["noise_mk2_masked_2611"] < row["noise_mk2_actual"]
