"""Projection through fields that the resin carries: every ray traced anew at every pose."""

from __future__ import annotations

from math import ceil
from typing import Any, final

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OutOfMemory
from vamgpu.geometry import Beam, Grid, Turntable, counts, one_ray_a_pixel, positive
from vamgpu.kernels.gather import gather_rows
from vamgpu.kernels.trace import ABSORBS, back_traced, clear_volume, forward_traced, survey_rays, trace_entries
from vamgpu.operators.bundle import RayBundle
from vamgpu.operators.carried import Carried
from vamgpu.operators.dwell import Dwell
from vamgpu.operators.linear import LinearOperator, Transposed
from vamgpu.operators.rows import Rows
from vamgpu.operators.space import SinogramSpace, VolumeSpace
from vamgpu.operators.sparse import SparseEntries

SCRATCH = 64 << 20
"""Bytes of the table that poses are traced into at once."""
WHOLE = 1 << 24
"""Float32 tells whole numbers apart up to here."""
PLANES, POSES = 32, 45
"""Planes of voxels, and poses, whose entries are gathered together, so that neighbors find them in the cache."""
PATIENCE = 8
"""A ray is lost that has not left after the way through this many grids."""


@final
class TracedProjection(LinearOperator):
    """Rays of a beam through a volume that turns together with what it carries.

    ``A(volume)`` is the sinogram [angle, r, z], ``A.T(sinogram)`` the dose [x, y, z]; ``A[i, j]`` is the length [mm] of
    ray i in voxel j, times transmittance and the absorbed fraction per mm where an extinction is carried, and times the
    pose's time over the mean. No dose is counted in opaque voxels. Where nothing depends on z and light is level, all
    slices share the rays of one: they are traced once into a sparse matrix and its transpose, both on the device.
    Otherwise rays are marched in every product.

    A pixel is one ray, or those of ``rays``, without point spread: a beam must leave ``fill`` and ``spread`` out.

    grid, beam, motion: the geometry.  carried: what turns with the resin.  rays: `RayBundle`, None for parallel light.
    device: a name or a device.  step: of a ray [voxels], at most 0.5 past thin inserts.  most_steps: after which a ray
    counts as caught.
    Raises `BadInput`, `ShapeMismatch`, `DeviceError`.
    """

    def __init__(
        self,
        grid: Grid,
        beam: Beam,
        motion: Turntable,
        carried: Carried | None = None,
        rays: RayBundle | None = None,
        device: str | Device | None = None,
        step: float = 0.5,
        most_steps: int | None = None,
    ) -> None:
        carried = Carried() if carried is None else carried
        rays = RayBundle.parallel(beam) if rays is None and isinstance(beam, Beam) else rays
        wanted = ((grid, Grid), (beam, Beam), (motion, Turntable), (carried, Carried), (rays, RayBundle))
        for value, kind in wanted:
            if not isinstance(value, kind):
                raise BadInput(f"got {value!r} where a {kind.__name__} is wanted; TracedProjection(grid, beam, …)")
        one_ray_a_pixel("TracedProjection", beam)
        self.grid, self.beam, self.motion, self.carried, self.rays = grid, beam, motion, carried, rays
        self.vessel = None
        self.domain, self.range = VolumeSpace(grid), SinogramSpace(beam, motion)
        self.device = open_device(device)
        self.step = positive("step [voxels]", step)
        patience = ceil(PATIENCE * sum(grid.shape) / self.step)
        self.most_steps = patience if most_steps is None else counts("most_steps", (most_steps,), 1)[0]
        carried.check(grid)
        level = carried.is_level and rays.is_level  # type: ignore[union-attr]
        self._way: _Matrix | _March = _Matrix(self) if level else _March(self)
        self._dwell = Dwell(motion, self.device)
        self._transpose = Transposed(self)

    def __repr__(self) -> str:
        fields = ", ".join(self.carried.fields()) or "nothing"
        return f"TracedProjection({self.grid!r}, {self.beam!r}, {self.motion!r}, {fields}, device={self.device.name!r})"

    @property
    def T(self) -> LinearOperator:  # noqa: N802
        return self._transpose

    @property
    def entries(self) -> int:
        """Pairs of the sparse matrix of one slice; 0 where rays are marched in every product."""
        return self._way.entries

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self._way.forward(x, out)
        self._dwell.weigh(out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._way.transposed(self._dwell.weighted(y), out)

    def inputs(self, *, level: bool) -> dict[str, Any]:
        """Medium, rays, step and kind as the kernels of `trace` take them."""
        unit = 1.0 if self.carried.kind & ABSORBS else self.grid.pitch
        starts = self.rays.table(self.grid, self.beam, level=level, unit=unit)  # type: ignore[union-attr]
        return {
            "medium": self.device.table(self.carried.medium(self.grid)),
            "starts": self.device.table(starts),
            "step": self.step,
            "kind": self.carried.kind,
        }

    def check_left(self, caught: np.ndarray, rows: int, bundle: int) -> None:
        """Raise `BadInput` if any ray is marked in ``caught`` (angle, ray)."""
        if not caught.any():
            return
        angle, ray = np.argwhere(caught)[0]
        column, row = divmod(int(ray) // bundle, rows)
        pose = np.degrees(self.motion.poses[angle])
        raise BadInput(
            f"{int(caught.sum())} of {caught.size} rays have not left after {self.most_steps} steps of {self.step:g} "
            f"voxels ({self.most_steps * self.step * self.grid.pitch:.4g} mm), first that of column {column}, "
            f"row {row} at {pose:.4g}°; look at the index, or allow more with most_steps="
        )


class _Matrix:
    """One sparse matrix for all slices, by rows and by columns."""

    def __init__(self, owner: TracedProjection) -> None:
        self.device, grid, beam = owner.device, owner.grid, owner.beam
        self.resampled = Rows(beam.pixels[1], beam.pitch, grid.shape[2], grid.pitch, owner.device)
        self.slices = (owner.motion.angles, beam.pixels[0], grid.shape[2])
        cells, rays = grid.shape[0] * grid.shape[1], owner.motion.angles * beam.pixels[0]
        if max(cells, rays) > WHOLE:
            raise BadInput(f"{cells} voxels a slice and {rays} rays; at most {WHOLE} of each: use a coarser geometry")
        entries = _traced(owner)
        self.entries = entries.weight.size
        self.rows = entries.table(self.device, self.slices[:2], PLANES * grid.shape[1])
        self.columns = entries.transposed().table(self.device, grid.shape[:2], POSES * beam.pixels[0])

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        rows = out if self.resampled.same else self.device.empty(self.slices)
        self.device.launch(gather_rows, source=x, **self.rows, out=rows)
        if rows is not out:
            self.resampled.from_slices(rows, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        rows = y
        if not self.resampled.same:
            rows = self.device.empty(self.slices)
            self.resampled.to_slices(y, rows)
        self.device.launch(gather_rows, source=rows, **self.columns, out=out)


def _traced(owner: TracedProjection) -> SparseEntries:
    """The matrix of one slice, rows being [angle, r]; traced some poses at a time."""
    device, bundle = owner.device, owner.rays.rays  # type: ignore[union-attr]
    inputs = owner.inputs(level=True) | {"most": owner.most_steps}
    rays = owner.beam.pixels[0] * bundle
    capacity = 3 * sum(owner.grid.shape[:2]) + 16
    poses, solid = owner.motion.poses, _solid(owner)
    entries, pairs, at = [], [], 0
    while at < poses.size:
        some = poses[at : at + max(1, SCRATCH // (8 * rays * capacity))]
        count = device.empty((some.size, rays), np.int32, table=True)
        scratch = device.empty((some.size, rays, capacity, 2), device.kept("float32"), table=True)
        directions = device.table(np.stack([np.cos(some), np.sin(some)], axis=1))
        device.launch(trace_entries, **inputs, directions=directions, counts=count, entries=scratch)
        found = count.numpy()
        if found.max() > capacity:
            capacity = int(found.max())
            continue
        owner.check_left(found < 0, 1, bundle)
        valid = np.arange(capacity) < found[..., None]
        part = scratch.numpy()[valid]
        if solid is not None:
            dark = solid[part[:, 0].astype(np.int64)]
            valid[valid] = ~dark
            found, part = valid.sum(axis=2), part[~dark]
        entries.append(found.reshape(-1, bundle).sum(axis=1))
        pairs.append(part)
        at += some.size
    found, whole = np.concatenate(entries), np.concatenate(pairs)
    if len(whole) >= 2**31:
        raise OutOfMemory(f"the matrix has {len(whole)} entries; below {2**31} can be told apart: use a coarser grid")
    row = np.repeat(np.arange(found.size, dtype=np.int32), found)
    return SparseEntries(row, whole[:, 0].astype(np.int32), np.ascontiguousarray(whole[:, 1]))


def _solid(owner: TracedProjection) -> np.ndarray | None:
    return None if owner.carried.opaque is None else owner.carried.opaque.ravel()


class _March:
    """Rays of every pixel marched in every product."""

    entries = 0

    def __init__(self, owner: TracedProjection) -> None:
        self.device, poses = owner.device, owner.motion.poses
        angles, (columns, rows) = owner.motion.angles, owner.beam.pixels
        self.inputs = owner.inputs(level=False)
        self.inputs["directions"] = self.device.table(np.stack([np.cos(poses), np.sin(poses)], axis=1))
        steps = self.device.empty((angles, columns * rows), np.int32, table=True)
        self.device.launch(
            survey_rays, **self.inputs, top=owner.grid.shape[2] + 1.0, most=owner.most_steps, steps=steps
        )
        owner.check_left(steps.numpy() < 0, rows, 1)
        self.inputs["steps"] = steps

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self.device.launch(forward_traced, volume=x, **self.inputs, lanes=out.lanes, sinogram=out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self.device.launch(clear_volume, volume=out)
        self.device.launch(back_traced, sinogram=y, **self.inputs, lanes=y.lanes, volume=out)
