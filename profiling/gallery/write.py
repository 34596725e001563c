"""Pages: a PNG and its markdown for each entry, and an index of all."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

from profiling.gallery.catalog import CATALOG, GROUPS, parameters
from profiling.gallery.picture import Picture, Table
from vamgpu.reports.style import png
from vamgpu.storage.atomic import replacing

FOLDER = "gallery"
"""Folder of the pages, beside the index."""


def write_page(picture: Picture, name: str, out: str | Path, device: str = "", **values: Any) -> tuple[Path, Path]:
    """Write ``out``/gallery/NAME.png and NAME.md, replacing earlier ones. values: the given parameters.

    Raises `StorageError`.
    """
    place = Path(out) / FOLDER
    image, page = place / f"{name}.png", place / f"{name}.md"
    for path, content in ((image, png(picture.figure)), (page, markdown(picture, name, device, values).encode())):
        with replacing(path, overwrite=True) as draft:
            draft.write_bytes(content)
    return image, page


def write_index(out: str | Path) -> Path:
    """Write ``out``/gallery.md, which shows every entry. Raises `StorageError`."""
    index = Path(out) / "gallery.md"
    with replacing(index, overwrite=True) as draft:
        draft.write_text(contents(), encoding="utf-8")
    return index


def markdown(picture: Picture, name: str, device: str = "", values: dict[str, Any] | None = None) -> str:
    """The page of an entry."""
    parts = [f"# {CATALOG[name]}", f"![{CATALOG[name]}]({name}.png)", _filled(picture.caption), _facts(picture)]
    if picture.table:
        parts.append(_table(picture.table))
    if picture.papers:
        parts.append("References:\n\n" + "\n".join(f"- {paper}" for paper in picture.papers))
    chosen = ", ".join(
        f"{key} = {value}" if isinstance(value, str) else f"{key} = {value:g}"
        for key, value in (parameters(name) | (values or {})).items()
    )
    where = f" on `{device}`" if device else ""
    command = f"python -m profiling.gallery {name}"
    parts.append(_filled(f"Made by `{command}`{where}, with {chosen}. Lengths in mm, absorption in 1/mm."))
    parts.append("[All pictures](../gallery.md)")
    return "\n\n".join(part for part in parts if part) + "\n"


def contents() -> str:
    """The index."""
    opening = (
        "Each picture shows one thing that the library does. Its page says how the picture was made, and lists what "
        "was measured in that run. In a clone, `python -m profiling.gallery NAME` draws it again, and `python -m "
        "profiling.gallery all` every one. A film of a minute shows [Studio](studio.md); `python -m "
        "profiling.gallery.studio` makes it on a job that it solves."
    )
    entries = [part for heading, some in GROUPS.items() for part in (f"## {heading}", *(
        f"### [{title}]({FOLDER}/{name}.md)\n\n[![{title}]({FOLDER}/{name}.png)]({FOLDER}/{name}.md)"
        for name, title in some.items()))]  # fmt: skip
    return "\n\n".join(["# Gallery", _filled(opening), *entries]) + "\n"


def _facts(picture: Picture) -> str:
    if not picture.facts:
        return ""
    if all(fact.expected is None for fact in picture.facts):
        return _rows([("measured", "value"), *((fact.name, fact.shown) for fact in picture.facts)])
    rows = [(fact.name, fact.shown, fact.wanted, fact.difference) for fact in picture.facts]
    return _rows([("measured", "value", "expected", "difference"), *rows])


def _table(table: Table) -> str:
    return _rows([table.header, *table.cells()])


def _rows(rows: list[Any]) -> str:
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    lines.insert(1, "|" + "|".join(["---", *["---:"] * (len(rows[0]) - 1)]) + "|")
    return "\n".join(lines)


def _filled(text: str) -> str:
    return "\n\n".join(textwrap.fill(part, 120, break_long_words=False) for part in text.split("\n\n"))
