"""Numbers with units, as job files write them: ``"12.4 mm"``, ``"67 um"``, ``"0.05 1/mm"``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import BeforeValidator

from vamgpu.quantity import SPELLINGS, parse

__all__ = ["SPELLINGS", "parse"]


def _as(kind: str, *, zero: bool = False) -> BeforeValidator:
    read: Callable[[Any], float] = lambda text: parse(text, kind, zero=zero)  # noqa: E731
    return BeforeValidator(read)


Length = Annotated[float, _as("a length")]
Thickness = Annotated[float, _as("a length", zero=True)]


def _spread(text: Any) -> float | str:
    """A length, or the path of a calibration: what begins like a number and is no file is a length."""
    if isinstance(text, str) and (text.endswith(".toml") or "/" in text or "\\" in text or text[:1].isalpha()):
        return text
    try:
        return parse(text, "a length", zero=True)
    except ValueError as error:
        raise ValueError(f"{error}; or the path of a calibration: spread = \"mtf/result.toml\"") from error


Spread = Annotated[float | str, BeforeValidator(_spread)]
"""Of a point spread: 0 and above, or the path of what `vam calibrate mtf` wrote."""
Absorption = Annotated[float, _as("an absorption", zero=True)]
Irradiance = Annotated[float, _as("an irradiance")]
Background = Annotated[float, _as("an irradiance", zero=True)]
DoseValue = Annotated[float, _as("a dose")]
Speed = Annotated[float, _as("a speed")]
Angle = Annotated[float, _as("an angle")]
Exposure = Annotated[float, _as("a time")]
Time = Annotated[float, _as("a time", zero=True)]
Rate = Annotated[float, _as("a rate")]
Density = Annotated[float, _as("a density")]
Viscosity = Annotated[float, _as("a viscosity")]
LensPower = Annotated[float, _as("a lens power", zero=True)]
DataRate = Annotated[float, _as("a data rate")]
