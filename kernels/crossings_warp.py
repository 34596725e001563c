"""Crossings of the rays of voxel columns with a triangle, in whole numbers, in Warp; see `voxelize`."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

SAMPLES = 16
GENERATOR = 7
OFFSET = 11
RAY_SHIFT = 22


@wp.struct
class Edge:
    along_x: wp.int64
    along_y: wp.int64
    offset: wp.int64
    own: wp.int64


@wp.func
def edge(ax: int, ay: int, bx: int, by: int):
    e = Edge()
    dx = wp.int64(bx - ax)
    dy = wp.int64(by - ay)
    e.along_x = -dy
    e.along_y = dx
    e.offset = dy * wp.int64(ax) - dx * wp.int64(ay)
    e.own = wp.int64(1)
    if dy < wp.int64(0) or (dy == wp.int64(0) and dx > wp.int64(0)):
        e.own = wp.int64(0)
    return e


@wp.func
def at(e: Edge, x: int, y: int):
    return e.offset + e.along_x * wp.int64(x) + e.along_y * wp.int64(y)


@wp.func
def most(e: Edge, corner: wp.int64, unit: int):
    """The edge function's largest value in the square of one column."""
    return corner + (wp.max(e.along_x, wp.int64(0)) + wp.max(e.along_y, wp.int64(0))) * wp.int64(unit)


@wp.func
def height(wa: wp.int64, wb: wp.int64, wc: wp.int64, az: int, bz: int, cz: int):
    base = wp.min(az, wp.min(bz, cz))
    area = wa + wb + wc
    total = wa * wp.int64(az - base) + wb * wp.int64(bz - base) + wc * wp.int64(cz - base)
    return base + int((total + area // wp.int64(2)) // area)


@wp.func
def met(a: Edge, b: Edge, c: Edge, ea: wp.int64, eb: wp.int64, ec: wp.int64, i: int, unit: int):
    """Whether ray i of a column meets the triangle, and where: its three areas."""
    px = wp.int64((2 * i + 1) * unit // (2 * SAMPLES))
    py = wp.int64((2 * ((GENERATOR * i + OFFSET) % SAMPLES) + 1) * unit // (2 * SAMPLES))
    wa = ea + a.along_x * px + a.along_y * py
    wb = eb + b.along_x * px + b.along_y * py
    wc = ec + c.along_x * px + c.along_y * py
    return wa >= a.own and wb >= b.own and wc >= c.own, wa, wb, wc


@wp.func
def cross_triangle(
    t: wp.array1d[int], x_low: int, y_low: int, x_high: int, y_high: int, bits: int, top: int,
    counts: wp.array2d[int], lists: wp.array1d[int],
):  # fmt: skip
    """Count the crossings of a triangle (top < 0), or list ray, height within the grid and whether it leaves."""
    unit = 1 << bits
    a = edge(t[3], t[4], t[6], t[7])
    b = edge(t[6], t[7], t[0], t[1])
    c = edge(t[0], t[1], t[3], t[4])
    leaves = wp.where(t[9] > 0, 1, 0)
    x_begin = wp.max(x_low, wp.min(t[0], wp.min(t[3], t[6])) >> bits)
    x_end = wp.min(x_high, (wp.max(t[0], wp.max(t[3], t[6])) >> bits) + 1)
    y_begin = wp.max(y_low, wp.min(t[1], wp.min(t[4], t[7])) >> bits)
    y_end = wp.min(y_high, (wp.max(t[1], wp.max(t[4], t[7])) >> bits) + 1)
    nothing = wp.int64(0)
    for x in range(x_begin, x_end):
        for y in range(y_begin, y_end):
            ea = at(a, x << bits, y << bits)
            eb = at(b, x << bits, y << bits)
            ec = at(c, x << bits, y << bits)
            if most(a, ea, unit) >= nothing and most(b, eb, unit) >= nothing and most(c, ec, unit) >= nothing:
                for i in range(SAMPLES):
                    hit, wa, wb, wc = met(a, b, c, ea, eb, ec, i, unit)
                    if hit and top < 0:
                        counts[x, y] = counts[x, y] + 1
                    elif hit:
                        h = wp.clamp(height(wa, wb, wc, t[2], t[5], t[8]), 0, top)
                        list = counts[x, y]
                        number = lists[list] + 1
                        lists[list] = number
                        lists[list + number] = (i << RAY_SHIFT) | (h << 1) | leaves
