"""Time one observation with surveysim and with its peers: ``python tests/benchmark/peers.py [REPEATS]``.

Peers that are not installed are left out. All codes take turns in one process, on one thread. The first call of each,
which compiles and fills caches, is dropped; so is preparation that a survey has once: scene, telescope, schedule,
spectra. Times are medians over the repeats. The unit of time is also numpy's float32 normal deviate, drawn in turn.

The observation has 115 detectors and 20 scans of 15 s, one turbulent layer, white noise, average subtraction and a map
of 20 arcsec pixels. The codes differ:

surveysim
    The layer has no outer scale, and is continuous over the scans. Responsivities are fitted to each scan. PSDs before
    and after cleaning are included.
pixell + numpy, FFT + numba
    Each scan has its own periodic screen of 34 degrees; longer modes are missing before subtraction. Detectors are
    averaged without responsivities. The screen is interpolated by cubic splines (pixell) or linearly (numba).
maria
    Its atmosphere has eight layers, with an outer scale and a Gaussian beam; "one layer" is the second of them, with
    the variance of all. Scans follow each other without turnarounds. The first mode of all streams is removed, not the
    average of each scan. Plain tables replace those of weather and emission, which maria fetches.
TOAST
    Its atmosphere is three-dimensional, with default scales and volume elements and its median weather of the Atacama.
    Scans go back and forth in azimuth. The common mode is subtracted without regression.

The table has the rms in scans, less their means, before and after subtraction, and the white noise from second
differences. Before subtraction the atmospheres differ; afterwards white noise dominates, which is the same in all.
"""

import importlib.metadata
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

import numpy as np
from peer_codes import maria, own, screens, toast
from peer_codes.observation import Observation, Streams, prepare_observation
from threadpoolctl import threadpool_limits

RATES_HZ = (10, 50)
SHORTEST_S = 0.5  # CPU time of a turn
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "DASK_SCHEDULER": "synchronous",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    "TOAST_LOGLEVEL": "ERROR",
}


@dataclass(frozen=True)
class Code:
    """Code that is timed.

    Attributes
    ----------
    packages
        Distributions that it needs.
    prepare
        Makes the function that is timed.
    streams
        Streams of a result of that function.
    """

    packages: tuple[str, ...]
    prepare: Callable[[Observation], Callable[[], Any]]
    streams: Callable[[Any], Streams] = lambda result: result


CODES = {
    "surveysim": Code(("numpy", "scipy", "numba"), own.surveysim, own.surveysim_streams),
    "FFT + numba": Code(("numba",), screens.fft_numba),
    "pixell + numpy": Code(("pixell",), screens.pixell_numpy),
    # TOAST comes before maria: it takes 1.7 times as long in a process that imported maria first.
    "TOAST": Code(("toast",), toast.toast),
    "maria, one layer": Code(("maria",), maria.one_layer, maria.streams),
    "maria, eight layers": Code(("maria",), maria.eight_layers, maria.streams),
}


def versions(code: Code) -> dict[str, str] | None:
    """Versions of the packages of a code; None if one is not installed."""
    try:
        return {name: importlib.metadata.version(name) for name in code.packages}
    except importlib.metadata.PackageNotFoundError:
        return None


def timed(run: Callable[[], Any]) -> np.ndarray:
    """Mean CPU and wall time of a call [s]."""
    start, calls = np.array([process_time(), perf_counter()]), 0
    while calls == 0 or process_time() - start[0] < SHORTEST_S:
        run()
        calls += 1
    return (np.array([process_time(), perf_counter()]) - start) / calls


def deviations(seen: Observation, streams: Streams) -> list[str]:
    """Rms before and after subtraction, and of the white noise after it [mK]."""
    scans = [[data[:, first:end] for first, end in seen.bounds] for data in streams]
    rms = [np.sqrt(np.mean([scan.var(axis=1).mean() for scan in of_all])) for of_all in scans]
    white = np.sqrt(np.mean([np.mean(np.diff(scan, 2) ** 2) for scan in scans[1]]) / 6)
    return [f"{value:.2f}" for value in (*rms, white)]


def measure(rate_hz: int, repeats: int) -> None:
    """Print the table of a sample rate."""
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        seen = prepare_observation(rate_hz, Path(folder))
        codes = {name: code for name, code in CODES.items() if versions(code)}
        runs = {name: code.prepare(seen) for name, code in codes.items()}
        rms = {name: deviations(seen, code.streams(runs[name]())) for name, code in codes.items()}
        runs["deviates"] = own.numpy_deviates(seen)
        rounds = [{name: timed(run) for name, run in runs.items()} for _ in range(repeats)]
    cpu, wall = ({name: median(times[name][k] for times in rounds) for name in runs} for k in (0, 1))
    samples = seen.shape[0] * seen.shape[1]
    print(f"\n{rate_hz} Hz, {samples} detector-samples; white noise expected: {seen.white_mk:.2f} mK\n")
    print("| code | CPU [s] | wall [s] | ns | deviates | times surveysim | before [mK] | after [mK] | white [mK] |")
    print("|---|" + "---:|" * 8)
    for name in runs:
        times = f"{cpu[name]:.3g} | {wall[name]:.3g} | {1e9 * cpu[name] / samples:.3g}"
        ratios = f"{cpu[name] / cpu['deviates']:.3g} | {cpu[name] / cpu['surveysim']:.3g}"
        print(f"| {name} | {times} | {ratios} | " + " | ".join(rms.get(name, ["", "", ""])) + " |")


def main() -> None:
    """Measure each sample rate in a process of its own."""
    repeats, *rates = map(int, sys.argv[1:] or ["3"])
    if rates:
        measure(rates[0], repeats)
        return
    for name, code in CODES.items():
        found = versions(code)
        print(f"{name}: {', '.join(f'{key} {value}' for key, value in found.items()) if found else 'not installed'}")
    for rate_hz in RATES_HZ:
        with tempfile.TemporaryDirectory() as tables:
            environment = os.environ | ENVIRONMENT | {"MARIA_CACHE_DIR": tables}
            sys.stdout.flush()
            subprocess.run([sys.executable, __file__, str(repeats), str(rate_hz)], env=environment, check=True)


if __name__ == "__main__":
    main()
