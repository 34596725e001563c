"""Absorption against wavelength."""

from __future__ import annotations

from math import pi
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from vamgpu.chemistry.materials.dispersion import Spectrum, within
from vamgpu.chemistry.materials.source import quantities
from vamgpu.schema.section import Listed


class Extinction(Spectrum):
    """Absorption at measured wavelengths and linear between them; either absorption or k is given.

    Args:
        wavelength: In vacuum [mm], ascending.
        absorption: Per length [1/mm] and natural: light falls as e^{−μx}.
        k: Imaginary part of the refractive index, μ = 4πk/λ.
        source: Source of the numbers.
    """

    absorption: Annotated[tuple[float, ...] | None, quantities("an absorption", zero=True)] = None
    k: Annotated[tuple[Annotated[float, Field(ge=0)], ...] | None, Listed] = None

    @model_validator(mode="after")
    def _complete(self) -> Extinction:
        if (self.absorption is None) == (self.k is None):
            raise ValueError("expected exactly one of absorption and k")
        if len(self.wavelength) != len(self.absorption or self.k or ()):
            raise ValueError("expected as many values as wavelengths")
        return self

    def at(self, wavelength: float) -> float:
        """Absorption at a wavelength.

        Args:
            wavelength: In vacuum [mm].

        Returns:
            Absorption [1/mm], natural logarithm.

        Raises:
            OutsideData: No source covers that wavelength.
            BadInput: A value is out of its range.
        """
        place = within("the absorption", wavelength, *self.range)
        if self.absorption is not None:
            return float(np.interp(place, self.wavelength, self.absorption))
        return 4.0 * pi * float(np.interp(place, self.wavelength, self.k or ())) / place
