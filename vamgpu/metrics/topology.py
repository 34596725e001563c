"""Bodies, through holes and cavities of a voxel volume."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from vamgpu.backend.cores import ahead

Labels = npt.NDArray[np.int32]
Mask = npt.NDArray[np.bool_]

_SLAB = 32
"""Number of planes along x processed at a time."""
_ONWARD = (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1)
"""Steps from a corner to the other corners of its cube."""


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

    def together(self, group: npt.NDArray[np.int64], genus: npt.NDArray[np.int64]) -> Topology:
        """The same, with all bodies of a group as one; group: the group number of each body, (bodies,)."""
        # genus: holes of each group, numbered from 0; they are used for groups of several bodies
        own, number, many = np.unique(group, return_inverse=True, return_counts=True)
        body = np.concatenate([[0], number + 1]).astype(np.int32)[self.body]
        size, holes = (np.bincount(number, each).astype(np.int64) for each in (self.size, self.holes))
        holes = np.where(many > 1, genus[np.maximum(own, 0)], holes)
        return replace(self, body=body, size=size, holes=holes)


def topology(mask: Mask) -> Topology:
    """Label a volume [x, y, z] and count its holes."""
    # Holes follow from the Euler characteristic of each body: holes = 1 + cavities − (corners − edges + faces − cubes)
    # of the complex whose corners are the voxels (T. Y. Kong and A. Rosenfeld, Digital topology, Comput. Vis. Graph.
    # Image Process. 48 (1989) 357).
    mask = np.ascontiguousarray(mask)
    body, size = _labeled(mask, 6)
    cavity, cavity_size = _cavities(mask)
    inside = np.bincount(_owners(body, cavity), minlength=size.size + 1)[1:]
    return Topology(body, cavity, size, 1 + inside - _euler(mask, body, size.size), cavity_size)


def _labeled(mask: Mask, neighbors: Literal[6, 26]) -> tuple[Labels, npt.NDArray[np.int64]]:
    """Numbers of the components of a volume, from 1 on, 0 outside them, and their sizes."""
    import cc3d

    found: Any = cc3d.connected_components(mask, connectivity=neighbors, return_N=True, out_dtype=np.uint32)
    labels, count = found
    if count < 2:
        return labels.view(np.int32), np.full(count, np.count_nonzero(mask), np.int64)
    return labels.view(np.int32), cc3d.statistics(labels)["voxel_counts"][1:].astype(np.int64)


def _cavities(mask: Mask) -> tuple[Labels, npt.NDArray[np.int64]]:
    """Numbers of void voxels from which no path leads out, and the size of each cavity."""
    void, size = _labeled(np.pad(~mask, 1, constant_values=True), 26)
    closed = np.arange(size.size + 1) > 0
    closed[void[0, 0, 0]] = False  # the void around everything
    if not closed.any():
        return np.zeros(mask.shape, np.int32), size[:0]
    number = np.where(closed, np.cumsum(closed), 0).astype(np.int32)
    return number[void[1:-1, 1:-1, 1:-1]], size[closed[1:]]


def _owners(body: Labels, cavity: Labels) -> npt.NDArray[np.int64]:
    """The body around each cavity: the voxel before the cavity's first voxel along x belongs to it."""
    flat = cavity.ravel()
    at = np.flatnonzero(flat)
    _, first = np.unique(flat[at], return_index=True)
    x, y, z = np.unravel_index(at[first], cavity.shape)
    return body[x - 1, y, z].astype(np.int64)


def _euler(mask: Mask, body: Labels, count: int) -> npt.NDArray[np.int64]:
    """Euler characteristic of each body."""
    # Every corner owns the edges, faces and cube that extend from it along the axes; inside a body they cancel.

    def slab(first: int) -> Any:
        cells = np.pad(mask[first : first + _SLAB + 1], ((0, 0), (0, 1), (0, 1)))
        cells = np.pad(cells, ((0, max(_SLAB + 1 - len(cells), 0)), (0, 0), (0, 0)))
        full = cells[:-1, :-1, :-1] & cells[1:, :-1, :-1] & cells[:-1, 1:, :-1] & cells[:-1, :-1, 1:]
        full &= cells[1:, 1:, :-1] & cells[1:, :-1, 1:] & cells[:-1, 1:, 1:] & cells[1:, 1:, 1:]
        x, y, z = np.nonzero(cells[:-1, :-1, :-1] & ~full)
        i, j, k, ij, ik, jk, ijk = (cells[x + a, y + b, z + c].view(np.int8) for a, b, c in _ONWARD)
        i_j, i_k, j_k = i * j * ij, i * k * ik, j * k * jk
        own = 1 - i - j - k + i_j + i_k + j_k - i_j * i_k * j_k * ijk
        return np.bincount(body[first + x, y, z], own, count + 1)

    return sum(ahead(slab, range(0, len(mask), _SLAB)), np.zeros(count + 1))[1:].astype(np.int64)
