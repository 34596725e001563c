"""Warp version of `gauss`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def blur_planes(
    source: Vectors, taps: wp.array[float], blurred: Vectors,
    n_i: int, n_j: int, n_z: int, n_tap: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    total = taps[0] * source[slab, i, j, lane]
    for t in range(1, wp.min(i, n_tap - 1) + 1):
        total += taps[t] * source[slab, i - t, j, lane]
    for t in range(1, wp.min(n_i - 1 - i, n_tap - 1) + 1):
        total += taps[t] * source[slab, i + t, j, lane]
    blurred[slab, i, j, lane] = total
