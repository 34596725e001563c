"""Warp version of `project`; a thread owns four lanes of z, and fields are flat per slab: ``[slab, sample · lane]``.

They are flat because one multiplication per access then finds the sample; four would take longer than the arithmetic.
"""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Flat, read

wp.set_module_options({"enable_backward": False, "fast_math": True})

STRIP = 16  # planes that a group crosses at its two angles before it continues


@wp.func
def march(
    field: Flat, slab: int, lane: int, lanes: int, strip: int, offset: float, c: float, s: float, n_x: int, n_y: int
):
    """The sum along the ray at `offset` columns from the middle in planes [strip, strip + STRIP)."""
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
    if wp.min(start, end) > 0.01 and wp.max(start, end) < float(cells) - 1.01:  # always between two cells
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


@wp.kernel(launch_bounds=(256, 2))  # fewer registers allow more threads, which hide the loads
def forward_joseph(
    volume: Flat, directions: wp.array2d[float], pitch: float, sinogram: Flat,
    n_x: int, n_y: int, n_z: int, n_angle: int, n_r: int,
) -> None:  # fmt: skip
    slab, block, r, lane = wp.tid()
    lanes = volume.shape[1] // (n_x * n_y)
    offset = float(r) - 0.5 * float(n_r - 1)
    here = 2 * block
    beside = wp.min(here + 1, n_angle - 1)  # for an odd number of angles, the last thread computes its angle twice
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
def gather(field: Flat, slab: int, row: int, lanes: int, u: float, m: float, n_r: int):
    """The light that a voxel at column u receives from the angle that begins at sample `row`.

    Weights of columns farther than 1 / m are zero; limiting the pair of columns to the beam therefore needs no branch.
    """
    column = wp.clamp(int(u), 0, n_r - 2)
    index = row + column * lanes
    near = wp.max(0.0, m - m * m * wp.abs(u - float(column)))
    far = wp.max(0.0, m - m * m * wp.abs(u - float(column + 1)))
    return near * read(field, slab, index) + far * read(field, slab, index + lanes)


@wp.func
def gather_one(field: Flat, slab: int, row: int, u: float, m: float):
    """The same from a beam of a single column."""
    return wp.max(0.0, m - m * m * wp.abs(u)) * read(field, slab, row)


@wp.kernel
def back_joseph(
    sinogram: Flat, directions: wp.array2d[float], pitch: float, volume: Flat,
    n_angle: int, n_r: int, n_z: int, n_x: int, n_y: int,
) -> None:  # fmt: skip
    slab, block_x, block_y, lane = wp.tid()
    lanes = volume.shape[1] // (n_x * n_y)
    for i in range(4 * block_x, wp.min(4 * block_x + 4, n_x), 2):
        for j in range(4 * block_y, wp.min(4 * block_y + 4, n_y), 2):
            x = float(i) - 0.5 * float(n_x - 1)
            y = float(j) - 0.5 * float(n_y - 1)
            t00 = wp.vec4(0.0, 0.0, 0.0, 0.0)
            t01 = wp.vec4(0.0, 0.0, 0.0, 0.0)
            t10 = wp.vec4(0.0, 0.0, 0.0, 0.0)
            t11 = wp.vec4(0.0, 0.0, 0.0, 0.0)
            for angle in range(n_angle):
                c = directions[angle, 0]
                s = directions[angle, 1]
                m = 1.0 / wp.max(wp.abs(c), wp.abs(s))
                u = y * c - x * s + 0.5 * float(n_r - 1)
                row = angle * n_r * lanes + lane
                if n_r > 1:
                    t00 += gather(sinogram, slab, row, lanes, u, m, n_r)
                    t01 += gather(sinogram, slab, row, lanes, u + c, m, n_r)
                    t10 += gather(sinogram, slab, row, lanes, u - s, m, n_r)
                    t11 += gather(sinogram, slab, row, lanes, u - s + c, m, n_r)
                else:
                    t00 += gather_one(sinogram, slab, row, u, m)
                    t01 += gather_one(sinogram, slab, row, u + c, m)
                    t10 += gather_one(sinogram, slab, row, u - s, m)
                    t11 += gather_one(sinogram, slab, row, u - s + c, m)
            at = (i * n_y + j) * lanes + lane
            volume[slab, at] = t00 * pitch
            if j + 1 < n_y:
                volume[slab, at + lanes] = t01 * pitch
            if i + 1 < n_x:
                volume[slab, at + n_y * lanes] = t10 * pitch
                if j + 1 < n_y:
                    volume[slab, at + n_y * lanes + lanes] = t11 * pitch
