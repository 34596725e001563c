"""Bodies, through holes and cavities of a voxel volume."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vamgpu.metrics.runs import Indices, Runs


@dataclass(frozen=True, eq=False)
class Topology:
    """Bodies, holes and cavities of a volume of voxels."""

    # Voxels of one body share faces; voxels of one cavity share a face, an edge or a corner.

    runs: Runs  # the voxels of the volume
    body: Indices  # number of each run's body, 1, 2, …, (runs,)
    hollow: Runs  # void voxels that no path of voxels leads out from
    cavity: Indices  # number of the cavity of each of those runs, 1, 2, …
    size: Indices  # voxels of each body, int64 (bodies,)
    holes: Indices  # through holes of each body (its first Betti number), int64 (bodies,): a ring has one
    cavity_size: Indices  # voxels of each cavity, int64 (cavities,)
    pierced: int = 0  # holes that voxels leave in a thin wall, not among ``holes``

    @property
    def bodies(self) -> int:
        """Number of bodies."""
        return len(self.size)

    @property
    def cavities(self) -> int:
        """Number of cavities."""
        return len(self.cavity_size)

    def together(self, group: Indices, genus: Indices) -> Topology:
        """The same, with all bodies of a group as one; group: the group number of each body, (bodies,)."""
        # genus: holes of each group, numbered from 0; they are used for groups of several bodies
        own, number, many = np.unique(group, return_inverse=True, return_counts=True)
        size, holes = (np.bincount(number, each).astype(np.int64) for each in (self.size, self.holes))
        holes = np.where(many > 1, genus[np.maximum(own, 0)], holes)
        return replace(self, body=number[self.body - 1] + 1, size=size, holes=holes)


def topology(runs: Runs) -> Topology:
    """Label a volume and count its holes."""
    # Holes follow from the Euler characteristic of each body: holes = 1 + cavities − (corners − edges + faces − cubes)
    # of the complex whose corners are the voxels (T. Y. Kong and A. Rosenfeld, Digital topology, Comput. Vis. Graph.
    # Image Process. 48 (1989) 357). Corners less the edges along z are one a run, edges along another axis less the
    # faces on them one for each pair of runs that share voxels, faces across z less cubes one for each four.
    *along_y, sides = runs.shared(runs, runs.step_y)
    along_x = runs.meeting(runs, runs.step_x)
    body, size = _labeled(runs, along_y, along_x)
    across, _ = sides.meeting(sides, runs.step_x)
    owners = body, body[along_y[0]], body[along_x[0]], body[along_y[0][across]]
    corners, edges_y, edges_x, faces = (np.bincount(each, minlength=size.size + 1)[1:] for each in owners)
    hollow, cavity, cavity_size = _cavities(runs.gaps())
    _, first = np.unique(cavity, return_index=True)
    owner = body[runs.holding(hollow.start[first] - runs.step_x)]  # the voxel before a cavity's first one along x
    inside = np.bincount(owner, minlength=size.size + 1)[1:]
    holes = 1 + inside - (corners - edges_y - edges_x + faces)
    return Topology(runs, body, hollow, cavity, size, holes, cavity_size)


def _labeled(runs: Runs, *pairs: Sequence[Indices]) -> tuple[Indices, Indices]:
    """Numbers of the components, from 1 on, that pairs of runs connect, and their sizes."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count, one, other = len(runs.start), *(np.concatenate(ends) for ends in zip(*pairs, strict=True))
    if not count:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    graph = coo_array((np.ones(len(one), np.int8), (one, other)), (count, count))
    _, number = connected_components(graph, directed=False)
    return number.astype(np.int64) + 1, np.bincount(number, runs.length).astype(np.int64)


def _cavities(void: Runs) -> tuple[Runs, Indices, Indices]:
    """Runs of void voxels from which no path leads out, the numbers of their cavities, and the size of each."""
    # Most runs reach the rim of the volume; only the others are labeled.
    (x, y, z), (nx, ny, nz) = void.index, void.shape
    inner = (x > 0) & (x < nx - 1) & (y > 0) & (y < ny - 1) & (z > 0) & (z + void.length < nz)
    within, number = Runs(void.shape, void.start[inner], void.stop[inner]), np.where(inner, inner.cumsum(), 0) - 1
    out, pairs = np.zeros(len(within.start), bool), list[tuple[Indices, Indices]]()
    for step in (void.step_y, void.step_x - void.step_y, void.step_x, void.step_x + void.step_y):
        for way in (step, -step):
            own, other = within.meeting(void, way, 1)
            other = number[other]
            out[own[other < 0]] = True
            pairs += [(own[other >= 0], other[other >= 0])] * (way > 0)
    group, size = _labeled(within, *pairs)
    closed = np.arange(size.size + 1) > 0
    closed[group[out]] = False
    kept = closed[group]
    return Runs(void.shape, within.start[kept], within.stop[kept]), closed.cumsum()[group[kept]], size[closed[1:]]
