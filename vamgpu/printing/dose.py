"""Calibrated dose: the one place where light in mW/mm² becomes energy in mJ/mm³."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.operators.dose_unit import absorbs, dose_unit
from vamgpu.operators.projection import Projection

__all__ = ["Dose", "absorbed_dose", "absorbs", "dose_unit"]


@dataclass(frozen=True, eq=False)
class Dose:
    """Energy absorbed per volume: ``field`` [x, y, z] on the device times ``unit`` is mJ/mm³."""

    field: DeviceArray
    unit: float

    def numpy(self) -> np.ndarray:
        """The dose [mJ/mm³] as float64 [x, y, z]."""
        return self.field.numpy().astype(np.float64) * self.unit


def absorbed_dose(
    A: Projection, light: DeviceArray, dwell: float, *, unit: float = 1.0, absorption: float | None = None
) -> Dose:
    """Aᵀ(irradiance) · pixel_area · dwell / voxel_volume."""
    # light: of every pixel and angle [angle, r, z] on the device of ``A``; times ``unit`` it is mW/mm² in air. Other
    # arguments and errors as for `dose_unit`.
    factor = dose_unit(A, dwell, unit=unit, absorption=absorption)
    return Dose(A.T(light), factor)
