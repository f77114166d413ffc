"""Ten thousand detectors at 200 Hz, from the command line: what an observation in blocks takes and leaves."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from astropy.io import fits
from astropy.table import Table

from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.timestreams.observed_block import observation_levels

SCENE = Path(__file__).parents[2] / "scenarios" / "large_camera.toml"
SETTINGS = {"observations": 1, "scan.scans": 3, "scan.step": "60 arcmin", "numerics.max_block_memory": "100 MB"}


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "wait4"), reason="what a process held is asked of a Unix system")
def test_one_observation_in_blocks(tmp_path):
    """Half a minute with all data sets: every sample is in the maps, and white noise as it went in.

    More scans make more blocks, not larger ones: ten minutes take no more memory.
    """
    command = [sys.executable, "-c", "from surveysim.cli.main import main; main()", "run", str(SCENE), "--workers", "1"]
    command += [word for key, value in SETTINGS.items() for word in ("--set", f"{key}={value}")]
    process = subprocess.Popen([*command, "--no-figures", "--quiet", "--out", str(tmp_path)])
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    assert usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024) < 3e9
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["detectors"] == 10267 and summary["detector_samples"] == 3 * 2000 * 10267
    row = Table.read(tmp_path / "tables" / "observations.ecsv")[0]
    with fits.open(tmp_path / "maps" / "white.fits") as file:
        assert file["HITS"].data.sum(dtype=int) == (3 - row["discarded_actual"]) * 2000 * 10267
    levels = observation_levels(prepare(load_scene(SCENE, SETTINGS)), 0)
    # Of the noise above 20 Hz, the mean over 10267 detectors, six templates take next to nothing.
    assert row["white_mk2_hz"] == pytest.approx(levels.photon_mk2_hz + levels.detector_mk2_hz, rel=0.01)
