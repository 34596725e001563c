"""The factor that converts light to energy."""

from __future__ import annotations

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.operators.projection import Projection
from vamgpu.schema.quantities import Absorption, measured


def dose_unit(A: Projection, dwell: float, *, unit: float = 1.0, absorption: float | str | None = None) -> float:
    """The factor pixel_area · dwell / voxel_volume that converts Aᵀ(light) to a dose [mJ/mm³]. Raises `BadInput`."""
    # dwell: mean exposure of an angle [s]. unit: irradiance in air [mW/mm²] of one unit of light. absorption: of the
    # resin [1/mm], only if A absorbs no light; Aᵀ(light) is then a fluence, of which thin resin absorbs that share per
    # mm.
    factor = unit * A.beam.pixel_area * positive("dwell [s]", dwell) / A.grid.voxel_volume
    if absorbs(A):
        if absorption is not None:
            raise BadInput(f"absorption is {absorption!r}, but light is already absorbed in {A.vessel!r}; leave it out")
        return factor
    if absorption is None:
        raise BadInput(
            f"this {type(A).__name__} absorbs no light, so that the energy absorbed by the resin is unknown; give "
            "absorption= [1/mm], or a vessel that absorbs"
        )
    return factor * positive("absorption [1/mm]", measured("absorption", absorption, Absorption))


def absorbs(A: Projection) -> bool:
    """Whether the light of a projection is attenuated on its way, which makes Aᵀ an absorbed dose."""
    extinction = getattr(getattr(A, "medium", None), "extinction", None)
    vessel = getattr(A, "vessel", None)
    return (vessel is not None and vessel.absorption > 0) or extinction is not None
