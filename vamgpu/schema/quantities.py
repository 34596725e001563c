"""Types of fields: the quantity that a number measures, and its allowed range.

`vamgpu.schema.check` applies them in dataclasses, pydantic in models, where ``Length`` also reads ``"12.4 mm"``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite, pi
from typing import Annotated, Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.quantity import EXAMPLES, meant, parse, positive, unit_of
from vamgpu.units import NAMES, dpt

PLAIN = {"plain": True}  # validation context for numbers without units, in mm, s, mJ and rad, as in manifests


@dataclass(frozen=True)
class Quantity:
    """Kind and bounds of a number: ``above`` < number < ``below``, ``least`` ≤ number ≤ ``most``."""

    kind: str | None = None  # key of `vamgpu.quantity.SPELLINGS`; None for a plain number
    above: float = -inf
    least: float = -inf
    most: float = inf
    below: float = inf
    hint: str = ""  # remedy for a number out of bounds
    scale: float = 1.0  # value, in mm, s and mJ, of 1 in Python
    endless: bool = False  # Python accepts inf; files omit such keys
    whole: bool = False
    usual: tuple[float, float] | None = None  # lengths [mm] outside this range must state their unit
    example: str = ""  # how errors say to write it; by default that of its kind

    @property
    def unit(self) -> str:
        """Unit in files and messages; "" for a plain number."""
        return "" if self.kind is None else unit_of(self.kind)

    @property
    def bounds(self) -> str:
        """Bounds in words, in the unit of files; "" if any number is allowed."""
        unit = self.scale / NAMES[self.unit] if self.unit else 1.0
        limits = ((">", self.above), ("≥", self.least), ("≤", self.most), ("<", self.below))
        return ", ".join(f"{sign} {limit * unit:.6g}" for sign, limit in limits if isfinite(limit))

    def _holds(self, value: float) -> bool:
        return self.above < value < self.below and self.least <= value <= self.most

    def check(self, name: str, value: Any) -> float | int:
        """``value`` as a float, or as an integer if it is whole; else `BadInput`."""
        if self.endless and value == inf:
            return inf
        if self.above == 0.0 or self.least == 0.0:
            number = positive(name, value, zero=self.least == 0.0)
        else:
            number = finite(name, value)
        if not self._holds(number):
            raise BadInput(f"{name} is {number:g}; expected {self.hint or f'a number {self.bounds}'}")
        if slip := self._slip(number):
            usual, unit = slip
            likely = "" if unit is None else f"; if {number:g} {unit} was meant, write {number:g} * vamgpu.units.{unit}"
            raise BadInput(f"{name} is {number:g}; expected {usual}: check the unit{likely}")
        if self.whole and (isinstance(value, bool) or number != int(number)):
            raise BadInput(f"{name} is {value!r}; expected a whole number")
        return int(number) if self.whole else number

    def read(self, text: Any) -> float:
        """A number from text with its unit; raises `ValueError`."""
        signed = max(self.above, self.least) < 0.0
        value = parse(text, str(self.kind), zero=self.least == 0.0, signed=signed, example=self.example)
        value /= self.scale
        if not self._holds(value):
            shown = f"{value * self.scale / NAMES[self.unit]:.6g} {self.unit}"
            raise ValueError(f"is {shown}; expected {self.bounds}: correct the value")
        if slip := self._slip(value):
            likely = "" if slip[1] is None else f'; was "{value:g} {slip[1]}" meant?'
            raise ValueError(f"is {value:g} mm; expected {slip[0]}: check the unit{likely}")
        return value

    def _slip(self, value: float) -> tuple[str, str | None] | None:
        """Usual lengths in words, and the likely unit of a length outside this range; None for a usual length."""
        if self.usual is None or self.usual[0] <= value <= self.usual[1]:
            return None
        least, most = self.usual
        return f"{least:g} to {most:g} mm" if least else f"at most {most:g} mm", meant(value, least, most)

    def spell(self, value: float) -> str | float:
        """The number as a file writes it."""
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
        return {"type": "string", "examples": [self.example or EXAMPLES[self.kind]]}


def measured(name: str, value: Any, kind: Any) -> float:
    """A number, or text with its unit, checked against a type of this module such as `Length`; else `BadInput`."""
    quantity = next(part for part in kind.__metadata__ if isinstance(part, Quantity))
    if isinstance(value, str) and quantity.kind is not None:
        try:
            return quantity.read(value)
        except ValueError as error:
            raise BadInput(f"{name}: got {value!r}; {error}") from error
    return quantity.check(f"{name} [{quantity.unit}]" if quantity.unit else name, value)


def finite(name: str, value: Any) -> float:
    """``value`` as a finite float, else `BadInput`."""
    try:
        number = float(value) if not isinstance(value, (str, bytes, bool)) else float("nan")
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not isfinite(number):
        raise BadInput(f"{name} is {value!r}; expected a finite number")
    return number


def numeric(
    name: str, values: Any, axes: tuple[int, ...] = (1,), expected: str = "a list of numbers, finite and at least one"
) -> np.ndarray:
    """``values`` as finite float64, at least one on one of these numbers of axes, if given; else `BadInput`."""
    try:
        numbers = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise BadInput(f"{name} is {values!r}; expected {expected}") from error
    if (axes and (numbers.ndim not in axes or not numbers.size)) or not np.isfinite(numbers).all():
        raise BadInput(f"{name} has shape {numbers.shape} and {np.count_nonzero(~np.isfinite(numbers))} numbers that "
                       f"are not finite; expected {expected}")  # fmt: skip
    return numbers


Length = Annotated[float, Quantity("a length", above=0.0)]
Pitch = Annotated[float, Quantity("a length", above=0.0, usual=(0.0, 25.0), example="50 um")]  # the edge of a voxel
PixelPitch = Annotated[float, Quantity("a length", above=0.0, usual=(1e-4, 25.0), example="67 um")]
VesselRadius = Annotated[float, Quantity("a length", above=0.0, usual=(0.05, 1000.0))]
Thickness = Annotated[float, Quantity("a length", least=0.0)]
Far = Annotated[float, Quantity("a length", above=0.0, endless=True)]  # a length that may be infinite
Width = Annotated[Any, Quantity("a length", least=0.0, example="25 um")]
"""A length; constructors also take a calibration in its place."""
Place = Annotated[float, Quantity("a length")]  # a length that may be negative
Absorption = Annotated[float, Quantity("an absorption", least=0.0)]
ScatteringCoefficient = Annotated[float, Quantity("a scattering coefficient", above=0.0)]
Angle = Annotated[float, Quantity("an angle", above=0.0)]
Turn = Annotated[float, Quantity("an angle")]  # an angle that may be negative
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
ExposureTime = Annotated[float, Quantity("a time", above=0.0, example="20 s")]
FrameTime = Annotated[float, Quantity("a time", above=0.0)]
PauseTime = Annotated[float, Quantity("a time", least=0.0, example="30 s")]
Age = Annotated[float, Quantity("a time", least=0.0, example="90 d")]
Rate = Annotated[float, Quantity("a rate", above=0.0)]
Density = Annotated[float, Quantity("a density", above=0.0)]
DensityDifference = Annotated[float, Quantity("a density", example="20 kg/m3")]  # a density that may be negative
Viscosity = Annotated[float, Quantity("a viscosity", above=0.0)]
LensPower = Annotated[float, Quantity("a lens power", least=0.0, scale=dpt)]  # in diopters
DataRate = Annotated[float, Quantity("a data rate", above=0.0, endless=True)]
Diffusivity = Annotated[float, Quantity("a diffusivity", above=0.0)]
Wavelength = Annotated[float, Quantity("a wavelength", above=0.0)]
