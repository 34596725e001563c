"""Warp siblings of `dwell`."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

Vectors = wp.array4d(dtype=wp.vec4)


@wp.kernel
def weigh_poses(
    light: Vectors, times: wp.array(dtype=float), weighted: Vectors, n_angle: int, n_r: int, n_z: int, n_pose: int
):
    slab, angle, column, lane = wp.tid()
    weighted[slab, angle, column, lane] = times[angle % n_pose] * light[slab, angle, column, lane]
