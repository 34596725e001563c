"""Warp version of `inhibition`; a thread owns four lanes of z of one sample."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def take_poses(light: Vectors, first: int, part: Vectors, n_angle: int, n_r: int, n_z: int, n_pose: int) -> None:
    slab, pose, j, lane = wp.tid()
    part[slab, pose, j, lane] = light[slab, first + pose, j, lane]


@wp.kernel
def put_poses(part: Vectors, first: int, light: Vectors, n_pose: int, n_r: int, n_z: int, n_angle: int) -> None:
    slab, pose, j, lane = wp.tid()
    light[slab, first + pose, j, lane] = part[slab, pose, j, lane]
