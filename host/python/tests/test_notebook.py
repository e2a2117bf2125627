"""Test of the notebook docs/python.ipynb: it runs, and prints its stored outputs."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from conftest import ROOT
from nbclient import NotebookClient

NOTEBOOK = ROOT / "docs" / "python.ipynb"


def texts(notebook: nbformat.NotebookNode) -> list[str]:
    """Text that each code cell printed; the kernel may split it into several outputs."""

    def text(output: nbformat.NotebookNode) -> str:
        return "".join(output.get("text", output.get("data", {}).get("text/plain", "")))

    return ["".join(map(text, cell.outputs)) for cell in notebook.cells if cell.cell_type == "code"]


# The libraries of the kernel emit warnings.
@pytest.mark.filterwarnings("ignore")
def test_it_prints_what_is_printed_in_it(tmp_path: Path) -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    printed = texts(notebook)
    assert len(printed) > 5 and all(printed[number] for number in (0, 1, 2, 3, 4, 5))
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    # Virtual time passes only during calls: the outputs are the same on every computer.
    assert texts(notebook) == printed
