"""A quick scene whose score depends on its weather: 10 ms an observation."""

from pathlib import Path

from surveysim.scene.scene import Scene, load_scene
from tests.scenes import SMALL_SCENE, without_sections

WEATHER = {
    "scan.speed": "8 arcmin/s",
    "scan.duration": "5 s",
    "scan.scans": 14,
    "scan.step": "2.5 arcmin",
    "scan.sample_rate": "16 Hz",
    "instrument.responsivity_scatter": 0.0,
    "atmosphere.b2": "[500, 1000, 2000] mK2 rad(-5/3)",
    "excess.b2": [300, 3000],
    "excess.variance": "[1, 30] mK2",
    "score.size": "30 arcmin",
    "score.ell_min": 3000,
    "score.ell_bin": 1000,
    "score.jackknives": 48,
    "score.noise_only_sets": [],
    "score.signal_sims.skies": 4,
    "score.signal_sims.observations": 200,
    "observations": 400,
}


def weather_scene(folder: Path, settings: dict | None = None, leave_out: tuple[str, ...] = ()) -> Scene:
    """The scene with some settings of its own, less some sections."""
    text = without_sections(SMALL_SCENE, "sky", *leave_out).replace("mask_separation_f_lambda = 1.3\n", "")
    path = folder / "weather.toml"
    path.write_text(text)
    ours = {key: value for key, value in WEATHER.items() if key.split(".")[0] not in leave_out}
    return load_scene(path, ours | (settings or {}))
