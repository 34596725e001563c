"""Warp version of `voxelize`; a thread owns a square of columns, all of z."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.crossings_warp import RAY_SHIFT, SAMPLES, cross_triangle
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.func
def add(volume: Vectors, x: int, y: int, z: int, value: float):
    lanes = 4 * volume.shape[3]
    vector = volume[z // lanes, x, y, (z % lanes) // 4]
    vector[z % 4] += value
    volume[z // lanes, x, y, (z % lanes) // 4] = vector


@wp.func
def change(volume: Vectors, x: int, y: int, h: int, weight: float, bits: int, n_z: int):
    """Change all voxels of a column above height h by weight; the voxel that h cuts changes by its part above h."""
    z = wp.max(h, 0) >> bits
    below = wp.max(h, 0) - (z << bits)
    if z < n_z:
        add(volume, x, y, z, weight * float((1 << bits) - below))
    if below > 0 and z + 1 < n_z:
        add(volume, x, y, z + 1, weight * float(below))


@wp.func
def sort(code: wp.array1d[int], begin: int, n: int):
    """Shell's sort of code[begin:begin + n]: lists are short, and no other memory is needed."""
    gap = int(1)
    while gap < n // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, n):
            moved = code[begin + i]
            j = int(i)
            while j >= gap and code[begin + wp.max(j - gap, 0)] > moved:
                code[begin + j] = code[begin + j - gap]
                j -= gap
            code[begin + j] = moved
        gap = gap // 3


@wp.func
def walk(
    code: wp.array1d[int], begin: int, n: int, x: int, y: int, bits: int, volume: Vectors, n_z: int,
):  # fmt: skip
    """Mark where the rays of a column enter and leave, by winding number; returns the range of changed voxels."""
    low = int(n_z)
    high = int(0)
    weight = 1.0 / float(SAMPLES << bits)
    ray = int(-1)
    winding = int(0)
    for k in range(begin, begin + n):
        if (code[k] >> RAY_SHIFT) != ray:
            ray = code[k] >> RAY_SHIFT
            winding = 0
        h = (code[k] & ((1 << RAY_SHIFT) - 1)) >> 1
        before = winding
        winding += 1 - 2 * (code[k] & 1)
        if (before > 0) != (winding > 0):
            change(volume, x, y, h, wp.where(winding > 0, weight, -weight), bits, n_z)
            low = wp.min(low, h >> bits)
            high = wp.max(high, (h >> bits) + 1)
    return low, high


@wp.func
def settle(volume: Vectors, x: int, y: int, low: int, high: int, n_z: int):
    """Turns the changes along a column into fractions, and returns their sum."""
    lanes = 4 * volume.shape[3]
    inside = wp.float32(0.0)
    total = wp.float32(0.0)
    group = int(low // 4)
    while 4 * group < n_z and (4 * group <= high or inside > 0.0):
        slab = 4 * group // lanes
        lane = group % volume.shape[3]
        vector = volume[slab, x, y, lane]
        for k in range(4):
            inside += vector[k]
            vector[k] = inside
            if 4 * group + k < n_z:
                total += inside
        volume[slab, x, y, lane] = vector
        group += 1
    return total


@wp.kernel
def count_crossings(
    triangles: wp.array2d[int], members: wp.array1d[int], first: wp.array2d[int],
    last: wp.array2d[int], tile: int, bits: int, counts: wp.array2d[int],
    n_triangle: int, n_member: int, n_tile_x: int, n_tile_y: int, n_x: int, n_y: int,
) -> None:  # fmt: skip
    tile_x, tile_y = wp.tid()
    x_low = tile_x * tile
    y_low = tile_y * tile
    x_high = wp.min(x_low + tile, n_x)
    y_high = wp.min(y_low + tile, n_y)
    for x in range(x_low, x_high):
        for y in range(y_low, y_high):
            counts[x, y] = 0
    for m in range(first[tile_x, tile_y], last[tile_x, tile_y]):
        cross_triangle(triangles[members[m]], x_low, y_low, x_high, y_high, bits, -1, counts, members)


@wp.kernel
def voxelize(
    triangles: wp.array2d[int], members: wp.array1d[int], first: wp.array2d[int],
    last: wp.array2d[int], start: wp.array2d[int], tile: int, bits: int, row: int,
    lists: wp.array1d[int], volume: Vectors, filled: wp.array2d[float],
    n_triangle: int, n_member: int, n_tile_x: int, n_tile_y: int, n_x: int, n_y: int, n_entry: int, n_z: int,
) -> None:  # fmt: skip
    tile_x, tile_y = wp.tid()
    x_low = (row + tile_x) * tile
    y_low = tile_y * tile
    x_high = wp.min(x_low + tile, n_x)
    y_high = wp.min(y_low + tile, n_y)
    for slab in range(volume.shape[0]):
        for x in range(x_low, x_high):
            for y in range(y_low, y_high):
                for lane in range(volume.shape[3]):
                    volume[slab, x, y, lane] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for x in range(x_low, x_high):
        for y in range(y_low, y_high):
            lists[start[x, y]] = 0
    for m in range(first[tile_x, tile_y], last[tile_x, tile_y]):
        cross_triangle(triangles[members[m]], x_low, y_low, x_high, y_high, bits, n_z << bits, start, lists)
    total = wp.float32(0.0)
    for x in range(x_low, x_high):
        for y in range(y_low, y_high):
            begin = start[x, y] + 1
            number = lists[begin - 1]
            if number > 0:
                sort(lists, begin, number)
                low, high = walk(lists, begin, number, x, y, bits, volume, n_z)
                total += settle(volume, x, y, low, high, n_z)
    filled[tile_x, tile_y] = total
