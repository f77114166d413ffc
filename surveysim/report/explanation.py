"""Tables of an explanation of the paper's findings, from the content of its summary.json."""

from collections.abc import Mapping
from typing import Any

from surveysim.runtime.numbers import short, with_error
from surveysim.runtime.table import Column, Table, column, file_column

EXPLAINS, HELPS, WORSENS = "explains", "helps", "worsens"
Content = Mapping[str, Any]  # the key `explained` of summary.json
_ROUNDING = 1e-6  # relative to the value: differences of streams in single precision
_ENTRY = ("value", "error", "difference", "difference_error", "verdict")


def entry_table(content: Content) -> Table:
    """Return a row for each finding and ingredient, for files."""
    rows = [
        (finding["name"], finding["title"], item["name"], *finding["paper"], _known(finding["paper_error"]))
        + tuple(_known(entry[name]) for name in _ENTRY)
        for finding in content["findings"]
        for item, entry in zip(content["ingredients"], finding["entries"], strict=True)
    ]
    names = ("finding", "title", "ingredient", "paper_low", "paper_high", "paper_error", *_ENTRY)
    columns = tuple(
        file_column(name, list(values)) for name, values in zip(names, zip(*rows, strict=True), strict=True)
    )
    return Table("explain", "Findings with each ingredient", columns)


def overview_table(content: Content) -> Table:
    """Return a row for each finding: paper, one layer, best combination, and ingredients that explain it or help."""
    columns = (
        _titles(content),
        _paper(content),
        _values(content, 0),
        _values(content, -1),
        *(_named(content, verdict) for verdict in (EXPLAINS, HELPS)),
    )
    return Table("overview", "Findings of the paper, and the ingredients that explain them", columns)


def value_table(content: Content) -> Table:
    """Return a row for each finding, with its value for each ingredient."""
    places = range(len(content["ingredients"]))
    columns = (_titles(content), _paper(content), *(_values(content, place) for place in places))
    return Table("values", "Findings with each ingredient alone", columns)


def difference_table(content: Content) -> Table:
    """Return a row for each finding, with its paired difference to one layer and the verdict for each ingredient."""
    columns = [_titles(content)]
    for place, item in enumerate(content["ingredients"][1:], start=1):
        found = [finding["entries"][place] for finding in content["findings"]]
        cells = [_moved(entry) for entry in found]
        columns.append(column(item["name"], cells, item["title"]))
    return Table("differences", "Paired differences to one layer", tuple(columns))


def ingredient_table(content: Content) -> Table:
    """Return a row for each ingredient, with its settings as options of a command and their origin."""
    names = {"title": "ingredient", "origin": "origin of the values", "options": "settings"}
    columns = tuple(
        column(key, [item[key] for item in content["ingredients"]], heading) for key, heading in names.items()
    )
    return Table("ingredients", "Ingredients", columns)


def second_layer_table(content: Content) -> Table:
    """Return a row for each angle and share of a second layer, with the trusted winds of each half of the weather."""
    rows = content["second_layer"]
    columns = [
        column("turn", [row["turn_deg"] for row in rows], "angle [deg]", short, unit="deg"),
        column("share", [row["share"] for row in rows], "share of B2", short),
    ]
    for half, title in (("better", "trusted, better half of B2"), ("poorer", "trusted, poorer half of B2")):
        values, errors = ([row[f"{half}{kind}"] for row in rows] for kind in ("", "_error"))
        cells = tuple(with_error(*pair) for pair in zip(values, errors, strict=True))
        columns += [Column(half, values, heading=title, cells=cells), file_column(f"{half}_error", errors)]
    return Table("second_layer", "Trusted winds with a second layer", tuple(columns))


def _known(value: Any) -> Any:
    """NaN in place of null."""
    return float("nan") if value is None else value


def _titles(content: Content) -> Column:
    return column("finding", [finding["title"] for finding in content["findings"]], "finding")


def _paper(content: Content) -> Column:
    cells = tuple(_published(item["paper"], _known(item["paper_error"])) for item in content["findings"])
    return Column("paper", cells, heading="paper", cells=cells)


def _published(ends: tuple[float, float], error: float) -> str:
    low, high = ends
    if low < high:
        return f"{short(low)} to {short(high)}"
    return with_error(low, error) if error == error else short(low)


def _values(content: Content, place: int) -> Column:
    item, found = content["ingredients"][place], [finding["entries"][place] for finding in content["findings"]]
    values = [_known(entry["value"]) for entry in found]
    cells = tuple(with_error(value, _known(entry["error"])) for value, entry in zip(values, found, strict=True))
    return Column(item["name"], values, heading=item["title"], cells=cells)


def _named(content: Content, verdict: str) -> Column:
    """Column of the ingredients, one alone, with a verdict."""
    titles = [item["title"] for item in content["ingredients"][1:-1]]
    cells = [
        ", ".join(
            title for title, entry in zip(titles, finding["entries"][1:-1], strict=True) if entry["verdict"] == verdict
        )
        for finding in content["findings"]
    ]
    return column(verdict, cells, verdict)


def _moved(entry: Mapping[str, Any]) -> str:
    value, error = _known(entry["difference"]), _known(entry["difference_error"])
    if max(abs(value), error) <= _ROUNDING * abs(_known(entry["value"])):
        return "0"
    sign = "+" if value > 0 else ""
    return f"{sign}{with_error(value, error)} {entry['verdict']}".rstrip()
