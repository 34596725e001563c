"""A dose around a part, and the surface at which it reaches the threshold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.metrics.triangle_search import Array

_SLAB = 32
"""Number of planes along x whose surface is found at a time."""
_AROUND = 2
"""Voxels kept around the part and its print."""


@dataclass(frozen=True, eq=False)
class PrintedField:
    """The part of a dose that is relevant for a print."""

    values: npt.NDArray[np.float32]  # dose, float32 [x, y, z]
    origin: Array  # center of voxel [0, 0, 0] [mm], (3,)
    pitch: float  # voxel edge [mm]
    threshold: float  # resin prints from this dose on

    @property
    def mask(self) -> npt.NDArray[np.bool_]:
        """Voxels that reach the threshold, [x, y, z]."""
        return self.values >= self.threshold

    def printed(self, points: Array) -> npt.NDArray[np.bool_]:
        """Whether the dose at points (n, 3) [mm], linear between voxels' centers, reaches the threshold."""
        from scipy.ndimage import map_coordinates

        at = ((points - self.origin) / self.pitch).T
        return map_coordinates(self.values, at, order=1, mode="constant", cval=0.0) >= self.threshold

    def triangles(self) -> Array:
        """The surface of the print, (m, 3, 3) [mm], by marching cubes in slabs; m = 0 if nothing prints."""
        from skimage.measure import marching_cubes

        found = [np.zeros((0, 3, 3))]
        for first in range(0, len(self.values) - 1, _SLAB):
            slab = self.values[first : first + _SLAB + 1]
            if slab.min() < self.threshold < slab.max():
                points, faces, _, _ = marching_cubes(slab, self.threshold, gradient_direction="ascent")
                found.append(((points + (first, 0, 0)) * self.pitch + self.origin)[faces])
        return np.concatenate(found)


def printed_field(
    dose: npt.ArrayLike, origin: npt.ArrayLike, pitch: float, threshold: float, bounds: npt.ArrayLike
) -> PrintedField:
    """Cut a dose to the box around a part and its print."""
    # If a print reaches the grid's outer faces, it is closed there, half a voxel beyond the last centers. dose [x, y,
    # z]; origin [0, 0, 0] [mm] (3,); pitch [mm]; bounds [mm] (2, 3)
    values, start = np.asarray(dose), np.asarray(origin, np.float64)
    if values.ndim != 3 or not values.size:
        raise BadInput(f"the dose has shape {values.shape}; expected [x, y, z] with at least one voxel")
    if start.shape != (3,) or not np.isfinite(start).all():
        raise BadInput(f"origin is {origin}; expected the center (x, y, z) [mm] of the dose's first voxel")
    edge, level = positive("pitch [mm]", pitch), positive("threshold", threshold)
    if not np.isfinite(values.max() - values.min()):
        raise BadInput("the dose holds NaN or infinity; expected finite numbers: check it for a division by zero")
    box = (np.asarray(bounds, np.float64) - start) / edge
    low, high = np.floor(box[0]).astype(np.int64), np.ceil(box[1]).astype(np.int64)
    mask = values >= level
    for axis in range(3):
        along = np.flatnonzero(mask.any(axis=tuple(k for k in range(3) if k != axis)))
        if along.size:
            low[axis], high[axis] = min(low[axis], along[0]), max(high[axis], along[-1])
    low, high = low - _AROUND, high + _AROUND + 1
    return PrintedField(_cut(values, low, high, level), start + low * edge, edge, level)


def _cut(values: np.ndarray, low: np.ndarray, high: np.ndarray, level: float) -> npt.NDArray[np.float32]:
    """Voxels low..high of a dose; the layer beyond its end mirrors the last one about the level, all others are 0."""
    cut = np.zeros(high - low, np.float32)
    start, stop = np.maximum(low, 0), np.minimum(high, values.shape)
    if (start >= stop).any():
        return cut
    here = tuple(slice(a, b) for a, b in zip(start - low, stop - low, strict=True))
    cut[here] = values[tuple(slice(a, b) for a, b in zip(start, stop, strict=True))]
    for axis in range(3):
        for last, beyond in ((here[axis].start, here[axis].start - 1), (here[axis].stop - 1, here[axis].stop)):
            grid_end = low[axis] + last in (0, values.shape[axis] - 1)
            if grid_end and 0 <= beyond < cut.shape[axis]:
                layer = np.take(cut, last, axis)
                np.moveaxis(cut, axis, 0)[beyond] = np.minimum(layer, 2.0 * level - layer)
    return cut
