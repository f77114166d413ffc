"""Closure tests on the page of a run: inputs and measured values, forecast and simulation."""

from collections.abc import Iterator, Mapping
from typing import Any

from surveysim.report.html.components import Block, grid
from surveysim.results.results import GOOD_PSD, KNOWN
from surveysim.results.tables import agreement_table, closure_table, effect_table
from surveysim.runtime.numbers import count, percent

Content = Mapping[str, Any]  # content of summary.json
MEASURED = (
    "Expected: noise as the scene sets it; found: in the cleaned time-streams, where the tail of the excess noise adds"
    " to it and templates remove a part of the common noise. Signal power after cleaning is expected in closed form and"
    " found from simulated skies, whose errors are taken as common to all bins."
)
DRAWN = "Expected: the scene's distribution; found: the draws of this run, with the error of so many draws."
EFFECTS = "Sizes are relative to the noise PSD of the scored multipoles. Flagged effects may put the forecast off."


def closure_blocks(summary: Content) -> Iterator[Block]:
    """Return tables of all comparisons that the run allows."""
    kinds = {item["kind"] for item in summary.get("closure", [])}
    if "measured" in kinds:
        yield grid(closure_table(summary["closure"], "measured"), MEASURED)
    if agreements := summary.get("forecast_over_simulated"):
        yield grid(agreement_table(agreements), _agreement_note(agreements))
        yield grid(effect_table(summary["forecast"]), EFFECTS)
    if "drawn" in kinds:
        yield grid(closure_table(summary["closure"], "drawn"), DRAWN)


def _agreement_note(agreements: Content) -> str:
    some = next(iter(agreements.values()))
    note = (
        "Forecast over simulated, less 1, with the errors of these ratios. Both are of the same observations and of the"
        " scans that were kept."
    )
    if some["bins"]:
        low, high = (count(some[key]) for key in ("low_ell", "high_ell"))
        note += (
            f" The noise PSD is that of the bin, from ℓ = {low} to {high}, where it is furthest beyond two standard"
            f" errors, as one bin in twenty is by chance; good bins are within {percent(GOOD_PSD)} and known to"
            f" {percent(KNOWN)} or better."
        )
    return note
