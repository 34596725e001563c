"""Fractions of the cells of rings: of a mesh, or of an array of voxels."""

from __future__ import annotations

from math import ceil, pi
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from vamgpu.backend.device import Device
from vamgpu.geometry import Grid
from vamgpu.operators.polar import PolarGrid
from vamgpu.targets.resampling import along
from vamgpu.targets.solid import Solid
from vamgpu.targets.voxelize import voxelize

if TYPE_CHECKING:
    from scipy.sparse import csr_array

POINTS, GENERATOR = 89, 55
"""Points of a cell that represent equal parts of its area: a Fibonacci lattice, one in each of 89 rows and columns."""
FINE = 4
"""Columns along the side of a cell on which a mesh is voxelized; each has 16 points of its own, and all of z."""
_BAND = 1 << 26
"""Number of fine voxels in memory at a time, 256 MB."""


def voxelized(solid: Solid, rings: PolarGrid, device: Device) -> npt.NDArray[np.float32]:
    """The filled part of each cell for a solid, which keeps its place. Raises `TargetTooLarge`."""
    across = 2 * min(rings.rings, ceil(float(np.abs(solid.vertices[:, :2]).max()) / rings.pitch) + 1) * FINE
    pitch = rings.pitch / FINE
    squeezed = solid.vertices * (1.0, 1.0, pitch / rings.slice_pitch)
    shares = shares_of_voxels(rings, (across, across), pitch)
    band = max(1, min(rings.slices, _BAND // across**2))
    found = np.zeros((rings.shape[0] * rings.shape[1], rings.slices), np.float32)
    for first in range(0, rings.slices, band):
        count = min(band, rings.slices - first)
        middle = (first + 0.5 * count - 0.5 * rings.slices) * pitch
        moved = squeezed - (0.0, 0.0, middle)
        if moved[:, 2].min() >= 0.5 * count * pitch or moved[:, 2].max() <= -0.5 * count * pitch:
            continue
        part = voxelize(
            Solid(moved, solid.faces, solid.name), Grid((across, across, count), pitch), device
        ).fraction.numpy()
        found[:, first : first + count] = shares @ part.reshape(-1, count).astype(np.float32, copy=False)
    return np.minimum(found, np.float32(1.0)).reshape(rings.shape)


def averaged_on_rings(fraction: npt.NDArray[np.floating], grid: Grid, rings: PolarGrid) -> npt.NDArray[np.float32]:
    """The mean over the cells of rings of fractions that are constant within each voxel and 0 outside."""
    shares = shares_of_voxels(rings, grid.shape[:2], grid.pitch)
    on_slices = along(fraction, grid, Grid((1, 1, rings.slices), rings.slice_pitch), 2)
    found = shares @ np.ascontiguousarray(on_slices, np.float32).reshape(-1, rings.slices)
    return np.minimum(found, np.float32(1.0)).reshape(rings.shape)


def shares_of_voxels(rings: PolarGrid, shape: tuple[int, int], pitch: float) -> csr_array:
    """Share of every cell in each column of voxels, (angles · cells, x · y) float32, from `POINTS` points."""
    from scipy.sparse import csr_array, vstack

    blocks = [_of_band(rings, number, shape, pitch) for number in range(len(rings.bands))]
    whole = csr_array(vstack(blocks))
    cells, at, sizes = rings.shape[1], [], 0
    for band in rings.bands:  # rows are in order of bands, but volumes hold all bands of an angle together
        own = band.rings * band.samples
        at.append(sizes + np.arange(rings.angles * own).reshape(rings.angles, own))
        sizes += rings.angles * own
    order = np.concatenate(at, axis=1).reshape(rings.angles * cells)
    return csr_array(whole[order])


def _of_band(rings: PolarGrid, number: int, shape: tuple[int, int], pitch: float) -> csr_array:
    """Rows of the cells of a band, [angle, cell of the band]."""
    from scipy.sparse import csr_array

    band = rings.bands[number]
    count = rings.angles * band.samples
    u, v = (np.arange(POINTS) + 0.5) / POINTS, (np.arange(POINTS) * GENERATOR % POINTS + 0.5) / POINTS
    inner = np.arange(band.begin, band.stop)[:, None]
    rho = np.sqrt(inner**2 + u * (2 * inner + 1)) * (rings.pitch / pitch)  # equal parts of the area
    turn = 2.0 * pi / count * (np.arange(count)[:, None] + v - 0.5)
    x, y = (np.floor(f(turn)[:, None, :] * rho + 0.5 * n).astype(np.int32)
            for f, n in ((np.cos, shape[0]), (np.sin, shape[1])))  # fmt: skip
    inside = (x >= 0) & (x < shape[0]) & (y >= 0) & (y < shape[1])
    places = x * shape[1] + y
    row = np.broadcast_to(np.arange(count * band.rings).reshape(count, band.rings, 1), places.shape)
    weight = np.full(int(inside.sum()), 1.0 / POINTS, np.float32)
    found = csr_array((weight, (row[inside], places[inside])), shape=(count * band.rings, shape[0] * shape[1]))
    found.sum_duplicates()
    return found
