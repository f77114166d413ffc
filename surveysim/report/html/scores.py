"""Scores on the page of a run: score table, gains, cleaning pipelines, alternatives, method."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from surveysim.reduction.cleaning_pipelines import OPTIMAL
from surveysim.reduction.data_set import DataSetKind
from surveysim.report.html.components import UK2, Block, Listing, grid
from surveysim.report.html.scene import cleaning_words
from surveysim.results.method import CONTROLLED, PLAIN, method
from surveysim.results.metric_tables import metric_notes, metric_table
from surveysim.results.tables import alternative_table, cleaning_table, gain_table, score_table

Content = Mapping[str, Any]  # content of summary.json or scene.json
DATA_SETS = {
    "actual": "the survey itself",
    "uncorrelated": "noise with each detector's measured PSD in each observation, without correlations",
    "white": "white noise at the measured level",
    OPTIMAL: "the best cleaning of each observation",
}

METRICS = (
    "Metrics of the scene, with Monte Carlo errors, as for σ(A). A forecast is for the weather of the quoted value."
)
ALTERNATIVES = (
    f"σ(A) in {UK2}. own: every data set weights its bins by its own noise; actual: all by the actual data's; 2-D:"
    " modes also by their direction. A masked array's is scaled."
)


def score_blocks(summary: Content, scene: Content) -> Iterator[Block]:
    """Return the tables of the scores of a run, and the method of scoring."""
    reference = scene["score"]["reference"]
    yield grid(score_table(summary["scores"], reference["source"] if reference else ""), _score_note(summary))
    if summary.get("gains"):
        note = "Ratios of σ(A). Both data sets share weather and skies, so a ratio has a smaller error than its parts."
        yield grid(gain_table(summary["gains"], dict(reference["gains"]) if reference else {}), note)
    if metrics := metric_table(summary["metrics"]):
        yield grid(metrics, METRICS, *metric_notes(summary["metrics"]))
    if len([name for name, entry in summary["cleaning"].items() if "psd_over_white" in entry]) > 1:
        yield grid(cleaning_table(summary["cleaning"]))
    if summary.get("alternatives"):
        yield grid(alternative_table(summary["alternatives"]), ALTERNATIVES)
    compared = bool(scene["cleaning"]["compare"])
    yield Listing(
        method(compared, scene["instrument"]["bandwidth"], summary.get("bin_correlation", math.nan)),
        "Choices of the scoring that the reference leaves open:",
    )


def kind_sentence(best: Content) -> str:
    """Return the sentence on the kind of the quoted estimate."""
    text = CONTROLLED if best["kind"] == "controlled" else PLAIN
    return f"{text.replace('sigma', 'σ')}."


def _score_note(summary: Content) -> str:
    """Definitions of the data sets and of the errors."""
    known = [f"{name}: {DATA_SETS[name]}" for name in summary["scores"] if name in DATA_SETS]
    masked = [name for name, row in summary["scores"].items() if row["kind"] == DataSetKind.MASKED]
    if masked:
        part, whole = summary["scores"][masked[0]]["n_det"], summary["detectors"]
        known.append(f"{masked[0]}: the actual streams of {part} detectors, masked by separation")
        known += [f"{name}: its σ(A) times {part}/{whole}, its share of the detectors" for name in masked[1:]]
    cleanings = [name for name in summary["scores"] if name not in DATA_SETS and name not in masked]
    known += [f"{name}: {cleaning_words(name.split('+'))} in place of the scene's own" for name in cleanings]
    errors = "Errors are Monte Carlo errors: noise, the sample of observations, and the transfer function."
    return f"{kind_sentence(summary['estimate'])} {errors} {'; '.join(known)}."
