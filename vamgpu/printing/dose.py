"""Calibrated dose: the one place where light in mW/mm² becomes energy in mJ/mm³."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.operators.projection import Projection


@dataclass(frozen=True, eq=False)
class Dose:
    """Energy absorbed per volume: ``field`` [x, y, z] on the device times ``unit`` is mJ/mm³."""

    field: DeviceArray
    unit: float

    def numpy(self) -> np.ndarray:
        """The dose [mJ/mm³] as float64 [x, y, z]."""
        return self.field.numpy().astype(np.float64) * self.unit


def dose_unit(A: Projection, dwell: float, *, unit: float = 1.0, absorption: float | None = None) -> float:
    """pixel_area · dwell / voxel_volume: what Aᵀ(light) is to be multiplied by to be a dose in mJ/mm³.

    dwell: exposure of an angle [s], the mean of all where they are lit for unequal times.  unit: irradiance in air
    [mW/mm²] of one unit of light.  absorption: of the resin [1/mm], only where ``A`` absorbs no light: there Aᵀ(light)
    is a fluence, of which thin resin absorbs that share per mm. Raises `BadInput` where nothing, or two things, say how
    much is absorbed.
    """
    factor = unit * A.beam.pixel_area * positive("dwell [s]", dwell) / A.grid.voxel_volume
    if absorbs(A):
        if absorption is not None:
            raise BadInput(f"absorption is {absorption!r}, but light is already absorbed in {A.vessel!r}; leave it out")
        return factor
    if absorption is None:
        raise BadInput(
            f"{A!r} absorbs no light, so nothing says how much energy the resin takes up; "
            "give absorption= [1/mm], or a vessel that absorbs"
        )
    return factor * positive("absorption [1/mm]", absorption)


def absorbed_dose(
    A: Projection, light: DeviceArray, dwell: float, *, unit: float = 1.0, absorption: float | None = None
) -> Dose:
    """Aᵀ(irradiance) · pixel_area · dwell / voxel_volume.

    light: of every pixel and angle [angle, r, z] on the device of ``A``; times ``unit`` it is mW/mm² in air. Other
    arguments and errors as for `dose_unit`.
    """
    factor = dose_unit(A, dwell, unit=unit, absorption=absorption)
    return Dose(A.T(light), factor)


def absorbs(A: Projection) -> bool:
    """Whether the light of a projection is attenuated on its way, so that Aᵀ is an absorbed dose."""
    extinction = getattr(getattr(A, "medium", None), "extinction", None)
    vessel = getattr(A, "vessel", None)
    return (vessel is not None and vessel.absorption > 0) or extinction is not None
