"""Numbers with units, as job files write them: ``"12.4 mm"``, ``"67 um"``, ``"0.05 1/mm"``."""

from __future__ import annotations

import re
from collections.abc import Callable
from math import isfinite
from typing import Annotated, Any

from pydantic import BeforeValidator

from vamgpu.units import NAMES

QUANTITY = re.compile(r"\s*([-+]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")
SPELLINGS = {
    "a length": ("mm", "um", "µm", "cm", "m"),
    "an absorption": ("1/mm", "/mm", "1/cm", "/cm"),
    "an irradiance": ("mW/cm2", "mW/cm²", "mW/mm2", "mW/mm²"),
    "a dose": ("mJ/cm3", "mJ/cm³", "mJ/mm3", "mJ/mm³"),
    "a speed": ("mm/min", "mm/s", "m/min"),
    "an angle": ("deg", "°", "rad"),
    "a time": ("ms", "s", "us", "µs", "min"),
    "a rate": ("Hz", "kHz"),
    "a density": ("kg/m3", "kg/m³", "g/cm3", "g/cm³"),
    "a viscosity": ("Pa s", "mPa s"),
    "a lens power": ("dpt",),
    "a data rate": ("MB/s", "GB/s"),
}
"""What is measured → the units it may be written in, the most usual first."""
EXAMPLES = {
    "a length": "12.4 mm", "an absorption": "0.05 1/mm", "an irradiance": "5 mW/cm2", "a dose": "40 mJ/cm3",
    "a speed": "48 mm/min", "an angle": "0.5 deg", "a time": "5 ms", "a rate": "266 Hz", "a density": "1100 kg/m3",
    "a viscosity": "40 Pa s", "a lens power": "5 dpt", "a data rate": "400 MB/s",
}  # fmt: skip


def parse(text: Any, kind: str, *, zero: bool = False) -> float:
    """A quantity in mm, s and mJ; ``kind`` is a key of `SPELLINGS`. Raises `ValueError` saying what was wanted."""
    example = f'write it like "{EXAMPLES[kind]}"'
    if not isinstance(text, str):
        raise ValueError(f"wanted {kind} with its unit in quotes: {example}")
    match = QUANTITY.fullmatch(text)
    if match is None:
        raise ValueError(f"wanted {kind}, a number and a unit: {example}")
    number, unit = float(match[1].replace("_", "")), match[2]
    if unit not in SPELLINGS[kind]:
        got = f"unit {unit!r}" if unit else "no unit"
        raise ValueError(f"{got}; wanted {kind} in {', '.join(SPELLINGS[kind])}: {example}")
    value = number * NAMES[unit]
    if not isfinite(value) or value < 0 or (value == 0 and not zero):
        raise ValueError(f"wanted {kind} {'≥' if zero else '>'} 0: {example}")
    return value


def _as(kind: str, *, zero: bool = False) -> BeforeValidator:
    read: Callable[[Any], float] = lambda text: parse(text, kind, zero=zero)  # noqa: E731
    return BeforeValidator(read)


Length = Annotated[float, _as("a length")]
Thickness = Annotated[float, _as("a length", zero=True)]
Absorption = Annotated[float, _as("an absorption", zero=True)]
Irradiance = Annotated[float, _as("an irradiance")]
DoseValue = Annotated[float, _as("a dose")]
Speed = Annotated[float, _as("a speed")]
Angle = Annotated[float, _as("an angle")]
Time = Annotated[float, _as("a time", zero=True)]
Rate = Annotated[float, _as("a rate")]
Density = Annotated[float, _as("a density")]
Viscosity = Annotated[float, _as("a viscosity")]
LensPower = Annotated[float, _as("a lens power", zero=True)]
DataRate = Annotated[float, _as("a data rate")]
