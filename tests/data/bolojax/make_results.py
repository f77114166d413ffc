"""Make results.json from the YAML files beside it, with bolojax: ``pip install bolojax; python make_results.py``."""

import json
from importlib.metadata import version
from pathlib import Path

import bolojax
import numpy as np
import yaml

FOLDER = Path(__file__).resolve().parent
OUTPUTS = ("opt_power", "effic", "P_sat", "G", "NEP_ph", "NEP_bolo", "NEP_read", "NEP", "NET", "NET_RJ")


def channels(name):
    """Return the frequencies, the detector's response and the results of each channel of an instrument, in SI units."""
    config = yaml.safe_load((FOLDER / f"{name}.yaml").read_text())
    config["sim_config"]["config_dir"] = str(FOLDER)
    found = {}
    experiments = bolojax.ExperimentConfig(**config)
    for camera, section in experiments.instrument.cameras.items():
        for channel in section.channels:
            made = experiments.setup(camera, channel)
            result, freqs = made.compute(), np.asarray(made.instrument.freqs)
            response = np.broadcast_to(made.instrument.elements["detector"].trans_spectrum, freqs.shape)
            values = {key: float(np.squeeze(getattr(result, key))) for key in OUTPUTS}
            grid = {"frequency_hz": freqs.tolist(), "response": np.asarray(response).tolist()}
            loads = np.asarray(result.elem_power_to_det).reshape(len(made.instrument.elements))
            powers = dict(zip(made.instrument.elements, loads.tolist(), strict=True))
            found[f"{camera}.{channel}"] = values | grid | {"load_w": powers}
    return found


if __name__ == "__main__":
    results = {name: channels(name) for name in ("comprehensive", "example")}
    text = json.dumps({"made_with": f"bolojax {version('bolojax')}"} | results, indent=1)
    (FOLDER / "results.json").write_text(text + "\n")
