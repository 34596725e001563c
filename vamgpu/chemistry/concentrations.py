"""What a box of resin holds, voxel by voxel, and what light has done to it so far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.species import SPECIES
from vamgpu.errors import BadInput
from vamgpu.geometry import positive

NEVER = -1.0
"""What the fields of times hold in voxels that have not crossed."""


@dataclass(eq=False)
class Concentrations:
    """Fields of A, B and C [mol/m³ or normalized], what light has started, and when; all on one device.

    dose: light whose radicals met no inhibitor [mJ/mm²].  optical_time, mechanical_time: when it crossed T_opt and
    T_mec [s], `NEVER` before.  time: reached so far [s].
    """

    a: DeviceArray
    b: DeviceArray
    c: DeviceArray
    dose: DeviceArray
    optical_time: DeviceArray
    mechanical_time: DeviceArray
    time: float = 0.0

    FIELDS = ("a", "b", "c", "dose", "optical_time", "mechanical_time")

    def species(self, name: str) -> DeviceArray:
        """The field of "A", "B" or "C". Raises `BadInput` for another name."""
        if name not in SPECIES:
            raise BadInput(f"no species is named {name!r}; there are {', '.join(SPECIES)}")
        return getattr(self, name.lower())

    def numpy(self) -> dict[str, np.ndarray]:
        """Every field by its name."""
        return {name: getattr(self, name).numpy() for name in self.FIELDS}

    def conversion(self, scale: float) -> np.ndarray:
        """Share of polymer, 1 − exp(−dose/scale): nothing polymerizes before the inhibitors are exhausted."""
        return -np.expm1(-self.dose.numpy() / positive("scale of conversion [mJ/mm²]", scale))
