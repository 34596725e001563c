"""Bodies, through holes and cavities of a voxel volume."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

Labels = npt.NDArray[np.int32]
Mask = npt.NDArray[np.bool_]

_SLAB = 32
"""Planes along x looked at at once."""


@dataclass(frozen=True, eq=False)
class Topology:
    """Bodies, holes and cavities of a volume of voxels."""

    # Voxels of one body share faces; voxels of one cavity share a face, an edge or a corner.

    body: Labels  # number of each voxel's body, int32 [x, y, z], 1, 2, …; 0 in the void
    cavity: Labels  # number of each voxel's cavity, int32 [x, y, z], 1, 2, …; 0 in bodies and in the void around them
    size: npt.NDArray[np.int64]  # voxels of each body, int64 (bodies,)
    holes: npt.NDArray[np.int64]  # through holes of each body (its first Betti number), int64 (bodies,): a ring has one
    cavity_size: npt.NDArray[np.int64]  # voxels of each cavity, int64 (cavities,)

    @property
    def bodies(self) -> int:
        """Number of bodies."""
        return len(self.size)

    @property
    def cavities(self) -> int:
        """Number of cavities."""
        return len(self.cavity_size)

    def together(self, group: npt.NDArray[np.int64]) -> Topology:
        """The same, where all bodies of a group count as one; group: the number of each body's, (bodies,)."""
        _, number = np.unique(group, return_inverse=True)
        body = np.concatenate([[0], number + 1]).astype(np.int32)[self.body]
        size, holes = (np.bincount(number, each).astype(np.int64) for each in (self.size, self.holes))
        return replace(self, body=body, size=size, holes=holes)


def topology(mask: Mask) -> Topology:
    """Label a volume [x, y, z] and count its holes."""
    # Holes follow from the Euler characteristic of each body: holes = 1 + cavities − (corners − edges + faces − cubes)
    # of the complex whose corners are the voxels (T. Y. Kong and A. Rosenfeld, Digital topology, Comput. Vis. Graph.
    # Image Process. 48 (1989) 357).
    from scipy.ndimage import label

    found: Any = label(mask)
    body, count = found
    cavity = _cavities(mask)
    size = np.bincount(body.ravel(), minlength=count + 1)[1:]
    cavity_size = np.bincount(cavity.ravel())[1:]
    inside = np.bincount(_owners(body, cavity), minlength=count + 1)[1:]
    return Topology(body, cavity, size, 1 + inside - _euler(body, count), cavity_size)


def _cavities(mask: Mask) -> Labels:
    """Numbers of void voxels that no path of voxels leads out from."""
    from scipy.ndimage import label

    found: Any = label(np.pad(~mask, 1, constant_values=True), np.ones((3, 3, 3)))
    void, count = found
    number = np.arange(-1, count, dtype=np.int32)  # the void around everything is number 1: it comes first
    number[:2] = 0
    return number[void[1:-1, 1:-1, 1:-1]]


def _owners(body: Labels, cavity: Labels) -> npt.NDArray[np.int64]:
    """The body around each cavity: it lies before the cavity's first voxel along x."""
    flat = cavity.ravel()
    at = np.flatnonzero(flat)
    _, first = np.unique(flat[at], return_index=True)
    x, y, z = np.unravel_index(at[first], cavity.shape)
    return body[x - 1, y, z].astype(np.int64)


def _euler(body: Labels, count: int) -> npt.NDArray[np.int64]:
    """Euler characteristic of each body."""
    total = np.zeros(count + 1, np.int64)
    for first in range(0, body.shape[0], _SLAB):
        labels = body[first : first + _SLAB + 1]
        for axes in (axes for number in range(4) for axes in combinations(range(3), number)):
            full = labels > 0
            for axis in axes:
                low, high = [slice(None)] * 3, [slice(None)] * 3
                low[axis], high[axis] = slice(None, -1), slice(1, None)
                full = full[tuple(low)] & full[tuple(high)]
            full = full[:_SLAB]  # the plane after them belongs to the next slab
            at = labels[: full.shape[0], : full.shape[1], : full.shape[2]][full]
            total += (-1) ** len(axes) * np.bincount(at, minlength=count + 1)
    return total[1:]
