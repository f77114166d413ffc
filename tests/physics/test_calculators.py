"""Depths for point sources beside public calculators, within the differences that the page states."""

import pytest

from docs.calculators import COMPARISONS, PAGE, PRINTED_SEFD, atlast_sefd, with_table

QUICK = [item for item in COMPARISONS if "AtLAST" in item.name or "y per" in item.quantity]


@pytest.mark.parametrize("item", QUICK, ids=lambda item: f"{item.name}-{item.quantity}")
def test_calculators(item):
    assert item.program() / item.published() == pytest.approx(item.ratio, abs=item.tolerance)
    assert item.stated


def test_the_formula_of_atlast_is_the_calculators():
    """Its documentation prints the value for the same inputs."""
    assert atlast_sefd() == pytest.approx(PRINTED_SEFD, rel=1e-9)


@pytest.mark.slow
def test_forecasts_of_cameras_and_the_page():
    """The others, which take a forecast of a large camera, and the page's table of today."""
    for item in COMPARISONS:
        assert item.program() / item.published() == pytest.approx(item.ratio, abs=item.tolerance), item.name
    text = PAGE.read_text(encoding="utf-8")
    assert with_table(text) == text
