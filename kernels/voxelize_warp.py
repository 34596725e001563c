"""Warp sibling of `voxelize`; a thread owns a square of columns, all of z."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

SAMPLES = wp.constant(16)
GENERATOR = wp.constant(7)
OFFSET = wp.constant(11)
RAY_SHIFT = wp.constant(22)


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
    """The edge's largest value in the square of one column."""
    return corner + (wp.max(e.along_x, wp.int64(0)) + wp.max(e.along_y, wp.int64(0))) * wp.int64(unit)


@wp.func
def height(wa: wp.int64, wb: wp.int64, wc: wp.int64, az: int, bz: int, cz: int):
    base = wp.min(az, wp.min(bz, cz))
    area = wa + wb + wc
    total = wa * wp.int64(az - base) + wb * wp.int64(bz - base) + wc * wp.int64(cz - base)
    return base + int((total + area // wp.int64(2)) // area)


@wp.func
def add(volume: wp.array4d(dtype=wp.vec4), x: int, y: int, z: int, value: float):
    lanes = 4 * volume.shape[3]
    vector = volume[z // lanes, x, y, (z % lanes) // 4]
    vector[z % 4] += value
    volume[z // lanes, x, y, (z % lanes) // 4] = vector


@wp.func
def change(volume: wp.array4d(dtype=wp.vec4), x: int, y: int, h: int, weight: float, bits: int, n_z: int):
    """From height h on, all voxels of a column change by weight; the voxel that h cuts, by its part above h."""
    z = wp.max(h, 0) >> bits
    below = wp.max(h, 0) - (z << bits)
    if z < n_z:
        add(volume, x, y, z, weight * float((1 << bits) - below))
    if below > 0 and z + 1 < n_z:
        add(volume, x, y, z + 1, weight * float(below))


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
    t: wp.array1d(dtype=int),
    x_low: int,
    y_low: int,
    x_high: int,
    y_high: int,
    bits: int,
    top: int,
    counts: wp.array2d(dtype=int),
    lists: wp.array1d(dtype=int),
):
    """Counts the crossings of a triangle (top < 0), or adds them to the lists, which begin at counts: ray, height
    within the grid, whether the ray leaves."""
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


@wp.func
def sort(code: wp.array1d(dtype=int), begin: int, n: int):
    """Shell's sort of code[begin:begin + n]: lists are short, and nothing but the list is needed."""
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
    code: wp.array1d(dtype=int),
    begin: int,
    n: int,
    x: int,
    y: int,
    bits: int,
    volume: wp.array4d(dtype=wp.vec4),
    n_z: int,
):
    """Every ray of a column from below: inside from where its winding number rises above 0 to where it falls back.

    Returns the lowest and the highest voxel with a change.
    """
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
def settle(volume: wp.array4d(dtype=wp.vec4), x: int, y: int, low: int, high: int, n_z: int):
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
    triangles: wp.array2d(dtype=int),
    members: wp.array1d(dtype=int),
    first: wp.array2d(dtype=int),
    last: wp.array2d(dtype=int),
    tile: int,
    bits: int,
    counts: wp.array2d(dtype=int),
    n_triangle: int,
    n_member: int,
    n_tile_x: int,
    n_tile_y: int,
    n_x: int,
    n_y: int,
):
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
    triangles: wp.array2d(dtype=int),
    members: wp.array1d(dtype=int),
    first: wp.array2d(dtype=int),
    last: wp.array2d(dtype=int),
    start: wp.array2d(dtype=int),
    tile: int,
    bits: int,
    row: int,
    lists: wp.array1d(dtype=int),
    volume: wp.array4d(dtype=wp.vec4),
    filled: wp.array2d(dtype=float),
    n_triangle: int,
    n_member: int,
    n_tile_x: int,
    n_tile_y: int,
    n_x: int,
    n_y: int,
    n_entry: int,
    n_z: int,
):
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
