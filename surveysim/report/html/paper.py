"""Page of the paper's tables and figures: agreement, tables, figures, closure tests, provenance."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surveysim.report.html.components import (
    Block,
    Cell,
    Grid,
    Page,
    Picture,
    Section,
    Terms,
    Text,
    cell,
    measured,
    picture,
)
from surveysim.report.html.paper_captions import PAPER
from surveysim.runtime.numbers import count, day_and_time, duration, joined, number, plural, short

if TYPE_CHECKING:
    from astropy.table import Row, Table

SIGMAS, SHARE = 2.0, 0.2
YES, NEARLY, NO = "yes", "nearly", "no"
RULE = (
    f"A value agrees if it is within {SIGMAS:g} standard errors: of both values, or of ours alone where the paper gives"
    f" none. It nearly agrees if it does not, but is within {100 * SHARE:g} % of the paper's."
)
BANDS = ("143", "268", "151", "282")
NO_NUMBER = float("nan")


@dataclass(frozen=True)
class Compared:
    """A published and a simulated value, each with its error (NaN or 0 for none)."""

    name: str
    ours: float
    error: float
    paper: float
    paper_error: float = NO_NUMBER

    @property
    def ratio(self) -> float:
        """Simulated value over the published value."""
        return self.ours / self.paper

    @property
    def agrees(self) -> str:
        """Return whether the two values agree by `RULE`."""
        known = [error for error in (self.error, self.paper_error) if math.isfinite(error)]
        off = abs(self.ours - self.paper)
        if off <= SIGMAS * math.hypot(*known):
            return YES
        return NEARLY if off <= SHARE * abs(self.paper) else NO

    @property
    def distance(self) -> float:
        """Absolute logarithm of the ratio."""
        return abs(math.log(self.ratio)) if self.ratio > 0 else math.inf


@dataclass(frozen=True)
class TableOf:
    """Display of a table file: names of its rows, comparison of a row, and further columns."""

    file: str
    title: str
    what: str
    compared: Callable[["Row"], Compared]
    others: tuple[tuple[str, str], ...] = ()
    note: str = ""


SITE_RATIOS = {
    "band_268_over_143": "268 over 143 GHz, Mauna Kea",
    "mauna_kea_over_south_pole_150": "Mauna Kea over South Pole, 150 GHz",
    "mauna_kea_over_south_pole_275": "Mauna Kea over South Pole, 275 GHz",
    "mauna_kea_over_alma": "Mauna Kea over ALMA, 150 GHz",
    "ccat_below_alma": "share by which CCAT is below ALMA",
}
QUANTITIES = {
    "b2": "B2",
    "adjacent correlated noise": "shared noise",
    "adjacent correlation fraction": "shared fraction",
    "adjacent white correlation": "shared white noise",
}
SHARED = "Shared: by adjacent pairs, below 1 Hz (white noise: above 2.5 Hz), after average or quadratic subtraction."


def _of_instrument(row: "Row") -> Compared:
    name = f"{row['instrument']} {row['band']}, {_ordinal(row['quartile'])} quartile"
    return Compared(name, row["ours"], row["error"], row["paper"])


def _of_site(row: "Row") -> Compared:
    return Compared(SITE_RATIOS.get(row["ratio"], str(row["ratio"])), row["ours"], NO_NUMBER, row["paper"])


def _of_bin(row: "Row") -> Compared:
    cleaning = f", {row['cleaning']}" if row["cleaning"] != "none" else ""
    name = f"{QUANTITIES.get(row['quantity'], row['quantity'])}{cleaning}, {row['bin']}"
    return Compared(name, row["ours"], row["error"], row["paper"], row["paper_error"])


def _of_load(row: "Row") -> Compared:
    name = f"{row['band']}, {row['quantity']} [{row['unit']}]"
    return Compared(name, row["formula"], NO_NUMBER, row["paper"])


def _of_data_set(row: "Row") -> Compared:
    return Compared(str(row["data_set"]), row["sigma_ukcmb2"], row["error"], row["paper"])


def _of_gain(row: "Row") -> Compared:
    return Compared(str(row["gain"]), row["ours"], row["error"], row["paper"])


TABLES = (
    TableOf(
        "table1",
        "Table 1: amplitude B2 of the atmosphere",
        "quartile",
        _of_instrument,
        (("drawn", "drawn"), ("expected", "of the distribution")),
    ),
    TableOf("table1_sites", "Table 1: what opacities predict for sites and bands", "ratio", _of_site),
    TableOf(
        "table2",
        "Table 2: noise below 1 Hz in quarters of the weather",
        "quantity",
        _of_bin,
        (("observations", "observations"),),
        SHARED,
    ),
    TableOf("table2_photons", "Table 2: photon noise of Bolocam's load", "quantity", _of_load),
    TableOf(
        "table3",
        "Table 3: uncertainty of a flat CMB band power",
        "data set",
        _of_data_set,
        (("detectors", "detectors"),),
    ),
    TableOf("table3_gains", "Table 3: gains between data sets", "gain", _of_gain),
)


def has_items(directory: Path) -> bool:
    """Return whether a directory has tables or figures of the paper."""
    return any((directory / f"{item.file}.ecsv").exists() for item in TABLES) or any(
        (directory / f"figure{figure:02d}.png").exists() for figure in PAPER
    )


def paper_page(directory: Path, summary: Mapping[str, Any]) -> Page:
    """Return the page of the paper's items in a directory."""
    found = {item: _read(directory / f"{item.file}.ecsv") for item in TABLES}
    tables = {item: table for item, table in found.items() if table is not None}
    pictures = tuple(_pictures(directory))
    recovered = {band: _read(directory / f"recovered_{band}.ecsv") for band in BANDS}
    recovered = {band: table for band, table in recovered.items() if table is not None}
    sections = [Section("overview", "What agrees, and what does not", tuple(_overview(tables, recovered)))]
    if tables:
        grids = tuple(_grid(item, table) for item, table in tables.items())
        sections.append(Section("tables", "Tables", grids, nested=True))
    if pictures:
        sections.append(Section("figures", "Figures", pictures, nested=True))
    if recovered:
        sections.append(Section("truth", "Truth against measured", _recovered(recovered)))
    sections.append(Section("provenance", "Provenance", tuple(_provenance(summary))))
    numbers = {int(item.file[5]) for item in tables}
    made = f"{plural(len(numbers), 'table')} and {plural(len(pictures), 'figure')}"
    lead = (
        f"{made} of Sayers et al. (2010), Studies of Millimeter-Wave Atmospheric Noise Above Mauna Kea, made again from"
        " simulated observations. Values called measured are measured from simulated time-streams only, by the"
        " paper's methods.",
    )
    return Page("surveysim paper", "The paper's tables and figures", lead, (), tuple(sections))


def _read(path: Path) -> "Table | None":
    if not path.exists():
        return None
    from astropy.table import Table

    return Table.read(path, format="ascii.ecsv")


# ---------------------------------------------------------------- what agrees


def _overview(tables: dict[TableOf, "Table"], recovered: dict[str, "Table"]) -> Iterator[Block]:
    """Summarize the agreement in a paragraph, and in a row for each table with its largest difference."""
    groups = {item.title: _values(item, table) for item, table in tables.items()}
    groups |= {f"Measured back at {band} GHz": _recovered_values(table) for band, table in recovered.items()}
    groups = {title: values for title, values in groups.items() if values}
    if not groups:
        yield Text(("There is no table to compare: only figures are here.",))
        return
    every = [value for values in groups.values() for value in values]
    yes, nearly, no = (sum(value.agrees == verdict for value in every) for verdict in (YES, NEARLY, NO))
    text = (
        f"{plural(len(every), 'value')} here are in the paper too: {yes} agree within errors, {nearly} more within"
        f" {100 * SHARE:g} %, and {no} are further off."
    )
    far = {title: sum(value.agrees == NO for value in values) for title, values in groups.items()}
    if whole := [f"“{title}”" for title in groups if not far[title]]:
        text += f" None is further off in {joined(whole)}."
    most = max(groups, key=lambda title: far[title] / len(groups[title]))
    if far[most]:
        text += f" The largest share is in “{most}”, {far[most]} of {len(groups[most])}."
    yield Text((text,))
    rows = tuple(_group_row(title, values) for title, values in groups.items())
    columns = ("table", "values", "agree", "nearly", "further off", "here over paper", "furthest off")
    yield Grid("grid-overview", "Comparison with the paper", columns, rows, (RULE,))


def _group_row(title: str, values: list[Compared]) -> tuple[Cell, ...]:
    furthest, ratios = max(values, key=lambda value: value.distance), [value.ratio for value in values]
    numbers = [cell(len(values))]
    numbers += [cell(sum(value.agrees == verdict for value in values)) for verdict in (YES, NEARLY, NO)]
    reach = f"{number(min(ratios), 2)} to {number(max(ratios), 2)}"
    return cell(title), *numbers, Cell(reach), cell(f"{furthest.name} ({number(furthest.ratio, 2)})")


def _values(item: TableOf, table: "Table") -> list[Compared]:
    return [value for value in map(item.compared, table) if math.isfinite(value.paper) and math.isfinite(value.ours)]


def _recovered_values(table: "Table") -> list[Compared]:
    # Drawn values are inputs, not measurements.
    rows = [row for row in table if math.isfinite(row["paper"]) and not str(row["quantity"]).endswith("drawn")]
    # Published changes have no sign.
    return [Compared(str(row["quantity"]), abs(row["ours"]), row["error"], row["paper"]) for row in rows]


# ---------------------------------------------------------------- tables and figures


def _grid(item: TableOf, table: "Table") -> Grid:
    rows = []
    for row in table:
        value = item.compared(row)
        both = math.isfinite(value.paper) and math.isfinite(value.ours)
        cells = [cell(value.name), measured(value.ours, value.error), _paper(value)]
        ratio_error = value.error / abs(value.paper) if both and value.error > 0 else None
        cells += [measured(value.ratio, ratio_error), Cell(value.agrees)] if both else [Cell("")] * 2
        rows.append((*cells, *(_other(row[name]) for name, _ in item.others)))
    columns = (item.what, "here", "paper", "here over paper", "agrees", *(heading for _, heading in item.others))
    notes = (f"{table.meta['title']}. {item.note}".strip(),)
    return Grid(f"grid-{item.file}", item.title, columns, tuple(rows), notes)


def _paper(value: Compared) -> Cell:
    if not math.isfinite(value.paper):
        return Cell("")
    error = f" ± {short(value.paper_error)}" if math.isfinite(value.paper_error) else ""
    return Cell(f"{short(value.paper)}{error}", value.paper)


def _other(value: Any) -> Cell:
    if isinstance(value, float):
        return measured(value)
    return cell(int(value))


def _pictures(directory: Path) -> Iterator[Picture]:
    for figure, caption in PAPER.items():
        path = directory / f"figure{figure:02d}.png"
        if path.is_file():
            points = _read(path.with_suffix(".ecsv"))
            drawn = "" if points is None else str(points.meta["caption"])
            lines = (caption.shows, caption.look_for)
            yield picture(path, f"Figure {figure}: {caption.title}", caption.alt, lines, drawn)


# ---------------------------------------------------------------- truth and provenance


def _recovered(recovered: dict[str, "Table"]) -> tuple[Block, ...]:
    """Table of the recovered parameters in all bands."""
    quantities = dict.fromkeys((str(row["quantity"]), _unit(row)) for table in recovered.values() for row in table)
    rows = []
    for quantity, unit in quantities:
        cells, papers = [], {}
        for band, table in recovered.items():
            row = next((row for row in table if str(row["quantity"]) == quantity), None)
            cells.append(Cell("") if row is None else measured(row["ours"], row["error"]))
            if row is not None and math.isfinite(row["paper"]):
                papers[band] = short(row["paper"])
        each = ", ".join(f"{value} ({band})" for band, value in papers.items())
        paper = each if len(set(papers.values())) > 1 else next(iter(papers.values()), "")
        rows.append((cell(f"{quantity} [{unit}]" if unit else quantity), *cells, Cell(paper)))
    columns = ("quantity", *(f"{band} GHz" for band in recovered), "paper")
    lines = (
        "Wind, B2, index b and height of the layer are measured from the time-streams of every observation, and"
        " compared with the drawn values. Errors are from resampling the observations.",
    )
    return Text(lines), Grid("grid-recovered", "Recovered values", columns, tuple(rows))


def _unit(row: "Row") -> str:
    return "" if str(row["unit"]) in ("--", "") else str(row["unit"])


def _provenance(summary: Mapping[str, Any]) -> Iterator[Block]:
    """Terms and a table of scenes for each command that made some of the items."""
    for place, run in enumerate(summary.get("runs", ())):
        packages = ", ".join(f"{name} {version}" for name, version in run["packages"].items())
        pairs = (
            ("Items", _items(run["items"])),
            ("surveysim", run["surveysim"]),
            ("Python", run["python"]),
            ("Packages", packages),
            ("Date", day_and_time(run["date"])),
            ("Engine", run["engine"]),
            ("Workers", str(run["workers"])),
            ("Wall time", duration(run["wall_s"])),
            *((f"Not made: {name}", reason) for name, reason in run["failed"].items()),
        )
        yield Terms(pairs, code=True)
        rows = tuple(_scene_row(scene) for scene in run["scenes"])
        columns = ("scene", "for", "observations", "seed", "SHA-256")
        if rows:
            yield Grid(f"scenes-{place}", "Scenes", columns, rows)
    if not summary.get("runs"):
        yield Text(("No summary.json in this directory says with which versions and seeds its files were made.",))


def _scene_row(scene: Mapping[str, Any]) -> tuple[Cell, ...]:
    observations = Cell(count(scene["observations"]), scene["observations"])
    origin = Cell(str(scene["seed"])), cell(scene["scene_sha256"])
    return cell(scene["scene"]), cell(_items(scene["items"])), observations, *origin


def _items(names: Iterable[str]) -> str:
    """Shorten names such as "figure 3" to ``table 1, 2; figure 3 to 12, 14; 143 GHz``."""
    kinds: dict[str, list[int]] = {"table": [], "figure": []}
    others = []
    for name in names:
        kind, _, place = name.partition(" ")
        kinds[kind].append(int(place)) if kind in kinds else others.append(name)
    lists = [f"{kind} {_spans(sorted(places))}" for kind, places in kinds.items() if places]
    return "; ".join([*lists, *others])


def _spans(places: list[int]) -> str:
    """Format increasing numbers, with three or more consecutive ones as ``3 to 12``."""
    spans: list[list[int]] = []
    for place in places:
        if spans and place == spans[-1][-1] + 1:
            spans[-1].append(place)
        else:
            spans.append([place])
    texts = (f"{span[0]} to {span[-1]}" if len(span) > 2 else ", ".join(map(str, span)) for span in spans)
    return ", ".join(texts)


def _ordinal(place: int) -> str:
    return ("first", "second", "third")[int(place) - 1]
