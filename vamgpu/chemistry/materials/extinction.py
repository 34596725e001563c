"""Absorption against wavelength."""

from __future__ import annotations

from math import pi
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from vamgpu.chemistry.materials.dispersion import within
from vamgpu.chemistry.materials.sourced import Source, Sourced, Wavelengths, tupled
from vamgpu.quantity import parse


def _absorptions(values: Any) -> Any:
    if not isinstance(values, list):
        return values
    return tuple(parse(text, "an absorption", zero=True) for text in values)


class Extinction(Sourced):
    """What light loses on its way, at measured wavelengths and linear between them.

    Either ``absorption`` [1/mm], per length and natural (light falls as e^{−μx}), or ``k``, the imaginary part of the
    refractive index: μ = 4πk/λ.
    """

    wavelength: Wavelengths
    absorption: Annotated[tuple[float, ...] | None, BeforeValidator(_absorptions)] = None
    k: Annotated[tuple[Annotated[float, Field(ge=0)], ...] | None, BeforeValidator(tupled)] = None
    source: Source

    @model_validator(mode="after")
    def _complete(self) -> Extinction:
        if np.any(np.diff(self.wavelength) <= 0):
            raise ValueError("wanted ascending wavelengths, none twice")
        if (self.absorption is None) == (self.k is None):
            raise ValueError("wanted exactly one of absorption and k")
        if len(self.wavelength) != len(self.absorption or self.k or ()):
            raise ValueError("wanted as many values as wavelengths")
        return self

    @property
    def range(self) -> tuple[float, float]:
        """First and last wavelength [mm]."""
        return self.wavelength[0], self.wavelength[-1]

    def at(self, wavelength: float) -> float:
        """Absorption [1/mm] at a wavelength [mm]. Raises `OutsideData`, `BadInput`."""
        place = within("the absorption", wavelength, *self.range)
        if self.absorption is not None:
            return float(np.interp(place, self.wavelength, self.absorption))
        return 4.0 * pi * float(np.interp(place, self.wavelength, self.k or ())) / place
