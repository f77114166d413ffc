"""Gains: ratios of the uncertainties of two data sets."""

from surveysim.reduction.data_set import DataSetKind, scaled_name
from surveysim.reduction.setup import Setup
from surveysim.survey.error_modes import Gain, gain
from surveysim.survey.scores import DataSetScore


def data_set_gains(setup: Setup, scores: dict[str, DataSetScore]) -> dict[str, Gain]:
    """Return ratios of sigma(A) between data sets, with the error of each pair."""
    masked = next((name for name, item in scores.items() if item.kind is DataSetKind.MASKED), None)
    found = {}
    if {"actual", "uncorrelated"} <= scores.keys():
        found["actual / uncorrelated"] = gain(scores["actual"], scores["uncorrelated"])
    if {"uncorrelated", "white"} <= scores.keys():
        found["uncorrelated / white"] = gain(scores["uncorrelated"], scores["white"])
    if masked and "uncorrelated" in scores:
        share = scores[masked].n_det / setup.camera.n_det
        found[f"{scaled_name(masked)} / uncorrelated"] = gain(scores[masked], scores["uncorrelated"], share)
    return found
