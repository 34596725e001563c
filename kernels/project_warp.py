"""Warp siblings of `project`; a thread owns four lanes of z, and fields come flat per slab: ``[slab, sample · lane]``.

Flat, because one multiplication an access then finds the sample, where four would cost more than the arithmetic.
"""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Flat, read

wp.set_module_options({"enable_backward": False, "fast_math": True})

STRIP = wp.constant(16)  # planes a group crosses at its two poses before it goes on


@wp.func
def march(
    field: Flat, slab: int, lane: int, lanes: int, strip: int, offset: float, c: float, s: float, n_x: int, n_y: int
):
    """What the ray at `offset` columns from the middle meets in planes [strip, strip + STRIP)."""
    across_y = wp.abs(c) >= wp.abs(s)
    planes = wp.where(across_y, n_x, n_y)
    cells = wp.where(across_y, n_y, n_x)
    plane_stride = wp.where(across_y, n_y * lanes, lanes)
    cell_stride = wp.where(across_y, lanes, n_y * lanes)
    step = wp.where(across_y, 1.0 / c, -1.0 / s)  # y = (r + x s) / c, or x = (y c - r) / s
    slope = wp.where(across_y, s / c, c / s)
    origin = 0.5 * float(cells - 1) + offset * step - 0.5 * float(planes - 1) * slope
    first = wp.min(strip, planes)
    last = wp.min(strip + STRIP, planes)
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    start = origin + float(first) * slope
    end = origin + float(last - 1) * slope
    if wp.min(start, end) > 0.01 and wp.max(start, end) < float(cells) - 1.01:  # between two cells all along
        for plane in range(first, last):
            position = origin + float(plane) * slope
            cell = int(position)
            fraction = position - float(cell)
            index = plane * plane_stride + cell * cell_stride + lane
            total += (1.0 - fraction) * read(field, slab, index)
            total += fraction * read(field, slab, index + cell_stride)
    else:
        for plane in range(first, last):
            position = origin + float(plane) * slope
            below = wp.floor(position)
            cell = int(below)
            index = plane * plane_stride + cell * cell_stride + lane
            if cell >= 0 and cell < cells:
                total += (1.0 - (position - below)) * read(field, slab, index)
            if cell >= -1 and cell + 1 < cells:
                total += (position - below) * read(field, slab, index + cell_stride)
    return total


@wp.func
def length(pitch: float, c: float, s: float):
    return pitch / wp.max(wp.abs(c), wp.abs(s))


@wp.kernel
def forward_joseph(
    volume: wp.array2d(dtype=wp.vec4),
    directions: wp.array2d(dtype=float),
    pitch: float,
    sinogram: wp.array2d(dtype=wp.vec4),
    n_x: int,
    n_y: int,
    n_z: int,
    n_angle: int,
    n_r: int,
):
    slab, block, r, lane = wp.tid()
    lanes = volume.shape[1] // (n_x * n_y)
    offset = float(r) - 0.5 * float(n_r - 1)
    here = 2 * block
    beside = wp.min(here + 1, n_angle - 1)  # the last thread of an odd number of poses computes its pose twice
    c0 = directions[here, 0]
    s0 = directions[here, 1]
    c1 = directions[beside, 0]
    s1 = directions[beside, 1]
    t0 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t1 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for strip in range(0, wp.max(n_x, n_y), STRIP):
        t0 += march(volume, slab, lane, lanes, strip, offset, c0, s0, n_x, n_y)
        t1 += march(volume, slab, lane, lanes, strip, offset, c1, s1, n_x, n_y)
    sinogram[slab, (here * n_r + r) * lanes + lane] = t0 * length(pitch, c0, s0)
    sinogram[slab, (beside * n_r + r) * lanes + lane] = t1 * length(pitch, c1, s1)


@wp.func
def gather(field: Flat, slab: int, row: int, lanes: int, u: float, m: float):
    """What a voxel that projects between two columns, at u, receives from the pose that begins at sample `row`."""
    column = int(u)
    beyond = u - float(column)
    index = row + column * lanes
    near = wp.max(0.0, m - m * m * beyond)
    far = wp.max(0.0, m - m * m * (1.0 - beyond))
    return near * read(field, slab, index) + far * read(field, slab, index + lanes)


@wp.func
def gather_edge(field: Flat, slab: int, row: int, lanes: int, u: float, m: float, n_r: int):
    """The same for a voxel that may project beyond the outermost columns."""
    below = wp.floor(u)
    column = int(below)
    index = row + column * lanes
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if column >= 0 and column < n_r:
        total += wp.max(0.0, m - m * m * (u - below)) * read(field, slab, index)
    if column >= -1 and column + 1 < n_r:
        total += wp.max(0.0, m - m * m * (1.0 - (u - below))) * read(field, slab, index + lanes)
    return total


@wp.func
def put(field: Flat, slab: int, i: int, j: int, lane: int, lanes: int, n_i: int, n_j: int, value: wp.vec4):
    if i < n_i and j < n_j:
        field[slab, (i * n_j + j) * lanes + lane] = value


@wp.kernel
def back_joseph(
    sinogram: wp.array2d(dtype=wp.vec4),
    directions: wp.array2d(dtype=float),
    pitch: float,
    volume: wp.array2d(dtype=wp.vec4),
    n_angle: int,
    n_r: int,
    n_z: int,
    n_x: int,
    n_y: int,
):
    slab, block_x, block_y, lane = wp.tid()
    lanes = volume.shape[1] // (n_x * n_y)
    j = 4 * block_y
    y = float(j) - 0.5 * float(n_y - 1)
    for i in range(4 * block_x, wp.min(4 * block_x + 4, n_x), 2):
        x = float(i) - 0.5 * float(n_x - 1)
        t00 = wp.vec4(0.0, 0.0, 0.0, 0.0)
        t01 = wp.vec4(0.0, 0.0, 0.0, 0.0)
        t02 = wp.vec4(0.0, 0.0, 0.0, 0.0)
        t03 = wp.vec4(0.0, 0.0, 0.0, 0.0)
        t10 = wp.vec4(0.0, 0.0, 0.0, 0.0)
        t11 = wp.vec4(0.0, 0.0, 0.0, 0.0)
        t12 = wp.vec4(0.0, 0.0, 0.0, 0.0)
        t13 = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for angle in range(n_angle):
            c = directions[angle, 0]
            s = directions[angle, 1]
            m = 1.0 / wp.max(wp.abs(c), wp.abs(s))
            u = y * c - x * s + 0.5 * float(n_r - 1)
            row = angle * n_r * lanes + lane
            lowest = u + wp.min(3.0 * c, 0.0) - wp.max(s, 0.0)
            highest = u + wp.max(3.0 * c, 0.0) - wp.min(s, 0.0)
            if lowest > 0.01 and highest < float(n_r) - 1.01:
                t00 += gather(sinogram, slab, row, lanes, u, m)
                t01 += gather(sinogram, slab, row, lanes, u + c, m)
                t02 += gather(sinogram, slab, row, lanes, u + 2.0 * c, m)
                t03 += gather(sinogram, slab, row, lanes, u + 3.0 * c, m)
                t10 += gather(sinogram, slab, row, lanes, u - s, m)
                t11 += gather(sinogram, slab, row, lanes, u - s + c, m)
                t12 += gather(sinogram, slab, row, lanes, u - s + 2.0 * c, m)
                t13 += gather(sinogram, slab, row, lanes, u - s + 3.0 * c, m)
            else:
                t00 += gather_edge(sinogram, slab, row, lanes, u, m, n_r)
                t01 += gather_edge(sinogram, slab, row, lanes, u + c, m, n_r)
                t02 += gather_edge(sinogram, slab, row, lanes, u + 2.0 * c, m, n_r)
                t03 += gather_edge(sinogram, slab, row, lanes, u + 3.0 * c, m, n_r)
                t10 += gather_edge(sinogram, slab, row, lanes, u - s, m, n_r)
                t11 += gather_edge(sinogram, slab, row, lanes, u - s + c, m, n_r)
                t12 += gather_edge(sinogram, slab, row, lanes, u - s + 2.0 * c, m, n_r)
                t13 += gather_edge(sinogram, slab, row, lanes, u - s + 3.0 * c, m, n_r)
        put(volume, slab, i, j, lane, lanes, n_x, n_y, t00 * pitch)
        put(volume, slab, i, j + 1, lane, lanes, n_x, n_y, t01 * pitch)
        put(volume, slab, i, j + 2, lane, lanes, n_x, n_y, t02 * pitch)
        put(volume, slab, i, j + 3, lane, lanes, n_x, n_y, t03 * pitch)
        put(volume, slab, i + 1, j, lane, lanes, n_x, n_y, t10 * pitch)
        put(volume, slab, i + 1, j + 1, lane, lanes, n_x, n_y, t11 * pitch)
        put(volume, slab, i + 1, j + 2, lane, lanes, n_x, n_y, t12 * pitch)
        put(volume, slab, i + 1, j + 3, lane, lanes, n_x, n_y, t13 * pitch)
