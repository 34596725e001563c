"""What docs/arrays.md shows runs."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from needs import missing, optional

PAGE = Path(__file__).resolve().parents[2] / "docs" / "arrays.md"


def chapters() -> list[list[str]]:
    """Blocks by what they go on from: one that imports the library as a whole begins anew."""
    found: list[list[str]] = []
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.S):
        if re.search(r"^import vamgpu as vam$", block, re.M):
            found.append([])
        found[-1].append(block)
    return found


@pytest.mark.parametrize("chapter", chapters(), ids=lambda chapter: chapter[0].split()[1])
def test_the_blocks_of_the_page_run(chapter: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    if any("torch" in block for block in chapter):
        optional("torch", "install PyTorch: pip install vamgpu[torch]; with CUDA it is gigabytes, so not everywhere")
    if any("jax" in block for block in chapter):
        try:
            import jax  # noqa: F401  # pyright: ignore[reportUnusedImport]
        except ImportError:
            missing("install JAX: pip install vamgpu[jax]")
    page = ModuleType("page")  # where dataclasses look for what they name
    monkeypatch.setitem(sys.modules, "page", page)
    for block in chapter:
        exec(block, vars(page))  # noqa: S102 - our own page
