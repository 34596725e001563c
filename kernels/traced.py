"""Forward and back projection along rays that are marched anew each time, through a co-rotating medium."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np

from vamgpu.kernels.medium import BLOCKS, DARK, MARGIN, Directions, Medium, Starts, march
from vamgpu.kernels.pointwise import pointwise
from vamgpu.kernels.signature import Field, Integer, Real, Table, Volume, VolumeInOut, VolumeOut, kernel

Steps = Annotated[np.ndarray, Table("int32", ("angle", "pixel"))]
Rows = Annotated[np.ndarray, Field(("angle", "r", "row"))]
RowsOut = Annotated[np.ndarray, Field(("angle", "r", "row"), writes=True)]


@kernel(over="steps")
def forward_traced(
    volume: Volume, medium: Medium, starts: Starts, directions: Directions, steps: Steps, step: Real, kind: Integer,
    lanes: Integer, sinogram: RowsOut,
) -> None:  # fmt: skip
    """sinogram[a, r, row] = Σ over the steps of a pixel's rays of weight × volume, trilinear."""
    # steps: of the longest ray of each pixel, see `survey_rays`. lanes: of the sinogram's layout.
    total = np.zeros(directions.shape[0] * starts.shape[0])
    for ray, cell, weight in entries(medium, volume.shape, starts, directions, steps, step, kind):
        total[ray] += weight * volume[cell]
    sinogram[...] = total.reshape(*sinogram.shape, -1).sum(axis=3)


@kernel(over="steps")
def back_traced(
    sinogram: Rows, medium: Medium, starts: Starts, directions: Directions, steps: Steps, step: Real, kind: Integer,
    lanes: Integer, volume: VolumeInOut,
) -> None:  # fmt: skip
    """The transpose, added to ``volume``: every ray adds its light to the voxels that `forward_traced` reads."""
    bundle = directions.shape[0] * starts.shape[0] // sinogram.size
    light = np.repeat(sinogram.ravel(), bundle)
    for ray, cell, weight in entries(medium, volume.shape, starts, directions, steps, step, kind):
        np.add.at(volume, cell, weight * light[ray])


@pointwise(over="volume")
def clear_volume(volume: VolumeOut) -> None:
    """volume = 0."""
    volume[...] = 0.0


def entries(
    medium: np.ndarray, shape: tuple[int, ...], starts: np.ndarray, directions: np.ndarray, steps: np.ndarray,
    step: float, kind: int,
) -> Iterator[tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray]]:  # fmt: skip
    """Rays, voxels around the middles of their steps, and weights, 0 for voxels beyond the grid and for inserts."""
    most, unused = max(int(steps.max()), 0), np.zeros(len(directions) * len(starts), int)
    for ray, middle, weight in march(medium, starts, directions, shape[2] + 1, step, most, kind, unused):
        below = np.floor(middle).astype(int)
        near = np.stack([1 + below - middle, middle - below], axis=2).T
        for a, b, c in np.ndindex(2, 2, 2):
            cell = below + (a, b, c)
            share = near[a, 0] * near[b, 1] * near[c, 2] * ((cell >= 0) & (cell < shape)).all(axis=1)
            x, y, z = np.clip(cell, 0, np.array(shape) - 1).T
            if kind & BLOCKS:
                share *= medium[x + MARGIN, y + MARGIN, z + MARGIN if medium.shape[2] > 1 else 0, 3] > -DARK
            yield ray, (x, y, z), weight * share
