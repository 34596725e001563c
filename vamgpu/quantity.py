"""Numbers with units, as files write them: ``"12.4 mm"``, ``"67 um"``, ``"0.05 1/mm"``."""

from __future__ import annotations

import re
from math import isfinite, log
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.units import NAMES

QUANTITY = re.compile(r"\s*([-+]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")
SPELLINGS: dict[str, tuple[str, ...]] = {
    "a length": ("mm", "um", "µm", "cm", "m"),
    "an absorption": ("1/mm", "/mm", "1/cm", "/cm"),
    "a scattering coefficient": ("1/mm", "/mm", "1/cm", "/cm"),
    "an irradiance": ("mW/cm2", "W/cm2", "mW/mm2"),
    "a dose": ("mJ/cm3", "J/cm3", "mJ/mm3"),
    "a speed": ("mm/min", "mm/s", "mm/h", "m/min"),
    "an angular speed": ("deg/s", "°/s", "rpm", "rad/s"),
    "an angle": ("deg", "°", "rad"),
    "a time": ("ms", "s", "us", "µs", "min", "h", "d"),
    "a rate": ("Hz", "kHz"),
    "a density": ("kg/m3", "g/cm3", "g/mL"),
    "a viscosity": ("Pa s", "mPa s", "cP"),
    "a lens power": ("dpt",),
    "a data rate": ("MB/s", "GB/s"),
    "a diffusivity": ("mm2/s", "cm2/s", "m2/s"),
    "a molar mass": ("g/mol",),
    "a concentration": ("mol/m3", "mM", "mol/L"),
    "a temperature": ("K",),
    "a share of mass": ("wt%", "ppm"),
    "a wavelength": ("nm", "um", "µm"),
    "a share": ("%",),
}
"""Quantity → the units in which it may be written, the most usual first; `spelled` accepts further spellings."""
FOREIGN = {"in": 25.4, "inch": 25.4, "inches": 25.4, '"': 25.4, "mil": 0.0254, "thou": 0.0254, "ft": 304.8}
"""Units of length that files do not accept, in mm: the error converts them."""
EXAMPLES = {
    "a length": "12.4 mm", "an absorption": "0.05 1/mm", "an irradiance": "65 mW/cm2", "a dose": "100 mJ/cm3",
    "a speed": "48 mm/min", "an angular speed": "40 deg/s", "an angle": "0.5 deg", "a time": "5 ms", "a rate": "266 Hz",
    "a density": "1100 kg/m3",
    "a viscosity": "40 Pa s", "a lens power": "5 dpt", "a data rate": "400 MB/s", "a diffusivity": "3.27e-7 mm2/s",
    "a molar mass": "32 g/mol", "a concentration": "1 mol/m3", "a temperature": "293.15 K",
    "a share of mass": "0.4 wt%", "a wavelength": "405 nm", "a scattering coefficient": "0.6 1/mm",
    "a share": "5 %",
}  # fmt: skip


FAR = 100.0  # a number without a unit is shown in another unit than an example if their ratio exceeds this
RAISED = str.maketrans("⁻¹²³μ·⋅", "-123µ  ", "^")
"""Superscript digits as plain ones, Greek mu as the micro sign, blanks for dots, no caret."""
PER = re.compile(r"(.*?) *(?<![a-z])([a-z]+)-([123])")


def spelled(unit: str) -> str:
    """A unit as `SPELLINGS` writes it: ``mJ/cm³``, ``mJ/cm^3``, ``mJ cm-3``, ``mJ cm⁻³`` are ``mJ/cm3``."""
    plain = unit.translate(RAISED)
    per = PER.fullmatch(plain)
    return plain if per is None else f"{per[1]}/{per[2]}{per[3] if per[3] != '1' else ''}"


def positive(name: str, value: float, *, zero: bool = False) -> float:
    """``value`` as a float if it is finite and positive (or zero, where allowed), else `BadInput`."""
    try:
        number = float(value) if not isinstance(value, (str, bytes)) else float("nan")
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"{name} is {value!r}; expected a number") from error
    if not isfinite(number) or number < 0 or (number == 0 and not zero):
        raise BadInput(f"{name} is {value!r}; expected a finite number {'≥' if zero else '>'} 0")
    return number


def meant(value: float, least: float, most: float) -> str | None:
    """The unit of length that was likely meant for a number in mm outside these bounds; None if none fits."""
    return next((unit for unit in ("um", "nm", "m", "cm") if least <= value * NAMES[unit] <= most), None)


def unit_of(kind: str) -> str:
    """The unit of a kind in which the library computes, or else its most usual one."""
    return next((unit for unit in SPELLINGS[kind] if NAMES[unit] == 1.0), SPELLINGS[kind][0])


def like(example: str, kind: str, number: float | None = None) -> str:
    """How to write a quantity: the example, or a number in the unit that brings it nearest to the example."""
    read = QUANTITY.fullmatch(example)
    if number is None or read is None:
        return f'write it like "{example}"'
    units, typical = (spelled(read[2]), *SPELLINGS[kind]), float(read[1]) * NAMES[spelled(read[2])]
    far = [abs(log(abs(number) * NAMES[unit] / typical)) if number else 0.0 for unit in units]
    return f'write it like "{number:g} {units[0 if far[0] < log(FAR) else far.index(min(far))]}"'


def parse(text: Any, kind: str, *, zero: bool = False, signed: bool = False, example: str = "") -> float:
    """A quantity in mm, s and mJ; ``kind`` is a key of `SPELLINGS`. Raises `ValueError` with what it expects."""
    example = example or EXAMPLES[kind]
    if not isinstance(text, str):
        plain = isinstance(text, int | float) and not isinstance(text, bool)
        raise ValueError(f"expected {kind} with its unit in quotes: {like(example, kind, text if plain else None)}")
    match = QUANTITY.fullmatch(text)
    if match is None:
        raise ValueError(f"expected {kind}, a number and a unit: {like(example, kind)}")
    number, unit = float(match[1].replace("_", "")), spelled(match[2] or "")
    if unit not in SPELLINGS[kind]:
        got = repr(match[2]) if unit else "a number without a unit"
        hint = like(example, kind, None if unit else number)
        if kind == "a length" and unit in FOREIGN:
            mm = f"{number * FOREIGN[unit]:.6g} mm"
            got, hint = f"{got} ({number:g} × {FOREIGN[unit]:g} mm = {mm})", like(mm, kind)
        raise ValueError(f"expected {kind} in {', '.join(SPELLINGS[kind])}, not {got}: {hint}")
    value = number * NAMES[unit]
    if not isfinite(value) or (not signed and (value < 0 or (value == 0 and not zero))):
        raise ValueError(f"expected {kind}{'' if signed else ' ≥ 0' if zero else ' > 0'}: {like(example, kind)}")
    return value


def counted(number: float, noun: str, form: str = "") -> str:
    """A number of things in words: ``1 turn``, ``0.5 turns``."""
    text = f"{number:{form}}"
    return f"{text} {noun}{'s' * (text != '1')}"


SIZES = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12,
         "KIB": 2**10, "MIB": 2**20, "GIB": 2**30, "TIB": 2**40}  # fmt: skip


def bytes_of(text: str) -> int | None:
    """Read a size of memory such as ``24 GB`` in bytes; None if the text is not a size above zero."""
    found = re.fullmatch(r"([0-9]{1,15}(?:\.[0-9]{1,15})?)\s*([A-Za-z]*)", text.strip())
    unit = SIZES.get(found[2].upper()) if found else None
    return int(float(found[1]) * unit) or None if found and unit else None
