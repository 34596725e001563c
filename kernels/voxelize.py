"""Anti-aliased voxels of a closed triangle surface.

Rays run up z through SAMPLES points of every (x, y) column. Where a ray enters the solid at height h, every voxel above
gains one, the voxel cut by the surface its part above h; where it leaves, they lose as much. The running sum is the
winding number, so nothing needs sorting, and the result is exact along z. Vertices sit on a fine grid of 2**bits units
a voxel, edge tests and heights are integers of 64 bits, and a ray through an edge or a vertex counts as passing it an
infinitesimal (ε, ε²) beside: neighboring triangles never both take it and never both miss it. All sums are multiples of
1 / (SAMPLES · 2**bits), exact in float32 up to a thousand shells, so devices give the very same numbers in any order.

The points are a lattice of 16 rows and 16 columns with one point in each (rank 1, generator 7): a wall along x or y is
resolved to 1/16 of a voxel, where a square array of as many points would resolve 1/4.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Integer, Table, Tiling, VolumeOut, kernel

SAMPLES = 16
GENERATOR = 7
FINEST = 5
"""Fewest bits at which the sample points lie on the fine grid."""

Triangles = Annotated[np.ndarray, Table("int32", ("triangle", "10"))]
"""Three corners (x, y, z), counter-clockwise seen from above; sign."""
Members = Annotated[np.ndarray, Table("int32", ("member",))]
Bounds = Annotated[np.ndarray, Table("int32", ("tile_x", "tile_y"))]
Filled = Annotated[np.ndarray, Table("float32", ("tile_x", "tile_y"), writes=True)]


def sample_points(bits: int) -> np.ndarray:
    """Where the rays pass within a column, in units of the fine grid; int64 (SAMPLES, 2)."""
    i = np.arange(SAMPLES)
    return (2 * np.stack([i, GENERATOR * i % SAMPLES], axis=1) + 1) * (1 << bits) // (2 * SAMPLES)


@kernel(over="first", cpu=Tiling(), gpu=Tiling(group=(64, 1)))
def voxelize(
    triangles: Triangles,
    members: Members,
    first: Bounds,
    last: Bounds,
    tile: Integer,
    bits: Integer,
    volume: VolumeOut,
    filled: Filled,
) -> None:
    """volume[x, y, z] = fraction of the voxel inside the surface, 0..1; filled = its sum over tile × tile columns.

    triangles: corners in units of the fine grid, counted from the low corner of the volume, and −1 where the surface
    is entered from below (it faces down), +1 where it is left. members[first:last] of a tile are the triangles whose
    boxes touch it; they spare devices a search and change nothing.
    """
    unit = 1 << int(bits)
    changes = np.zeros((*volume.shape[:2], volume.shape[2] + 1), np.int64)
    for point in sample_points(int(bits)):
        x, y, height, sign = crossings(triangles.astype(np.int64), point, unit, volume.shape)
        voxel = np.clip(height // unit, 0, volume.shape[2])
        above = np.clip(height - voxel * unit, 0, unit)  # part of the voxel below the surface
        np.subtract.at(changes, (x, y, voxel), sign * (unit - above))
        lifted = voxel < volume.shape[2]
        np.subtract.at(changes, (x[lifted], y[lifted], voxel[lifted] + 1), (sign * above)[lifted])
    winding = np.cumsum(changes[:, :, :-1], axis=2) / (SAMPLES * unit)
    volume[...] = np.clip(winding, 0.0, 1.0)
    columns = volume.sum(axis=2)
    filled[...] = np.add.reduceat(
        np.add.reduceat(columns, np.arange(0, columns.shape[0], tile), axis=0),
        np.arange(0, columns.shape[1], tile),
        axis=1,
    )


def crossings(
    triangles: np.ndarray, point: np.ndarray, unit: int, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Column x, y, height and sign of every crossing of the rays through ``point`` of all columns."""
    corners = triangles[:, :9].reshape(-1, 3, 3)
    low = np.maximum(corners[:, :, :2].min(axis=1) // unit, 0)
    high = np.minimum(corners[:, :, :2].max(axis=1) // unit, np.array(shape[:2]) - 1)
    size = np.maximum(high - low + 1, 0)
    count = size[:, 0] * size[:, 1]
    which = np.repeat(np.arange(len(triangles)), count)
    place = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    x = low[which, 0] + place // np.maximum(size[which, 1], 1)
    y = low[which, 1] + place % np.maximum(size[which, 1], 1)
    a, b, c = (corners[which, k] - np.stack([x * unit, y * unit, 0 * x], axis=1) for k in range(3))
    sides = [edge(b, c, point), edge(c, a, point), edge(a, b, point)]
    inside = np.logical_and.reduce([(side > 0) | ((side == 0) & kept) for side, kept in sides])
    weights = [side[inside] for side, _ in sides]
    heights = np.stack([a[inside, 2], b[inside, 2], c[inside, 2]])
    base = heights.min(axis=0)
    area = sum(weights)
    height = base + (sum(w * (h - base) for w, h in zip(weights, heights, strict=True)) + area // 2) // area
    return x[inside], y[inside], height, triangles[which[inside], 9]


def edge(start: np.ndarray, end: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twice the area of (start, end, point), > 0 with the point on the left; whether the edge owns points on it."""
    dx, dy = end[:, 0] - start[:, 0], end[:, 1] - start[:, 1]
    return dx * (point[1] - start[:, 1]) - dy * (point[0] - start[:, 0]), (dy < 0) | ((dy == 0) & (dx > 0))
