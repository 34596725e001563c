"""Warp version of `blur`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors, slice_of

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def blur_slices(
    source: Vectors, taps: wp.array[float], blurred: Vectors,
    n_i: int, n_j: int, n_z: int, n_tap: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        z = 4 * (slab * blurred.shape[3] + lane) + k
        total = float(0.0)
        for s in range(wp.max(z - n_tap + 1, 0), wp.min(z + n_tap, n_z)):
            total += taps[wp.abs(s - z)] * slice_of(source, i, j, s)
        result[k] = total
    blurred[slab, i, j, lane] = result
