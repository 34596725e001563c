"""Warp version of `unfold`; a thread owns four lanes of z at eight neighboring samples; fields are flat per slab.

Warp keeps no local arrays in registers; the eight sums and the samples that slide over them therefore have names.
"""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Flat, Vectors, read

wp.set_module_options({"enable_backward": False, "fast_math": False})

TOGETHER = 8


@wp.func
def seen(field: Flat, slab: int, index: int, length: int, at: int, column: int):
    """Sample ``index`` of the source, 0 outside it."""
    value = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if index >= 0 and index < length:
        value = read(field, slab, at + index * column)
    return value


@wp.func
def no_sums():
    zero = wp.vec4(0.0, 0.0, 0.0, 0.0)
    return zero, zero, zero, zero, zero, zero, zero, zero


@wp.func
def slid(
    source: Flat, weights: wp.array2d[float], slab: int, at: int, column: int, chunk: int, count: int,
    s0: wp.vec4, s1: wp.vec4, s2: wp.vec4, s3: wp.vec4, s4: wp.vec4, s5: wp.vec4, s6: wp.vec4, s7: wp.vec4,
):  # fmt: skip
    """Add a band's contribution to the sums, four weights at a time; each sample is read once for all sums."""
    here = int(at)
    for c in range(chunk, chunk + (count + 3) // 4):
        w0 = weights[c, 0]
        w1 = weights[c, 1]
        w2 = weights[c, 2]
        w3 = weights[c, 3]
        x0 = read(source, slab, here)
        x1 = read(source, slab, here + column)
        x2 = read(source, slab, here + 2 * column)
        x3 = read(source, slab, here + 3 * column)
        s0 += w0 * x0 + w1 * x1 + w2 * x2 + w3 * x3
        x4 = read(source, slab, here + 4 * column)
        s1 += w0 * x1 + w1 * x2 + w2 * x3 + w3 * x4
        x5 = read(source, slab, here + 5 * column)
        s2 += w0 * x2 + w1 * x3 + w2 * x4 + w3 * x5
        x6 = read(source, slab, here + 6 * column)
        s3 += w0 * x3 + w1 * x4 + w2 * x5 + w3 * x6
        x7 = read(source, slab, here + 7 * column)
        s4 += w0 * x4 + w1 * x5 + w2 * x6 + w3 * x7
        x8 = read(source, slab, here + 8 * column)
        s5 += w0 * x5 + w1 * x6 + w2 * x7 + w3 * x8
        x9 = read(source, slab, here + 9 * column)
        s6 += w0 * x6 + w1 * x7 + w2 * x8 + w3 * x9
        x10 = read(source, slab, here + 10 * column)
        s7 += w0 * x7 + w1 * x8 + w2 * x9 + w3 * x10
        here += 4 * column
    return s0, s1, s2, s3, s4, s5, s6, s7


@wp.func
def write_first(
    target: Flat, slab: int, at: int, stride: int, count: int, a: wp.vec4, b: wp.vec4, c: wp.vec4, d: wp.vec4
):  # fmt: skip
    """As many of four sums as there are samples left, a stride apart."""
    if count > 0:
        target[slab, at] = a
    if count > 1:
        target[slab, at + stride] = b
    if count > 2:
        target[slab, at + 2 * stride] = c
    if count > 3:
        target[slab, at + 3 * stride] = d


@wp.kernel
def shift_window(
    source: Flat, rows: wp.array1d[wp.int32], bands: wp.array2d[wp.int32],
    weights: wp.array2d[float], step: int, phases: int, target: Flat,
    n_source_major: int, n_source_minor: int, n_z: int, n_row: int, n_band: int, n_chunk: int, n_target_major: int,
    n_target_minor: int,
) -> None:  # fmt: skip
    slab, begin, n, lane = wp.tid()
    lanes = target.shape[1] // (n_target_major * n_target_minor)
    launched = (n_target_major + TOGETHER - 1) // TOGETHER
    longest = (n_target_major + phases - 1) // phases
    tiles = (longest + TOGETHER - 1) // TOGETHER * phases
    column = n_source_minor * lanes
    for tile in range(begin, tiles, launched):  # for remaining phases, threads repeat
        phase = tile % phases
        m = tile // phases * TOGETHER
        s0, s1, s2, s3, s4, s5, s6, s7 = no_sums()
        row = phase * n_target_minor + n
        for b in range(rows[row], rows[row + 1]):
            first = m * step + bands[b, 1]
            chunk = bands[b, 2]
            count = bands[b, 3]
            at = bands[b, 0] * lanes + lane
            if first + count + 7 * step <= 0 or first >= n_source_major:
                continue
            if step == 1 and first >= 0 and first + 8 + count + 3 <= n_source_major:
                s0, s1, s2, s3, s4, s5, s6, s7 = slid(
                    source, weights, slab, at + first * column, column, chunk, count, s0, s1, s2, s3, s4, s5, s6, s7
                )  # fmt: skip
            else:
                for k in range(count):
                    w = weights[chunk + k // 4, k % 4]
                    i = first + k
                    s0 += w * seen(source, slab, i, n_source_major, at, column)
                    s1 += w * seen(source, slab, i + step, n_source_major, at, column)
                    s2 += w * seen(source, slab, i + 2 * step, n_source_major, at, column)
                    s3 += w * seen(source, slab, i + 3 * step, n_source_major, at, column)
                    s4 += w * seen(source, slab, i + 4 * step, n_source_major, at, column)
                    s5 += w * seen(source, slab, i + 5 * step, n_source_major, at, column)
                    s6 += w * seen(source, slab, i + 6 * step, n_source_major, at, column)
                    s7 += w * seen(source, slab, i + 7 * step, n_source_major, at, column)
        stride = phases * n_target_minor * lanes
        out = ((m * phases + phase) * n_target_minor + n) * lanes + lane
        left = (n_target_major - phase + phases - 1) // phases - m
        write_first(target, slab, out, stride, left, s0, s1, s2, s3)
        write_first(target, slab, out + 4 * stride, stride, left - 4, s4, s5, s6, s7)


@wp.kernel
def mix_poses(
    source: Vectors, rows: wp.array1d[wp.int32], indices: wp.array1d[wp.int32],
    shares: wp.array1d[float], target: Vectors,
    n_source_major: int, n_i: int, n_z: int, n_row: int, n_entry: int, n_target_major: int,
) -> None:  # fmt: skip
    slab, m, i, lane = wp.tid()
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for e in range(rows[m], rows[m + 1]):
        total += shares[e] * source[slab, indices[e], i, lane]
    target[slab, m, i, lane] = total
