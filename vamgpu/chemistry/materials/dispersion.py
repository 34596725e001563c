"""Refractive index against wavelength, only at wavelengths covered by measurements."""

from __future__ import annotations

from math import sqrt
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from vamgpu.chemistry.materials.source import Numbers, Source, Wavelengths
from vamgpu.errors import OutsideData
from vamgpu.geometry import positive
from vamgpu.schema.section import Listed, Section
from vamgpu.units import nm, um

NEAR = 0.5 * nm  # a wavelength this close to a single measured one counts as equal to it


def within(name: str, wavelength: float, low: float, high: float) -> float:
    """The wavelength [mm], moved onto the data if it misses them by at most `NEAR`. Raises `OutsideData`."""
    value = positive("wavelength [mm]", wavelength)
    if not low - NEAR <= value <= high + NEAR:
        data = f"{low / nm:g} nm" if low == high else f"{low / nm:g} to {high / nm:g} nm"
        raise OutsideData(
            f"wavelength is {value / nm:g} nm; {name} is known at {data}: choose one of these, or add data in a file"
        )
    return min(max(value, low), high)


class Spectrum(Section):
    """Numbers against wavelength."""

    wavelength: Wavelengths  # in vacuum [mm], ascending
    source: Source  # where the numbers are from

    @field_validator("wavelength")
    @classmethod
    def _ascending(cls, wavelength: tuple[float, ...]) -> tuple[float, ...]:
        if np.any(np.diff(wavelength) <= 0):
            raise ValueError("expected ascending wavelengths, none twice")
        return wavelength

    @property
    def range(self) -> tuple[float, float]:
        """First and last wavelength [mm]."""
        return self.wavelength[0], self.wavelength[-1]


class Dispersion(Spectrum):
    """Refractive index n(λ), λ in µm in the formulas.

    Args:
        form: "sellmeier": n² = 1 + constant + Σ Bᵢλ²/(λ² − Cᵢ), terms (B, C [µm²]); "powers": n² = constant + Σ aᵢλ^pᵢ,
            terms (a, p); "cauchy": n = constant + Σ aᵢλ^pᵢ; "points": ``index`` at ``wavelength``, linear between them.
        wavelength: The first and the last wavelength [mm] of the formula, or those of all points, ascending.
        constant: The formula's constant, dimensionless.
        terms: The formula's coefficients, in pairs.
        index: Refractive index at each wavelength of "points".
        temperature: Temperature of the measurement [K].
        source: Source of the numbers.
    """

    form: Literal["sellmeier", "powers", "cauchy", "points"]
    constant: float = 0.0
    terms: Annotated[tuple[tuple[float, float], ...], Listed] = ()
    index: Numbers | None = None
    temperature: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _complete(self) -> Dispersion:
        if self.form == "points":
            if self.index is None or len(self.index) != len(self.wavelength) or self.terms:
                raise ValueError(
                    'expected as many numbers in index as in wavelength, and no terms, for form = "points"'
                )
        elif len(self.wavelength) != 2 or not self.terms or self.index is not None:
            raise ValueError(
                f'expected the first and the last wavelength, terms and no index, for form = "{self.form}"'
            )
        low = min(self._at(w / um) for w in np.linspace(self.wavelength[0], self.wavelength[-1], 201))
        if not low >= 1.0:
            raise ValueError(f"the index falls to {low:.4g} within its wavelengths; expected at least 1 everywhere")
        return self

    def at(self, wavelength: float) -> float:
        """Refractive index at a wavelength.

        Args:
            wavelength: In vacuum [mm], as ``405 * units.nm``.

        Returns:
            Refractive index, dimensionless.

        Raises:
            OutsideData: No source covers that wavelength.
            BadInput: A value is out of its range.
        """
        return self._at(within("the refractive index", wavelength, *self.range) / um)

    def _at(self, micrometers: float) -> float:
        square = micrometers**2
        if self.form == "points":
            return float(np.interp(micrometers, np.divide(self.wavelength, um), self.index or ()))
        if self.form == "sellmeier":
            return _root(1.0 + self.constant + sum(b * square / (square - c) for b, c in self.terms))
        value = self.constant + sum(a * micrometers**power for a, power in self.terms)
        return _root(value) if self.form == "powers" else value


def _root(square: float) -> float:
    return sqrt(square) if square > 0 else 0.0
