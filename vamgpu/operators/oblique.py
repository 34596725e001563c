"""Projection of light that also moves along the axis of rotation, or past an axis that wobbles."""

from __future__ import annotations

from math import ceil, hypot
from typing import Any, Protocol, final, runtime_checkable

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable, Vessel, one_ray_a_pixel
from vamgpu.kernels.oblique import back_oblique, forward_oblique
from vamgpu.operators.dwell import Dwell
from vamgpu.operators.frame_motion import mean, places, ray_parts
from vamgpu.operators.linear import VoxelProjector
from vamgpu.operators.ray_table import EQUAL, OpenAir, column_in_resin, tabulate
from vamgpu.operators.wobble import Wobble, check_reach
from vamgpu.travel import at_rest


@runtime_checkable
class Rising(Protocol):
    """Light that moves along the axis: its path in the plane, and the row of each ray."""

    @property
    def plane(self) -> Vessel:
        """The vessel that describes the light across the axis."""
        ...

    def rows(self, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(lift, stretch, gain): the row at lift + stretch·z [mm] lights (X, Y, z), gain times as much as the plane."""
        ...


@final
class Oblique(VoxelProjector):
    """Rays that have a column and a row: ``A(volume)`` is the sinogram [angle, r, z], ``A.T(sinogram)`` the dose.

    Entries are those of `Projection`: lengths [mm] of rays in voxels, multiplied by the transmitted and absorbed shares
    of a vessel, and by the ratio of the dwell of the angle to the mean. One kernel follows every ray through the
    slices; a cone's rows therefore spread with depth exactly as its columns do. A pixel is one ray, without point
    spread. For a container that turns while a frame is lit, light is the mean over positions a third of a voxel apart
    at the rim, which multiplies the number of products; the axis stays at its position for the frame's angle.

    Args:
        grid: Voxels of the volume.
        beam: Pixels; ``fill`` and ``spread`` must be left out.
        motion: Angles of the turntable.
        light: A `Cone`, an `Inclined`, or any vessel (None for air), whose rows are level.
        wobble: Position of the axis at each angle; the light and all vessels do not move.
        device: A name or a device; the best available one by default.

    Raises:
        BadInput: An argument is of another type or out of its range.
        DeviceError: There is no such device.
    """

    def __init__(
        self,
        grid: Grid,
        beam: Beam,
        motion: Turntable,
        light: Rising | Vessel | None = None,
        wobble: Wobble | None = None,
        device: str | Device | None = None,
    ) -> None:
        self._set_geometry(grid, beam, motion, device)
        one_ray_a_pixel("Oblique", beam)
        if light is not None and not isinstance(light, (Rising, Vessel)):
            raise BadInput(
                f"got {light!r} as light; expected a Cone, an Inclined, a vessel, or None for straight light"
            )
        self.light: Rising | Vessel | None = light
        self.wobble: Wobble | None = wobble
        if isinstance(light, Rising) or (motion.travel is not None and motion.travel.aside):
            at_rest("Oblique, with light that rises or for a part that moves sideways,", motion)
        plane = light.plane if isinstance(light, Rising) else light
        self.vessel: Any = None if isinstance(plane, OpenAir) else plane
        self._places = np.zeros((motion.angles, 2)) if wobble is None else wobble.places(motion.angles) / grid.pitch
        check_reach(self._places * grid.pitch, beam)
        self._tables = self._tabulated(plane or OpenAir())
        self._dwell = Dwell(motion, beam, self.device)

    def __repr__(self) -> str:
        return (f"Oblique({self.grid!r}, {self.beam!r}, {self.motion!r}, {self.light!r}, {self.wobble!r}, "
                f"device={self.device.name!r})")  # fmt: skip

    def _tabulated(self, plane: Vessel) -> dict[str, Any]:
        """The projector's tables, together with the rows, over every position that a voxel may reach."""
        grid, beam = self.grid, self.beam
        margin = 2 * ceil(float(np.abs(self._places).max(initial=0.0)))
        wide = Grid((grid.shape[0] + margin, grid.shape[1] + margin, grid.shape[2]), grid.pitch)
        ratio = grid.pitch / column_in_resin(beam, plane)
        width = 1.0 if ratio <= EQUAL else ratio
        light = tabulate(wide, beam, plane, half=0.5 * (1.0 + width))
        n = light.map.shape[0]
        position = (np.arange(n) - 0.5 * (n - 1)) * grid.pitch
        lift, stretch, gain = self._rows(*np.meshgrid(position, position, indexing="ij"))
        if not stretch.min() > 0.0:
            raise BadInput(f"rows are stretched by {stretch.min():.3g}; expected more than 0: light must not run along "
                           "the axis or start inside the volume")  # fmt: skip
        ratio = grid.pitch / beam.pitch
        rows = [lift / beam.pitch, stretch * ratio]
        strength = light.map[..., 1] * gain * ratio
        table = np.stack([light.map[..., 0], strength, *rows], axis=-1)
        wander = float(np.hypot(*self._places.T).max(initial=0.0))
        self._size = {"width": width, "radius": max(light.radius - wander, 0.0)}
        upload, parts = self.device.table, ray_parts(self.motion, min(light.radius, 0.5 * hypot(*grid.shape[:2])))
        self._poses = [
            upload(np.stack([np.cos(poses), np.sin(poses), *self._places.T], axis=1))
            for poses in places(self.motion, parts)
        ]
        return {"light": upload(table), "edges": upload(light.edges)}

    def _rows(self, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if isinstance(self.light, Rising):
            return self.light.rows(across, along)
        return np.zeros_like(across), np.ones_like(across), np.ones_like(across)

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        fields = {"volume": x, **self._tables, **self._size, "lanes": x}

        def compute(part: int, out: DeviceArray) -> None:
            self.device.launch(forward_oblique, **fields, poses=self._poses[part], sinogram=out)

        mean(len(self._poses), compute, out)
        self._dwell.weigh(out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        fields = {"sinogram": self._dwell.weighted(y), "light": self._tables["light"], **self._size, "lanes": y}

        def compute(part: int, out: DeviceArray) -> None:
            self.device.launch(back_oblique, **fields, poses=self._poses[part], volume=out)

        mean(len(self._poses), compute, out)
