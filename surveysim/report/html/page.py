"""Report page of an output directory: a run, a sweep, items of the paper or a convergence study."""

import json
import re
from pathlib import Path
from typing import Any

from mapmaker.files import atomic_write
from mapmaker.printable import printable, shortened
from mapmaker.report.page import page_bytes
from surveysim import __version__
from surveysim.report.html.components import Page

REPORT = "report.html"
FOOTER = (
    f"Written by surveysim {__version__} from the files beside it. This page is whole: it asks nothing of the network. "
    "Rebuild it with `surveysim report DIR`."
)
LONGEST_REASON = 150
FIRST = (0, 5)  # first version with the present keys of summary.json
# Keys that identify the kind of results.
KINDS = {"points", "scores", "accuracy", "bands", "budget", "optimum", "compared", "explained"}
EXPECTED = (
    "the directory of a run, a sweep, 'surveysim budget', 'optimise', 'compare', 'accuracy' or 'paper' is expected"
)


class NoResultsError(ValueError):
    """A directory without readable results; the text says in one line what was found and what is expected."""


def write_report(directory: str | Path) -> Path:
    """Write `report.html` atomically, from the files in `directory` alone; return its path.

    Raises NoResultsError for a directory without results, or with damaged ones.
    """
    directory = Path(directory)
    if not directory.is_dir():
        found = "not a directory" if directory.exists() else "no such directory"
        raise NoResultsError(f"{directory}: {found}; {EXPECTED}")
    try:
        page = page_bytes(_page_of(directory), FOOTER)
    except (NoResultsError, OSError, MemoryError):
        raise
    except Exception as error:  # files that others wrote, or that are damaged, can have anything in them
        reason = shortened(printable(f"{type(error).__name__} {error}"), LONGEST_REASON)
        raise NoResultsError(f"{directory}: results that can't be read ({reason}); {EXPECTED}") from None
    with atomic_write(directory / REPORT) as partial:
        partial.write_bytes(page)
    return directory / REPORT


def _page_of(directory: Path) -> Page:
    """Make the page of a directory, by the kind of its files."""
    summary = _read_summary(directory / "summary.json") if (directory / "summary.json").exists() else {}
    if "compared" in summary:
        from surveysim.report.html.compare import comparison_page

        return comparison_page(directory, summary)
    if "explained" in summary:
        from surveysim.report.html.explanation import explanation_page

        return explanation_page(directory, summary)
    if "points" in summary:
        from surveysim.report.html.sweep import sweep_page

        return sweep_page(directory, summary, _read(directory / "scene.json"))
    if "budget" in summary:
        from surveysim.report.html.budget import budget_page

        return budget_page(directory, summary, _read(directory / "scene.json"))
    if "optimum" in summary:
        from surveysim.report.html.optimum import optimum_page

        return optimum_page(directory, summary, _read(directory / "scene.json"))
    if "bands" in summary:
        from surveysim.report.html.bands import bands_page

        return bands_page(directory, summary)
    if "scores" in summary:
        from surveysim.report.html.survey import run_page

        return run_page(directory, summary, _read(directory / "scene.json"))
    if "accuracy" in summary:
        from surveysim.report.html.convergence import accuracy_page

        return accuracy_page(directory, summary, _read(directory / "scene.json"))
    from surveysim.report.html.paper import has_items, paper_page

    if has_items(directory):
        return paper_page(directory, summary)
    raise NoResultsError(f"{directory}: found no results; {EXPECTED}")


def _read_summary(path: Path) -> dict[str, Any]:
    """Read summary.json; raise NoResultsError for keys of a version before `FIRST`."""
    summary = _read(path)
    found = str(summary.get("surveysim", "of unknown version"))
    if not summary.keys().isdisjoint(KINDS) and tuple(map(int, re.findall(r"\d+", found)[:2])) < FIRST:
        first = ".".join(map(str, FIRST))
        raise NoResultsError(f"{path}: written by surveysim {found}; {first} or later is expected, run it again")
    return summary


def _read(path: Path) -> dict[str, Any]:
    if path.exists() and not path.is_file():  # a pipe would never end
        raise NoResultsError(f"{path}: found no file; {EXPECTED}")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else shortened(printable(error), LONGEST_REASON)
        raise NoResultsError(f"{path}: can't be read ({reason}); {EXPECTED}") from None
    if not isinstance(content, dict):
        raise NoResultsError(f"{path}: found {type(content).__name__}; a JSON object is expected")
    return content
