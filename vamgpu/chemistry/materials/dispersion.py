"""Refractive index against wavelength, and nothing beyond the wavelengths it was measured at."""

from __future__ import annotations

from math import sqrt
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from vamgpu.chemistry.materials.sourced import Numbers, Source, Sourced, Wavelengths, tupled
from vamgpu.errors import OutsideData
from vamgpu.geometry import positive
from vamgpu.units import nm, um

NEAR = 0.5 * nm
"""A wavelength this near to a single measured one is taken for it."""


def within(name: str, wavelength: float, low: float, high: float) -> float:
    """The wavelength [mm], moved onto the data where it misses them by at most `NEAR`. Raises `OutsideData`."""
    value = positive("wavelength [mm]", wavelength)
    if not low - NEAR <= value <= high + NEAR:
        data = f"{low / nm:g} nm" if low == high else f"{low / nm:g} to {high / nm:g} nm"
        raise OutsideData(
            f"wavelength is {value / nm:g} nm; {name} is known at {data}: choose one of these, or add data in a file"
        )
    return min(max(value, low), high)


class Dispersion(Sourced):
    """Refractive index n(λ), λ in µm in the formulas.

    form: "sellmeier": n² = 1 + constant + Σ Bᵢλ²/(λ² − Cᵢ), terms (B, C [µm²]); "powers": n² = constant + Σ aᵢλ^pᵢ,
    terms (a, p); "cauchy": n = constant + Σ aᵢλ^pᵢ; "points": ``index`` at ``wavelength``, linear between them.
    wavelength: the first and the last one [mm] the formula holds for, or all of the points, ascending.
    """

    form: Literal["sellmeier", "powers", "cauchy", "points"]
    wavelength: Wavelengths
    constant: float = 0.0
    terms: Annotated[tuple[tuple[float, float], ...], BeforeValidator(tupled)] = ()
    index: Numbers | None = None
    temperature: Annotated[float, Field(gt=0)] | None = None
    source: Source

    @model_validator(mode="after")
    def _complete(self) -> Dispersion:
        if np.any(np.diff(self.wavelength) <= 0):
            raise ValueError("wanted ascending wavelengths, none twice")
        if self.form == "points":
            if self.index is None or len(self.index) != len(self.wavelength) or self.terms:
                raise ValueError('wanted as many numbers in index as in wavelength, and no terms, for form = "points"')
        elif len(self.wavelength) != 2 or not self.terms or self.index is not None:
            raise ValueError(f'wanted the first and the last wavelength, terms and no index, for form = "{self.form}"')
        low = min(self._at(w / um) for w in np.linspace(self.wavelength[0], self.wavelength[-1], 201))
        if not low >= 1.0:
            raise ValueError(f"the index falls to {low:.4g} within its wavelengths; wanted at least 1 everywhere")
        return self

    @property
    def range(self) -> tuple[float, float]:
        """First and last wavelength [mm]."""
        return self.wavelength[0], self.wavelength[-1]

    def at(self, wavelength: float) -> float:
        """Refractive index at a wavelength [mm], as ``405 * units.nm``. Raises `OutsideData`, `BadInput`."""
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
