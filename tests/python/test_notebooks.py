"""The notebooks run from their first cell to the last, with and without widgets."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[2] / "notebooks"
NAMES = sorted(path.stem for path in FOLDER.glob("*.ipynb"))
WIDGET = "application/vnd.jupyter.widget-view+json"


@pytest.fixture(autouse=True)
def users_environment(monkeypatch):
    """Pictures are shown as Jupyter shows them: no other back end is asked for."""
    monkeypatch.delenv("MPLBACKEND", raising=False)


def read(name):
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def outputs(notebook):
    """Run a notebook; what its cells show, by kind."""
    NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    shown = [output for cell in cells for output in cell.outputs]
    said = "".join(x["text"] for x in shown if x.get("name") == "stderr")
    assert "Warning" not in said and "Error" not in said, said
    return [output.get("data", {}) for output in shown]


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_shows_a_film_pictures_and_a_slider(name):
    found = outputs(read(name))
    assert any("<iframe" in data.get("text/html", "") for data in found)
    last = found[-1]
    assert WIDGET in last and "Slider" in last["text/plain"]


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_without_widgets_draws_what_they_would(name):
    notebook = read(name)
    hide = nbformat.v4.new_code_cell("import sys; sys.modules['ipywidgets'] = None")
    notebook.cells.insert(0, hide)
    found = outputs(notebook)
    assert "image/png" in found[-1]
    assert not any("Slider" in data.get("text/plain", "") for data in found)


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_kept_without_what_it_shows(name):
    assert len(NAMES) == 3
    for cell in read(name).cells:
        assert not cell.get("outputs") and not cell.get("execution_count")
