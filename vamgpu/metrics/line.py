"""One number of a report, ready to be read."""

from __future__ import annotations

from typing import NamedTuple


class Line(NamedTuple):
    """One number with its name and what it means."""

    name: str
    value: str
    meaning: str
