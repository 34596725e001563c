"""Checks and small formulas that the vessels share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vamgpu.geometry import Vessel
from vamgpu.schema.quantities import numeric

Floats = NDArray[np.float64]

LOW_TRANSMITTANCE = 0.8  # share of the light below which a vessel warns: regions with less light print late


class Container(Vessel):
    """A vessel that limits the radius of a target."""

    def check_fits(self, radius: float) -> None:
        """Check that a target of this radius about the axis can be printed.

        Args:
            radius: Radius of the target [mm].

        Raises:
            BadInput: The radius is not a finite number above 0.
            TargetTooLarge: The radius exceeds the printable radius.

        Warns:
            OpticsWarning: Faces, windows or liquid transmit less than 0.8 of the light within the radius.
        """
        raise NotImplementedError


def as_offsets(name: str, value: ArrayLike) -> Floats:
    """Return the value as float64; raises BadInput if it is not finite."""
    return numeric(name, value, (), "finite numbers throughout")


def absorbed_share(absorption: float, path: Floats) -> Floats:
    """Power absorbed per mm after a path in resin [1/mm], or 1 if the resin absorbs nothing."""
    if absorption > 0:
        return absorption * np.exp(-absorption * path)
    return np.ones_like(path)
