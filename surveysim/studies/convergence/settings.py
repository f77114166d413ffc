"""Ladders of settings, one for each parameter."""

from collections.abc import Mapping
from typing import Any

from surveysim.reduction.signal_sims import carriers
from surveysim.scene.scene import Scene
from surveysim.studies.convergence.records import (
    FINEST,
    FLIPS,
    PARTS,
    RATES,
    SIGNAL_SIM_PARTS,
    SKIES,
    STEPS,
    SUB_SURVEY,
    Setting,
)


def ladders(scene: Scene, most: int = SUB_SURVEY) -> tuple[Setting, ...]:
    """List all settings, from coarse to fine for each parameter, including the scene's own."""
    n_obs = scene.observations
    counts = [Setting("observations", str(n_obs // part), {}, "survey", part == 1) for part in PARTS]
    forecast = Setting("forecast", "closed form", {}, "forecast", False)
    return (*counts, *_sampling(scene, sub_survey(scene, most)), *_numerical(scene), forecast)


def sub_survey(scene: Scene, most: int) -> dict[str, Any]:
    """Keys of a survey of at most `most` observations, with signal simulations in the same fraction of them."""
    wanted = min(scene.observations, most)
    with_sims = round(scene.score.signal_sims.observations * wanted / scene.observations)
    return {"observations": wanted, "score.signal_sims.observations": max(2, with_sims)}


def _sampling(scene: Scene, base: Mapping[str, Any]) -> list[Setting]:
    score, key = scene.score, "score.signal_sims.observations"
    flips, skies = sorted({*FLIPS, score.jackknives}), sorted({*SKIES, score.signal_sims.skies})
    # As many as carry them: a short survey has fewer than it asks for.
    n_obs, asked = base["observations"], {max(2, base["observations"] // part) for part in SIGNAL_SIM_PARTS}
    own = int(carriers(base[key], n_obs).sum())
    counts = {int(carriers(count, n_obs).sum()) for count in asked} | {own}
    ladder = [("noise realizations", "score.jackknives", count, score.jackknives) for count in flips]
    ladder += [("signal simulations", "score.signal_sims.skies", count, score.signal_sims.skies) for count in skies]
    ladder += [("observations with simulations", key, count, own) for count in sorted(counts)]
    return [
        Setting(parameter, str(value), {key: value}, "sampling", value == own) for parameter, key, value, own in ladder
    ]


def _numerical(scene: Scene) -> list[Setting]:
    own, rate_hz = scene.numerics, scene.scan.sample_rate_hz
    steps = sorted({*STEPS, own.screen_step}, reverse=True)
    ladder: list[tuple[str, str, float | str, float | str]]
    ladder = [("screen step", "numerics.screen_step", step, own.screen_step) for step in steps]
    for parameter, kinds in (("interpolation", ("nearest", "linear", "cubic")), ("precision", ("float32", "float64"))):
        ladder += [(parameter, f"numerics.{parameter}", kind, getattr(own, parameter)) for kind in kinds]
    found = [
        Setting(parameter, value if isinstance(value, str) else f"{value:g}", {key: value}, "numerical", value == mine)
        for parameter, key, value, mine in ladder
    ]
    for factor in RATES:
        text = f"{factor * rate_hz:.10g} Hz"
        found.append(Setting("sample rate", text, {"scan.sample_rate": text}, "numerical", factor == 1))
    together = [("scene's own", {}, True), ("finest", dict(FINEST), False)]
    return found + [Setting("numerics together", label, keys, "numerical", mine) for label, keys, mine in together]
