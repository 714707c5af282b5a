"""The notebooks in examples/ run from their first cell to their last, here at sizes that take seconds."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

EXAMPLES = Path(__file__).parents[1] / "examples"
SIZES = {  # what replaces the first line of code of each
    "inside_one_trial": "SECONDS = 7.0",
    "a_sweep_and_its_statistics": "SECONDS, TRIALS = 7.0, 2",
}


def test_every_notebook_is_here_and_in_the_documents() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.ipynb")} == SIZES.keys()
    page = (EXAMPLES.parent / "docs" / "notebooks.md").read_text()
    assert all(f"examples/{name}.ipynb" in page for name in SIZES)


@pytest.mark.parametrize("name", SIZES)
def test_a_notebook_runs_and_draws(name: str, tmp_path: Path) -> None:
    notebook = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs for cell in cells)
    _, *rest = cells[0].source.splitlines()
    cells[0].source = "\n".join([SIZES[name], *rest])
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output.get("data", {}) for cell in cells for output in cell.outputs]
    drawing = [cell for cell in cells if "snnrl.plot." in cell.source or "errorbar" in cell.source]
    assert sum("image/png" in data for data in shown) == len(drawing)
