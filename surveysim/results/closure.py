"""Closure tests of a run: noise levels, transfer function and weather against their inputs."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from surveysim.atmosphere.water import pwv_quantile
from surveysim.atmosphere.weather import b2_quantile, season_quantiles
from surveysim.reduction.setup import Setup
from surveysim.scene.units import b2_unit
from surveysim.scene.weather_table import OF_B2
from surveysim.survey.coadds import CoAdds
from surveysim.survey.scores import DataSetScore
from surveysim.telescope.noise_levels import white_levels
from surveysim.timestreams.response import present_steps
from surveysim.timestreams.simulation import camera_white

if TYPE_CHECKING:
    from surveysim.forecasting.forecast import Forecast

QUARTILES = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class ClosureTest:
    """A quantity and its expected value.

    Parameters
    ----------
    kind : {"measured", "drawn"}
        "measured" in time-streams and maps, or weather "drawn" from its distribution.
    quantity, unit : str
        Name and unit.
    expected : float
        Value from the scene or in closed form.
    found, error : float
        Value found and its Monte Carlo error.
    """

    kind: Literal["measured", "drawn"]
    quantity: str
    unit: str
    expected: float
    found: float
    error: float


def closure_tests(
    setup: Setup, coadds: CoAdds, scores: dict[str, DataSetScore], expected: "Forecast | None"
) -> tuple[ClosureTest, ...]:
    """Return the closure tests of the stages that a run has.

    Parameters
    ----------
    setup : Setup
        Setup of the run.
    coadds : CoAdds
        Sums over its observations.
    scores : dict of DataSetScore
        Scores by data set; empty without a score.
    expected : Forecast, optional
        Forecast of the run's own observations.
    """
    return (*_white(setup, coadds), *_signal(scores, expected), *_weather(setup, coadds))


def _white(setup: Setup, coadds: CoAdds) -> list[ClosureTest]:
    """Compare photon and detector noise of the scene with the level of the cleaned time-streams, as means."""
    measured = coadds.column("white_mk2_hz")
    known = np.isfinite(measured)
    if known.sum() < 2 or setup.scene.score is None or any(step.acts_on != "signals" for step in present_steps(setup)):
        return []  # time constants and crosstalk change the noise
    opacity = setup.air.water.opacity if setup.air.water else None
    conditions = zip(coadds.column("pwv_mm")[known], coadds.column("elevation_rad")[known], strict=True)
    levels = [white_levels(setup.scene, opacity, *item) for item in conditions]
    set_to = float(np.mean([camera_white(setup.camera, item).mean for item in levels]))
    name = f"white noise of the streams, above {setup.scene.score.white_noise_above_hz:g} Hz"
    return [ClosureTest("measured", name, "mK2 / Hz", set_to, *_mean(measured[known]))]


def _signal(scores: dict[str, DataSetScore], expected: "Forecast | None") -> list[ClosureTest]:
    """Compare the transfer function of the scored bins by forecast and by simulated skies, once for each."""
    rows, seen = [], set()
    for name, item in scores.items():
        if expected is None or name not in expected.scores or id(item.transfer_function) in seen:
            continue
        seen.add(id(item.transfer_function))
        share = item.band.weight / item.band.weight.sum()
        closed = float(share @ expected.scores[name].transmission)
        # The skies are common to all bins, so their errors are taken as common too.
        found, error = float(share @ item.transfer_function.transmission), float(share @ item.transfer_function.error)
        rows.append(ClosureTest("measured", f"signal power left by cleaning, {name}", "", closed, found, error))
    return rows


def _weather(setup: Setup, coadds: CoAdds) -> list[ClosureTest]:
    """Compare quartiles of the weather's distributions with quartiles of the draws."""
    from scipy.special import ndtri

    air = setup.scene.atmosphere
    if air is None:
        return []
    if setup.air.dated and setup.air.dated.seasons:
        b2, pwv = season_quantiles(air, setup.air.water, setup.air.dated.seasons, QUARTILES)
    else:
        b2 = b2_quantile(air, setup.air.water, ndtri(np.array(QUARTILES)))
        pwv = pwv_quantile(air, np.array(QUARTILES)) if setup.air.water is not None else np.empty(0)
    unit = b2_unit(air.spectral_index)
    known = set(setup.air.dated.known) if setup.air.dated else set()  # of a table, not drawn
    b2, pwv = b2[: 0 if known & set(OF_B2) else None], pwv[: 0 if "pwv" in known else None]
    n_draw = coadds.done / (setup.air.dated.variance_factor if setup.air.dated else 1.0)
    rows = [_quartile("B2", unit, k, value, coadds.column("b2_mk2"), n_draw) for k, value in enumerate(b2)]
    wind = np.degrees(coadds.column("wind_speed_rad_s")) * 60
    if air.wind_b2_exponent == 0 and "wind_speed" not in known:  # else its median depends on B2
        rows.append(_quartile("wind", "arcmin / s", 1, float(np.degrees(air.wind_median_rad_s)) * 60, wind, n_draw))
    rows += [_quartile("water", "mm", k, value, coadds.column("pwv_mm"), n_draw) for k, value in enumerate(pwv)]
    return rows


def _quartile(name: str, unit: str, place: int, expected: float, drawn: np.ndarray, n_draw: float) -> ClosureTest:
    """Compare one quartile of draws (n,), which are worth `n_draw` independent ones.

    Its error is half the distance of draws one standard error of rank away.
    """
    level, label = QUARTILES[place], ("first quartile", "median", "third quartile")[place]
    reach = np.sqrt(level * (1 - level) / n_draw)
    low, found, high = np.quantile(drawn, np.clip([level - reach, level, level + reach], 0, 1))
    return ClosureTest("drawn", f"{name}, {label}", unit, float(expected), float(found), float(high - low) / 2)


def _mean(values: np.ndarray) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))
