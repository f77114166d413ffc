"""The page of a run: its result, what was simulated, scores, error against run time, figures, truth, provenance."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surveysim.reduction.cleaning_pipelines import ACTUAL, OPTIMAL
from surveysim.reduction.data_set import DataSetKind
from surveysim.report.html.captions import RUN
from surveysim.report.html.components import (
    UK2,
    Block,
    Cell,
    Grid,
    Listing,
    Page,
    Picture,
    Section,
    Terms,
    Text,
    as_known,
    cell,
    count,
    duration,
    measured,
    number,
    percent,
    picture,
    plural,
    quoted,
    short,
    times,
)
from surveysim.report.html.discarded_scans import discarded_section, warned
from surveysim.report.html.provenance import provenance, sources, stage_times
from surveysim.report.html.scene import cleaning_words, scene_terms
from surveysim.results.agreement import GOOD_PSD, KNOWN
from surveysim.results.results import CONTROLLED, PLAIN, method

Content = Mapping[str, Any]  # of summary.json and scene.json
UNKNOWN = "Its error is unknown: so few observations do not tell how far theirs is typical."
DATA_SETS = {
    "actual": "the survey itself",
    "uncorrelated": "streams with each detector's measured spectrum in each observation, without correlations",
    "white": "white streams at the measured level",
    OPTIMAL: "the best cleaning of each observation",
}


def run_page(directory: Path, summary: Content, scene: Content) -> Page:
    """The page of what a run left in a directory."""
    pictures = run_pictures(directory, summary, scene)
    timing = [item for item in pictures if item.anchor == "figure-run_time"]
    others = tuple(item for item in pictures if item not in timing)
    sections = [Section("scene", "What was simulated", what_was_simulated(scene, summary, summary["detectors"]))]
    if summary["scores"]:
        sections.append(Section("scores", "Scores", tuple(_scores(summary, scene))))
    sections.append(discarded_section(summary))
    title = "Error against run time" if summary["scores"] else "Run time"
    sections.append(Section("time", title, (*_time(summary, scene), *timing)))
    if others:
        sections.append(Section("figures", "Figures", others, nested=True))
    if blocks := tuple(_truth(summary)):
        sections.append(Section("truth", "Truth against measured", blocks))
    sections += [
        Section("sources", "Where the values come from", sources(scene)),
        Section("provenance", "Provenance", (provenance(summary), stage_times(summary["run"]))),
    ]
    lead = (*_lead(summary, scene), *warned(summary))
    return Page("surveysim run", summary["title"], lead, _key_figures(summary), tuple(sections))


def run_pictures(directory: Path, summary: Content, scene: Content) -> list[Picture]:
    """Figures that the run wrote and that are still there, with their captions."""
    facts = {"cleaning": cleaning_words(scene["cleaning"]["algorithm"]), "sky": _sky_fact(scene)}
    found = []
    for name, caption in RUN.items():
        path = f"figures/{name}.png"
        if path in summary["files"] and (directory / path).is_file():
            lines = (caption.shows, caption.look_for.format(**facts).strip())
            found.append(picture(directory / path, caption.title, caption.alt, lines))
    return found


def _sky_fact(scene: Content) -> str:
    return "" if scene["sky"] else "The streams hold no sky: all that is seen is noise."


def what_was_simulated(scene: Content, summary: Content, n_det: int) -> tuple[Block, ...]:
    """The scene in words, and every stage that is left out with its reason."""
    left_out = summary.get("left_out") or dict.fromkeys(summary.get("stages_left_out", ()), "no such section")
    terms = Terms(scene_terms(dict(scene), n_det))
    return (terms, Terms(tuple(left_out.items()), "Left out, and why")) if left_out else (terms,)


# ---------------------------------------------------------------- the result in a few lines


def _lead(summary: Content, scene: Content):
    camera = f"{plural(summary['detectors'], 'detector')} at {short(scene['instrument']['frequency_hz'] / 1e9)} GHz"
    stopped, made = summary["stopped"], summary["observations"]
    survey = plural(stopped["observations_of_survey"], "observation")
    if not summary["scores"]:
        why = summary.get("unscored") or "the scene has no section [score]"
        yield f"{plural(made, 'observation')} with {camera}, simulated, cleaned and mapped. There is no score: {why}."
        return
    row, best = summary["scores"][ACTUAL], summary["best"]
    sigma = f"σ(A) = {quoted(best['sigma_ukcmb2'], best['error_ukcmb2'])} {UK2}"
    text = f"{survey} with {camera}, cleaned by {cleaning_words(scene['cleaning']['algorithm'])}, measure the amplitude"
    text += f" of a flat CMB band power with an uncertainty of {sigma}."
    if "reference_ukcmb2" in row:
        ratio = _over_reference(row)
        source = scene["score"]["reference"]["source"]
        text += f" {source} has {short(row['reference_ukcmb2'])} {UK2}; this run has {ratio} times that."
    if "forecast_ukcmb2" in row:
        text += f" The forecast in closed form is {as_known(row['forecast_ukcmb2'], row['error_ukcmb2'])} {UK2}."
    yield text
    if made < stopped["observations_of_survey"]:
        yield f"Of the survey's observations {count(made)} were simulated; all numbers are for the whole survey."
    plain = quoted(best["plain_sigma_ukcmb2"], best["plain_error_ukcmb2"])
    beside = f" Plain, it is {plain} {UK2}." if best["kind"] == "controlled" else ""
    yield f"{_kind_sentence(best)}{beside}{' ' + UNKNOWN if best['error_ukcmb2'] is None else ''}"


def _kind_sentence(best: Content) -> str:
    text = CONTROLLED if best["kind"] == "controlled" else PLAIN
    return f"{text.replace('sigma', 'σ')}."


def _over_reference(row: Content) -> str:
    error = row["error_ukcmb2"]
    return quoted(row["ratio_to_reference"], None if error is None else error / row["reference_ukcmb2"])


def _key_figures(summary: Content) -> tuple[tuple[str, str], ...]:
    found = []
    if row := summary["scores"].get(ACTUAL):
        found.append((f"σ(A) [{UK2}]", quoted(row["sigma_ukcmb2"], row["error_ukcmb2"])))
        if "reference_ukcmb2" in row:
            ratio = _over_reference(row)
            found += [(f"published [{UK2}]", short(row["reference_ukcmb2"])), ("over published", ratio)]
    if "relative_error" in summary["stopped"]:
        error = summary["stopped"]["relative_error"]
        found.append(("error of σ(A)", "unknown" if error is None else percent(error)))
    found.append(("observations", count(summary["observations"])))
    return (*found, ("run time", duration(summary["run"]["wall_s"])))


# ---------------------------------------------------------------- scores


def _scores(summary: Content, scene: Content):
    yield _score_grid(summary, scene)
    if summary.get("gains"):
        yield _gain_grid(summary, scene)
    if len([name for name, entry in summary["cleaning"].items() if "psd_over_white" in entry]) > 1:
        yield _cleaning_grid(summary)
    if summary.get("alternatives"):
        yield _alternative_grid(summary["alternatives"])
    compared = bool(scene["cleaning"]["compare"])
    yield Listing(
        method(compared, scene["instrument"]["bandwidth"], summary.get("bin_correlation", math.nan)),
        "How it is scored, where the reference leaves it open:",
    )


def _score_grid(summary: Content, scene: Content) -> Grid:
    reference = scene["score"]["reference"]
    columns = ["data set", f"σ(A) [{UK2}]", "forecast"]
    columns += [reference["source"], "ratio"] if reference else []
    rows = []
    for name, row in summary["scores"].items():
        cells = [cell(name), Cell(quoted(row["sigma_ukcmb2"], row["error_ukcmb2"]), row["sigma_ukcmb2"])]
        forecast = row.get("forecast_ukcmb2")
        cells.append(Cell("") if forecast is None else Cell(as_known(forecast, row["error_ukcmb2"]), forecast))
        if reference and "reference_ukcmb2" in row:
            published = row["reference_ukcmb2"]
            ratio = Cell(_over_reference(row), row["ratio_to_reference"])
            cells += [Cell(short(published), published), ratio]
        elif reference:
            cells += [Cell(""), Cell("")]
        numbers = [Cell(count(row["n_det"]), row["n_det"])]
        numbers += [Cell(count(row[key]), row[key]) for key in ("ell_eff", "fwhm_ell")]
        rows.append((*cells, *numbers))
    columns += ["detectors", "ell_eff", "FWHM in ℓ"]
    title = "Uncertainty of a flat CMB band power"
    return Grid("score-table", title, tuple(columns), tuple(rows), _score_notes(summary))


def _score_notes(summary: Content) -> tuple[str, ...]:
    """What the data sets are, and what errors are."""
    known = [f"{name}: {DATA_SETS[name]}" for name in summary["scores"] if name in DATA_SETS]
    masked = [name for name, row in summary["scores"].items() if row["kind"] == DataSetKind.MASKED]
    if masked:
        known.append(f"{masked[0]}: the actual streams of an array masked by separation (scaled: times its share)")
    cleanings = [name for name in summary["scores"] if name not in DATA_SETS and name not in masked]
    known += [f"{name}: {cleaning_words(name.split('+'))} in place of the scene's own" for name in cleanings]
    errors = "Errors are Monte Carlo errors: noise, the sample of observations, and the signal window."
    return (f"{_kind_sentence(summary['best'])} {errors} {'; '.join(known)}.",)


def _gain_grid(summary: Content, scene: Content) -> Grid:
    reference = scene["score"]["reference"]
    published = dict(reference["gains"]) if reference else {}
    rows = []
    for name, item in summary["gains"].items():
        row = [cell(name), Cell(quoted(item["ratio"], item["error"]), item["ratio"])]
        if published:
            row.append(Cell(short(published[name]), published[name]) if name in published else Cell(""))
        rows.append(tuple(row))
    columns = ("gain", "here", *(("published",) if published else ()))
    note = "Ratios of σ(A). Both data sets see the same weather and skies, so a ratio is known better than its parts."
    return Grid("gain-table", "Gains", columns, tuple(rows), (note,))


def _cleaning_grid(summary: Content) -> Grid:
    entries = {name: entry for name, entry in summary["cleaning"].items() if "psd_over_white" in entry}
    shares = {
        "point_source_flux_removed": "flux removed [%]",
        "best_for_cmb": "best for CMB [%]",
        "best_for_point_source": "best for source [%]",
    }
    first = next(iter(entries.values()))
    there = [name for name in shares if name in first]
    rows = []
    for entry in entries.values():
        cells = [cell("+".join(entry["steps"])), cell(entry["scans_discarded"])]
        cells += [Cell(number(entry[key]), entry[key]) for key in ("mean_iterations", "mean_removed")]
        cells += [Cell("" if ratio is None else number(ratio), ratio) for ratio in entry["psd_over_white"].values()]
        rows.append((*cells, *(Cell(number(100 * entry[name]), 100 * entry[name]) for name in there)))
    columns = ["cleaning", "scans discarded", "iterations", "templates"]
    columns += [f"PSD at {hz} over white" for hz in first["psd_over_white"]] + [shares[name] for name in there]
    return Grid("cleaning-table", "Cleaning: what it costs, and what it leaves", tuple(columns), tuple(rows))


def _alternative_grid(rows: list[Content]) -> Grid:
    texts = {"weights": "weights of bins", "ell_min": "from ℓ", "ell_eff": "ell_eff", "fwhm_ell": "FWHM in ℓ"}
    columns = tuple(texts.get(name, name.replace("_", " ")) for name in rows[0])
    body = tuple(
        tuple(Cell(value) if isinstance(value, str) else Cell(count(value), value) for value in row.values())
        for row in rows
    )
    note = (
        f"σ(A) in {UK2}. own: every data set weights its bins by its own noise; actual: all by the actual data's; 2-D:"
        " modes also by their direction. A masked array's is scaled."
    )
    return Grid("alternative-table", "The same data scored otherwise", columns, body, (note,))


# ---------------------------------------------------------------- error against run time


def _time(summary: Content, scene: Content):
    run, stopped = summary["run"], summary["stopped"]
    each_s = sum(run["stage_s"].values()) / summary["observations"]
    ns = sum(run["stage_ns_per_detector_sample"].values())
    reasons = {
        "all": "all observations of the survey were simulated",
        "target": f"the target error of {percent(stopped.get('target_error') or 0)} was reached",
        "budget": f"the time budget of {duration(stopped.get('time_budget_s') or 0)} was spent",
    }
    text = (
        f"{plural(summary['observations'], 'observation')} took {duration(run['wall_s'])} with"
        f" {plural(run['workers'], 'worker')}: {duration(each_s)} of one worker for each, or {number(ns, 2)} ns for"
        f" each of {number(summary['detector_samples'] / 1e6)} million detector-samples."
        f" The run ended when {reasons[stopped['reason']]}."
    )
    if stopped.get("relative_error") is not None:
        text += f" σ(A) is known to {percent(stopped['relative_error'])}."
    yield Text((text,))
    if summary.get("error_budget"):
        yield _budget_grid(summary)
    if summary.get("answers") or summary.get("fine_answer"):
        yield _answer_grid(summary, scene)


def _budget_grid(summary: Content) -> Grid:
    """Relative errors of sigma(A) as quoted, by what they come from."""
    kinds = ("noise", "weather", "window", "population")
    rows = []
    for name, entry in summary["error_budget"].items():
        parts = [_share(entry[kind]) for kind in kinds]
        total = None if None in entry.values() else sum(value**2 for value in entry.values()) ** 0.5
        rows.append((cell(name), *parts, _share(total)))
    columns = ("estimate", *(f"{kind} [%]" for kind in kinds), "in all [%]")
    left = " that the forecast does not explain" if summary["best"]["kind"] == "controlled" else ""
    note = (
        f"Noise: its realizations; weather: the sample of observations, their weather and discarded scans{left};"
        " window: skies that measure the signal; population: the sample of all weather that the forecast takes. Parts"
        " add up in quadrature."
    )
    return Grid("budget-table", "Relative error of σ(A), by what it comes from", columns, tuple(rows), (note,))


def _share(value: float | None) -> Cell:
    return Cell("unknown") if value is None else Cell(number(100 * value, 2), 100 * value)


def _answer_grid(summary: Content, scene: Content) -> Grid:
    score, run = scene["score"], summary["run"]
    answers = summary.get("answers") or [summary["fine_answer"]]
    here = {
        "relative_error": summary["stopped"]["relative_error"],
        "seconds": sum(run["stage_s"].values()) / run["workers"],
        "observations": summary["observations"],
        "jackknives": score["jackknives"],
        "skies": score["signal_sims"]["skies"],
    }
    rows, mark = [], 0
    known = [answer for answer in (here, *answers) if answer["relative_error"] is not None]
    for answer in sorted(known, key=lambda answer: -answer["relative_error"]):
        if answer is here:
            mark = len(rows)
        name = f"{percent(answer['relative_error'])}{', this run' if answer is here else ''}"
        numbers = [cell(answer[key]) for key in ("observations", "jackknives", "skies")]
        rows.append((cell(name), Cell(duration(answer["seconds"]), answer["seconds"]), *numbers))
    note = (
        f"Times are those of simulating with {plural(run['workers'], 'worker')}, without starting and writing, "
        "extrapolated from this run's own errors and times."
    )
    columns = ("error of σ(A)", "time", "observations", "sign flips", "window skies")
    return Grid("answer-table", "What an answer costs", columns, tuple(rows), (note,), (mark,))


# ---------------------------------------------------------------- truth


def _truth(summary: Content):
    truth = summary.get("truth", [])
    columns = ("quantity", "unit", "put in", "came out", "ratio")
    if found := [item for item in truth if item["kind"] == "measured"]:
        note = (
            "Noise is set in the scene and measured in the cleaned streams, where the tail of the excess noise adds to"
            " it and templates take a part of what detectors share. What cleaning leaves of the signal is known in"
            " closed form and measured with simulated skies, whose errors are taken as common to all bins."
        )
        yield Grid("truth-table", "Measured from streams and maps", columns, _truth_rows(found), (note,))
    if summary.get("forecast_over_simulated"):
        yield _forecast_grid(summary)
        yield _effect_grid(summary)
    if found := [item for item in truth if item["kind"] == "drawn"]:
        note = "Put in: the scene's distribution. Came out: the draws of this run, with the error of so many draws."
        yield Grid("weather-table", "Weather drawn", columns, _truth_rows(found), (note,))


def _truth_rows(items: list[Content]) -> tuple[tuple[Cell, ...], ...]:
    rows = []
    for item in items:
        expected, ratio = item["expected"], Cell("")
        if expected is not None and expected > 0:
            ratio = measured(times(item["found"], 1 / expected), times(item["error"], 1 / expected))
        beside = (measured(expected), measured(item["found"], item["error"]), ratio)
        rows.append((cell(item["quantity"]), cell(item["unit"]), *beside))
    return tuple(rows)


def _forecast_grid(summary: Content) -> Grid:
    rows = []
    for name, item in summary["forecast_over_simulated"].items():
        off = quoted(times(item["sigma"], 100), times(item["sigma_error"], 100))
        cells = [cell(name), Cell(off, times(item["sigma"], 100))]
        if item["bins"]:
            worst = quoted(times(item["psd"], 100), times(item["psd_error"], 100))
            cells.append(Cell(worst, times(item["psd"], 100)))
            cells.append(Cell(count(item["worst_ell"]), item["worst_ell"]))
        else:
            cells += [Cell("")] * 2
        rows.append((*cells, cell(item["within"]), cell(item["bins"])))
    some = next(iter(summary["forecast_over_simulated"].values()))
    columns = ("data set", "σ(A) [%]", "noise PSD [%]", "at ℓ", "good bins", "bins")
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
    return Grid("forecast-table", "Forecast against simulation", columns, tuple(rows), (note,))


def _effect_grid(summary: Content) -> Grid:
    """Effects on the forecasts: of simulated data sets, only those that are not the actual data's too."""
    rows, seen = [], set()
    for name, item in summary["forecast"].items():
        for effect in item["effects"]:
            if effect["sentence"] not in seen:
                seen.add(effect["sentence"])
                size = Cell("not known") if effect["size"] is None else measured(100 * effect["size"])
                told = cell(effect["sentence"]), cell("yes" if effect["flagged"] else "")
                rows.append((cell(name), cell(effect["name"]), size, *told))
    note = "Sizes are relative to the noise PSD of the scored multipoles. Where one is flagged the forecast may be off."
    columns = ("data set", "effect", "size [%]", "in this scene", "flagged")
    return Grid("effect-table", "Effects on the forecast", columns, tuple(rows), (note,))
