"""Warp version of `lanes`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def to_lanes(plain: wp.array3d[float], field: Vectors, n_i: int, n_j: int, n_z: int) -> None:
    slab, i, j, lane = wp.tid()
    values = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        z = 4 * (slab * field.shape[3] + lane) + k
        if z < n_z:
            values[k] = plain[i, j, z]
    field[slab, i, j, lane] = values


@wp.kernel
def from_lanes(field: Vectors, plain: wp.array3d[float], n_i: int, n_j: int, n_z: int) -> None:
    slab, i, j, lane = wp.tid()
    values = field[slab, i, j, lane]
    for k in range(4):
        z = 4 * (slab * field.shape[3] + lane) + k
        if z < n_z:
            plain[i, j, z] = values[k]
