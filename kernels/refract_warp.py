"""Warp siblings of `refract`; a thread owns four lanes of z of one sample."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.func
def look_up(light: wp.array3d(dtype=float), n_across: int, n_along: int, c: float, s: float, x: float, y: float):
    across = y * c - x * s + 0.5 * float(n_across - 1)
    along = -x * c - y * s + 0.5 * float(n_along - 1)
    i = wp.clamp(int(across), 0, n_across - 2)
    j = wp.clamp(int(along), 0, n_along - 2)
    a = across - float(i)
    b = along - float(j)
    near_u = light[i, j, 0] + b * (light[i, j + 1, 0] - light[i, j, 0])
    near_w = light[i, j, 1] + b * (light[i, j + 1, 1] - light[i, j, 1])
    far_u = light[i + 1, j, 0] + b * (light[i + 1, j + 1, 0] - light[i + 1, j, 0])
    far_w = light[i + 1, j, 1] + b * (light[i + 1, j + 1, 1] - light[i + 1, j, 1])
    return wp.vec2(near_u + a * (far_u - near_u), near_w + a * (far_w - near_w))


@wp.func
def overlap(distance: float, reach: float, inverse: float):
    """How much of a voxel, 2 reach - 1 = 1 / inverse columns wide, lies in a column that far from it."""
    return wp.clamp(reach - wp.abs(distance), 0.0, 1.0) * inverse


@wp.kernel
def back_refracted(
    sinogram: wp.array4d(dtype=wp.vec4),
    directions: wp.array2d(dtype=float),
    light: wp.array3d(dtype=float),
    width: float,
    radius: float,
    volume: wp.array4d(dtype=wp.vec4),
    n_angle: int,
    n_r: int,
    n_z: int,
    n_across: int,
    n_along: int,
    n_x: int,
    n_y: int,
):
    slab, i, j, lane = wp.tid()
    x = float(i) - 0.5 * float(n_x - 1)
    y = float(j) - 0.5 * float(n_y - 1)
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if x * x + y * y <= radius * radius:
        inverse = 1.0 / width
        reach = 0.5 * (1.0 + width)
        taps = int(wp.ceil(2.0 * reach))
        for angle in range(n_angle):
            ray = look_up(light, n_across, n_along, directions[angle, 0], directions[angle, 1], x, y)
            first = int(wp.ceil(ray[0] - reach))
            for tap in range(wp.max(first, 0), wp.min(first + taps, n_r)):
                total += (ray[1] * overlap(ray[0] - float(tap), reach, inverse)) * sinogram[slab, angle, tap, lane]
    volume[slab, i, j, lane] = total


@wp.func
def line(
    p: float, cos_d: float, sin_d: float, c0: float, s0: float, along_y: int, planes_middle: float, cells_middle: float
):
    c = c0 * cos_d - s0 * sin_d
    s = s0 * cos_d + c0 * sin_d
    if along_y == 1:
        return wp.vec2(-p / s - planes_middle * c / s + cells_middle, c / s)
    return wp.vec2(p / c - planes_middle * s / c + cells_middle, s / c)


@wp.kernel
def forward_refracted(
    volume: wp.array4d(dtype=wp.vec4),
    directions: wp.array2d(dtype=float),
    light: wp.array3d(dtype=float),
    edges: wp.array2d(dtype=float),
    width: float,
    radius: float,
    sinogram: wp.array4d(dtype=wp.vec4),
    n_x: int,
    n_y: int,
    n_z: int,
    n_angle: int,
    n_across: int,
    n_along: int,
    n_r: int,
):
    slab, angle, r, lane = wp.tid()
    x0 = 0.5 * float(n_x - 1)
    y0 = 0.5 * float(n_y - 1)
    inverse = 1.0 / width
    reach = 0.5 * (1.0 + width)
    c = directions[angle, 0]
    s = directions[angle, 1]
    along_y = int(0)
    planes = n_x
    cells = n_y
    planes_middle = x0
    cells_middle = y0
    # the chord's own direction decides which planes it crosses most steeply
    if wp.abs(s * edges[r, 1] + c * edges[r, 2]) > wp.abs(c * edges[r, 1] - s * edges[r, 2]):
        along_y = int(1)
        planes = n_y
        cells = n_x
        planes_middle = y0
        cells_middle = x0
    low = line(edges[r, 0], edges[r, 1], edges[r, 2], c, s, along_y, planes_middle, cells_middle)
    high = line(edges[r, 4], edges[r, 5], edges[r, 6], c, s, along_y, planes_middle, cells_middle)
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for plane in range(planes):
        a = low[0] + float(plane) * low[1]
        b = high[0] + float(plane) * high[1]
        begin = wp.max(int(wp.ceil(wp.min(a, b) - edges[r, 3])), 0)
        end = wp.min(int(wp.floor(wp.max(a, b) + edges[r, 3])), cells - 1)
        for cell in range(begin, end + 1):
            i = plane
            j = cell
            if along_y == 1:
                i = cell
                j = plane
            x = float(i) - x0
            y = float(j) - y0
            if x * x + y * y <= radius * radius:
                ray = look_up(light, n_across, n_along, c, s, x, y)
                total += (ray[1] * overlap(ray[0] - float(r), reach, inverse)) * volume[slab, i, j, lane]
    sinogram[slab, angle, r, lane] = total
