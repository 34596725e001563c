"""Warp siblings of `project`; a thread owns four lanes of z."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

ANGLES = wp.constant(4)
STRIP = wp.constant(16)


@wp.func
def sample(volume: wp.array4d(dtype=wp.vec4), slab: int, lane: int, plane: int, cell: int, cells: int, across_y: int):
    if cell < 0 or cell >= cells:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    if across_y == 1:
        return volume[slab, plane, cell, lane]
    return volume[slab, cell, plane, lane]


@wp.kernel
def forward_joseph(
    volume: wp.array4d(dtype=wp.vec4),
    directions: wp.array2d(dtype=float),
    pitch: float,
    sinogram: wp.array4d(dtype=wp.vec4),
    n_x: int,
    n_y: int,
    n_z: int,
    n_angle: int,
    n_r: int,
):
    slab, block, r, lane = wp.tid()
    x0 = 0.5 * float(n_x - 1)
    y0 = 0.5 * float(n_y - 1)
    offset = float(r) - 0.5 * float(n_r - 1)
    for a in range(ANGLES):
        angle = block * ANGLES + a
        if angle < n_angle:
            c = directions[angle, 0]
            s = directions[angle, 1]
            total = wp.vec4(0.0, 0.0, 0.0, 0.0)
            if wp.abs(c) >= wp.abs(s):  # planes of constant x: y = (r + x s) / c
                step = 1.0 / c
                slope = s * step
                origin = y0 + (offset - x0 * s) * step
                for plane in range(n_x):
                    position = origin + float(plane) * slope
                    below = wp.floor(position)
                    cell = int(below)
                    fraction = position - below
                    total += (1.0 - fraction) * sample(volume, slab, lane, plane, cell, n_y, 1)
                    total += fraction * sample(volume, slab, lane, plane, cell + 1, n_y, 1)
                sinogram[slab, angle, r, lane] = total * (pitch * wp.abs(step))
            else:  # planes of constant y: x = (y c - r) / s
                step = 1.0 / s
                slope = c * step
                origin = x0 - (offset + y0 * c) * step
                for plane in range(n_y):
                    position = origin + float(plane) * slope
                    below = wp.floor(position)
                    cell = int(below)
                    fraction = position - below
                    total += (1.0 - fraction) * sample(volume, slab, lane, plane, cell, n_x, 0)
                    total += fraction * sample(volume, slab, lane, plane, cell + 1, n_x, 0)
                sinogram[slab, angle, r, lane] = total * (pitch * wp.abs(step))


@wp.func
def column(sinogram: wp.array4d(dtype=wp.vec4), slab: int, angle: int, r: int, lane: int, n_r: int):
    if r < 0 or r >= n_r:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    return sinogram[slab, angle, r, lane]


@wp.func
def gathered(
    sinogram: wp.array4d(dtype=wp.vec4), slab: int, angle: int, u: float, m: float, lane: int, n_r: int
):
    below = wp.floor(u)
    beyond = u - below
    r = int(below)
    left = wp.max(0.0, m - m * m * beyond)
    right = wp.max(0.0, m - m * m * (1.0 - beyond))
    return left * column(sinogram, slab, angle, r, lane, n_r) + right * column(sinogram, slab, angle, r + 1, lane, n_r)


@wp.kernel
def back_joseph(
    sinogram: wp.array4d(dtype=wp.vec4),
    directions: wp.array2d(dtype=float),
    pitch: float,
    volume: wp.array4d(dtype=wp.vec4),
    n_angle: int,
    n_r: int,
    n_z: int,
    n_x: int,
    n_y: int,
):
    slab, block_x, block_y, lane = wp.tid()
    x = float(2 * block_x) - 0.5 * float(n_x - 1)
    y = float(2 * block_y) - 0.5 * float(n_y - 1)
    zero = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t00 = zero
    t01 = zero
    t10 = zero
    t11 = zero
    for angle in range(n_angle):
        c = directions[angle, 0]
        s = directions[angle, 1]
        m = 1.0 / wp.max(wp.abs(c), wp.abs(s))
        u = y * c - x * s + 0.5 * float(n_r - 1)
        t00 += gathered(sinogram, slab, angle, u, m, lane, n_r)
        t01 += gathered(sinogram, slab, angle, u + c, m, lane, n_r)
        t10 += gathered(sinogram, slab, angle, u - s, m, lane, n_r)
        t11 += gathered(sinogram, slab, angle, u - s + c, m, lane, n_r)
    i = 2 * block_x
    j = 2 * block_y
    volume[slab, i, j, lane] = t00 * pitch
    if j + 1 < n_y:
        volume[slab, i, j + 1, lane] = t01 * pitch
    if i + 1 < n_x:
        volume[slab, i + 1, j, lane] = t10 * pitch
        if j + 1 < n_y:
            volume[slab, i + 1, j + 1, lane] = t11 * pitch
