"""Warp version of `dwell`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def weigh_poses(
    light: Vectors, times: wp.array[float], weighted: Vectors, n_angle: int, n_r: int, n_z: int, n_pose: int
) -> None:
    slab, angle, column, lane = wp.tid()
    weighted[slab, angle, column, lane] = times[angle % n_pose] * light[slab, angle, column, lane]
