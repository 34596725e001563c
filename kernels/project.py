"""Forward and back projection of straight rays at every angle of a turntable, after Joseph.

Where a ray crosses a plane of voxels, it interpolates between the two nearest; the transpose gathers, for each voxel,
the two rays next to it, with the same weights. Source: P. M. Joseph, IEEE Trans. Med. Imaging 1 (1982) 192. Columns are
as far apart as voxels, and lengths inside are counted in voxels from the middle of the grid and of the beam.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Real, Sinogram, SinogramOut, Table, Tiling, Volume, VolumeOut, kernel

Directions = Annotated[np.ndarray, Table("float32", ("angle", "2"))]  # cosθ, sinθ


def middle(n: int) -> float:
    """Index of the center of ``n`` samples."""
    return 0.5 * (n - 1)


@kernel(
    over="sinogram",
    cpu=Tiling(major=45, minor=0),
    gpu=Tiling(major=2, minor=1, group=(128, 1)),
    constants={"cpu": {"RAYS": 4, "STRIP": 32, "TOGETHER": 9}, "gpu": {"RAYS": 1, "STRIP": 16}},
)
def forward_joseph(volume: Volume, directions: Directions, pitch: Real, sinogram: SinogramOut) -> None:
    """sinogram[a, r, z] = Σ along the ray of volume, interpolated between two cells, × length [mm]."""
    columns = np.arange(sinogram.shape[1]) - middle(sinogram.shape[1])
    for angle, (c, s) in enumerate(directions):
        if abs(c) >= abs(s):  # planes of constant x: y = (r + x·s) / c
            planes, step, slope = volume, 1.0 / c, s / c
        else:  # planes of constant y: x = (y·c − r) / s
            planes, step, slope = volume.swapaxes(0, 1), -1.0 / s, c / s
        count, cells = planes.shape[:2]
        plane = np.arange(count)[:, None]
        position = columns * step + (plane - middle(count)) * slope + middle(cells)
        below = np.floor(position).astype(int)
        total = np.zeros(sinogram.shape[1:])
        for cell, weight in ((below, below + 1 - position), (below + 1, position - below)):
            inside = (cell >= 0) & (cell < cells)
            total += np.einsum("pr,prz->rz", weight * inside, planes[plane, np.clip(cell, 0, cells - 1)])
        sinogram[angle] = total * (pitch * abs(step))


@kernel(
    over="volume",
    cpu=Tiling(major=64, minor=0),
    gpu=Tiling(major=4, minor=4, group=(64, 4)),
    constants={"cpu": {"ROWS": 2, "COLUMNS": 2, "ANGLES": 45}, "gpu": {"ROWS": 4, "COLUMNS": 4, "ANGLES": 1 << 30}},
)
def back_joseph(sinogram: Sinogram, directions: Directions, pitch: Real, volume: VolumeOut) -> None:
    """The transpose: each voxel gathers the rays less than 1/m columns away, with weights m·max(0, 1 − m·distance)."""
    x, y = (np.arange(n) - middle(n) for n in volume.shape[:2])
    columns = sinogram.shape[1]
    volume[...] = 0.0
    for angle, (c, s) in enumerate(directions):
        m = 1.0 / max(abs(c), abs(s))
        u = y[None, :] * c - x[:, None] * s + middle(columns)
        below = np.floor(u).astype(int)
        for column in (below, below + 1):
            weight = pitch * m * np.maximum(0.0, 1.0 - m * np.abs(u - column))
            weight *= (column >= 0) & (column < columns)
            volume += weight[..., None] * sinogram[angle, np.clip(column, 0, columns - 1)]
