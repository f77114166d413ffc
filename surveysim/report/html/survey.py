"""The page of a run."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.report.html.captions import RUN
from surveysim.report.html.closure import closure_blocks
from surveysim.report.html.components import (
    UK2,
    Block,
    Grid,
    Listing,
    Page,
    Picture,
    Section,
    grid,
    picture,
)
from surveysim.report.html.discarded_scans import discarded_section, warned
from surveysim.report.html.provenance import provenance, sources, stage_times
from surveysim.report.html.run_time import time_blocks
from surveysim.report.html.scene import band_of, cleaning_words, what_was_simulated
from surveysim.report.html.scores import kind_sentence, score_blocks
from surveysim.results.metric_tables import label
from surveysim.results.sensitivity import sensitivity_tables
from surveysim.results.sky_tables import recovery_sentences, source_table
from surveysim.results.spectra import band_power_table, split_sentences, split_table
from surveysim.results.tables import over_reference
from surveysim.runtime.numbers import as_known, count, duration, percent, plural, quoted, short

Content = Mapping[str, Any]  # content of summary.json or scene.json
LOAD = (
    "From the sky to the detector: absorbed power, occupation number at the detector, and transmission to it. Shares of"
    " the squared NEP are of photon noise; detector noise is the rest.",
)
SENSITIVITY = (
    "NET and NEFD are above the atmosphere, for an integration of one second. Those of the array are of the mean of all"
    " detectors, with the correlation of their photon noise.",
)
BAND_POWERS = (
    "Cross-power of the parts, corrected for taper, beam, pixels, scans and cleaning. Errors come from random signs of"
    " the observations and Gaussian skies; the analytic error is that of Gaussian noise, even over the patch. The error"
    " of the transfer function is apart. Noise bias: the cross-power of the noise alone.",
)
NULLS = (
    "Input: band powers about the spectrum of the simulated sky. Null: power of half the difference of parts, about"
    " that of random signs. PTE: probability to exceed; below 0.001 a test fails.",
)
SKY = (
    "Fluxes in a compensated aperture: a disc less a ring of equal area around it. In: the sky through the beam. Out: "
    "its map without noise. Transfer: what scans and cleaning leave of such a source, from the simulated skies. In the "
    "map: the co-added map of the run, with its noise, that of sign-flipped co-adds anywhere on the map. All sources "
    "are in tables/sky_fluxes.ecsv.",
)
UNKNOWN = "Its error is unknown: there are too few observations to estimate it."


def run_page(directory: Path, summary: Content, scene: Content) -> Page:
    """Return the page of a run from its directory, summary.json and scene.json."""
    pictures = run_pictures(directory, summary, scene)
    timing = [item for item in pictures if item.anchor == "figure-run_time"]
    others = tuple(item for item in pictures if item not in timing)
    sections = [Section("scene", "What was simulated", what_was_simulated(scene, summary, summary["detectors"]))]
    if "sensitivity" in summary:
        sections.append(Section("sensitivity", "Load and sensitivity", sensitivity_blocks(summary["sensitivity"])))
    if summary["scores"]:
        sections.append(Section("scores", "Scores", tuple(score_blocks(summary, scene))))
    if "own_sky" in summary:
        sections.append(Section("sky", "Sky in and out", sky_blocks(summary["own_sky"])))
    if "split_spectra" in summary:
        sections.append(Section("spectra", "Band powers and null tests", spectra_blocks(summary["split_spectra"])))
    sections.append(discarded_section(summary, scene))
    title = "Error against run time" if summary["scores"] else "Run time"
    sections.append(Section("time", title, (*time_blocks(summary, scene), *timing)))
    if others:
        sections.append(Section("figures", "Figures", others, nested=True))
    if blocks := tuple(closure_blocks(summary)):
        sections.append(Section("closure", "Closure tests", blocks))
    sections += [
        Section("sources", "Where the values come from", sources(scene)),
        Section("provenance", "Provenance", (provenance(summary), stage_times(summary["run"]))),
    ]
    lead = (*_lead(summary, scene), *warned(summary))
    point = f": {summary['point']}" if "point" in summary else ""
    return Page("surveysim run", f"{summary['title']}{point}", lead, _key_figures(summary), tuple(sections))


def sensitivity_blocks(entries: Sequence[Content]) -> tuple[Grid, ...]:
    """Return the tables of load and sensitivity."""
    notes = (LOAD, (), SENSITIVITY)
    return tuple(grid(table, *note) for table, note in zip(sensitivity_tables(entries), notes, strict=True))


def spectra_blocks(entry: Content) -> tuple[Block, ...]:
    """Return the tables of band powers and null tests, and sentences on the parts."""
    tables = grid(band_power_table(entry), *BAND_POWERS), grid(split_table(entry), *NULLS)
    return (*tables, Listing(tuple(split_sentences(entry)), "Parts of the splits:"))


def sky_blocks(entry: Content) -> tuple[Block, ...]:
    """Return the sentences on the sky that comes back, and the table of its brightest sources."""
    lines = Listing(tuple(recovery_sentences(entry)), "Cross-spectrum of the scene's own sky, without noise:")
    return (lines, grid(source_table(entry), *SKY)) if "sources" in entry else (lines,)


def run_pictures(directory: Path, summary: Content, scene: Content) -> list[Picture]:
    """Return the figures of the run that exist, with their captions."""
    facts = {"cleaning": cleaning_words(scene["cleaning"]["algorithm"]), "sky": _sky_fact(scene)}
    found = []
    for name, caption in RUN.items():
        path = f"figures/{name}.png"
        if path in summary["files"] and (directory / path).is_file():
            lines = (caption.shows, caption.look_for.format(**facts).strip())
            found.append(picture(directory / path, caption.title, caption.alt, lines))
    return found


def _sky_fact(scene: Content) -> str:
    return "" if scene["sky"] else "The time-streams have no sky: the map is noise alone."


# ---------------------------------------------------------------- the result in a few lines


def _lead(summary: Content, scene: Content) -> Iterator[str]:
    camera = f"{plural(summary['detectors'], 'detector')} {band_of(scene['instrument'])}"
    stopped, made = summary["stopped"], summary["observations"]
    survey = plural(stopped["observations_of_survey"], "observation")
    if not summary["scores"]:
        why = summary.get("unscored") or "the scene has no section [score]"
        yield f"{plural(made, 'observation')} with {camera}, simulated, cleaned and mapped. There is no score: {why}."
        return
    row, best = summary["scores"][ACTUAL], summary["estimate"]
    sigma = f"σ(A) = {quoted(best['sigma_ukcmb2'], best['error_ukcmb2'])} {UK2}"
    text = f"{survey} with {camera}, cleaned by {cleaning_words(scene['cleaning']['algorithm'])}, measure the amplitude"
    text += f" of a flat CMB band power with an uncertainty of {sigma}."
    if "reference_ukcmb2" in row:
        ratio = quoted(*over_reference(row))
        source = scene["score"]["reference"]["source"]
        text += f" {source} has {short(row['reference_ukcmb2'])} {UK2}; this run has {ratio} times that."
    if "forecast_ukcmb2" in row:
        text += f" The forecast in closed form is {as_known(row['forecast_ukcmb2'], row['error_ukcmb2'])} {UK2}."
    yield text
    if made < stopped["observations_of_survey"]:
        yield f"{count(made)} of the survey's observations were simulated; all numbers are for the whole survey."
    plain = quoted(best["plain_sigma_ukcmb2"], best["plain_error_ukcmb2"])
    without = f" Plain, it is {plain} {UK2}." if best["kind"] == "controlled" else ""
    yield f"{kind_sentence(best)}{without}{' ' + UNKNOWN if best['error_ukcmb2'] is None else ''}"


def _key_figures(summary: Content) -> tuple[tuple[str, str], ...]:
    found = []
    if row := summary["scores"].get(ACTUAL):
        found.append((f"σ(A) [{UK2}]", quoted(row["sigma_ukcmb2"], row["error_ukcmb2"])))
        if "reference_ukcmb2" in row:
            ratio = quoted(*over_reference(row))
            found += [(f"published [{UK2}]", short(row["reference_ukcmb2"])), ("over published", ratio)]
    if "relative_error" in summary["stopped"]:
        error = summary["stopped"]["relative_error"]
        name = label(summary["stopped"]["metric"]).replace("sigma", "σ")
        found.append((f"error of {name}", "unknown" if error is None else percent(error)))
    found.append(("observations", count(summary["observations"])))
    return (*found, ("wall time of the run", duration(summary["run"]["wall_s"])))
