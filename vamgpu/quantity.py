"""Numbers with units, as files write them: ``"12.4 mm"``, ``"67 um"``, ``"0.05 1/mm"``."""

from __future__ import annotations

import re
from math import isfinite
from typing import Any

from vamgpu.units import NAMES

QUANTITY = re.compile(r"\s*([-+]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")
SPELLINGS = {
    "a length": ("mm", "um", "µm", "cm", "m"),
    "an absorption": ("1/mm", "/mm", "1/cm", "/cm"),
    "an irradiance": ("mW/cm2", "mW/cm²", "mW/mm2", "mW/mm²"),
    "a dose": ("mJ/cm3", "mJ/cm³", "mJ/mm3", "mJ/mm³"),
    "a speed": ("mm/min", "mm/s", "mm/h", "m/min"),
    "an angle": ("deg", "°", "rad"),
    "a time": ("ms", "s", "us", "µs", "min"),
    "a rate": ("Hz", "kHz"),
    "a density": ("kg/m3", "kg/m³", "g/cm3", "g/cm³"),
    "a viscosity": ("Pa s", "mPa s"),
    "a lens power": ("dpt",),
    "a data rate": ("MB/s", "GB/s"),
    "a diffusivity": ("mm2/s", "mm²/s", "cm2/s", "cm²/s", "m2/s", "m²/s"),
    "a molar mass": ("g/mol",),
    "a concentration": ("mol/m3", "mol/m³", "mM", "mol/L"),
    "a temperature": ("K",),
    "a share of mass": ("wt%", "ppm"),
    "a wavelength": ("nm", "um", "µm"),
}
"""What is measured → the units it may be written in, the most usual first."""
EXAMPLES = {
    "a length": "12.4 mm", "an absorption": "0.05 1/mm", "an irradiance": "5 mW/cm2", "a dose": "40 mJ/cm3",
    "a speed": "48 mm/min", "an angle": "0.5 deg", "a time": "5 ms", "a rate": "266 Hz", "a density": "1100 kg/m3",
    "a viscosity": "40 Pa s", "a lens power": "5 dpt", "a data rate": "400 MB/s", "a diffusivity": "3.27e-7 mm2/s",
    "a molar mass": "32 g/mol", "a concentration": "1 mol/m3", "a temperature": "293.15 K",
    "a share of mass": "0.4 wt%", "a wavelength": "405 nm",
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
