"""Types of fields: what a number measures, and which numbers it may be.

They work in dataclasses, whose constructors `vamgpu.schema.check` them, and in pydantic's models, which read them from
text with units. ``Length`` is a float in mm everywhere in Python and ``"12.4 mm"`` in a file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite, pi
from typing import Annotated, Any

from vamgpu.errors import BadInput
from vamgpu.quantity import EXAMPLES, parse, positive, unit_of
from vamgpu.units import NAMES, dpt

PLAIN = {"plain": True}
"""Context of validation in which numbers come without units, in mm, s, mJ and rad, as in manifests."""


@dataclass(frozen=True)
class Quantity:
    """What a number measures, and its bounds.

    kind: a key of `vamgpu.quantity.SPELLINGS`; None for a plain number.  above, below: it is greater, and less.
    least, most: it is no less and no more.  hint: what to do about another one.
    scale: what 1 in Python is in mm, s and mJ.  endless: Python may say inf, files leave it out.
    whole: an integer.
    """

    kind: str | None = None
    above: float = -inf
    least: float = -inf
    most: float = inf
    below: float = inf
    hint: str = ""
    scale: float = 1.0
    endless: bool = False
    whole: bool = False

    @property
    def unit(self) -> str:
        """That files and messages write; "" for a plain number."""
        return "" if self.kind is None else unit_of(self.kind)

    @property
    def bounds(self) -> str:
        """In words and the unit that files write; "" where any number will do."""
        unit = self.scale / NAMES[self.unit] if self.unit else 1.0
        limits = ((">", self.above), ("≥", self.least), ("≤", self.most), ("<", self.below))
        return ", ".join(f"{sign} {limit * unit:.6g}" for sign, limit in limits if isfinite(limit))

    def _holds(self, value: float) -> bool:
        return self.above < value < self.below and self.least <= value <= self.most

    def check(self, name: str, value: Any) -> float | int:
        """``value`` as a float, or an integer where it is whole; else `BadInput`."""
        if self.endless and value == inf:
            return inf
        if self.above == 0.0 or self.least == 0.0:
            number = positive(name, value, zero=self.least == 0.0)
        else:
            number = finite(name, value)
        if not self._holds(number):
            raise BadInput(f"{name} is {number:g}; expected {self.hint or f'a number {self.bounds}'}")
        if self.whole and (isinstance(value, bool) or number != int(number)):
            raise BadInput(f"{name} is {value!r}; expected a whole number")
        return int(number) if self.whole else number

    def read(self, text: Any) -> float:
        """A number from text with its unit; raises `ValueError`."""
        signed = max(self.above, self.least) < 0.0
        value = parse(text, str(self.kind), zero=self.least == 0.0, signed=signed) / self.scale
        if not self._holds(value):
            shown = f"{value * self.scale / NAMES[self.unit]:.6g} {self.unit}"
            raise ValueError(f"is {shown}; expected {self.bounds}: correct the value")
        return value

    def spell(self, value: float) -> str | float:
        """As a file writes it."""
        return value if self.kind is None else f"{value * self.scale / NAMES[self.unit]!r} {self.unit}"

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        every = (self.above, self.least, self.most, self.below)
        above, least, most, below = (limit if isfinite(limit) else None for limit in every)
        if self.whole:
            return core_schema.int_schema(strict=True, ge=None if least is None else int(least),
                                          le=None if most is None else int(most))  # fmt: skip
        number = core_schema.float_schema(strict=True, allow_inf_nan=False, gt=above, ge=least, le=most, lt=below)
        if self.kind is None:
            return number

        def read(value: Any, plain: Callable[[Any], float], info: Any) -> float:
            if isinstance(info.context, dict) and info.context.get("plain"):
                return plain(value)
            return self.read(value)

        return core_schema.with_info_wrap_validator_function(read, number)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        if self.kind is None:
            return handler(schema)
        return {"type": "string", "examples": [EXAMPLES[self.kind]]}


def finite(name: str, value: Any) -> float:
    """``value`` as a finite float, else `BadInput`."""
    try:
        number = float(value) if not isinstance(value, (str, bytes, bool)) else float("nan")
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not isfinite(number):
        raise BadInput(f"{name} is {value!r}; expected a finite number")
    return number


Length = Annotated[float, Quantity("a length", above=0.0)]
Thickness = Annotated[float, Quantity("a length", least=0.0)]
Far = Annotated[float, Quantity("a length", above=0.0, endless=True)]
"""A length that may be infinite."""
Width = Annotated[Any, Quantity("a length", least=0.0)]
"""A length that constructors also take from what measured it."""
Place = Annotated[float, Quantity("a length")]
"""A length that may be negative."""
Absorption = Annotated[float, Quantity("an absorption", least=0.0)]
Angle = Annotated[float, Quantity("an angle", above=0.0)]
Turn = Annotated[float, Quantity("an angle")]
"""An angle that may be negative."""
Step = Annotated[float, Quantity("an angle", above=0.0, most=pi, hint="half a turn or less")]
Gain = Annotated[float, Quantity(least=1.0, hint="a gain of at least 1")]
HalfTilt = Annotated[float, Quantity("an angle", above=-0.5 * pi, below=0.5 * pi)]
HalfAngle = Annotated[float, Quantity("an angle", least=0.0, below=0.5 * pi)]
Index = Annotated[
    float, Quantity(least=1.0, most=5.0, hint="a refractive index of at least 1, at most 5; give it relative to vacuum")
]
Share = Annotated[float, Quantity(least=0.0, most=1.0, hint="a share in 0..1")]
Deviation = Annotated[
    float, Quantity("a share", least=0.0, below=1.0, hint='± a share of it below 1: 0.05, or "5 %" in a file')
]
Fill = Annotated[float, Quantity(above=0.0, most=1.0, hint="a share of the pixel's area, above 0 and at most 1")]
Count = Annotated[int, Quantity(least=1.0, whole=True)]
Positive = Annotated[float, Quantity(above=0.0)]
NonNegative = Annotated[float, Quantity(least=0.0)]
Irradiance = Annotated[float, Quantity("an irradiance", above=0.0)]
Background = Annotated[float, Quantity("an irradiance", least=0.0)]
Dose = Annotated[float, Quantity("a dose", above=0.0)]
Speed = Annotated[float, Quantity("a speed", above=0.0)]
Time = Annotated[float, Quantity("a time", least=0.0)]
ExposureTime = Annotated[float, Quantity("a time", above=0.0)]
Rate = Annotated[float, Quantity("a rate", above=0.0)]
Density = Annotated[float, Quantity("a density", above=0.0)]
Viscosity = Annotated[float, Quantity("a viscosity", above=0.0)]
LensPower = Annotated[float, Quantity("a lens power", least=0.0, scale=dpt)]
"""In diopters."""
DataRate = Annotated[float, Quantity("a data rate", above=0.0, endless=True)]
Diffusivity = Annotated[float, Quantity("a diffusivity", above=0.0)]
Wavelength = Annotated[float, Quantity("a wavelength", above=0.0)]
