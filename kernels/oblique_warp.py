"""Warp siblings of `oblique`; a thread owns four lanes of one sample."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

Field = wp.array4d(dtype=wp.vec4)


@wp.func
def overlap(distance: float, reach: float, inverse: float):
    """How much of a voxel, 2 reach - 1 = 1 / inverse columns wide, lies in a column that far from it."""
    return wp.clamp(reach - wp.abs(distance), 0.0, 1.0) * inverse


@wp.func
def node(light: wp.array3d(dtype=float), i: int, j: int):
    return wp.vec4(light[i, j, 0], light[i, j, 1], light[i, j, 2], light[i, j, 3])


@wp.func
def look_up(
    light: wp.array3d(dtype=float), n_across: int, n_along: int, poses: wp.array2d(dtype=float), angle: int,
    x: float, y: float,
):  # fmt: skip
    """Column index, weight, row of slice 0 and rows per slice of the light at a voxel, relative to the axis."""
    across = y * poses[angle, 0] - x * poses[angle, 1] + poses[angle, 2] + 0.5 * float(n_across - 1)
    along = -x * poses[angle, 0] - y * poses[angle, 1] + poses[angle, 3] + 0.5 * float(n_along - 1)
    i = wp.clamp(int(across), 0, n_across - 2)
    j = wp.clamp(int(along), 0, n_along - 2)
    a = across - float(i)
    b = along - float(j)
    near = node(light, i, j)
    far = node(light, i + 1, j)
    near += b * (node(light, i, j + 1) - near)
    far += b * (node(light, i + 1, j + 1) - far)
    return near + a * (far - near)


@wp.func
def even(stretch: float):
    """Height in rows of slices that stand so many rows apart: whole multiples of that share out every row evenly."""
    return stretch * wp.max(1.0, wp.floor(1.0 / stretch + 0.5))


@wp.func
def row_of(ray: wp.vec4, z: float, row0: float):
    """Where among the rows a slice stands, z counted from the middle; the same sum in both directions."""
    return z * ray[3] + (ray[2] + row0)


@wp.func
def sample(source: Field, i: int, j: int, z: int, lanes: int):
    """Sample z of a column: neighbors in z sit in one slab, or in the next."""
    vector = source[z // lanes, i, j, (z % lanes) // 4]
    return vector[z % 4]


@wp.kernel
def back_oblique(
    sinogram: Field,
    poses: wp.array2d(dtype=float),
    light: wp.array3d(dtype=float),
    width: float,
    radius: float,
    lanes: int,
    volume: Field,
    n_angle: int,
    n_r: int,
    n_row: int,
    n_across: int,
    n_along: int,
    n_x: int,
    n_y: int,
    n_z: int,
):
    slab, i, j, lane = wp.tid()
    x = float(i) - 0.5 * float(n_x - 1)
    y = float(j) - 0.5 * float(n_y - 1)
    reach = 0.5 * (1.0 + width)
    taps = int(wp.ceil(2.0 * reach))
    first_z = float(4 * (slab * volume.shape[3] + lane)) - 0.5 * float(n_z - 1)
    row0 = 0.5 * float(n_row - 1)
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if x * x + y * y <= radius * radius:
        for angle in range(n_angle):
            ray = look_up(light, n_across, n_along, poses, angle, x, y)
            first = int(wp.ceil(ray[0] - reach))
            reach_z = 0.5 * (1.0 + even(ray[3]))
            taps_z = int(wp.ceil(2.0 * reach_z))
            for tap in range(wp.max(first, 0), wp.min(first + taps, n_r)):
                weight = ray[1] * overlap(ray[0] - float(tap), reach, 1.0 / width) / even(ray[3])
                for k in range(4):
                    position = row_of(ray, first_z + float(k), row0)
                    place = int(wp.ceil(position - reach_z))
                    for row in range(wp.max(place, 0), wp.min(place + taps_z, n_row)):
                        apart = position - float(row)
                        share = weight * wp.clamp(reach_z - wp.abs(apart), 0.0, wp.min(1.0, even(ray[3])))
                        total[k] = total[k] + share * sample(sinogram, angle, tap, row, lanes)
    volume[slab, i, j, lane] = total


@wp.func
def line(edges: wp.array2d(dtype=float), r: int, at: int, poses: wp.array2d(dtype=float), angle: int, along_y: bool):
    """Where a chord (p, cos d, sin d) at one pose crosses the middle plane, and how far it drifts a plane."""
    c = poses[angle, 0] * edges[r, at + 1] - poses[angle, 1] * edges[r, at + 2]
    s = poses[angle, 1] * edges[r, at + 1] + poses[angle, 0] * edges[r, at + 2]
    p = edges[r, at] - poses[angle, 2] * edges[r, at + 1] - poses[angle, 3] * edges[r, at + 2]
    crossing = wp.vec2(p / c, s / c)
    if along_y:
        crossing = wp.vec2(-p / s, c / s)
    return crossing


@wp.kernel
def forward_oblique(
    volume: Field,
    poses: wp.array2d(dtype=float),
    light: wp.array3d(dtype=float),
    edges: wp.array2d(dtype=float),
    width: float,
    radius: float,
    lanes: int,
    sinogram: Field,
    n_x: int,
    n_y: int,
    n_slice: int,
    n_angle: int,
    n_across: int,
    n_along: int,
    n_r: int,
    n_z: int,
):
    slab, angle, r, lane = wp.tid()
    x0 = 0.5 * float(n_x - 1)
    y0 = 0.5 * float(n_y - 1)
    z0 = 0.5 * float(n_slice - 1)
    reach = 0.5 * (1.0 + width)
    first_row = 4 * (slab * sinogram.shape[3] + lane)
    row0 = 0.5 * float(n_z - 1)
    c = poses[angle, 0] * edges[r, 1] - poses[angle, 1] * edges[r, 2]
    s = poses[angle, 1] * edges[r, 1] + poses[angle, 0] * edges[r, 2]
    along_y = wp.abs(s) > wp.abs(c)
    planes = n_x
    cells = n_y
    if along_y:
        planes = n_y
        cells = n_x
    low = line(edges, r, 0, poses, angle, along_y)
    high = line(edges, r, 4, poses, angle, along_y)
    slack = edges[r, 3]
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for plane in range(planes):
        step = float(plane) - 0.5 * float(planes - 1)
        a = low[0] + step * low[1] + 0.5 * float(cells - 1)
        b = high[0] + step * high[1] + 0.5 * float(cells - 1)
        begin = wp.max(int(wp.ceil(wp.min(a, b) - slack)), 0)
        end = wp.min(int(wp.floor(wp.max(a, b) + slack)), cells - 1)
        for cell in range(begin, end + 1):
            i = plane
            j = cell
            if along_y:
                i = cell
                j = plane
            x = float(i) - x0
            y = float(j) - y0
            if x * x + y * y <= radius * radius:
                ray = look_up(light, n_across, n_along, poses, angle, x, y)
                weight = ray[1] * overlap(ray[0] - float(r), reach, 1.0 / width) / even(ray[3])
                if weight != 0.0:
                    reach_z = 0.5 * (1.0 + even(ray[3]))
                    for k in range(4):
                        row = float(first_row + k)
                        middle = (row - row0 - ray[2]) / ray[3] + z0
                        span = reach_z / ray[3]
                        from_z = wp.max(int(wp.floor(middle - span)), 0)
                        to_z = wp.min(int(wp.ceil(middle + span)), n_slice - 1)
                        for z in range(from_z, to_z + 1):
                            apart = row_of(ray, float(z) - z0, row0) - row
                            share = weight * wp.clamp(reach_z - wp.abs(apart), 0.0, wp.min(1.0, even(ray[3])))
                            total[k] = total[k] + share * sample(volume, i, j, z, lanes)
    sinogram[slab, angle, r, lane] = total
