"""Trusted winds against the share of a second layer: winds of the same observations with each share."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mapmaker.wind import measure_wind, scan_velocities
from surveysim.atmosphere.weather import slant_b2
from surveysim.paper.explain.findings import Finding, bootstrapped, of_half, trusted
from surveysim.paper.explain.values import TRUSTED, Values
from surveysim.reduction.setup import prepare
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.runtime.engine import Engine, ordered_map
from surveysim.scene.scene import Scene
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_weather
from surveysim.timestreams.simulation import observation_path

LOOKS = {"better": "blue", "poorer": "vermilion"}
UNKNOWN = float("nan")


@dataclass(frozen=True)
class WindJob:
    """Job of a worker: simulated B2 and flag of the wind of an observation of a scene, given its number."""

    scene: Scene

    def __call__(self, observation: int) -> tuple[float, str]:
        """Simulate and measure an observation."""
        setup = prepare(self.scene)
        streams = draw_observation(setup, observation)
        _, pointing = observation_path(setup.observing, observation)
        wind = measure_wind(
            streams.data_mk,
            streams.scan_bounds,
            streams.focal_plane,
            sample_rate_hz=setup.observing.scans.sample_rate_hz,
            scan_velocity_rad_s=scan_velocities(streams),
        )
        truth = observation_weather(setup, observation)
        b2 = float(slant_b2(setup.air.water, [truth], [pointing.elevation_rad.mean()])[0])
        return b2, wind.flag or TRUSTED


def winds(scene: Scene, engine: Engine, progress: Callable[[], None] = lambda: None) -> Values:
    """Measure the winds of all observations of a scene; values (n_obs,) by name."""
    found = []
    for item in ordered_map(WindJob(scene), range(scene.observations), engine):
        found.append(item)
        progress()
    b2, flags = zip(*found, strict=True)
    return {"observation": np.arange(len(b2)), "drawn_b2": np.array(b2), "wind": np.array(flags)}


def trusted_rows(surveys: Mapping[tuple[float, float], Values]) -> list[dict[str, Any]]:
    """Fractions of trusted winds in both halves of B2 with their errors, for each angle [deg] and share."""
    rows = []
    for (turn, share), values in surveys.items():
        row = {"turn_deg": turn, "share": share}
        for half, name in enumerate(LOOKS):
            samples = bootstrapped(
                Finding(name, name, (UNKNOWN, UNKNOWN), UNKNOWN, partial(of_half, trusted, half)), values
            )
            row |= {name: float(samples[0]), f"{name}_error": float(samples[1:].std())}
        rows.append(row)
    return rows


def second_layer_figure(rows: list[dict[str, Any]], observations: int) -> PaperFigure:
    """Figure of the trusted winds against the share of a second layer, a panel for each angle."""
    panels = []
    for turn in dict.fromkeys(row["turn_deg"] for row in rows):
        of_turn = [row for row in rows if row["turn_deg"] == turn]
        series = tuple(_series(name, of_turn) for name in LOOKS)
        panels.append(
            Panel(f"winds {turn:g} deg apart", "Share of the second layer", "Trusted winds", series, y_range=(0, 1))
        )
    caption = (
        f"Fraction of {observations} simulated observations of Lynx whose wind is trusted, in the better and the poorer"
        " half of B2, against the share of B2 of a second layer. The paper's model fits about half of the data."
    )
    return PaperFigure(0, "Trusted winds with a second layer", caption, tuple(panels), 2)


def _series(name: str, rows: list[dict[str, Any]]) -> Series:
    share, value, error = (np.array([row[key] for row in rows]) for key in ("share", name, f"{name}_error"))
    return Series(f"{name} half of B2", "points", share, value, LOOKS[name], value - error, value + error)
