"""The projector of a geometry: by rays through each voxel, or on rings if that is faster."""

from __future__ import annotations

from typing import Any, Literal

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OutOfMemory
from vamgpu.geometry import Beam, Grid, Turntable, Vessel
from vamgpu.operators.defocus import Defocused
from vamgpu.operators.photon_table import Scatterer
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import RingProjection, prefers_rings
from vamgpu.operators.scattering_rings import ScatteringRings

Algorithm = Literal["auto", "rays", "rings"]
ALGORITHMS = ("auto", "rays", "rings")


def projector(
    grid: Grid,
    beam: Beam,
    motion: Turntable,
    vessel: Vessel | None = None,
    device: str | Device | None = None,
    *,
    algorithm: Algorithm = "auto",
    scattering: Scatterer | None = None,
) -> Projection | RingProjection | ScatteringRings:
    """Make the projector of a geometry, by the algorithm that was measured to be faster for it.

    ``A(volume)`` is the sinogram [angle, r, z], ``A.T(sinogram)`` the dose [x, y, z], whatever the algorithm.

    Args:
        grid: Voxels of the volume.
        beam: Pixels, with their fill factor and point spread.
        motion: Angles of the turntable.
        vessel: For example a `Vial`; None for straight light.
        device: A name or a device; the best available one by default.
        algorithm: "rays" for a `Projection`, by rays through each voxel; "rings" for a `RingProjection`, by Fourier
            transforms over evenly spaced angles; "auto" for rings if they support the geometry, were measured to be
            faster and fit into memory, else rays.
        scattering: A resin that scatters light, such as `vamgpu.Scattering`, for which rings are needed; None for one
            that is clear.

    Returns:
        The projector.

    Raises:
        BadInput: An argument is of another type, or "rings" or scattering do not support the geometry.
        DeviceError: There is no such device.
        OutOfMemory: The tables of "rings" do not fit into memory.
    """
    if algorithm not in ALGORITHMS:
        raise BadInput(f"algorithm is {algorithm!r}; expected one of {', '.join(ALGORITHMS)}")
    A = Projection(grid, beam, motion, vessel, device)
    if scattering is None:
        return with_algorithm(A, algorithm)
    if algorithm == "rays":
        raise BadInput("got algorithm='rays' with scattering; expected 'rings' or 'auto': rays are not scattered")
    return ScatteringRings(A, scattering)


def with_algorithm(A: Any, algorithm: Algorithm) -> Any:
    """The operator computed by an algorithm; raises `BadInput` if "rings" do not support it, and `OutOfMemory`."""
    rays: Any = A.operator if isinstance(A, Defocused) else A
    if algorithm == "rays" or (algorithm == "auto" and not prefers_rings(rays)):
        return A
    try:
        rings = RingProjection.of(rays)
        return rings if rays is A else Defocused(rings, A.defocus, A.tolerance)
    except OutOfMemory:
        if algorithm == "rings":
            raise
        return A
