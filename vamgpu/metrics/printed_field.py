"""A dose around a part, and the surface at which it reaches the threshold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vamgpu.backend.cores import ahead
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.metrics.runs import Runs, runs_of
from vamgpu.metrics.triangle_search import Array

_SLAB = 32  # number of planes along x whose surface is found at a time
_AROUND = 2  # voxels kept around the part and its print


@dataclass(frozen=True, eq=False)
class PrintedField:
    """The part of a dose that is relevant for a print."""

    values: npt.NDArray[np.float32]  # dose, float32 [x, y, z]
    origin: Array  # center of voxel [0, 0, 0] [mm], (3,)
    pitch: float  # voxel edge [mm]
    threshold: float  # resin prints from this dose on
    runs: Runs  # voxels that reach it

    def dose(self, points: Array) -> npt.NDArray[np.float32]:
        """The dose at points (n, 3) [mm], linear between voxels' centers."""
        from scipy.ndimage import map_coordinates

        at = ((points - self.origin) / self.pitch).T
        return np.asarray(map_coordinates(self.values, at, order=1, mode="constant", cval=0.0), np.float32)

    def printed(self, points: Array) -> npt.NDArray[np.bool_]:
        """Whether the dose at points (n, 3) [mm] reaches the threshold."""
        return self.dose(points) >= self.threshold

    def triangles(self) -> Array:
        """The surface of the print, (m, 3, 3) [mm], by marching cubes in slabs; m = 0 if nothing prints."""
        from skimage.measure import marching_cubes

        def of_slab(first: int) -> Array:
            slab = self.values[first : first + _SLAB + 1]
            crossed = _crossed(slab > self.threshold)
            if not crossed.any():
                return np.zeros((0, 3, 3))
            y, z = (np.flatnonzero(np.any(crossed, axis=(0, axis))) for axis in (2, 1))
            cut = slice(None), slice(y[0] - 1, y[-1] + 1), slice(z[0] - 1, z[-1] + 1)
            points, faces, _, _ = marching_cubes(
                slab[cut], self.threshold, gradient_direction="ascent", mask=crossed[cut]
            )
            return ((points + (first, y[0] - 1, z[0] - 1)) * self.pitch + self.origin)[faces]

        return np.concatenate([np.zeros((0, 3, 3)), *ahead(of_slab, range(0, len(self.values) - 1, _SLAB))])


def _crossed(above: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Cubes between voxels' centers that the surface crosses, each at its last corner, [x, y, z]."""
    every, some = above, above
    for axis in range(3):
        low, high = (tuple(cut if k == axis else slice(None) for k in range(3)) for cut in (slice(-1), slice(1, None)))
        every, some = every[low] & every[high], some[low] | some[high]
    crossed = np.zeros(above.shape, bool)
    np.not_equal(every, some, out=crossed[1:, 1:, 1:])
    return crossed


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
    low, high = np.floor(box[0]).astype(np.int64), np.ceil(box[1]).astype(np.int64) + 1
    runs = runs_of(values, level)
    if runs.start.size:
        low, high = np.minimum(low, runs.box[0]), np.maximum(high, runs.box[1])
    low, high = low - _AROUND, high + _AROUND
    cut = _cut(values, low, high, level)
    return PrintedField(cut, start + low * edge, edge, level, runs.moved(low, cut.shape))


def _cut(values: np.ndarray, low: np.ndarray, high: np.ndarray, level: float) -> npt.NDArray[np.float32]:
    """Voxels low..high of a dose; the layer beyond its end mirrors the last one about the level, all others are 0."""
    start, stop = np.maximum(low, 0), np.minimum(high, values.shape)
    if (start == low).all() and (stop == high).all():
        return np.asarray(values[tuple(map(slice, start, stop))], np.float32)
    cut = np.zeros(high - low, np.float32)
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
