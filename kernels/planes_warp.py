"""Warp version of `planes`: a thread takes one block of 64 columns, or one byte of a frame."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

Eight: type = wp.types.vector(length=8, dtype=wp.uint64)


@wp.func
def turn_bits(x: wp.uint64):
    """8 × 8 bits, transposed from the lowest byte's highest bit."""
    t = (x ^ (x << wp.uint64(36))) & wp.uint64(0xF0F0F0F000000000)
    x = x ^ t ^ (t >> wp.uint64(36))
    t = (x ^ (x << wp.uint64(18))) & wp.uint64(0xCCCC0000CCCC0000)
    x = x ^ t ^ (t >> wp.uint64(18))
    t = (x ^ (x << wp.uint64(9))) & wp.uint64(0xAA00AA00AA00AA00)
    return x ^ t ^ (t >> wp.uint64(9))


@wp.func
def word_of(images: wp.array3d[wp.uint8], masks: wp.array2d[wp.uint8], angle: int, focus: int, row: int, column: int):
    """Eight columns from one on, cut by the mask, the leftmost in the lowest byte; 0 outside the frame."""
    n_line = images.shape[1]
    n_byte = images.shape[2]
    bits = wp.uint64(0)
    if row < 0 or row >= n_line or column <= -8 or column >= n_byte:
        return bits
    places = (images.ptr | masks.ptr | wp.uint64(n_byte) | wp.uint64(column)) & wp.uint64(7)
    if column >= 0 and column + 8 <= n_byte and places == wp.uint64(0):
        across = n_byte // 8
        levels = wp.array(ptr=images.ptr, shape=(images.shape[0] * n_line * across,), dtype=wp.uint64)
        cut = wp.array(ptr=masks.ptr, shape=(masks.shape[0] * across,), dtype=wp.uint64)
        return levels[(angle * n_line + row) * across + column // 8] & cut[focus * across + column // 8]
    for k in range(8):
        if column + k >= 0 and column + k < n_byte:
            level = images[angle, row, column + k] & masks[focus, column + k]
            bits = bits | (wp.uint64(level) << wp.uint64(8 * k))
    return bits


@wp.func
def sum_of(x: wp.uint64):
    """Sum of the bytes of a word."""
    low = wp.uint64(0x00FF00FF00FF00FF)
    pairs = (x & low) + ((x >> wp.uint64(8)) & low)
    return int((pairs * wp.uint64(0x0001000100010001)) >> wp.uint64(48))


@wp.kernel
def split_planes(
    images: wp.array3d[wp.uint8], masks: wp.array2d[wp.uint8], chosen: wp.array2d[int], top: int,
    left: int, packed: wp.array4d[wp.uint8], sent: wp.array2d[int],
    n_angle: int, n_line: int, n_byte: int, n_bin: int, n_frame: int, n_row: int, n_width: int, n_strip: int,
) -> None:  # fmt: skip
    frame, strip = wp.tid()
    across = n_width // 8
    blocks = n_row * across
    run = (blocks + 8 * n_strip - 1) // (8 * n_strip) * 8
    begin = strip * run
    end = begin + run
    step = int(1)
    if n_strip > n_row and n_strip % across == 0:  # neighbors read and write side by side
        bands = n_strip // across
        run = (n_row + bands - 1) // bands * across
        begin = strip // across * run + strip % across
        end = (strip // across + 1) * run
        step = across
    out = wp.array(ptr=packed.ptr, shape=(n_frame * 8 * blocks,), dtype=wp.uint64)
    total = int(0)
    for b in range(begin, wp.min(end, blocks), step):
        row = b // across - top
        column = 64 * (b % across) - left
        planes = Eight()
        for k in range(8):
            word = word_of(images, masks, chosen[frame, 0], chosen[frame, 1], row, column + 8 * k)
            total += sum_of(word)
            bits = turn_bits(word)
            for plane in range(8):
                byte = (bits >> wp.uint64(8 * plane)) & wp.uint64(255)
                planes[plane] = planes[plane] | (byte << wp.uint64(8 * k))
        for plane in range(8):
            out[(frame * 8 + plane) * blocks + b] = planes[plane]
    sent[frame, strip] = total


@wp.kernel
def pick_frames(
    images: wp.array3d[wp.uint8], masks: wp.array2d[wp.uint8], chosen: wp.array2d[int], top: int,
    left: int, picked: wp.array3d[wp.uint8],
    n_angle: int, n_line: int, n_byte: int, n_bin: int, n_frame: int, n_row: int, n_width: int,
) -> None:  # fmt: skip
    frame, row, byte = wp.tid()
    value = wp.uint8(0)
    y = row - top
    x = byte - left
    if y >= 0 and y < n_line and x >= 0 and x < n_byte:
        value = images[chosen[frame, 0], y, x] & masks[chosen[frame, 1], x]
    picked[frame, row, byte] = value
