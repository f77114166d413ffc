"""The guide's notebooks, run from the first cell to the last; what runs them is of the extra `docs`."""

import os

import pytest

from tests.docs.pages import ROOT

pytestmark = pytest.mark.docs
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
MOST_SECONDS = 600  # a cell, on a busy machine


def execute(book, folder, monkeypatch):
    """Run a notebook in a folder that has nothing in it, with this clone's packages."""
    from nbclient import NotebookClient

    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return NotebookClient(book, timeout=MOST_SECONDS, resources={"metadata": {"path": str(folder)}}).execute()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook(path, tmp_path, monkeypatch):
    import nbformat

    book = nbformat.read(path, as_version=4)
    nbformat.validate(book)
    cells = [cell for cell in execute(book, tmp_path, monkeypatch).cells if cell.cell_type == "code"]
    drawn = [output for cell in cells for output in cell.outputs if "image/png" in output.get("data", {})]
    assert len(cells) > 3 and drawn


def test_there_are_three():
    assert [path.stem for path in NOTEBOOKS] == ["first_run", "own_data", "pixel_spacing"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_kept_without_outputs(path):
    import nbformat

    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in cells)


def test_a_cell_that_fails_is_noticed(tmp_path, monkeypatch):
    import nbformat
    from nbclient.exceptions import CellExecutionError

    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("import surveysim\nsurveysim.sprint()")])
    with pytest.raises(CellExecutionError, match="no attribute 'sprint'"):
        execute(book, tmp_path, monkeypatch)
