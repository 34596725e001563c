"""Warp version of `filter`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.pointwise_warp import ROWS
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.func
def convolve(rows: Vectors, taps: wp.array[float], stride: int, slab: int, i: int, r: int, lane: int):
    """The taps convolved with row i at sample r."""
    n_r = rows.shape[2]
    total = taps[0] * rows[slab, i, r, lane]
    last = taps.shape[0] - 1
    for s in range(1, wp.min(r, last) + 1, stride):
        total += taps[s] * rows[slab, i, r - s, lane]
    for s in range(1, wp.min(n_r - 1 - r, last) + 1, stride):
        total += taps[s] * rows[slab, i, r + s, lane]
    return total


@wp.kernel
def filter_rows(
    sinogram: Vectors, taps: wp.array[float], stride: int, floor: float, filtered: Vectors,
    n_angle: int, n_r: int, n_z: int, n_tap: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    lowest = wp.vec4(floor, floor, floor, floor)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_angle)):
        filtered[slab, i, j, lane] = wp.max(lowest, convolve(sinogram, taps, stride, slab, i, j, lane))


@wp.kernel
def filtered_step(
    gradient: Vectors, taps: wp.array[float], stride: int, step: float, momentum: float, light: Vectors,
    ahead: Vectors,
    n_angle: int, n_r: int, n_z: int, n_tap: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    dark = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_angle)):
        before = light[slab, i, j, lane]
        start = ahead[slab, i, j, lane]
        new = wp.max(dark, start - step * convolve(gradient, taps, stride, slab, i, j, lane))
        slope = gradient[slab, i, j, lane]
        for k in range(4):
            if start[k] <= 0.0 and slope[k] >= 0.0:
                new[k] = 0.0
        ahead[slab, i, j, lane] = new + momentum * (new - before)
        light[slab, i, j, lane] = new
