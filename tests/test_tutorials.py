"""Tutorials are notebooks of valid cells; the build of the documentation runs them, and fails if one does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "tutorials"
CELL = re.compile(r"^```\{code-cell\} python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = sorted(page.stem for page in FOLDER.glob("*.md"))


@pytest.mark.parametrize("name", PAGES)
def test_a_tutorial_is_a_notebook_of_valid_cells(name: str) -> None:
    text = (FOLDER / f"{name}.md").read_text("utf-8")
    cells = CELL.findall(text)
    assert text.startswith("---\nfile_format: mystnb\n") and len(cells) >= 3
    for cell in cells:
        compile(cell, f"{name}.md", "exec")
