"""One number of a report, ready to be read."""

from __future__ import annotations

from math import isnan
from typing import NamedTuple


class Line(NamedTuple):
    """One number with its name and meaning."""

    name: str
    value: str
    meaning: str


def length(millimeters: float, sign: str = "") -> str:
    """A length in µm, from a millimeter on in mm, with three digits; "none" for NaN. ``sign`` as formats have it."""
    if isnan(millimeters):
        return "none"
    return f"{millimeters:{sign}.3g} mm" if abs(millimeters) >= 0.9995 else f"{1e3 * millimeters:{sign}.3g} µm"
