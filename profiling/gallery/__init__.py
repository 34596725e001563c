"""Pictures of every capability, made from parameters: a figure, and the numbers its caption states."""

from __future__ import annotations

from profiling.gallery.catalog import CATALOG, draw, names, parameters
from profiling.gallery.picture import Fact, Picture, Table
from profiling.gallery.write import write_index, write_page

__all__ = ["CATALOG", "Fact", "Picture", "Table", "draw", "names", "parameters", "write_index", "write_page"]
