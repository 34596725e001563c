"""Concentrations in a box of resin, voxel by voxel, and the effect of the light so far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.species import SPECIES
from vamgpu.errors import BadInput

NEVER = -1.0  # value of the fields of times in voxels that have not crossed the threshold


@dataclass(eq=False)
class Concentrations:
    """Fields of A, B and C [mol/m³ or normalized], the dose that started chains, and crossing time; on one device."""

    a: DeviceArray
    b: DeviceArray
    c: DeviceArray
    dose: DeviceArray  # light whose radicals met no inhibitor [mJ/mm²]
    optical_time: DeviceArray  # when the dose crossed T_opt [s], `NEVER` before
    mechanical_time: DeviceArray  # likewise T_mec
    time: float = 0.0  # time so far [s]

    FIELDS = ("a", "b", "c", "dose", "optical_time", "mechanical_time")

    def species(self, name: str) -> DeviceArray:
        """The field of "A", "B" or "C". Raises `BadInput` for another name."""
        if name not in SPECIES:
            raise BadInput(f"no species is named {name!r}; there are {', '.join(SPECIES)}")
        return getattr(self, name.lower())

    def numpy(self) -> dict[str, np.ndarray]:
        """Every field by its name."""
        return {name: getattr(self, name).numpy() for name in self.FIELDS}
