"""Volumes of voxels as runs along z; a part has hundreds of times fewer runs than voxels."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import numpy as np
import numpy.typing as npt

from vamgpu.backend.cores import ahead

Shape = tuple[int, int, int]
Indices = npt.NDArray[np.int64]

_PIECE = 1 << 21  # voxels that a thread looks at


@dataclass(frozen=True, eq=False)
class Runs:
    """The voxels of a volume, as runs along z in the order of the volume; runs of one column have gaps between them."""

    # A voxel's place is (x·(ny + 1) + y)·(nz + 1) + z. The place behind each column and each plane is free: one step
    # along any axis leads only to neighbors.

    shape: Shape  # of the volume
    start: Indices  # place of each run's first voxel, (n,)
    stop: Indices  # place behind its last one, (n,)

    @property
    def step_x(self) -> int:
        """Difference of the places of two neighbors along x."""
        return (self.shape[1] + 1) * (self.shape[2] + 1)

    @property
    def step_y(self) -> int:
        """Difference of the places of two neighbors along y."""
        return self.shape[2] + 1

    @property
    def length(self) -> Indices:
        """Voxels of each run, (n,)."""
        return self.stop - self.start

    @property
    def index(self) -> Indices:
        """Index x, y, z of each run's first voxel, (3, n)."""
        x, rest = np.divmod(self.start, self.step_x)
        return np.stack([x, *np.divmod(rest, self.step_y)])

    @property
    def box(self) -> tuple[Indices, Indices]:
        """Least index of the voxels, of which there must be some, along each axis, and one more than the greatest."""
        x, y, z = self.index
        return self.index.min(axis=1), np.array([x.max() + 1, y.max() + 1, (z + self.length).max()])

    def holding(self, place: Indices) -> Indices:
        """Number of the run that contains each place (n,), or −1."""
        run = np.searchsorted(self.start, place, "right") - 1
        return np.where((run >= 0) & (place < np.append(self.stop, 0)[run]), run, -1)

    def holds(self, index: Indices) -> npt.NDArray[np.bool_]:
        """Whether each voxel (n, 3) of the volume is one of these."""
        return self.holding(index @ np.array([self.step_x, self.step_y, 1])) >= 0

    def moved(self, low: Indices, shape: Shape) -> Runs:
        """The same in a volume whose first voxel is the one at index ``low`` here; it must contain them."""
        x, y, z = self.index - low[:, None]
        start = (x * (shape[1] + 1) + y) * (shape[2] + 1) + z
        return Runs(shape, start, start + self.length)

    def gaps(self) -> Runs:
        """All other voxels of the volume."""
        nx, ny, nz = self.shape
        first = (np.arange(nx)[:, None] * self.step_x + np.arange(ny) * self.step_y).ravel()
        start, stop = (
            np.sort(np.append(*ends), kind="stable") for ends in ((self.stop, first), (self.start, first + nz))
        )
        return Runs(self.shape, start[start < stop], stop[start < stop])

    def meeting(self, other: Runs, step: int = 0, beside: int = 0) -> tuple[Indices, Indices]:
        """Pairs of a run, moved by a step of places, and one of another volume that share a voxel."""
        # beside: 1 to include runs that meet only at an edge or a corner
        first = np.searchsorted(other.stop, self.start + (step - beside), "right")
        count = np.searchsorted(other.start, self.stop + (step + beside), "left") - first
        own = np.repeat(np.arange(len(count)), count)
        return own, np.arange(len(own)) + (first - count.cumsum() + count)[own]

    def shared(self, other: Runs, step: int = 0) -> tuple[Indices, Indices, Runs]:
        """Pairs as of `meeting`, and the voxels that each pair shares, in the places of the other volume."""
        one, two = self.meeting(other, step)
        start = np.maximum(self.start[one] + step, other.start[two])
        return one, two, Runs(self.shape, start, np.minimum(self.stop[one] + step, other.stop[two]))


def runs_of(values: npt.ArrayLike, level: float | bool = True) -> Runs:
    """Voxels of values [x, y, z] that reach a level; of a boolean mask, those that are true."""
    field = np.asarray(values)
    shape: Shape = field.shape  # type: ignore[assignment]
    around = shape[1] + 1, shape[2] + 1
    each = max(1, _PIECE // prod(around))

    def ends(first: int) -> Indices:
        some = field[first : first + each]
        line = np.zeros(1 + len(some) * prod(around), bool)
        np.greater_equal(some, level, out=line[1:].reshape(-1, *around)[:, :-1, :-1])
        return np.flatnonzero(line[1:] != line[:-1]) + first * prod(around)

    found = np.concatenate([np.zeros(0, np.int64), *ahead(ends, range(0, shape[0], each))])
    return Runs(shape, found[::2], found[1::2])
