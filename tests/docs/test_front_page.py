"""The files at the root that people read first: length, links, versions, and the numbers of Table 3."""

import re
from pathlib import Path

import pytest
from astropy.table import Table

import surveysim
from docs.development import house
from tests.docs.pages import README, ROOT

pytestmark = pytest.mark.docs
WORDS, PICTURE_BYTES = 600, 150_000
PAGES_AT_ROOT = [README, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
ROWS = {
    "actual": "actual",
    "uncorrelated between detectors": "uncorrelated",
    "white": "white",
    "actual, 36 detectors at least 1.3 (f/#)lambda apart, scaled by 36/115": "masked_36_scaled",
}


def links(path: Path) -> list[str]:
    return re.findall(r"\]\(([^)]+)\)", path.read_text(encoding="utf-8"))


def headings(path: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub and Sphinx make them."""
    found = re.findall(r"^#+ (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", text.lower()).replace(" ", "-") for text in found}


def leads_somewhere(page: Path, link: str) -> bool:
    path, _, anchor = link.partition("#")
    target = page.parent / path
    return target.exists() and (not anchor or anchor in headings(target))


def test_readme_is_one_screen():
    text = README.read_text(encoding="utf-8")
    pictures = re.findall(r"!\[[^]]*\]\((.+)\)", text)
    assert len(text.split()) <= WORDS
    assert [(ROOT / name).stat().st_size < PICTURE_BYTES for name in pictures] == [True]


@pytest.mark.parametrize("path", PAGES_AT_ROOT, ids=lambda path: path.stem)
def test_links_lead_somewhere(path):
    there = [link for link in links(path) if not link.startswith("https://")]
    assert there and [link for link in there if not leads_somewhere(path, link)] == []


def test_lost_headings_are_noticed():
    assert leads_somewhere(README, "docs/validation/paper.md#table-3")
    assert not leads_somewhere(README, "docs/validation/paper.md#table-33")


def test_readme_has_the_scores_of_the_reference_run():
    table = Table.read(ROOT / "outputs" / "reference" / "lynx" / "tables" / "scores.ecsv")
    rows = {row["name"]: row for row in table}
    cells = [line.strip("| ").split(" | ") for line in README.read_text().splitlines() if " ± " in line]
    assert [name for name, _, _ in cells] == list(ROWS)
    for name, score, paper in cells:
        row = rows[ROWS[name]]
        assert score == f"{row['sigma_ukcmb2']:.1f} ± {row['error_ukcmb2']:.1f}"
        assert paper == f"{row['reference_ukcmb2']:.0f}"


def test_versions_are_alike():
    assert f"\nversion: {surveysim.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"\n## [{surveysim.__version__}]" in (ROOT / "CHANGELOG.md").read_text()


def test_house_finds_every_step_of_the_main_flow():
    found = house.measures(ROOT)
    assert re.fullmatch(r"\d+", found["files of the main flow"])
    assert int(found["files"]) > 100 and int(found["functions"]) > 1000
