"""Forward projection of a volume to a sinogram, and its transpose, the dose of a sinogram."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cached_property
from math import hypot
from typing import Literal, final

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable, Vessel
from vamgpu.kernels.footprint import back_footprint, forward_footprint
from vamgpu.kernels.project import back_joseph, forward_joseph
from vamgpu.operators.dwell import Dwell
from vamgpu.operators.frame_motion import mean, places, straight_parts
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.ray_table import OpenAir, column_in_resin, tabulate
from vamgpu.operators.row_resampler import RowResampler
from vamgpu.operators.space import SinogramSpace, VolumeSpace, require_kinds

FOOTPRINTS = ("exact", "joseph")


@final
class Projection(LinearOperator):
    """Rays of a beam through a volume that a turntable turns, in air or inside a vessel.

    ``A(volume)`` is the sinogram [angle, r, z], ``A.T(sinogram)`` the dose [x, y, z]. ``A[i, j]`` is the light of pixel
    i's box, blurred by the beam's point spread, averaged over the box of voxel j: the length [mm] of the ray in the
    voxel, multiplied by the transmittance, and by the absorbed fraction per mm if a vessel absorbs. Inside a vessel,
    one ray passes through each point within the printable radius; voxels outside it count as unlit. For a container
    that turns while a frame is lit, light is the mean over that arc, accurate to 0.001 of the greatest dose.

    Args:
        grid: Voxels of the volume.
        beam: Pixels, with their fill factor and point spread.
        motion: Angles of the turntable.
        vessel: For example a `Vial`; None for straight light.
        device: A name or a device; the best available one by default.
        footprint: "exact", or "joseph" for straight rays interpolated between voxels as tomography packages do: no
            fill factor, no point spread, columns as wide as voxels, and a container at rest while a frame is lit
            (P. M. Joseph, IEEE Trans. Med. Imaging 1 (1982)).

    Raises:
        BadInput: An argument is of another type, or Joseph's rays do not fit the geometry.
        DeviceError: There is no such device.
    """

    domain: VolumeSpace
    range: SinogramSpace
    grid: Grid
    beam: Beam
    motion: Turntable
    vessel: Vessel | None

    def __init__(
        self,
        grid: Grid,
        beam: Beam,
        motion: Turntable,
        vessel: Vessel | None = None,
        device: str | Device | None = None,
        *,
        footprint: Literal["exact", "joseph"] = "exact",
    ) -> None:
        require_kinds("Projection(grid, beam, motion, …)", (grid, Grid), (beam, Beam), (motion, Turntable))
        if vessel is not None and not isinstance(vessel, Vessel):
            raise BadInput(f"got {vessel!r} as vessel; expected a Vial, a Vat, or None for straight light")
        self.grid, self.beam, self.vessel = grid, beam, vessel
        self.motion = motion = motion.stepped if footprint == "joseph" else motion
        self.footprint: Literal["exact", "joseph"] = footprint
        self._check_footprint()
        self.domain = VolumeSpace(grid)  # pyright: ignore[reportIncompatibleVariableOverride] - and never replaced
        self.device: Device = open_device(device)
        if footprint == "joseph":
            self._rows = RowResampler(beam.pixels[1], beam.pitch, grid.shape[2], grid.pitch, self.device)
        else:
            self._rows = RowResampler.of(beam, grid.shape[2], grid.pitch, self.device)
            self._light, self._gather = self._tables()
        self._turn(motion)

    def __repr__(self) -> str:
        vessel = f", {self.vessel!r}" if self.vessel else ""
        how = f", footprint={self.footprint!r}" if self.footprint != "exact" else ""
        return f"Projection({self.grid!r}, {self.beam!r}, {self.motion!r}{vessel}, device={self.device.name!r}{how})"

    def _check_footprint(self) -> None:
        if self.footprint not in FOOTPRINTS:
            raise BadInput(f"footprint is {self.footprint!r}; expected one of {', '.join(FOOTPRINTS)}")
        if self.footprint == "exact":
            return
        beam, grid = self.beam, self.grid
        if self.vessel is not None or abs(beam.pitch / grid.pitch - 1.0) > 1e-6:
            raise BadInput(f"got footprint='joseph' with {self.vessel!r}, pixels of {beam.pitch:g} mm and voxels of "
                           f"{grid.pitch:g} mm; Joseph's rays are straight and as far apart as voxels: leave the "
                           "vessel out and make the pitches equal, or use footprint='exact'")  # fmt: skip
        if beam.fill != 1.0 or beam.spread:
            raise BadInput(f"got footprint='joseph' with {beam!r}; Joseph's rays have no fill factor and no point "
                           "spread: give neither, or use footprint='exact'")  # fmt: skip

    def _turn(self, motion: Turntable) -> None:
        """Make this a projection at these angles."""
        self.motion, self._dwell = motion, Dwell(motion, self.device)
        self.range = SinogramSpace(self.beam, motion)  # pyright: ignore[reportIncompatibleVariableOverride]
        arc = [] if self.footprint == "joseph" else [motion.arcs / self._parts]
        self._directions = [
            self.device.table(np.stack([np.cos(poses), np.sin(poses), *arc], axis=1))
            for poses in places(motion, self._parts)
        ]

    @cached_property
    def _parts(self) -> int:
        """Parts of a frame's arc, each of which is straight within a voxel."""
        vessel, grid = self.vessel or OpenAir(), self.grid
        reach = min(vessel.lit_radius, 0.5 * grid.pitch * hypot(*grid.shape[:2]))
        return straight_parts(self.motion, reach / column_in_resin(self.beam, vessel))

    def _tables(self) -> tuple[dict[str, object], dict[str, object]]:
        """Arguments of both directions, and those of the forward one, which gathers along rays."""
        arc = float(self.motion.arcs.max()) / self._parts
        light = tabulate(self.grid, self.beam, self.vessel or OpenAir(), arc=arc)
        ratio, strength = self.grid.pitch / self.beam.pitch, self.grid.pitch**2 / self.beam.pitch
        bent, table = self.vessel is not None, self.device.table
        both = {
            "light": table(light.map if bent else np.zeros((2, 2, 4))),
            "bent": int(bent),
            "ratio": light.steepest if bent else ratio,
            "strength": strength,
            "fill": light.fill,
            "sigma": light.sigma,
            "radius": light.radius,
            "taps": light.taps,
        }
        return both, {"edges": table(light.edges), "cells": light.cells}

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        with self._rows.filling(out) as rows:
            mean(len(self._directions), lambda part, out: self._project(x, part, out), rows)
        self._dwell.weigh(out)

    def _project(self, x: DeviceArray, part: int, out: DeviceArray) -> None:
        fields = {"volume": x, "directions": self._directions[part], "sinogram": out}
        if self.footprint == "joseph":
            self.device.launch(forward_joseph, **fields, pitch=self.grid.pitch)
        else:
            self.device.launch(forward_footprint, **fields, **self._light, **self._gather)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._back(self._rows.in_slices(self._dwell.weighted(y)), out)

    def _back(self, rows: DeviceArray, out: DeviceArray) -> None:
        mean(len(self._directions), lambda part, out: self._expose(rows, part, out), out)

    def _expose(self, rows: DeviceArray, part: int, out: DeviceArray) -> None:
        fields = {"sinogram": rows, "directions": self._directions[part], "volume": out}
        if self.footprint == "joseph":
            self.device.launch(back_joseph, **fields, pitch=self.grid.pitch)
        else:
            self.device.launch(back_footprint, **fields, **self._light)

    def of_poses(self, chosen: Sequence[int]) -> Projection:
        """This projection at some of its angles; it shares everything that does not depend on them.

        Args:
            chosen: Numbers of the angles, in order.

        Returns:
            The projection, whose light is [chosen angle, r, z].

        Raises:
            BadInput: The angles have unequal dwell times, which are relative to a whole turn.
        """
        if self.motion.dwell is not None:
            raise BadInput(f"got {self.motion} angles; expected angles of equal dwell")
        return self.turned(self.motion.chosen(chosen))

    def turned(self, motion: Turntable) -> Projection:
        """This projection at other angles of the same turn; it shares everything that does not depend on them.

        Args:
            motion: The angles; their arcs must not be longer than this projection's.

        Returns:
            The projection.
        """
        some = copy(self)
        some._turn(motion)
        some._made = Projection.turned, (self, motion)
        return some

    @property
    def row_weights(self) -> np.ndarray:
        """Share of each pixel row's light that falls in each slice, (slices, rows)."""
        return self._rows.weights

    def lit_slices(self, light: np.ndarray | DeviceArray) -> DeviceArray:
        """Dose of some slices, each only from its own light.

        Args:
            light: Light after `row_weights`, [angle, r, slice], of any number of slices; NumPy or on the device.

        Returns:
            The dose, [x, y, slice] on the device.
        """
        out = self.device.empty((*self.grid.shape[:2], light.shape[2]))
        self._back(self._dwell.weighted(self.device.field(light)), out)
        return out
