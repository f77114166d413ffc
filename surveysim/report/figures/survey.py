"""All figures of a run by name.

Each figure is one function from results to a `Figure`, drawn with Agg and without any global state.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.report.figures.layout import lay_out
from surveysim.report.figures.observations import timestream_psd, weather
from surveysim.report.figures.run_time import time_figure
from surveysim.report.figures.sky_map import coadded_map
from surveysim.report.figures.sky_recovery import sky_in_and_out
from surveysim.report.figures.spectra import bin_weights, cumulative_sensitivity, map_psds, transfer_functions
from surveysim.report.figures.split_spectra import split_spectra
from surveysim.report.figures.style import save
from surveysim.report.figures.track import track_and_hits
from surveysim.results.results import SurveyResult

TITLES = {
    "track": "scans and samples",
    "timestream_psd": "time-streams before and after cleaning",
    "map": "co-added map and its noise",
    "map_psd": "PSDs of the maps",
    "transfer_function": "transfer functions",
    "sky": "input sky, and its map after scans and cleaning",
    "cumulative_sensitivity": "cumulative sensitivity",
    "weights": "weights of multipoles in the score",
    "spectra": "band powers and null tests",
    "weather": "noise of each observation",
}
RUN_TIME = "run_time"
FULL_COLOUR = ("track", "map", "weather", "sky")  # those with a colour bar


def survey_figures(result: SurveyResult) -> dict[str, Callable[[], Figure]]:
    """Return a function for each figure that the run has results for, by name.

    Track, time-stream PSDs and map need a kept scan; spectra of the maps need scores; noise against weather needs an
    atmosphere; error against run time needs a known error.
    """
    setup, coadds, scores, expected = result.setup, result.coadds, result.scores, result.expected
    if not coadds.weight[0].any():
        return {}
    made = {
        "track": partial(track_and_hits, setup, coadds),
        "timestream_psd": partial(timestream_psd, setup, coadds),
        "map": partial(coadded_map, setup, coadds),
    }
    if scores:
        made["map_psd"] = partial(map_psds, setup, scores, expected)
        made["transfer_function"] = partial(transfer_functions, setup, scores, expected)
        made["cumulative_sensitivity"] = partial(cumulative_sensitivity, setup, scores)
        made["weights"] = partial(bin_weights, setup, scores)
    if ACTUAL in result.sky:
        made["sky"] = partial(sky_in_and_out, result.sky[ACTUAL], setup.scene.instrument.cmb_per_rj)
    if result.spectra:
        made["spectra"] = partial(split_spectra, result.spectra)
    if (coadds.column("b2_mk2") > 0).any():
        made["weather"] = partial(weather, setup, coadds)
    found: dict[str, Callable[[], Any]]
    found = {name: partial(_titled, result, name, draw) for name, draw in made.items()}
    if result.estimate is not None and np.isfinite(result.estimate.relative_error):
        found[RUN_TIME] = lambda: lay_out(time_figure(result))
    return found


def _titled(result: SurveyResult, name: str, draw: Callable[[], Figure]) -> Figure:
    figure = draw()
    title = f"{result.setup.scene.name}: {TITLES[name]} ({result.coadds.done} observations)"
    figure.suptitle(title, fontsize=11)
    return figure


def drawings(result: SurveyResult) -> dict[str, Callable[[Path], None]]:
    """Return a function for each of the `survey_figures` that writes it as a PNG atomically, by name."""
    return {name: partial(_write, name, draw) for name, draw in survey_figures(result).items()}


def _write(name: str, draw: Callable[[], Figure], path: Path) -> None:
    save(draw(), path, name in FULL_COLOUR)
