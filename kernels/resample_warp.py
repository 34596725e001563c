"""Warp sibling of `resample`."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def resample(
    source: wp.array4d(dtype=wp.vec4),
    ratio: float,
    reach: float,
    most: float,
    gain: float,
    lanes: int,
    target: wp.array4d(dtype=wp.vec4),
    n_i: int,
    n_j: int,
    n_source: int,
    n_z: int,
):
    slab, i, j, lane = wp.tid()
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        z = 4 * (slab * target.shape[3] + lane) + k
        position = (float(z) - 0.5 * float(n_z - 1)) * ratio + 0.5 * float(n_source - 1)
        first = wp.max(int(wp.ceil(position - reach)), 0)
        last = wp.min(int(wp.floor(position + reach)), n_source - 1)
        total = float(0.0)
        for s in range(first, last + 1):
            vector = source[s // lanes, i, j, (s % lanes) // 4]
            total += gain * wp.clamp(reach - wp.abs(float(s) - position), 0.0, most) * vector[s % 4]
        result[k] = total
    target[slab, i, j, lane] = result
