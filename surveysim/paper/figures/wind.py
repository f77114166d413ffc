"""Figures 3 and 4 of the paper: delays between detectors against pair angle, and measured winds."""

from collections.abc import Sequence
from dataclasses import replace
from math import degrees, radians

import numpy as np

from mapmaker.wind import WindFit
from surveysim.paper.measured_survey import MeasuredSurvey
from surveysim.paper.measurement import measure
from surveysim.paper.published import published
from surveysim.paper.statistics import described
from surveysim.reduction.setup import Setup
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.runtime.errors import InsufficientDataError
from surveysim.timestreams.atmosphere import add_layers
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_weather, observed_block
from surveysim.timestreams.response import block_response
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.simulation import observation_path

SECOND_LAYER_RAD = radians(120.0)  # direction of the second layer's wind from that of the first
BIN_ARCMIN_S = 5.0


def wind_examples_figure(survey: MeasuredSurvey) -> PaperFigure:
    """Figure 3: delays against pair angle, for an observation and for the same with a second layer.

    Raises
    ------
    InsufficientDataError
        Without a trusted wind in the first scene.
    """
    number = typical_observation(survey)
    setup, item = survey.setup, survey.measurements[number]
    double = two_layers(setup, item.observation)
    speed = degrees(item.truth.wind_speed_rad_s) * 60
    flagged = int((~survey.wind_good).sum())
    caption = (
        f"{described(survey)}. Slopes of the cross-PSDs' phase, averaged over pairs that are not neighbours and over"
        f" all scans of one observation, with errors from leaving out one scan at a time; the line is the sinusoid of"
        f" one frozen layer. Left: observation {item.observation} of {survey.scene_of[number]}, of median goodness"
        f" among those with a trusted wind in worse than median weather (B2 drawn {item.truth.b2:.0f} mK^2"
        f" rad^(-5/3), wind drawn {speed:.1f}, measured {_speed(item.wind)} arcmin/s). Right: the same observation"
        f" under a second layer of equal amplitude, whose wind of {speed:.1f} arcmin/s blows"
        f" {degrees(SECOND_LAYER_RAD):.0f} deg away from the first; measured {_speed(double)} arcmin/s,"
        f" {_verdict(double)}. In the survey, where every observation has one layer, {flagged} of"
        f" {len(survey.measurements)} winds are flagged; the paper finds features beyond the sinusoid in"
        f" roughly half of its data."
    )
    return PaperFigure(
        number=3,
        title="Delays between detectors against the angle of their pair",
        caption=caption,
        panels=(
            _slope_panel(f"one layer: {_verdict(item.wind)}", item.wind),
            _slope_panel(f"two layers: {_verdict(double)}", double),
        ),
        columns=2,
    )


def typical_observation(survey: MeasuredSurvey) -> int:
    """Index of a typical observation of the first scene with a trusted wind.

    It has the median goodness of fit among those with B2 above the median, or among all if there are none.

    Raises
    ------
    InsufficientDataError
        Without a trusted wind.
    """
    first = np.array(survey.scene_of) == survey.scene_of[0]
    trusted = first & survey.wind_good
    if not trusted.any():
        raise InsufficientDataError(
            f"found no wind to be trusted in scene {survey.scene_of[0]!r}; one or more is expected"
        )
    fair = trusted & (survey.b2_fitted > np.nanmedian(survey.b2_fitted))
    chosen = np.flatnonzero(fair if fair.any() else trusted)
    goodness = [survey.measurements[k].wind.goodness for k in chosen]
    return int(chosen[np.argsort(goodness, kind="stable")[(len(chosen) - 1) // 2]])


def two_layers(setup: Setup, observation: int) -> WindFit:
    """Measure the wind of an observation to which a second layer of equal amplitude and speed is added."""
    streams = draw_observation(setup, observation)
    _, pointing = observation_path(setup.observing, observation)
    weather = observation_weather(setup, observation)
    turned = replace(weather, wind_angle_rad=weather.wind_angle_rad + SECOND_LAYER_RAD)
    extra = np.zeros_like(streams.data_mk)
    add_layers(setup, observation, pointing, weather=turned, data=extra, realization=1)
    whole = Block(0, 0, setup.observing.scans.n_scans)
    block_response(observed_block(setup, observation, whole, pointing), extra).apply(extra)
    return measure(setup, replace(streams, data_mk=streams.data_mk + extra), observation).wind


def _slope_panel(title: str, wind: WindFit) -> Panel:
    per_arcmin = radians(1 / 60)
    angle = np.linspace(-np.pi, np.pi, 181)
    fit = wind.sinusoid @ np.stack([np.cos(angle), np.sin(angle)]) * per_arcmin
    slope, error = wind.slope * per_arcmin, wind.slope_error * per_arcmin
    return Panel(
        title=title,
        x_label=r"Angle of the pair $\phi_\mathrm{pair}$ [deg]",
        y_label=r"$2\pi\,\Delta t\,/\,\theta_\mathrm{pair}$ [s/arcmin]",
        series=(
            Series("measured", "points", np.degrees(wind.pair_angle_rad), slope, "black", slope - error, slope + error),
            Series("one frozen layer, fitted", "line", np.degrees(angle), fit, "vermilion"),
        ),
        x_range=(-180.0, 180.0),
    )


def _speed(wind: WindFit) -> str:
    return f"{degrees(wind.speed_rad_s) * 60:.1f} ± {degrees(wind.speed_error_rad_s) * 60:.1f}"


def _verdict(wind: WindFit) -> str:
    return f'flagged "{wind.flag}"' if wind.flag else "to be trusted"


def wind_histogram_figure(surveys: Sequence[MeasuredSurvey]) -> PaperFigure:
    """Figure 4: histograms of trusted measured wind speeds and of all drawn wind speeds, by band.

    Raises
    ------
    InsufficientDataError
        Without a trusted wind in a band.
    """
    for survey in surveys:
        if not survey.wind_good.any():
            raise InsufficientDataError(
                f"found no wind to be trusted at {survey.band_ghz} GHz; one or more is expected"
            )
    highest = max(max(_trusted(survey).max(), survey.wind_drawn_arcmin_s.max()) for survey in surveys)
    edges = np.arange(0.0, highest + BIN_ARCMIN_S, BIN_ARCMIN_S)
    panels = [_wind_panel(survey, edges) for survey in surveys]
    caption = " ".join(
        f"{described(survey)}: {int((~survey.wind_good).sum())} winds are not to be trusted and left out of the"
        f" measured ones; where trusted, the measured speed is {_spread(survey)} the drawn one's."
        for survey in surveys
    )
    caption += " The drawn speeds are those of all observations."
    return PaperFigure(4, "Angular wind speed of the turbulent layer", caption, tuple(panels), len(panels))


def _trusted(survey: MeasuredSurvey) -> np.ndarray:
    return survey.wind_arcmin_s[survey.wind_good]


def _spread(survey: MeasuredSurvey) -> str:
    ratio = _trusted(survey) / survey.wind_drawn_arcmin_s[survey.wind_good]
    low, middle, high = np.percentile(ratio, (15.865, 50.0, 84.135))
    return f"{middle:.2f} (68 % from {low:.2f} to {high:.2f}) times"


def _wind_panel(survey: MeasuredSurvey, edges: np.ndarray) -> Panel:
    paper = published()["wind_median_arcmin_s"].get(str(survey.band_ghz))
    published_median = "" if paper is None else f" (paper {paper:g})"
    measured, drawn = _trusted(survey), survey.wind_drawn_arcmin_s
    return Panel(
        title=f"{survey.band_ghz} GHz",
        x_label="Angular wind speed [arcmin/s]",
        y_label=f"Share of observations per {BIN_ARCMIN_S:g} arcmin/s",
        series=(
            _share_steps(
                f"measured and trusted ({len(measured)}): median {np.median(measured):.1f}{published_median}",
                measured,
                edges,
                "blue",
            ),
            _share_steps(f"drawn ({len(drawn)}): median {np.median(drawn):.1f}", drawn, edges, "grey --"),
        ),
        x_range=(0.0, float(edges[-1])),
    )


def _share_steps(label: str, values: np.ndarray, edges: np.ndarray, look: str) -> Series:
    share = np.histogram(values, edges)[0] / len(values)
    return Series(label, "steps", edges, np.append(share, 0.0), look)
