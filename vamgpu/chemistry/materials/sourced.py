"""What every table of a material's file obeys: nothing unknown, nothing without a source."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from vamgpu.quantity import parse


def tupled(value: Any) -> Any:
    """Lists of a TOML file as tuples."""
    return tuple(tupled(entry) for entry in value) if isinstance(value, list) else value


def _quantity(kind: str) -> BeforeValidator:
    return BeforeValidator(lambda text: parse(text, kind))


def _quantities(kind: str) -> BeforeValidator:
    def read(values: Any) -> Any:
        return tuple(parse(text, kind) for text in values) if isinstance(values, list) else values

    return BeforeValidator(read)


Source = Annotated[str, Field(min_length=12, pattern=r"\S")]
"""Where a number was found, so that somebody else finds it there."""
Wavelength = Annotated[float, _quantity("a wavelength")]
Wavelengths = Annotated[tuple[float, ...], _quantities("a wavelength"), Field(min_length=1)]
Numbers = Annotated[tuple[float, ...], BeforeValidator(tupled), Field(min_length=1)]


class Sourced(BaseModel):
    """A table of a material's file."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Viscosity(Sourced):
    """value: [mJ·s/mm³], in files "18.8 Pa s"."""

    value: Annotated[float, _quantity("a viscosity")]
    source: Source


class Density(Sourced):
    """value: [mJ·s²/mm⁵], in files "1.14 g/cm3"."""

    value: Annotated[float, _quantity("a density")]
    source: Source


class MolarMass(Sourced):
    """value: [g/mol]."""

    value: Annotated[float, _quantity("a molar mass")]
    source: Source


class Temperature(Sourced):
    """value: [K]."""

    value: Annotated[float, _quantity("a temperature")]
    source: Source


class Concentration(Sourced):
    """value: [mol/m³], which is mM."""

    value: Annotated[float, _quantity("a concentration")]
    source: Source


class CriticalDose(Sourced):
    """value: [mJ/mm³], in files "50 mJ/cm3"."""

    value: Annotated[float, _quantity("a dose")]
    source: Source


class Diffusivity(Sourced):
    """value: [mm²/s]."""

    value: Annotated[float, _quantity("a diffusivity")]
    source: Source


class Duration(Sourced):
    """value: [s]."""

    value: Annotated[float, _quantity("a time")]
    source: Source


class Share(Sourced):
    """value: share of the mass, 0..1; in files "0.4 wt%"."""

    value: Annotated[float, _quantity("a share of mass"), Field(le=1.0)]
    source: Source
