"""Rules of every table of a material's file: no unknown keys, and a source for every number."""

from __future__ import annotations

from typing import Annotated, Any, Generic, TypeVar

from pydantic import BeforeValidator, Field

from vamgpu.quantity import parse
from vamgpu.schema.section import Listed, Section


def _quantity(kind: str) -> BeforeValidator:
    return BeforeValidator(lambda text: parse(text, kind))


def quantities(kind: str, zero: bool = False) -> BeforeValidator:
    """Reads a list of quantities."""

    def read(values: Any) -> Any:
        return tuple(parse(text, kind, zero=zero) for text in values) if isinstance(values, list) else values

    return BeforeValidator(read)


Source = Annotated[str, Field(min_length=12, pattern=r"\S")]
"""Source of a number, precise enough to find it again."""
Wavelengths = Annotated[tuple[float, ...], quantities("a wavelength"), Field(min_length=1)]
Numbers = Annotated[tuple[float, ...], Listed, Field(min_length=1)]


Value = TypeVar("Value")


class Number(Section, Generic[Value]):
    """A number and where it was found."""

    value: Value
    source: Source

    def __repr_name__(self) -> str:
        return "Number"


Viscosity = Number[Annotated[float, _quantity("a viscosity")]]
"""[mJ·s/mm³], in files "18.8 Pa s"."""
Density = Number[Annotated[float, _quantity("a density")]]
"""[mJ·s²/mm⁵], in files "1.14 g/cm3"."""
MolarMass = Number[Annotated[float, _quantity("a molar mass")]]
"""[g/mol]."""
Temperature = Number[Annotated[float, _quantity("a temperature")]]
"""[K]."""
Concentration = Number[Annotated[float, _quantity("a concentration")]]
"""[mol/m³], which is mM."""
CriticalDose = Number[Annotated[float, _quantity("a dose")]]
"""[mJ/mm³], in files "50 mJ/cm3"."""
Duration = Number[Annotated[float, _quantity("a time")]]
"""[s]."""
Share = Number[Annotated[float, _quantity("a share of mass"), Field(le=1.0)]]
"""Share of the mass, 0..1; in files "0.4 wt%"."""
