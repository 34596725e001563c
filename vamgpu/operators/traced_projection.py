"""Projection through a medium that turns with the resin: every ray is traced at every angle."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from math import ceil, hypot
from typing import Any, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OpticsWarning, OutOfMemory
from vamgpu.geometry import Beam, Grid, Turntable, counts, one_ray_a_pixel, positive
from vamgpu.kernels.gather import gather_rows
from vamgpu.kernels.medium import ABSORBS
from vamgpu.kernels.trace import survey_rays, trace_entries
from vamgpu.kernels.traced import back_traced, clear_volume, forward_traced
from vamgpu.operators.bundle import RayBundle
from vamgpu.operators.dwell import Dwell
from vamgpu.operators.frame_motion import mean, places, ray_parts
from vamgpu.operators.linear import VoxelProjector
from vamgpu.operators.medium import CoRotatingMedium
from vamgpu.operators.row_resampler import RowResampler
from vamgpu.operators.space import require_kinds
from vamgpu.travel import at_rest

SCRATCH = 64 << 20  # bytes of the table for the angles that are traced at a time
WHOLE = 1 << 24  # float32 represents all whole numbers up to this one
BLOCK = 1 << 24  # number of columns of a matrix that are read together
PLANES, POSES = 32, 45
"""Planes of voxels, and angles, whose entries are gathered together; neighbors then find them in the cache."""
PATIENCE = 8  # a ray counts as trapped after a path through this number of grids
TRAPPED = 1e-3  # largest share of trapped rays, whose light is lost: walls of a high index guide a few


@final
class TracedProjection(VoxelProjector):
    """Rays of a beam through a volume that turns together with a medium.

    ``A(volume)`` is the sinogram [angle, r, z], ``A.T(sinogram)`` the dose [x, y, z]. ``A[i, j]`` is the length [mm] of
    ray i in voxel j, multiplied by the transmittance, by the absorbed fraction per mm if the medium absorbs, and by the
    ratio of the dwell of its angle to the mean. Opaque voxels get no dose. If nothing depends on z and light is
    horizontal, all slices share the rays of one: they are traced once into a sparse matrix and its transpose, both on
    the device. Otherwise rays are marched in every product. A pixel is one ray, or those of ``rays``, without point
    spread. For a container that turns while a frame is lit, light is the mean over positions a third of a voxel apart
    at the rim; the number of traced rays grows accordingly.

    Args:
        grid: Voxels of the volume.
        beam: Pixels; ``fill`` and ``spread`` must be left out.
        motion: Angles of the turntable.
        medium: Medium that turns with the resin; None for a clear one.
        rays: Rays of every pixel; None for parallel light.
        device: A name or a device; the best available one by default.
        step: Step of a ray [voxels], at most 0.5 for thin inserts.
        most_steps: Number of steps after which a ray counts as trapped; by default enough to cross the grid 8 times.

    Raises:
        BadInput: An argument is of another type or out of its range, or a ray never leaves.
        ShapeMismatch: The medium or the rays were made for another geometry.
        DeviceError: There is no such device, or it has too little memory.
    """

    def __init__(
        self,
        grid: Grid,
        beam: Beam,
        motion: Turntable,
        medium: CoRotatingMedium | None = None,
        rays: RayBundle | None = None,
        device: str | Device | None = None,
        step: float = 0.5,
        most_steps: int | None = None,
    ) -> None:
        medium = CoRotatingMedium() if medium is None else medium
        rays = RayBundle.parallel(beam) if rays is None and isinstance(beam, Beam) else rays
        self._set_geometry(grid, beam, motion, device)
        require_kinds("TracedProjection(…, medium, rays)", (medium, CoRotatingMedium), (rays, RayBundle))
        one_ray_a_pixel("TracedProjection", beam)
        at_rest("TracedProjection", motion)
        assert rays is not None  # only beams without rays lack it
        self.medium: CoRotatingMedium = medium
        self.rays: RayBundle = rays
        self.vessel: None = None
        self.step: float = positive("step [voxels]", step)
        patience = ceil(PATIENCE * sum(grid.shape) / self.step)
        self.most_steps: int = patience if most_steps is None else counts("most_steps", (most_steps,), 1)[0]
        medium.check(grid)
        level = medium.is_level and rays.is_level
        self._turns = places(motion, ray_parts(motion, 0.5 * hypot(*grid.shape[:2])))
        self._way: _Matrix | _March = _Matrix(self) if level else _March(self)
        self._dwell = Dwell(motion, beam, self.device)

    def __repr__(self) -> str:
        fields = ", ".join(self.medium.fields()) or "nothing"
        return f"TracedProjection({self.grid!r}, {self.beam!r}, {self.motion!r}, {fields}, device={self.device.name!r})"

    @property
    def entries(self) -> int:
        """Number of entries of the sparse matrix of one slice; 0 if rays are marched in every product."""
        return self._way.entries

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self._way.forward(x, out)
        self._dwell.weigh(out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._way.transposed(self._dwell.weighted(y), out)

    def _inputs(self, *, level: bool) -> dict[str, Any]:
        """Medium, rays, step and kind in the form for the kernels of `trace`."""
        unit = 1.0 if self.medium.kind & ABSORBS else self.grid.pitch
        starts = self.rays.table(self.grid, self.beam, level=level, unit=unit)  # type: ignore[union-attr]
        return {
            "medium": self.device.table(self.medium.samples(self.grid)),
            "starts": self.device.table(starts),
            "step": self.step,
            "kind": self.medium.kind,
        }

    def _check_left(self, caught: np.ndarray, rows: int, bundle: int) -> None:
        """Raise `BadInput` if more than a few rays are marked in ``caught`` (angle, ray)."""
        if not caught.any():
            return
        if caught.mean() < TRAPPED:
            warnings.warn(f"{int(caught.sum())} of {caught.size} rays are guided in the medium and never leave; their "
                          "light counts as lost", OpticsWarning, stacklevel=5)  # fmt: skip
            return
        angle, ray = np.argwhere(caught)[0]
        column, row = divmod(int(ray) // bundle, rows)
        pose = np.degrees(self.motion.poses[angle])
        raise BadInput(
            f"{int(caught.sum())} of {caught.size} rays have not left after {self.most_steps} steps of {self.step:g} "
            f"voxels ({self.most_steps * self.step * self.grid.pitch:.4g} mm), the first in column {column}, row "
            f"{row} at {pose:.4g}°; check the index, or allow more with most_steps="
        )


class _Matrix:
    """One sparse matrix for all slices, by rows and by columns."""

    def __init__(self, owner: TracedProjection) -> None:
        self.device, grid, beam = owner.device, owner.grid, owner.beam
        self.resampled = RowResampler(beam.pixels[1], beam.pitch, grid.shape[2], grid.pitch, owner.device)
        cells, rays = grid.shape[0] * grid.shape[1], owner.motion.angles * beam.pixels[0]
        if max(cells, rays) > WHOLE:
            raise BadInput(f"{cells} voxels per slice and {rays} rays; at most {WHOLE} of each: use a coarser geometry")
        entries = _mean_of(owner, (rays, cells))
        self.entries = entries.weight.size
        self.rows = entries.table(self.device, owner.range.shape[:2], PLANES * grid.shape[1])
        self.columns = entries.transposed().table(self.device, grid.shape[:2], POSES * beam.pixels[0])

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        with self.resampled.filling(out) as rows:
            self.device.launch(gather_rows, source=x, **self.rows, out=rows)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self.device.launch(gather_rows, source=self.resampled.in_slices(y), **self.columns, out=out)


def _mean_of(owner: TracedProjection, shape: tuple[int, int]) -> SparseEntries:
    """The mean matrix of one slice over the parts of every frame."""
    from scipy.sparse import csr_array

    parts = (_traced(owner, poses) for poses in owner._turns)
    if len(owner._turns) == 1:
        return next(parts)
    whole = csr_array(shape, dtype=np.float32)
    for part in parts:
        whole = whole + csr_array((part.weight, (part.row, part.column)), shape)
    found = whole.tocoo()
    weight = found.data / np.float32(len(owner._turns))
    return SparseEntries(found.row.astype(np.int32), found.col.astype(np.int32), weight)


def _traced(owner: TracedProjection, poses: np.ndarray) -> SparseEntries:
    """The matrix of one slice at some angles, with rows [angle, r]; some angles are traced at a time."""
    device, bundle = owner.device, owner.rays.rays  # type: ignore[union-attr]
    inputs = owner._inputs(level=True) | {"most": owner.most_steps}
    rays = owner.beam.pixels[0] * bundle
    capacity = 3 * sum(owner.grid.shape[:2]) + 16
    solid = None if owner.medium.dark is None else owner.medium.dark.ravel()
    entries, pairs, caught, at = [], [], [], 0
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
        caught.append(found < 0)
        found = np.maximum(found, 0)
        valid = np.arange(capacity) < found[..., None]
        part = scratch.numpy()[valid]
        if solid is not None:
            dark = solid[part[:, 0].astype(np.int64)]
            valid[valid] = ~dark
            found, part = valid.sum(axis=2), part[~dark]
        entries.append(found.reshape(-1, bundle).sum(axis=1))
        pairs.append(part)
        at += some.size
    owner._check_left(np.concatenate(caught), 1, bundle)
    found, whole = np.concatenate(entries), np.concatenate(pairs)
    if len(whole) >= 2**31:
        raise OutOfMemory(f"the matrix has {len(whole)} entries; expected fewer than {2**31}: use a coarser grid")
    row = np.repeat(np.arange(found.size, dtype=np.int32), found)
    return SparseEntries(row, whole[:, 0].astype(np.int32), np.ascontiguousarray(whole[:, 1]))


class _March:
    """Rays of every pixel marched in every product."""

    entries = 0

    def __init__(self, owner: TracedProjection) -> None:
        self.device, owned = owner.device, owner._inputs(level=False)
        angles, (columns, rows) = owner.motion.angles, owner.beam.pixels
        self.inputs = []
        for poses in owner._turns:
            directions = self.device.table(np.stack([np.cos(poses), np.sin(poses)], axis=1))
            inputs = owned | {"directions": directions}
            steps = self.device.empty((angles, columns * rows), np.int32, table=True)
            self.device.launch(survey_rays, **inputs, top=owner.grid.shape[2] + 1.0, most=owner.most_steps, steps=steps)
            owner._check_left(steps.numpy() < 0, rows, 1)
            self.inputs.append(inputs | {"steps": steps})

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        def compute(part: int, out: DeviceArray) -> None:
            self.device.launch(forward_traced, volume=x, **self.inputs[part], lanes=out, sinogram=out)

        mean(len(self.inputs), compute, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        def compute(part: int, out: DeviceArray) -> None:
            self.device.launch(clear_volume, volume=out)
            self.device.launch(back_traced, sinogram=y, **self.inputs[part], lanes=y, volume=out)

        mean(len(self.inputs), compute, out)


@dataclass(frozen=True, eq=False)
class SparseEntries:
    """Entries of a matrix in any order: rows and columns, int32, and weights; entries at the same position add up."""

    row: np.ndarray
    column: np.ndarray
    weight: np.ndarray

    def transposed(self) -> SparseEntries:
        """The same entries with rows and columns exchanged."""
        return SparseEntries(self.column, self.row, self.weight)

    def table(self, device: Device, shape: tuple[int, int], block: int) -> dict[str, DeviceArray]:
        """Tables of `gather_rows` for a matrix whose rows are ``shape``, in blocks of ``block`` columns."""
        from scipy.sparse import csr_array

        major, minor = np.divmod(self.row, shape[1])
        blocks = -(-(int(self.column.max(initial=0)) + 1) // block)
        place = (major * blocks + self.column // block) * shape[1] + minor
        row = np.arange(place.size, dtype=np.int32), place, np.array([0, place.size])
        by_place = csr_array(row, shape=(1, shape[0] * blocks * shape[1])).tocsc()
        order: np.ndarray = by_place.data  # entries of one place keep their order
        pairs = np.stack([self.column[order].astype(self.weight.dtype), self.weight[order]], axis=1)
        return {"first": device.table(by_place.indptr, "int32"), "entries": device.table(pairs)}
