"""Warp version of `mask`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def mask_bytes(
    images: wp.array3d[wp.uint8], mask: wp.array[wp.uint8], masked: wp.array3d[wp.uint8],
    n_angle: int, n_z: int, n_byte: int,
) -> None:  # fmt: skip
    angle, row, byte = wp.tid()
    masked[angle, row, byte] = images[angle, row, byte] & mask[byte]


@wp.kernel
def mask_rays(light: Vectors, shares: wp.array[float], masked: Vectors, n_angle: int, n_r: int, n_z: int) -> None:
    slab, angle, column, lane = wp.tid()
    masked[slab, angle, column, lane] = shares[column] * light[slab, angle, column, lane]
