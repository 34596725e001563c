"""What light has to be multiplied by to be energy."""

from __future__ import annotations

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.operators.projection import Projection


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


def absorbs(A: Projection) -> bool:
    """Whether the light of a projection is attenuated on its way, so that Aᵀ is an absorbed dose."""
    extinction = getattr(getattr(A, "medium", None), "extinction", None)
    vessel = getattr(A, "vessel", None)
    return (vessel is not None and vessel.absorption > 0) or extinction is not None
