"""Every tutorial runs as a notebook, from its first cell to its last."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

import pytest
from needs import missing, optional

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "tutorials"
CELL = re.compile(r"^```\{code-cell\} python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = sorted(page.stem for page in FOLDER.glob("*.md"))
INSTALL = 'the tutorials run as notebooks: pip install "vamgpu[docs]"'


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_a_tutorial_runs(name: str, tmp_path: Path) -> None:
    if find_spec("nbclient") is None or find_spec("ipykernel") is None:
        missing(INSTALL)
    from nbclient import NotebookClient
    from nbformat.v4 import new_code_cell, new_notebook

    cells = CELL.findall((FOLDER / f"{name}.md").read_text("utf-8"))
    if any("import torch" in cell for cell in cells):
        optional("torch", 'this tutorial needs PyTorch: pip install "vamgpu[torch]"')
    assert len(cells) >= 3
    notebook = new_notebook(cells=[new_code_cell(cell) for cell in cells])
    NotebookClient(notebook, timeout=250, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()


@pytest.mark.parametrize("name", PAGES)
def test_a_tutorial_is_a_notebook_of_valid_cells(name: str) -> None:
    text = (FOLDER / f"{name}.md").read_text("utf-8")
    assert text.startswith("---\nfile_format: mystnb\n")
    for cell in CELL.findall(text):
        compile(cell, f"{name}.md", "exec")
