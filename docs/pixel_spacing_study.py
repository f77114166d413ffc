"""Tables and figure of the page on pixel spacing: `python docs/pixel_spacing_study.py [NAME ...]`.

Names are bands, causes, bolocam and neighbours; all four without, which takes some ten minutes.
Tables are printed in Markdown; the figure goes to docs/_static.
"""

import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from scipy.special import j0

from surveysim.forecasting.forecast import forecast
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import Scene, load_scene
from surveysim.telescope.array_noise import array_psd
from surveysim.telescope.diffraction import with_beam
from surveysim.telescope.focal_plane import Camera, camera
from surveysim.telescope.illumination import TableIllumination
from surveysim.telescope.layouts import hexagon
from surveysim.telescope.noise_levels import WhiteLevels, stop_emits, white_levels
from surveysim.timestreams.shared_parts import photon_coherence

ROOT = Path(__file__).parent.parent
SCENES, PICTURE = ROOT / "scenarios", ROOT / "docs" / "_static" / "pixel_spacing.png"
BANDS = ("90 GHz", "150 GHz", "280 GHz", "850 GHz")
PITCHES = np.round(np.arange(0.5, 3.01, 0.05), 2)
NOISES = {
    "none": ("black", ":", "independent"),
    "hbt": ("#0072B2", "-", "wave noise correlated (hbt)"),
    "field": ("#D55E00", "--", "all photon noise correlated (field)"),
}


def main(names: Sequence[str]) -> None:
    """Print the named tables, or all."""
    tables = {"bands": bands, "causes": causes, "bolocam": bolocam, "neighbours": neighbours}
    for name in names or tables:
        print(f"\n{name}\n")
        for row in tables[name]():
            print("|", " | ".join(row), "|")


# ---------------------------------------------------------------- four bands


def keys_of(band: str, pitch: float) -> dict[str, Any]:
    """Keys of one point of the scene."""
    sweep = tomllib.loads((SCENES / "pixel_spacing_hbt.toml").read_text())["sweep"]
    place = sweep["band"]["instrument.frequency"].index(band)
    keys = {key: values[place] for key, values in sweep["band"].items()}
    return keys | dict.fromkeys(sweep["pitch"], float(pitch))


def array_of(scene: Scene) -> tuple[float, WhiteLevels, Camera]:
    """PSD of the mean of all detectors, levels of one, and the camera, without responsivities and weather."""
    whole = with_beam(scene)
    cam, levels = camera(whole.instrument, whole.seed), white_levels(whole, None, np.nan, np.pi / 3)
    coherence = photon_coherence(cam, whole.photon, stop_emits(whole))
    return array_psd(cam, coherence, levels), levels, cam


def speeds(
    band: str, coherence: str, extra: Mapping[str, Any] | None = None, pitches: np.ndarray = PITCHES
) -> np.ndarray:
    """Mapping speed at all pitches: inverse PSD of the mean, any unit."""
    changes = {"photon.coherence": coherence} | dict(extra or {})
    scene = SCENES / "pixel_spacing_hbt.toml"
    return np.array([1 / array_of(load_scene(scene, keys_of(band, pitch) | changes))[0] for pitch in pitches])


def best(speed: np.ndarray, pitches: np.ndarray = PITCHES) -> float:
    """Pitch of the highest speed."""
    return float(pitches[np.argmax(speed)])


def bands() -> Iterator[list[str]]:
    """Each band at a pitch of 1 (f/#)lambda, and its best pitches; draws the figure."""
    figure = Figure(figsize=(9.2, 6.4), dpi=110, layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
    costs = [f"cost of {name} at 0.5, 0.7, 1" for name in ("hbt", "field")]
    yield ["band", "wave noise", "aperture, stop", *(f"best, {name}" for name in NOISES), *costs]
    for axes, band in zip(panels, BANDS, strict=True):
        found = {name: speeds(band, name) for name in NOISES}
        unit = found["none"].max()
        for name, (colour, line, label) in NOISES.items():
            axes.plot(PITCHES, found[name] / unit, line, color=colour, label=label)
            axes.plot(best(found[name]), found[name].max() / unit, "o", color=colour, ms=4)
        axes.set_title(band, fontsize=10)
        axes.set_ylim(0, 1.05)
        _, levels, _ = array_of(load_scene(SCENES / "pixel_spacing_hbt.toml", keys_of(band, 1.0)))
        at = [int(np.argmin(np.abs(PITCHES - pitch))) for pitch in (0.5, 0.7, 1.0)]
        yield [
            band,
            f"{100 * levels.wave_mk2_hz / levels.photon_mk2_hz:.0f} %",
            f"{levels.aperture_weight:.2f}, {levels.stop_weight:.2f}",
            *(f"{best(item):.2f}" for item in found.values()),
            ", ".join(f"{100 * (1 - found['hbt'][i] / found['none'][i]):.0f} %" for i in at),
            ", ".join(f"{100 * (1 - found['field'][i] / found['none'][i]):.0f} %" for i in at),
        ]
    panels[0].legend(fontsize=8, loc="lower right")
    figure.supxlabel("pitch of the horns [(f/#)λ]", fontsize=10)
    figure.supylabel("mapping speed of a fixed field of view", fontsize=10)
    figure.savefig(PICTURE)
    Image.open(PICTURE).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(PICTURE, optimize=True)


# ---------------------------------------------------------------- causes

CAUSES: dict[str, dict[str, Any]] = {
    "as above": {},
    "no detector noise": {"detector.nep": "0 W / Hz(1/2)"},
    "detector noise of 3 times the photons'": {"detector.nep": "3.4e-17 W / Hz(1/2)"},
    "stop at 1 K": {"optics.stop.temperature": "1 K"},
    "stop at 20 K": {"optics.stop.temperature": "20 K"},
    "sky of 60 K": {"optics.sky": "60 K"},
    "Gaussian beams": {"instrument.illumination": "gaussian"},
}


NEAR = np.round(np.arange(0.6, 1.61, 0.1), 2)


def causes() -> Iterator[list[str]]:
    """Best pitches at 150 GHz with one assumption changed, at a fixed field of view; and at a fixed count."""
    yield ["assumption", "best, independent", "best, hbt", "gain of the best over 1.2, hbt", "cost of hbt at 0.7"]
    count = {"instrument.layout.field_of_view": None, "instrument.layout.rings": 7}
    for name, keys in {**CAUSES, "fixed count": count}.items():
        alone, shared = (speeds("150 GHz", kind, keys, NEAR) for kind in ("none", "hbt"))
        gain = shared.max() / shared[NEAR == 1.2][0] - 1
        cost = 1 - (shared / alone)[NEAR == 0.7][0]
        yield [name, f"{best(alone, NEAR):g}", f"{best(shared, NEAR):g}", f"{100 * gain:.1f} %", f"{100 * cost:.1f} %"]


# ---------------------------------------------------------------- Bolocam


def bolocam() -> Iterator[list[str]]:
    """Forecast sigma(A) of Bolocam's scenes by pitch, for each hypothesis about photon and excess noise."""
    pitches = (0.7, 1.0, 1.3)
    yield ["held constant", "photon noise", "excess noise", *(f"{pitch:g}" for pitch in pitches)]
    for name in ("fixed_count", "fixed_fov"):
        for photon in ("field", "hbt"):
            for excess in ("field", "none"):
                keys = {"photon.coherence": photon, "photon.bose_fraction": 0.69, "excess.coherence": excess}
                found = [sigma(SCENES / f"pixel_spacing_{name}.toml", keys, pitch) for pitch in pitches]
                yield [name, photon, excess, *(f"{found[0] / item:.2f}" for item in found)]


def sigma(path: Path, keys: Mapping[str, Any], pitch: float) -> float:
    """Forecast sigma(A) of the actual data at one pitch."""
    place = {"instrument.layout.pitch_f_lambda": pitch, "score.mask_separation_f_lambda": None}
    scene = load_scene(path, {**keys, **place})
    return forecast(prepare(scene)).scores["actual"].band.sigma_ukcmb2


# ---------------------------------------------------------------- six neighbours


def neighbours() -> Iterator[list[str]]:
    """Sum of the correlation of wave noise over all other pixels, and by the rules of bolojax 0.7.2 (preset he11)."""
    rho = np.unique(np.concatenate([np.linspace(0, 1.2, 2401), np.linspace(1.0, 1.15, 5001)]))
    value = j0(2.4048255577 * rho / 1.05) ** 2 * 0.5 * (1 - np.tanh((rho - 1.05) / 0.01))
    beam = TableIllumination(tuple(rho[rho <= 1.15].tolist()), tuple(value[rho <= 1.15].tolist()))
    yield ["pitch", "its rules", "J0(pi s rho)", "and gamma^2", "and all within 3", "all"]
    for pitch in (0.5, 0.7, 1.0, 1.2, 1.5, 2.0):
        shells = np.arange(1, round(3 / pitch) + 1) * pitch
        places = np.concatenate([shells, np.sqrt(3) * shells])
        sums = [6 * np.abs(beam.aperture(2 * places)).sum(), 6 * np.abs(beam.aperture(places)).sum()]
        sums.append(6 * (beam.aperture(places) ** 2).sum())
        around = np.linalg.norm(hexagon(9, pitch)[1:], axis=1)
        sums.append((beam.aperture(around[around <= 3]) ** 2).sum())
        sums.append((beam.aperture(np.linalg.norm(hexagon(60, pitch)[1:], axis=1)) ** 2).sum())
        yield [f"{pitch:g}", *(f"{item:.2f}" for item in sums)]


if __name__ == "__main__":
    main(sys.argv[1:])
