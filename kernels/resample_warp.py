"""Warp sibling of `resample`."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def resample(
    source: wp.array4d(dtype=wp.vec4),
    first: wp.array(dtype=int),
    weights: wp.array2d(dtype=float),
    lanes: int,
    target: wp.array4d(dtype=wp.vec4),
    n_i: int,
    n_j: int,
    n_source: int,
    n_z: int,
    n_tap: int,
):
    slab, i, j, lane = wp.tid()
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        z = 4 * (slab * target.shape[3] + lane) + k
        total = float(0.0)
        if z < n_z:
            for tap in range(wp.max(0, -first[z]), wp.min(n_tap, n_source - first[z])):
                s = first[z] + tap
                vector = source[s // lanes, i, j, (s % lanes) // 4]
                total += weights[z, tap] * vector[s % 4]
        result[k] = total
    target[slab, i, j, lane] = result
