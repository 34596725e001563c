"""Warp siblings of planes.py: a thread takes one block of 64 columns, or one byte of a picture."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def turn_bits(x: wp.uint64):
    """8 × 8 bits turned about their diagonal."""
    t = (x ^ (x >> wp.uint64(7))) & wp.uint64(0x00AA00AA00AA00AA)
    x = x ^ t ^ (t << wp.uint64(7))
    t = (x ^ (x >> wp.uint64(14))) & wp.uint64(0x0000CCCC0000CCCC)
    x = x ^ t ^ (t << wp.uint64(14))
    t = (x ^ (x >> wp.uint64(28))) & wp.uint64(0x00000000F0F0F0F0)
    return x ^ t ^ (t << wp.uint64(28))


@wp.kernel
def split_planes(
    images: wp.array3d(dtype=wp.uint8),
    masks: wp.array2d(dtype=wp.uint8),
    chosen: wp.array2d(dtype=int),
    top: int,
    left: int,
    packed: wp.array4d(dtype=wp.uint8),
    sent: wp.array2d(dtype=int),
    n_angle: int,
    n_line: int,
    n_byte: int,
    n_bin: int,
    n_picture: int,
    n_row: int,
    n_width: int,
    n_strip: int,
):
    picture, strip = wp.tid()
    across = n_width // 8
    blocks = n_row * across
    run = (blocks + n_strip - 1) // n_strip
    angle = chosen[picture, 0]
    focus = chosen[picture, 1]
    total = int(0)
    for word in range(8 * wp.min(strip * run, blocks), 8 * wp.min((strip + 1) * run, blocks)):
        row = word // n_width - top
        byte = word % n_width
        bits = wp.uint64(0)
        for k in range(8):
            column = 8 * byte + k - left
            bits = bits << wp.uint64(8)
            if row >= 0 and row < n_line and column >= 0 and column < n_byte:
                level = images[angle, row, column] & masks[focus, column]
                total += int(level)
                bits = bits | wp.uint64(level)
        bits = turn_bits(bits)
        for plane in range(8):
            packed[picture, 7 - plane, row + top, byte] = wp.uint8((bits >> wp.uint64(8 * plane)) & wp.uint64(255))
    sent[picture, strip] = total


@wp.kernel
def pick_pictures(
    images: wp.array3d(dtype=wp.uint8),
    masks: wp.array2d(dtype=wp.uint8),
    chosen: wp.array2d(dtype=int),
    top: int,
    left: int,
    picked: wp.array3d(dtype=wp.uint8),
    n_angle: int,
    n_line: int,
    n_byte: int,
    n_bin: int,
    n_picture: int,
    n_row: int,
    n_width: int,
):
    picture, row, byte = wp.tid()
    value = wp.uint8(0)
    y = row - top
    x = byte - left
    if y >= 0 and y < n_line and x >= 0 and x < n_byte:
        value = images[chosen[picture, 0], y, x] & masks[chosen[picture, 1], x]
    picked[picture, row, byte] = value
