"""Fractions of the cells of rings: of a mesh, or of an array of voxels."""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from vamgpu.backend.device import Device
from vamgpu.geometry import Grid
from vamgpu.operators.polar import PolarGrid
from vamgpu.operators.ring_means import shares_of_voxels
from vamgpu.targets.resampling import along
from vamgpu.targets.solid import Solid
from vamgpu.targets.voxelize import voxelize

if TYPE_CHECKING:
    from vamgpu.targets.solid import Solid

FINE = 4
"""Columns along the side of a cell that a mesh is voxelized on; each has 16 points of its own, and all of z."""
_BAND = 1 << 26
"""Fine voxels that are kept at once, 256 MB."""


def voxelized(solid: Solid, rings: PolarGrid, device: Device) -> npt.NDArray[np.float32]:
    """The part of each cell inside a solid, in the solid's own place. Raises `TargetTooLarge`."""
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
        part = voxelize(_same_faces(solid, moved), Grid((across, across, count), pitch), device).fraction.numpy()
        found[:, first : first + count] = shares @ part.reshape(-1, count).astype(np.float32, copy=False)
    return np.minimum(found, np.float32(1.0)).reshape(rings.shape)


def _same_faces(solid: Solid, vertices: npt.NDArray[np.float64]) -> Solid:
    return Solid(vertices, solid.faces, solid.name)


def averaged_on_rings(fraction: npt.NDArray[np.floating], grid: Grid, rings: PolarGrid) -> npt.NDArray[np.float32]:
    """The mean of fractions, constant within each voxel and 0 outside, over the cells of rings."""
    shares = shares_of_voxels(rings, grid.shape[:2], grid.pitch)
    on_slices = along(fraction, grid, Grid((1, 1, rings.slices), rings.slice_pitch), 2)
    found = shares @ np.ascontiguousarray(on_slices, np.float32).reshape(-1, rings.slices)
    return np.minimum(found, np.float32(1.0)).reshape(rings.shape)
