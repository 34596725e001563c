"""Forward projection of a volume to a sinogram, and its transpose, the dose of a sinogram."""

from __future__ import annotations

from functools import cached_property
from typing import final

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable, Vessel
from vamgpu.kernels.project import back_joseph, forward_joseph
from vamgpu.kernels.refract import back_refracted, forward_refracted
from vamgpu.operators.light import OpenAir, tabulate
from vamgpu.operators.linear import LinearOperator, Transposed
from vamgpu.operators.rows import Rows
from vamgpu.operators.space import SinogramSpace, VolumeSpace


@final
class Projection(LinearOperator):
    """Rays of a beam through a volume that a turntable turns, in air or inside a vessel.

    ``A(volume)`` is the sinogram [angle, r, z], ``A.T(sinogram)`` the dose [x, y, z]; ``A[i, j]`` is the length [mm] of
    ray i in voxel j, times transmittance and the absorbed fraction per mm where a vessel absorbs. Straight rays as far
    apart as voxels follow Joseph; all others an inverse map of the rays, exact inside the vessel's printable radius
    (outside it two or three rays meet and the voxels count as unlit).

    grid, beam, motion: the geometry.  vessel: e.g. `Vial`; None for straight light.  device: a name or a device.
    Raises `BadInput`, `DeviceError`.
    """

    domain: VolumeSpace
    range: SinogramSpace

    def __init__(
        self,
        grid: Grid,
        beam: Beam,
        motion: Turntable,
        vessel: Vessel | None = None,
        device: str | Device | None = None,
    ) -> None:
        for value, kind in ((grid, Grid), (beam, Beam), (motion, Turntable)):
            if not isinstance(value, kind):
                raise BadInput(f"got {value!r} where a {kind.__name__} is wanted; Projection(grid, beam, motion, …)")
        if vessel is not None and not isinstance(vessel, Vessel):
            raise BadInput(f"got {vessel!r} as vessel; wanted a Vial, a Vat, or None for straight light")
        self.grid, self.beam, self.motion, self.vessel = grid, beam, motion, vessel
        self.domain, self.range = VolumeSpace(grid), SinogramSpace(beam, motion)
        self.device = open_device(device)
        poses = motion.poses
        self._directions = self.device.table(np.stack([np.cos(poses), np.sin(poses)], axis=1))
        self._rows = Rows(beam.pixels[1], beam.pitch, grid.shape[2], grid.pitch)
        self._joseph = vessel is None and self._rows.same_pitch
        self._light = None if self._joseph else self._tables(vessel or OpenAir())
        self._transpose = Transposed(self)

    def __repr__(self) -> str:
        vessel = f", {self.vessel!r}" if self.vessel else ""
        return f"Projection({self.grid!r}, {self.beam!r}, {self.motion!r}{vessel}, device={self.device.name!r})"

    @property
    def T(self) -> LinearOperator:  # noqa: N802
        return self._transpose

    @cached_property
    def _slices(self) -> tuple[int, int, int]:
        """Shape of a sinogram with one row a slice."""
        return (self.motion.angles, self.beam.pixels[0], self.grid.shape[2])

    def _tables(self, vessel: Vessel) -> dict[str, object]:
        light = tabulate(self.grid, self.beam, vessel)
        table = self.device.table
        return {"light": table(light.map), "edges": table(light.edges), "width": light.width, "radius": light.radius}

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        rows = out if self._rows.same else self.device.empty(self._slices)
        common = {"volume": x, "directions": self._directions, "sinogram": rows}
        if self._light is None:
            self.device.launch(forward_joseph, **common, pitch=self.grid.pitch)
        else:
            self.device.launch(forward_refracted, **common, **self._light)
        if rows is not out:
            self._rows.from_slices(rows, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        rows = y
        if not self._rows.same:
            rows = self.device.empty(self._slices)
            self._rows.to_slices(y, rows)
        common = {"sinogram": rows, "directions": self._directions, "volume": out}
        if self._light is None:
            self.device.launch(back_joseph, **common, pitch=self.grid.pitch)
        else:
            light = {name: value for name, value in self._light.items() if name != "edges"}
            self.device.launch(back_refracted, **common, **light)
