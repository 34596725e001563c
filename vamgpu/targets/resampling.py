"""Fractions of one grid averaged over the voxels of another."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from vamgpu.geometry import Grid

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def averaged(
    fraction: npt.NDArray[np.floating], grid: Grid, other: Grid, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> npt.NDArray[np.float32]:
    """The mean over every voxel of ``other`` of ``fraction``, constant in each voxel of ``grid``, 0 outside."""
    values = np.asarray(fraction)
    for axis in (2, 0, 1):  # z first: it is cut to a slab more often than x and y
        values = along(values, grid, other, axis, shift[axis])
    return np.ascontiguousarray(np.minimum(values, np.float32(1.0)))


def along(
    values: npt.NDArray[np.floating], grid: Grid, other: Grid, axis: int, shift: float = 0.0
) -> npt.NDArray[np.float32]:
    """The means along one axis of values on ``grid``, over the voxels of ``other`` moved by ``shift`` [mm]."""
    share = _shares(grid, other, axis, shift)
    used = np.flatnonzero(np.diff(share.tocsc().indptr))
    reach = slice(used[0], used[-1] + 1) if len(used) else slice(0, 0)
    cut = np.moveaxis(values, axis, 0)[reach]
    flat = share[:, reach] @ np.ascontiguousarray(cut, np.float32).reshape(len(cut), prod(cut.shape[1:]))
    return np.moveaxis(flat.reshape(other.shape[axis], *cut.shape[1:]), 0, axis)


def _shares(grid: Grid, other: Grid, axis: int, shift: float) -> csr_array:
    """Share of every voxel of ``other`` (rows) that lies in each voxel of ``grid`` (columns) along an axis; float32."""
    from scipy.sparse import csr_array

    n, fine = grid.shape[axis], other.shape[axis]
    # Edges of the other voxels, counted in voxels of the grid from its low side.
    edges = ((np.arange(fine + 1) - 0.5 * fine) * other.pitch + shift) / grid.pitch + 0.5 * n
    low, high = edges[:-1], edges[1:]
    span = int(np.ceil(other.pitch / grid.pitch)) + 1
    columns = np.floor(low).astype(np.int64)[:, None] + np.arange(span)
    common = np.minimum(high[:, None], columns + 1.0) - np.maximum(low[:, None], columns)
    share = common * (grid.pitch / other.pitch)
    # A share below float32 resolution is only the rounding of an edge that coincides with a voxel face.
    keep = (share > 1e-7) & (columns >= 0) & (columns < n)
    rows = np.broadcast_to(np.arange(fine)[:, None], keep.shape)
    return csr_array((share[keep].astype(np.float32), (rows[keep], columns[keep])), shape=(fine, n))
