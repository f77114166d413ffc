"""Cost of one observation by its detectors and samples: `python tests/benchmark/scaling.py`.

Every point is made in a process of its own, whose peak memory is its own. Processor time, not that of the clock, a
detector-sample without and of signal simulations; the time to start, to compile and to make strips of the layer is
reported apart, as a survey has it once a process. A scan that does not calibrate takes all 100 iterations before it is
discarded: their mean goes with the time.
"""

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

SCENE = Path(__file__).parents[2] / "scenarios" / "large_camera.toml"
# Rings (91, 1027 and 10267 detectors), wafers, sample rate [Hz] and scans of 10 s.
POINTS = [
    (5, 1, 200, 60),
    (18, 1, 200, 60),
    (58, 1, 200, 6),
    (58, 1, 100, 6),
    (58, 1, 50, 6),
    (58, 1, 200, 3),
    (58, 1, 200, 12),
    (58, 3, 50, 3),
    (58, 10, 50, 3),
]
OBSERVATIONS, OBSERVATION_S, SIMULATED_SHARE = 10_000, 3600.0, 0.2


def several_wafers(rings: int, wafers: int) -> dict[str, Any]:
    """Settings for wafers in a square, a third as wide as the camera of the scene, so that they see one field."""
    side = math.ceil(wafers**0.5)
    centres = [(place % side - (side - 1) / 2, place // side - (side - 1) / 2) for place in range(wafers)]
    lattice = {"rings": rings, "pitch_f_lambda": 1.3}
    offsets = [{"offset_x": f"{1.1 * x} deg", "offset_y": f"{1.05 * y} deg"} for x, y in centres]
    made = [lattice | offset for offset in offsets]
    return {"instrument.layout": None, "instrument.wafers": made, "instrument.f_lambda": "22.9 arcsec"}


def measure(rings: int, wafers: int, rate_hz: float, scans: int) -> dict[str, float]:
    """One observation with signal simulations in this process, once one scan of it has been made."""
    from dataclasses import replace
    from time import process_time

    from threadpoolctl import threadpool_limits

    from surveysim.reduction.observation import observe
    from surveysim.reduction.setup import prepare
    from surveysim.runtime.memory import keep_freed_memory, peak_bytes
    from surveysim.scene.scene import load_scene
    from surveysim.telescope.scans import samples_per_scan
    from surveysim.timestreams.scan_blocks import Block

    settings = {"scan.sample_rate": f"{rate_hz} Hz", "scan.scans": scans}
    settings |= several_wafers(rings, wafers) if wafers > 1 else {"instrument.layout.rings": rings}
    # The map and its patch stay as large as those of the whole raster.
    settings |= {"scan.step": f"{300 / scans} arcmin", "observations": 1}
    keep_freed_memory()  # as a run does
    with threadpool_limits(1):
        setup = prepare(load_scene(SCENE, settings))
        observe(replace(setup, observing=replace(setup.observing, blocks=(Block(0, 0, 1),))), 0, True)
        start_s = process_time()
        result = observe(setup, 0, True)
        cpu_s = process_time() - start_s
    samples = setup.camera.n_det * setup.observing.scans.n_scans * samples_per_scan(setup.observing.scans)
    skies = result.seconds["transfer_function"] / sum(result.seconds.values())
    return {
        "detectors": setup.camera.n_det,
        "rate [Hz]": rate_hz,
        "scans": scans,
        "blocks": len(setup.observing.blocks),
        "iterations": result.iterations[0],
        "10^6 samples": samples / 1e6,
        "CPU [s]": cpu_s,
        "ns": 1e9 * cpu_s * (1 - skies) / samples,
        "simulations [ns]": 1e9 * cpu_s * skies / samples,
        "start [s]": start_s,
        "MB": peak_bytes() / 1e6,
    }


def main() -> None:
    """Print the table, a row as soon as it is measured, and what a large survey would take by its longest row."""
    if len(sys.argv) > 1:
        print(json.dumps(measure(*map(int, sys.argv[1:]))))
        return
    rows = []
    for point in POINTS:
        done = subprocess.run([sys.executable, __file__, *map(str, point)], capture_output=True, text=True, check=True)
        rows.append(json.loads(done.stdout))
        if len(rows) == 1:
            print("| " + " | ".join(rows[0]) + " |\n|" + "---:|" * len(rows[0]))
        print("| " + " | ".join(f"{value:.5g}" for value in rows[-1].values()) + " |", flush=True)
    largest = max(rows, key=lambda row: row["10^6 samples"] * (1e4 < row["detectors"] < 2e4))
    each = largest["ns"] + SIMULATED_SHARE * largest["simulations [ns]"]
    samples = largest["detectors"] * 200 * OBSERVATION_S
    hours = 1e-9 * each * samples / 3600
    print(
        f"\n{OBSERVATIONS} observations of an hour at 200 Hz with {largest['detectors']} detectors, signal simulations "
        f"in a fifth: {samples:.3g} samples and {hours:.3g} core-hours each, "
        f"{OBSERVATIONS * hours:.3g} core-hours in all"
    )


if __name__ == "__main__":
    main()
