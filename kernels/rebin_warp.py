"""Warp version of `rebin`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def rebin_rays(
    parallel: Vectors, rays: wp.array2d[float], light: Vectors,
    n_angle: int, n_column: int, n_z: int, n_r: int,
) -> None:  # fmt: skip
    slab, angle, r, lane = wp.tid()
    turn = rays[r, 0]
    column = rays[r, 1]
    first = int(wp.floor(turn))
    near = int(wp.floor(column))
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        later = k // 2
        right = k % 2
        a = ((angle + first + later) % n_angle + n_angle) % n_angle
        c = near + right
        if c >= 0 and c < n_column:
            weight = rays[r, 2] * (1.0 - wp.abs(turn - float(first + later))) * (1.0 - wp.abs(column - float(c)))
            total += weight * parallel[slab, a, c, lane]
    light[slab, angle, r, lane] = total
