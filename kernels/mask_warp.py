"""Warp siblings of `mask`."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

Vectors = wp.array4d(dtype=wp.vec4)


@wp.kernel
def mask_bytes(
    images: wp.array3d(dtype=wp.uint8),
    mask: wp.array(dtype=wp.uint8),
    masked: wp.array3d(dtype=wp.uint8),
    n_angle: int,
    n_z: int,
    n_byte: int,
):
    angle, row, byte = wp.tid()
    masked[angle, row, byte] = images[angle, row, byte] & mask[byte]


@wp.kernel
def mask_rays(light: Vectors, shares: wp.array(dtype=float), masked: Vectors, n_angle: int, n_r: int, n_z: int):
    slab, angle, column, lane = wp.tid()
    masked[slab, angle, column, lane] = shares[column] * light[slab, angle, column, lane]
