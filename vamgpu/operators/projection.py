"""Forward projection of a volume to a sinogram, and its transpose, the dose of a sinogram."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cached_property
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
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.ray_table import OpenAir, tabulate
from vamgpu.operators.row_resampler import RowResampler
from vamgpu.operators.space import SinogramSpace, VolumeSpace

FOOTPRINTS = ("exact", "joseph")


@final
class Projection(LinearOperator):
    """Rays of a beam through a volume that a turntable turns, in air or inside a vessel.

    ``A(volume)`` is the sinogram [angle, r, z], ``A.T(sinogram)`` the dose [x, y, z]. ``A[i, j]`` is the mean, over the
    box of voxel j, of the light that the box of pixel i sends, blurred by the beam's point spread: the length [mm] of
    the ray in the voxel, times transmittance and the absorbed fraction per mm where a vessel absorbs. Inside a vessel
    the light has one ray through each point within the printable radius; voxels outside it count as unlit.

    Args:
        grid: Voxels of the volume.
        beam: Pixels, with their fill factor and point spread.
        motion: Angles of the turntable.
        vessel: For example a `Vial`; None for straight light.
        device: A name or a device; the best one here by default.
        footprint: "exact", or "joseph" for straight rays interpolated between voxels as tomography packages do: no
            fill factor, no point spread, columns as wide as voxels (P. M. Joseph, IEEE Trans. Med. Imaging 1 (1982)).

    Raises:
        BadInput: An argument is of another kind, or Joseph's rays do not fit the geometry.
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
        for value, kind in ((grid, Grid), (beam, Beam), (motion, Turntable)):
            if not isinstance(value, kind):
                raise BadInput(f"got {value!r} where a {kind.__name__} is expected; Projection(grid, beam, motion, …)")
        if vessel is not None and not isinstance(vessel, Vessel):
            raise BadInput(f"got {vessel!r} as vessel; expected a Vial, a Vat, or None for straight light")
        self.grid, self.beam, self.motion, self.vessel = grid, beam, motion, vessel
        self.footprint: Literal["exact", "joseph"] = footprint
        self._check_footprint()
        self.domain = VolumeSpace(grid)  # pyright: ignore[reportIncompatibleVariableOverride] - and never replaced
        self.range = SinogramSpace(beam, motion)  # pyright: ignore[reportIncompatibleVariableOverride]
        self.device: Device = open_device(device)
        self._dwell, poses = Dwell(motion, self.device), motion.poses
        self._directions = self.device.table(np.stack([np.cos(poses), np.sin(poses)], axis=1))
        if footprint == "joseph":
            self._rows = RowResampler(beam.pixels[1], beam.pitch, grid.shape[2], grid.pitch, self.device)
        else:
            self._rows = RowResampler.of(beam, grid.shape[2], grid.pitch, self.device)
            self._light, self._gather = self._tables()

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
                           "vessel out and make the pitches equal, or take footprint='exact'")  # fmt: skip
        if beam.fill != 1.0 or beam.spread:
            raise BadInput(f"got footprint='joseph' with {beam!r}; Joseph's rays know no fill factor and no point "
                           "spread: give neither, or take footprint='exact'")  # fmt: skip

    @cached_property
    def _slices(self) -> tuple[int, int, int]:
        """Shape of a sinogram with one row a slice."""
        return (self.motion.angles, self.beam.pixels[0], self.grid.shape[2])

    def _tables(self) -> tuple[dict[str, object], dict[str, object]]:
        """What both directions take, and what the forward one takes to gather along rays."""
        light = tabulate(self.grid, self.beam, self.vessel or OpenAir())
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
        rows = out if self._rows.same else self.device.empty(self._slices)
        fields = {"volume": x, "directions": self._directions, "sinogram": rows}
        if self.footprint == "joseph":
            self.device.launch(forward_joseph, **fields, pitch=self.grid.pitch)
        else:
            self.device.launch(forward_footprint, **fields, **self._light, **self._gather)
        if rows is not out:
            self._rows.from_slices(rows, out)
        self._dwell.weigh(out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        rows = weighted = self._dwell.weighted(y)
        if not self._rows.same:
            rows = self.device.empty(self._slices)
            self._rows.to_slices(weighted, rows)
        self._back(rows, out)

    def _back(self, rows: DeviceArray, out: DeviceArray) -> None:
        fields = {"sinogram": rows, "directions": self._directions, "volume": out}
        if self.footprint == "joseph":
            self.device.launch(back_joseph, **fields, pitch=self.grid.pitch)
        else:
            self.device.launch(back_footprint, **fields, **self._light)

    def of_poses(self, chosen: Sequence[int]) -> Projection:
        """This projection at some of its angles; all that does not depend on them is shared.

        Args:
            chosen: Numbers of the angles, in order.

        Returns:
            The projection, whose light is [chosen angle, r, z].

        Raises:
            BadInput: Angles are lit for times of their own, which are shares of a whole turn's.
        """
        if self.motion.dwell is not None:
            raise BadInput(f"got {self.motion} angles; expected angles that are lit as long")
        some, poses = copy(self), self.motion.poses[list(chosen)]
        for kept in ("_slices", "_transpose"):
            vars(some).pop(kept, None)
        some.motion = Turntable(poses)
        some.range = SinogramSpace(self.beam, some.motion)  # pyright: ignore[reportIncompatibleVariableOverride]
        some._dwell = Dwell(some.motion, self.device)
        some._directions = self.device.table(np.stack([np.cos(poses), np.sin(poses)], axis=1))
        return some

    @property
    def row_weights(self) -> np.ndarray:
        """What each slice gets of the light of each row of pixels, (slices, rows)."""
        return self._rows.weights

    def dose_of_slices(self, light: np.ndarray | DeviceArray) -> np.ndarray:
        """Dose of some slices, of which each has its own light: none lights another.

        Args:
            light: With `row_weights` applied, [angle, r, slice], of any number of slices; NumPy or on the device.

        Returns:
            The dose, [x, y, slice], NumPy.
        """
        return self.lit_slices(light).numpy()

    def lit_slices(self, light: np.ndarray | DeviceArray) -> DeviceArray:
        """`dose_of_slices`, left on the device.

        Args:
            light: As for `dose_of_slices`, [angle, r, slice].

        Returns:
            The dose, [x, y, slice] on the device.
        """
        out = self.device.empty((*self.grid.shape[:2], light.shape[2]))
        self._back(self._dwell.weighted(self.device.field(light)), out)
        return out
