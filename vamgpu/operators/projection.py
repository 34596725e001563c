"""Forward projection of a volume to a sinogram, and its transpose, the dose of a sinogram."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from functools import cached_property, partial
from math import hypot
from typing import final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable, Vessel
from vamgpu.kernels.footprint import back_footprint, forward_footprint
from vamgpu.operators.dwell import Dwell
from vamgpu.operators.frame_motion import mean, places, straight_parts
from vamgpu.operators.linear import VoxelProjector
from vamgpu.operators.ray_table import OpenAir, RayTable, column_in_resin, tabulate
from vamgpu.operators.row_resampler import RowResampler
from vamgpu.travel import at_rest


@final
class Projection(VoxelProjector):
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

    Raises:
        BadInput: An argument is of another type.
        DeviceError: There is no such device.
    """

    def __init__(
        self,
        grid: Grid,
        beam: Beam,
        motion: Turntable,
        vessel: Vessel | None = None,
        device: str | Device | None = None,
    ) -> None:
        self._set_geometry(grid, beam, motion, device)
        if vessel is not None and not isinstance(vessel, Vessel):
            raise BadInput(f"got {vessel!r} as vessel; expected a Vial, a Vat, or None for straight light")
        self.vessel: Vessel | None = vessel
        self._rows = RowResampler.of(beam, grid.shape[2], grid.pitch, self.device)
        self._light = self._lit()
        self._turn(motion)

    def _turn(self, motion: Turntable) -> None:
        """Make this a projection at these angles."""
        self._set_geometry(self.grid, self.beam, motion, self.device)
        self._dwell = Dwell(motion, self.beam, self.device)
        arcs = motion.arcs / self._parts
        self._directions = [
            self.device.table(np.stack([np.cos(poses), np.sin(poses), arcs], axis=1))
            for poses in places(motion, self._parts)
        ]

    @cached_property
    def _parts(self) -> int:
        """Parts of a frame's arc, each of which is straight within a voxel."""
        vessel, grid = self.vessel or OpenAir(), self.grid
        reach = min(vessel.lit_radius, 0.5 * grid.pitch * hypot(*grid.shape[:2]))
        return straight_parts(self.motion, reach / column_in_resin(self.beam, vessel))

    @cached_property
    def _table(self) -> RayTable:
        travel, vessel = self.motion.travel, self.vessel
        if travel is not None and travel.aside and vessel is not None:
            raise BadInput(f"got a part that moves sideways in {vessel!r}, where light differs from place to place; "
                           "expected straight light (no vessel), or [wobble]: Oblique with a Wobble")  # fmt: skip
        arc = float(self.motion.arcs.max()) / self._parts
        return tabulate(self.grid, self.beam, vessel or OpenAir(), arc=arc)

    def _lit(self) -> dict[str, object]:
        """Arguments of both directions."""
        light = self._table
        ratio, strength = self.grid.pitch / self.beam.pitch, self.grid.pitch**2 / self.beam.pitch
        bent, table = self.vessel is not None, self.device.table
        return {
            "light": table(light.map if bent else np.zeros((2, 2, 4))),
            "bent": int(bent),
            "ratio": light.steepest if bent else ratio,
            "strength": strength,
            "fill": light.fill,
            "sigma": light.sigma,
            "radius": light.radius,
            "taps": light.taps,
        }

    @cached_property
    def _gather(self) -> dict[str, object]:
        """Further arguments of the forward direction, which gathers along rays."""
        return {"edges": self.device.table(self._table.edges), "cells": self._table.cells}

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        launch = partial(self.device.launch, forward_footprint, volume=x, **self._light, **self._gather)
        with self._rows.filling(out) as rows:
            mean(len(self._directions), lambda part, out: launch(directions=self._directions[part], sinogram=out), rows)
        self._dwell.weigh(out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._back(self._rows.in_slices(self._dwell.weighted(y)), out)

    def _back(self, rows: DeviceArray, out: DeviceArray) -> None:
        launch = partial(self.device.launch, back_footprint, sinogram=rows, **self._light)
        mean(len(self._directions), lambda part, out: launch(directions=self._directions[part], volume=out), out)

    def of_poses(self, chosen: Sequence[int]) -> Projection:
        """This projection at some of its angles; it shares everything that does not depend on them.

        Args:
            chosen: Numbers of the angles, in order.

        Returns:
            The projection, whose light is [chosen angle, r, z].

        Raises:
            BadInput: The angles have unequal dwell times, which are relative to a whole turn, or the part moves.
        """
        at_rest("a projection at some of its angles", self.motion)
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


def prepared(A: Projection, beam: Beam, vessel: Vessel | None) -> Callable[[], Projection]:
    """A with another beam and vessel: makes the table, which needs no device, and returns a function for the rest."""
    other = object.__new__(Projection)
    given = other.grid, other.beam, other.motion, other.vessel = A.grid, beam, A.motion, vessel
    assert other._table

    def made() -> Projection:
        Projection.__init__(other, *given, A.device)
        return other

    return made
