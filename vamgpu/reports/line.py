"""One number of a report as text."""

from __future__ import annotations

from math import isnan
from typing import NamedTuple


class Line(NamedTuple):
    """One number with its name and meaning."""

    name: str
    value: str
    meaning: str = ""


def length(millimeters: float, sign: str = "") -> str:
    """A length in µm, or in mm from one millimeter on, with three digits; "none" for NaN. ``sign`` as in formats."""
    if isnan(millimeters):
        return "none"
    return f"{millimeters:{sign}.3g} mm" if abs(millimeters) >= 0.9995 else f"{1e3 * millimeters:{sign}.3g} µm"
