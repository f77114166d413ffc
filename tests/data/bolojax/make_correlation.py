"""Make correlation.json with bolojax: ``pip install bolojax; python make_correlation.py``."""

import json
from importlib.metadata import version
from pathlib import Path

import jax
import numpy as np
from bolojax.compute.noise import Noise

jax.config.update("jax_enable_x64", True)
PITCHES = [0.5, 0.7, 1.0, 1.2, 1.5, 2.0, 3.0]
ELEMENTS = ["MIRROR", "LYOT", "LENS"]  # before the stop, the stop, behind it


def short(values):
    """Return numbers of ten digits."""
    return [float(f"{value:.10g}") for value in np.asarray(values).tolist()]


def curves(preset):
    """Return every third point of the curves of a beam, and its squared factors at some pitches."""
    noise = Noise(preset)
    factors = [short(np.asarray(noise.corr_facts(ELEMENTS, pitch, ["LYOT"])) ** 2) for pitch in PITCHES]
    return {
        "separation": short(noise._det_p[::3]),
        "aperture": short(noise._c_apert[::3]),
        "stop_squared": short(noise._c_stop[::3]),
        "pitch": PITCHES,
        "factors": factors,
    }


if __name__ == "__main__":
    presets = {name: curves(name) for name in ("he11", "trunc_gauss")}
    text = json.dumps({"made_with": f"bolojax {version('bolojax')}", "presets": presets}, indent=1)
    Path(__file__).with_name("correlation.json").write_text(text + "\n")
