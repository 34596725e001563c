"""Forward and back projection of light that also moves along the axis: cones, inclined light, a wobbling axis."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np

from vamgpu.kernels.footprint import Edges, look_up, middle
from vamgpu.kernels.signature import Field, Integer, Real, SinogramOut, Table, Tiling, VolumeOut, kernel

Poses = Annotated[np.ndarray, Table("float32", ("angle", "4"))]
"""cos θ, sin θ, and the position (X, Y) of the axis in fixed coordinates, in voxels."""
Rays = Annotated[np.ndarray, Table("float32", ("across", "along", "4"))]
"""Column index, weight, row index of the slice z = 0, rows per slice; samples one voxel apart."""
Images = Annotated[np.ndarray, Field(("angle", "r", "row"))]
Slices = Annotated[np.ndarray, Field(("x", "y", "slice"))]


def even(stretch: np.ndarray) -> np.ndarray:
    """Height in rows of slices that are ``stretch`` rows apart: the multiple of it closest to one, or more."""
    # Slices whose height is a whole multiple of their distance divide every row evenly, for any distance.
    return stretch * np.maximum(1.0, np.floor(1.0 / stretch + 0.5))


def _looked_up(shape: tuple[int, ...], pose: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(nx, ny, 4): the map at every voxel of a plane, continued linearly beyond its edge."""
    x, y = (np.arange(n) - middle(n) for n in shape[:2])
    c, s, shift_x, shift_y = pose
    across, along = y[None, :] * c - x[:, None] * s, -(x[:, None] * c + y[None, :] * s)
    return look_up(light, across + shift_x, along + shift_y)


def _taps(position: np.ndarray, width: np.ndarray, count: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(index, share) of the samples that an interval ``width`` samples wide overlaps; share 0 beyond ``count``."""
    reach = 0.5 * (1.0 + width)
    first = np.ceil(position - reach).astype(int)
    for tap in range(int(np.ceil(2 * reach.max()))):
        index = first + tap
        share = np.clip(reach - np.abs(position - index), 0.0, np.minimum(width, 1.0)) / width
        yield np.clip(index, 0, count - 1), share * ((index >= 0) & (index < count))


def _struck(
    volume: tuple[int, ...], sinogram: tuple[int, ...], pose: np.ndarray, light: np.ndarray, size: tuple[float, float]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(column, row, weight), each (nx, ny, nz), of every pixel that reaches the voxels at one angle."""
    width, radius = size
    x, y, z = (np.arange(n) - middle(n) for n in volume)
    u, strength, lift, stretch = np.moveaxis(_looked_up(volume, pose, light), -1, 0)[..., None]
    strength = strength * (x[:, None] ** 2 + y[None, :] ** 2 <= radius**2)[..., None]
    position = z * stretch + lift + middle(sinogram[2])
    for column, part in _taps(u, np.asarray(width), sinogram[1]):
        for row, share in _taps(position, even(stretch), sinogram[2]):
            yield np.broadcast_to(column, row.shape), row, strength * part * share


@kernel(over="sinogram", cpu=Tiling(major=1, minor=0))
def forward_oblique(
    volume: Slices, poses: Poses, light: Rays, edges: Edges, width: Real, radius: Real, lanes: Integer,
    sinogram: SinogramOut,
) -> None:  # fmt: skip
    """The transpose of `back_oblique`. edges bound the range of a column's light; lanes: of the volume's layout."""
    sinogram[...] = 0.0
    for angle, pose in enumerate(poses):
        for column, row, weight in _struck(volume.shape, sinogram.shape, pose, light, (width, radius)):
            np.add.at(sinogram[angle], (column, row), weight * volume)


@kernel(over="volume", cpu=Tiling(major=1, minor=0))
def back_oblique(
    sinogram: Images, poses: Poses, light: Rays, width: Real, radius: Real, lanes: Integer, volume: VolumeOut,
) -> None:  # fmt: skip
    """volume[x, y, z] = Σ over angles of the strength of the light there × the pixels around the ray that lights it."""
    # A voxel is ``width`` ≥ 1 columns wide and `even` rows high, and pixels count by their overlap with it. Voxels
    # beyond ``radius`` voxels from the axis get nothing. lanes: of the sinogram's layout (0 if it is plain).
    volume[...] = 0.0
    for angle, pose in enumerate(poses):
        for column, row, weight in _struck(volume.shape, sinogram.shape, pose, light, (width, radius)):
            volume += weight * sinogram[angle][column, row]
