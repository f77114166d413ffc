"""The tables of a page: under each heading the names that it documents, with their units."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

from mapmaker.cleaning import ALGORITHMS
from surveysim.scene.keys import all_keys

_NAME = f"(?:{'|'.join(ALGORITHMS)})"
_CLEANED = rf"actual|masked_\d+|{_NAME}(?:\+{_NAME})*"
_DATA_SET = rf"(?:{_CLEANED}|uncorrelated|white|optimal|masked_\d+_scaled)"
# What stands for one of several.
PLACEHOLDERS = {
    "<data set>": _DATA_SET,
    "<cleaning>": f"(?:{_CLEANED})",
    "<gain>": f"{_DATA_SET} / {_DATA_SET}",
    "<origin>": "(?:shot|wave|phonon|recombination|amplifier|detector)",
    "<key>": f"(?:{'|'.join(map(re.escape, all_keys()))})",
    "<cost>": "(?:detectors|data_rate|observing_time)",
    "<key of a sweep>": ".+",
    "<metric>": r"[a-z]\w*\.\w+",
    "<low>": r"\d+",
    "<high>": r"\d+",
    "<package>": r"\w+",
    "<ingredient>": "[a-z_]+",
    "<algorithm>": _NAME,
    "<target>": "(?:cmb|point_source)",
    "<stage>": r"[\w +]+",
    "<frequency>": r"[\d.]+ Hz",
    "<item>": r"(?:(?:table|figure) \d+|\d{3} GHz)",
    "<band>": r"\d{3}",
    "<first>": r"\d{9}",
    "<split>": "(?:night|direction|array)",
    "<number>": r"\d+",
    "<NNNN>": r"\d{4}",
    "<NN>": r"\d{2}",
}


def documented(page: Path) -> dict[str, dict[str, str]]:
    """Under each heading of a page: the names in the first column of its tables, and their units, "" for none.

    A unit is the same for all names of a row, or one for each, set apart by commas.
    """
    found: dict[str, dict[str, str]] = {}
    heading = ""
    for kind, cells in _headings_and_rows(page):
        if kind == "heading":
            heading = cells[0].content
            continue
        names = [token.content for token in cells[0].children if token.type == "code_inline"]
        units = [unit.strip() for unit in cells[1].content.split(",")] if kind == "row with unit" else [""]
        units *= len(names) if len(units) == 1 else 1
        found.setdefault(heading, {}).update(zip(names, units, strict=True))
    return found


def pattern(name: str) -> re.Pattern[str]:
    """Pattern of the names that a documented name stands for."""
    parts = re.split(r"(<[\w ]+>)", name)
    return re.compile("".join(PLACEHOLDERS[part] if part.startswith("<") else re.escape(part) for part in parts))


def differences(said: Mapping[str, str], there: Mapping[str, str]) -> list[str]:
    """Names that are undocumented, documented but absent, or documented with another unit."""
    patterns = {name: pattern(name) for name in said}
    by_name = {name: [key for key, item in patterns.items() if item.fullmatch(name)] for name in there}
    lines = [f"not documented: {name}" for name, keys in by_name.items() if not keys]
    used = {key for keys in by_name.values() for key in keys}
    lines += [f"documented, but not there: {name}" for name in said if name not in used]
    return lines + [
        f"{name}: unit {there[name]!r}, documented as {said[keys[0]]!r}"
        for name, keys in by_name.items()
        if keys and there[name] != said[keys[0]]
    ]


def _headings_and_rows(page: Path) -> Iterator[tuple[str, list[Token]]]:
    tokens = MarkdownIt().enable("table").parse(page.read_text(encoding="utf-8"))
    cells: list[Token] = []
    kind = "row"
    for before, token in zip(tokens, tokens[1:], strict=False):
        if before.type == "heading_open":
            yield "heading", [token]
        if before.type in ("th_open", "td_open"):
            cells.append(token)
        if token.type == "tr_close":
            if before.type == "th_close":
                kind = "row with unit" if cells[1].content == "unit" else "row"
            else:
                yield kind, cells
            cells = []
