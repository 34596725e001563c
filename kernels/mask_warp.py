"""Warp version of `mask`."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def mask_bytes(
    images: wp.array3d[wp.uint8], mask: wp.array[wp.uint8], masked: wp.array3d[wp.uint8],
    n_angle: int, n_z: int, n_byte: int,
) -> None:  # fmt: skip
    angle, row, byte = wp.tid()
    masked[angle, row, byte] = images[angle, row, byte] & mask[byte]
