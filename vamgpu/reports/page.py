"""A report: one self-contained HTML page of cards, for vials, webs and slices."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

from vamgpu.errors import StorageError
from vamgpu.reports.line import Line
from vamgpu.storage.atomic import check_folder, page_path, replacing


class Image(NamedTuple):
    source: str
    name: str


@dataclass(frozen=True)
class Chart:
    """Inline SVG."""

    svg: str  # the element, as `vamgpu.reports.chart.svg` draws it
    kind: ClassVar[str] = "chart"


@dataclass(frozen=True)
class Images:
    """Images side by side."""

    images: Sequence[Image]  # the images
    layout: Literal["frames", "trio upright", "panels", "strip", "sinogram"]  # a class of the style sheet
    across: int = 2  # columns of the layout ``panels``
    kind: ClassVar[str] = "images"


@dataclass(frozen=True)
class Numbers:
    """Lines of name, value and meaning."""

    lines: Iterable[Line]
    kind: ClassVar[str] = "numbers"


@dataclass(frozen=True)
class Table:
    """Cells in rows under a header; without one, the first cell of a row is its name."""

    rows: Iterable[Sequence[str]]  # text of the cells
    header: Sequence[str] = ()  # text above the columns
    kind: ClassVar[str] = "table"


@dataclass(frozen=True)
class Tolerances:
    """Windows of a print on a machine with one error at a time; one group of rows per error."""

    groups: Sequence[Mapping[str, Any]]
    kind: ClassVar[str] = "tolerances"


@dataclass(frozen=True)
class SurfaceView:
    """Surfaces in three dimensions, colored by deviation; the page's data holds them."""

    deviation: str  # greatest deviation of the color scale [µm], as text
    kind: ClassVar[str] = "solid"


@dataclass(frozen=True)
class Slices:
    """Target, dose and verdict slice by slice; the page's data holds them."""

    kind: ClassVar[str] = "slices"


@dataclass(frozen=True)
class Legend:
    """Colors of verdicts and of the dose."""

    most: str = "most"  # text for the greatest dose
    kind: ClassVar[str] = "legend"


@dataclass(frozen=True)
class Papers:
    """A numbered list of sources."""

    papers: Iterable[str]
    kind: ClassVar[str] = "papers"


Block = Chart | Images | Numbers | Table | Tolerances | SurfaceView | Slices | Legend | Papers


class Card:
    """A titled part of a page."""

    title: str
    blocks: tuple[Block, ...]
    note: str  # a line of small print
    wide: bool  # whether it spans both columns

    def __init__(self, title: str, *blocks: Block, note: str = "", wide: bool = False) -> None:
        self.title, self.blocks, self.note, self.wide = title, blocks, note, wide


@dataclass(frozen=True)
class Page:
    """A whole report."""

    sort: str  # kind of report, in two words
    title: str
    verdict: str
    good: bool  # whether the verdict is good
    tiles: Sequence[Line]  # numbers in a row
    cards: Sequence[Card]  # below the tiles, in two columns
    headline: Sequence[Line] = ()  # the most important numbers, above the tiles
    summary: Sequence[Card] = ()  # cards above the tiles
    remedies: Sequence[str] = ()  # what to do if the verdict is not good
    not_judged: Sequence[str] = ()  # what the verdict leaves open
    data: Mapping[str, Any] | None = None  # drawn by the page's script, for cards with a `SurfaceView` or `Slices`

    def html(self) -> str:
        """The page as text; everything except trusted markup types is escaped."""
        from jinja2 import Environment

        environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
        script = None if self.data is None else json.dumps(self.data, separators=(",", ":"))
        parts = {**vars(self), "data": script, "css": _shipped("page.css"), "js": _shipped("page.js")}
        return environment.from_string(_shipped("page.html")).render(parts)

    def write(self, path: str | Path) -> Path:
        """Write the page into an existing folder, replacing an earlier one."""
        place = page_path(path)
        check_folder(place)
        if place.is_dir():
            raise StorageError(f"{str(place)!r} is a folder; expected the path of a page: choose another path")
        with replacing(place, overwrite=True) as draft:
            draft.write_text(self.html(), encoding="utf-8")
        return place


def _shipped(name: str) -> str:
    return resources.files("vamgpu.reports").joinpath("templates", name).read_text(encoding="utf-8")
