"""Warp sibling of `blur`."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def blur_slices(
    source: wp.array4d(dtype=wp.vec4),
    taps: wp.array(dtype=float),
    blurred: wp.array4d(dtype=wp.vec4),
    n_i: int,
    n_j: int,
    n_z: int,
    n_tap: int,
):
    slab, i, j, lane = wp.tid()
    lanes = 4 * source.shape[3]
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        z = 4 * (slab * blurred.shape[3] + lane) + k
        total = float(0.0)
        for s in range(wp.max(z - n_tap + 1, 0), wp.min(z + n_tap, n_z)):
            vector = source[s // lanes, i, j, (s % lanes) // 4]
            total += taps[wp.abs(s - z)] * vector[s % 4]
        result[k] = total
    blurred[slab, i, j, lane] = result
