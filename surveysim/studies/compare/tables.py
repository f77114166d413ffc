"""Tables of a comparison, from the content of its summary.json."""

from collections.abc import Mapping
from typing import Any

from surveysim.runtime.numbers import count, number, quoted
from surveysim.runtime.table import Column, Table, column, file_column, share_text
from surveysim.studies.sweep.tables import chance_text

Content = Mapping[str, Any]  # the part "compared" of summary.json


def score_rows(compared: Content) -> Table:
    """Return a row for each quantity and run: its value, its ratio to the first run, and how that is known."""
    labels, kinds = ([run[key] for run in compared["runs"]] for key in ("label", "errors"))
    entries, n_run = compared["quantities"], len(labels)

    def values(key: str) -> list[Any]:
        return [value for entry in entries for value in entry[key]]

    def names(key: str) -> list[Any]:
        return [entry[key] for entry in entries for _ in labels]

    headings = tuple(_heading(entry) if place == 0 else "" for entry in entries for place in range(n_run))
    first = [place == 0 for _ in entries for place in range(n_run)]
    of_pairs = zip(values("ratios"), values("ratio_errors"), first, strict=True)
    ratios = tuple("" if ratio is None else "1" if own else quoted(ratio, error) for ratio, error, own in of_pairs)
    quantities = tuple(
        "" if value is None else quoted(value, error)
        for value, error in zip(values("values"), values("errors"), strict=True)
    )
    chances = values("best_probability")
    return Table(
        "compare",
        "Scores",
        (
            Column("quantity", names("key"), "", "quantity", headings),
            column("run", labels * len(entries), "run"),
            file_column("data_set", names("data_set")),
            file_column("unit", names("unit")),
            Column("value", values("values"), "", "value", quantities),
            file_column("error", values("errors")),
            Column("ratio", values("ratios"), "", "ratio", ratios),
            file_column("ratio_error", values("ratio_errors")),
            file_column("independent_error", values("independent_errors")),
            Column("errors", kinds * len(entries), "", "error of the ratio", _kinds(kinds, len(entries))),
            column("best_probability", chances, "best", chance_text),
        ),
    )


def quantity_tables(compared: Content) -> list[Table]:
    """Return the rows of `score_rows` for people, as a table for each quantity."""
    tables = []
    for place, entry in enumerate(compared["quantities"]):
        columns = [item for item in score_rows(dict(compared) | {"quantities": [entry]}).columns if item.cells]
        tables.append(Table(f"quantity-{place}", _heading(entry), tuple(columns[1:])))
    return tables


def _kinds(kinds: list[str], n: int) -> tuple[str, ...]:
    return ("", *kinds[1:]) * n


def _heading(entry: Content) -> str:
    unit = f" [{entry['unit']}]" if entry["unit"] else ""
    return f"{entry['data_set']}, {entry['key']}{unit}"


def difference_table(compared: Content) -> Table | None:
    """Return a row for each setting that differs; None without any."""
    rows = compared["differences"]
    if not rows:
        return None
    columns = [column("key", [row["key"] for row in rows], "key")]
    for place, run in enumerate(compared["runs"]):
        columns.append(column(f"value_{place}", [row["values"][place] for row in rows], run["label"]))
    return Table("settings", "Settings that differ", tuple(columns))


def run_table(compared: Content) -> Table:
    """Return a row for each run: its scene, seed, version, observations, weather and discarded scans."""
    runs = compared["runs"]

    def texts(key: str) -> list[str]:
        return [str(run[key]) for run in runs]

    made = [
        column("run", [run["label"] for run in runs], "run"),
        column("scene", texts("scene"), "scene"),
        column("seed", [run["seed"] for run in runs], "seed"),
        column("surveysim", texts("surveysim"), "surveysim"),
        column("detectors", [run["detectors"] for run in runs], "detectors", count),
        column("observations", [_observations(run) for run in runs], "observations"),
    ]
    headings = {
        "median_b2_mk2": "median B2 [mK^2]",
        "median_pwv_mm": "median water [mm]",
        "median_wind_arcmin_s": "median wind [arcmin / s]",
    }
    for key, heading in headings.items():
        if any(key in run for run in runs):
            made.append(column(key, [run.get(key) for run in runs], heading, number))
    made.append(column("discarded", [run["discarded"] for run in runs], "discarded", share_text))
    return Table("run", "Runs", tuple(made))


def _observations(run: Content) -> str:
    done, whole = run["observations"], run["observations_of_survey"]
    return count(done) if done == whole else f"{count(done)} of {count(whole)}"


def pairing_sentences(compared: Content) -> list[str]:
    """Return sentences on the errors of ratios: paired ones, and the reason for each other."""
    first, *others = compared["runs"]
    paired = [run["label"] for run in others if run["errors"] == "paired"]
    found = [f"Ratios are to {first['label']}."]
    if paired:
        found.append(
            f"Errors of ratios of {', '.join(paired)} are paired: seed and version are the same, so weather, noise and"
            " skies are common where the settings allow it."
        )
    found += [
        f"The errors of {run['label']} are for independent runs: {run['independent_because']}."
        for run in others
        if "independent_because" in run
    ]
    return found
