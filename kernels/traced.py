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
    """sinogram[a, r, row] = Σ over the steps of a pixel's rays of weight × volume, trilinear.

    steps: of the longest ray of each pixel, see `survey_rays`.  lanes: of the sinogram's layout.
    """
    total = np.zeros(directions.shape[0] * starts.shape[0])
    unused = np.zeros(total.size, int)
    top, most = volume.shape[2] + 1, max(int(steps.max()), 0)
    for ray, middle, weight in march(medium, starts, directions, top, step, most, kind, unused):
        for cell, share in nodes(medium, volume.shape, middle, kind):
            total[ray] += weight * share * volume[tuple(cell.T)]
    sinogram[...] = total.reshape(*sinogram.shape, -1).sum(axis=3)


@kernel(over="steps")
def back_traced(
    sinogram: Rows, medium: Medium, starts: Starts, directions: Directions, steps: Steps, step: Real, kind: Integer,
    lanes: Integer, volume: VolumeInOut,
) -> None:  # fmt: skip
    """The transpose, added to ``volume``: every ray adds its light to the voxels that `forward_traced` reads."""
    bundle = directions.shape[0] * starts.shape[0] // sinogram.size
    light = np.repeat(sinogram.ravel(), bundle)
    unused = np.zeros(light.size, int)
    top, most = volume.shape[2] + 1, max(int(steps.max()), 0)
    for ray, middle, weight in march(medium, starts, directions, top, step, most, kind, unused):
        for cell, share in nodes(medium, volume.shape, middle, kind):
            np.add.at(volume, tuple(cell.T), weight * share * light[ray])


@pointwise(over="volume")
def clear_volume(volume: VolumeOut) -> None:
    """volume = 0."""
    volume[...] = 0.0


def nodes(
    medium: np.ndarray, shape: tuple[int, ...], middle: np.ndarray, kind: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The eight voxels around each point and their shares, 0 for those beyond the grid and for inserts."""
    below = np.floor(middle).astype(int)
    near = np.stack([1 + below - middle, middle - below], axis=2).T
    for corner in np.ndindex(2, 2, 2):
        cell = below + corner
        share = near[corner[0], 0] * near[corner[1], 1] * near[corner[2], 2]
        share *= ((cell >= 0) & (cell < shape)).all(axis=1)
        cell = np.clip(cell, 0, np.array(shape) - 1)
        if kind & BLOCKS:
            up = cell[:, 2] + MARGIN if medium.shape[2] > 1 else 0
            share *= medium[cell[:, 0] + MARGIN, cell[:, 1] + MARGIN, up, 3] > -DARK
        yield cell, share
