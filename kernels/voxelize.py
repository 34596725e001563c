"""Anti-aliased voxels of a closed triangle surface."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Integer, Table, Tiling, VolumeOut, kernel

SAMPLES = 16
GENERATOR = 7
OFFSET = 11
FINEST = 5
"""Fewest bits at which the sample points lie on the fine grid."""

RAY_SHIFT = 22
"""A crossing is one integer that sorts by ray, then height: ray << 22 | height << 1 | whether the ray leaves."""

Triangles = Annotated[np.ndarray, Table("int32", ("triangle", "10"))]
"""Three corners (x, y, z), counter-clockwise seen from above; sign."""
Members = Annotated[np.ndarray, Table("int32", ("member",))]
Bounds = Annotated[np.ndarray, Table("int32", ("tile_x", "tile_y"))]
Start = Annotated[np.ndarray, Table("int32", ("x", "y"))]
Counts = Annotated[np.ndarray, Table("int32", ("x", "y"), writes=True)]
Lists = Annotated[np.ndarray, Table("int32", ("entry",), writes=True)]
Filled = Annotated[np.ndarray, Table("float32", ("tile_x", "tile_y"), writes=True)]
CPU, GPU = Tiling(), Tiling(group=(64, 1))


def sample_points(bits: int) -> np.ndarray:
    """Where the rays pass within a column, in units of the fine grid; int64 (SAMPLES, 2)."""
    i = np.arange(SAMPLES)
    return (2 * np.stack([i, (GENERATOR * i + OFFSET) % SAMPLES], axis=1) + 1) * (1 << bits) // (2 * SAMPLES)


@kernel(over="first", cpu=CPU, gpu=GPU)
def count_crossings(
    triangles: Triangles, members: Members, first: Bounds, last: Bounds, tile: Integer, bits: Integer, counts: Counts,
) -> None:  # fmt: skip
    """counts[x, y] = number of crossings of the column's rays with the triangles of `voxelize`."""
    counts[...] = 0
    for point in sample_points(int(bits)):
        x, y, _, _ = crossings(triangles.astype(np.int64), point, 1 << int(bits), counts.shape)
        np.add.at(counts, (x, y), 1)


@kernel(over="first", cpu=CPU, gpu=GPU)
def voxelize(
    triangles: Triangles, members: Members, first: Bounds, last: Bounds, start: Start, tile: Integer, bits: Integer,
    row: Integer, lists: Lists, volume: VolumeOut, filled: Filled,
) -> None:  # fmt: skip
    """volume[x, y, z] = fraction of the voxel inside the surface, 0..1; filled = its sum over tile × tile columns."""
    # triangles: in units of the fine grid from the low corner of the volume; sign −1 where a ray enters. Those whose
    # boxes touch a tile are members[first:last]. Only the rows of tiles in ``first``, from ``row`` on, are computed.
    # lists[start[x, y]] is the number of crossings of a column, followed by the sorted crossings.
    unit, (n_x, n_y, n_z) = 1 << int(bits), volume.shape
    low, high = int(row * tile), min(int((row + first.shape[0]) * tile), n_x)
    found = []
    for ray, point in enumerate(sample_points(int(bits))):
        x, y, height, sign = crossings(triangles.astype(np.int64), point, unit, volume.shape)
        code = ray << RAY_SHIFT | np.clip(height, 0, n_z * unit) << 1 | (sign > 0)
        found.append(np.stack([x * n_y + y, code])[:, (x >= low) & (x < high)])
    column, code = np.concatenate(found, axis=1)
    order = np.lexsort((code, column))
    column, code = column[order], code[order]
    _enlist(lists, start.ravel()[low * n_y : high * n_y], column - low * n_y, code)
    entered, changed = _changes(column, code)
    step, z, above = np.where(entered, 1, -1)[changed], *np.divmod((code & (1 << RAY_SHIFT) - 1)[changed] >> 1, unit)
    changes = np.zeros(((high - low) * n_y, n_z + 2), np.int64)
    np.add.at(changes, (column[changed] - low * n_y, z), step * (unit - above))
    np.add.at(changes, (column[changed] - low * n_y, z + 1), step * above)
    inside = np.cumsum(changes[:, :n_z], axis=1).reshape(high - low, n_y, n_z)
    volume[low:high] = inside / (SAMPLES * unit)
    columns = volume[low:high].sum(axis=2)
    rows, across = (np.arange(0, n, tile) for n in columns.shape)
    filled[...] = np.add.reduceat(np.add.reduceat(columns, rows, axis=0), across, axis=1)


def _enlist(lists: np.ndarray, start: np.ndarray, column: np.ndarray, code: np.ndarray) -> None:
    """Write sorted crossings after their number, each column's where it starts."""
    counts = np.bincount(column, minlength=len(start))
    lists[start] = counts
    lists[start[column] + 1 + np.arange(len(code)) - (np.cumsum(counts) - counts)[column]] = code


def _changes(column: np.ndarray, code: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For sorted crossings: whether the ray enters there, and whether its winding number changes between 0 and 1."""
    entered = code & 1 == 0
    step = np.where(entered, 1, -1)
    winding = np.cumsum(step)
    ray = column * SAMPLES + (code >> RAY_SHIFT)
    begins = np.concatenate([[True], ray[1:] != ray[:-1]])[: len(ray)]
    winding -= (winding - step)[begins][np.cumsum(begins) - 1]
    return entered, (winding > 0) != (winding - step > 0)


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
