"""Warp version of `resample`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors, slice_of

wp.set_module_options({"enable_backward": False, "fast_math": False})


MINOR = 8  # neighbors along j that a thread computes


@wp.kernel
def resample(
    source: Vectors, first: wp.array[int], weights: wp.array2d[float], lanes: int, target: Vectors,
    n_i: int, n_j: int, n_source: int, n_z: int, n_tap: int,
) -> None:  # fmt: skip
    slab, i, tile, lane = wp.tid()
    for j in range(tile * MINOR, wp.min(tile * MINOR + MINOR, n_j)):
        result = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for k in range(4):
            z = 4 * (slab * target.shape[3] + lane) + k
            total = float(0.0)
            if z < n_z:
                for tap in range(wp.max(0, -first[z]), wp.min(n_tap, n_source - first[z])):
                    total += weights[z, tap] * slice_of(source, i, j, first[z] + tap)
            result[k] = total
        target[slab, i, j, lane] = result
