"""Forward and back projection of bent and absorbed rays at every pose of a turntable.

The optics stand still while the resin turns, so one map of one pose, made once, says which ray lights a point of the
laboratory and how strongly; every voxel looks itself up at every pose. Both directions are exact transposes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np

from vamgpu.kernels.project import Directions, middle
from vamgpu.kernels.signature import Real, Sinogram, SinogramOut, Table, Tiling, Volume, VolumeOut, kernel

Map = Annotated[np.ndarray, Table("float32", ("across", "along", "2"))]
"""Column index and weight, samples one voxel apart around the axis."""
Edges = Annotated[np.ndarray, Table("float32", ("r", "8"))]
"""p, cos d, sin d, slack of the two chords between which a column's light falls."""


def _lit(
    shape: tuple[int, ...], columns: int, direction: np.ndarray, light: np.ndarray, width: float, radius: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(column, weight), each (nx, ny), of every column that reaches the voxels; weight 0 outside the beam."""
    reach = 0.5 * (1.0 + width)
    x, y = (np.arange(n) - middle(n) for n in shape[:2])
    c, s = direction
    across = y[None, :] * c - x[:, None] * s + middle(light.shape[0])
    along = -(x[:, None] * c + y[None, :] * s) + middle(light.shape[1])
    i = np.clip(across.astype(int), 0, light.shape[0] - 2)
    j = np.clip(along.astype(int), 0, light.shape[1] - 2)
    a, b = (across - i)[..., None], (along - j)[..., None]
    here = (1 - a) * ((1 - b) * light[i, j] + b * light[i, j + 1])
    here += a * ((1 - b) * light[i + 1, j] + b * light[i + 1, j + 1])
    u, strength = here[..., 0], here[..., 1] * (x[:, None] ** 2 + y[None, :] ** 2 <= radius**2)
    first = np.ceil(u - reach).astype(int)
    for tap in range(int(np.ceil(2 * reach))):
        column = first + tap
        weight = strength * np.clip(reach - np.abs(u - column), 0.0, 1.0) / width
        inside = (column >= 0) & (column < columns)
        yield np.clip(column, 0, columns - 1), weight * inside


@kernel(
    over="sinogram",
    cpu=Tiling(major=20, minor=0, slabs=4),
    gpu=Tiling(major=1, minor=1, slabs=4, group=(256, 1)),
    constants={"cpu": {"STRIP": 8, "POSES": 8, "RAYS": 8, "CAPACITY": 32}},
)
def forward_refracted(
    volume: Volume, directions: Directions, light: Map, edges: Edges, width: Real, radius: Real, sinogram: SinogramOut
) -> None:
    """The transpose of `back_refracted`: every voxel adds to the columns that light it.

    edges bound where a column's light falls, so that a device can gather along the ray instead.
    """
    sinogram[...] = 0.0
    for angle, direction in enumerate(directions):
        for column, weight in _lit(volume.shape, sinogram.shape[1], direction, light, width, radius):
            np.add.at(sinogram[angle], column, weight[..., None] * volume)


@kernel(
    over="volume",
    cpu=Tiling(major=16, minor=0, slabs=4),
    gpu=Tiling(major=1, minor=1, slabs=4, group=(64, 4)),
    constants={"cpu": {"ANGLES": 12, "TOGETHER": 16, "CAPACITY": 32}},
)
def back_refracted(
    sinogram: Sinogram, directions: Directions, light: Map, width: Real, radius: Real, volume: VolumeOut
) -> None:
    """volume[x, y, z] = Σ over poses of the strength of the light there × the columns around the ray that brings it.

    light holds, one voxel apart, the column index of the ray through a point and its weight. A voxel is ``width`` ≥ 1
    columns wide and takes of each column what they overlap, so even light leaves no ripple; for a width of 1 that is
    linear interpolation. Voxels beyond ``radius`` voxels from the axis get nothing.
    """
    volume[...] = 0.0
    for angle, direction in enumerate(directions):
        for column, weight in _lit(volume.shape, sinogram.shape[1], direction, light, width, radius):
            volume += weight[..., None] * sinogram[angle, column]
